"""Batches of shielded episodes: the rows of `run_paired`, a hundred times as fast."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from dynamics.state import BoolArray, FloatArray, IntArray
from evaluation.measuring.side_by_side import BatchMeasures
from evaluation.measuring.tally import SOON, Tallies, begin_tally, empty_tallies, tally
from evaluation.policies import list_references
from evaluation.running.decision_log import action_steps
from evaluation.running.drivers_side_by_side import BatchDrivers, GivenActions, ModelBatchDrivers, OpenLoopDrivers
from evaluation.running.episodes import run_episode
from evaluation.running.named_policies import ConstantPolicy, RandomActions, WeavingPolicy, make_policy, policy_label
from evaluation.running.records import ShieldVariant, rules_text, variant_for
from evaluation.settings import Setting
from evaluation.threads import one_thread
from shield.batch.codes import FALLBACKS, rules_in
from shield.certificate.simulated.batch_choice import batch_for
from shield.config import ShieldConfig
from shield.errors import ConfigError

__all__ = ["UNMEASURED", "BatchResult", "Many"]

UNMEASURED = (
    *("acceleration_distance", "steering_distance", "mean_confidence", "latency_p50_ms", "latency_p99_ms"),
    *("latency_max_ms", "peak_jerk", "mean_normalised_jerk", "peak_normalised_jerk"),
)
"""Columns of an episode that are NaN in a batch. The decisions of all environments are timed together, no frames are
kept, meta-actions have no inputs, and sensors are exact."""

_ENVS = 50
"""Default number of environments in a batch; the parts of `shield certify` are a multiple of it."""
_BATCH_POLICIES = ("faster", "idle", "slower", "random", "weaving", "left", "right")
"""Baseline policies that ignore the observation."""


class BatchResult(NamedTuple):
    """Results of a batch of chosen episodes.

    Attributes
    ----------
    clearance : least clearance of each episode, (n,) [m]; 0 in a crash, positive elsewhere.
    time_to_collision : least time to a collision at constant velocities, (n,) [s]; 0 in a crash, positive elsewhere.
    offences : number of violations of the assumptions by the traffic, (n,).
    lost : whether the first decision was a fallback because no plan verified, (n,).
    """

    clearance: FloatArray
    time_to_collision: FloatArray
    offences: IntArray
    lost: BoolArray


class Many:
    """Runner of shielded episodes of one setting and policy, in a batch.

    Parameters
    ----------
    setting : the environment.
    policy : name of a policy, or path of a zip file.
    config : the shield's settings.
    envs : number of environments in the batch.
    chosen : whether scenes are chosen with `run_chosen`.

    Raises
    ------
    ConfigError
        If the batch does not support the environment, the shield's settings, or a policy that reads more than its
        observation.
    """

    def __init__(
        self, setting: Setting, policy: str, config: ShieldConfig, envs: int = _ENVS, chosen: bool = False
    ) -> None:
        known = policy in _BATCH_POLICIES or policy in list_references() or policy.endswith(".zip")
        if not known:
            raise ConfigError(
                f"{policy!r} does not drive side by side; have {', '.join(_BATCH_POLICIES)}, references and zip files"
            )
        self._highways = batch_for(setting.env_id, config)(
            setting.env_id, envs, setting.configured, config, replay_draws=chosen
        )
        self._setting, self._policy, self._config = setting, policy, config
        self.steps = self._highways.steps
        one: Any = self._highways.one()
        self._measures = BatchMeasures(envs, action_steps(one.unwrapped.action_type.actions))
        made = make_policy(policy, one)
        blind, self._draws = (
            isinstance(made, ConstantPolicy | RandomActions | WeavingPolicy),
            isinstance(made, RandomActions),
        )
        self._drivers: BatchDrivers = OpenLoopDrivers(made, envs, self.steps) if blind else ModelBatchDrivers(made)  # type: ignore[arg-type]
        if not blind and getattr(getattr(made, "policy", None), "lstm_actor", None) is not None:
            raise ConfigError(f"{policy!r} is recurrent; it drives one environment at a time")

    @property
    def exact(self) -> bool:
        """Whether numpy sums in the supported order on this machine, so that results are exact (`Simulator.exact`)."""
        return bool(self._highways.simulator.exact)

    def run(self, seeds: Sequence[int]) -> pd.DataFrame:
        """Drive the episodes of the seeds.

        Returns
        -------
        A row for each seed, in order: the columns of `run_paired` about the result, and `fallbacks`, the number of
        decisions with a fallback. The columns `UNMEASURED` are NaN.
        """
        rows: list[dict[str, Any]] = [{}] * len(seeds)

        def begin(i: int, k: int) -> None:
            self._highways.reset([seeds[k]], [i])
            self._drivers.begin(i, seeds[k])

        def end(i: int, k: int, tallies: Tallies, lost: bool) -> None:
            rows[k] = self._row(seeds[k], tallies, i)

        self._drive(len(seeds), begin, end, False)
        return pd.DataFrame(rows)

    @property
    def actions(self) -> int:
        """Number of meta-actions."""
        return self._highways.actions

    @property
    def draws(self) -> int:
        """Number of random numbers of a scene (see `Simulator.draws`)."""
        return int(self._highways.simulator.draws)

    def run_chosen(self, uniforms: FloatArray, actions: IntArray | None = None) -> BatchResult:
        """Drive episodes in chosen scenes.

        Parameters
        ----------
        uniforms : random numbers of each scene, (n, `draws`), see `Simulator.reset_to`.
        actions : proposals of each episode, (n, steps); those of the policy by default.

        Returns
        -------
        The results of the n episodes.

        Raises
        ------
        ConfigError
            If the policy draws its actions from the seed of an episode, since a chosen scene has no seed.
        """
        if actions is None and self._draws:
            raise ConfigError("random actions go by an episode's seed; in scenes of one's own choice have actions=")

        def begin(i: int, k: int) -> None:
            self._highways.reset_to(uniforms[k : k + 1], [i])
            self._drivers.begin(i, 0)

        return self._run(len(uniforms), begin, actions)

    def run_seeds(self, seeds: Sequence[int] | IntArray, actions: IntArray | None = None) -> BatchResult:
        """Drive the episodes of the seeds (n,); `actions` and the result are those of `run_chosen`."""

        def begin(i: int, k: int) -> None:
            self._highways.reset([int(seeds[k])], [i])
            self._drivers.begin(i, int(seeds[k]))

        return self._run(len(seeds), begin, actions)

    def _run(self, count: int, begin: Callable[[int, int], None], actions: IntArray | None) -> BatchResult:
        gaps, times, offences = np.empty(count), np.empty(count), np.zeros(count, np.intp)
        given_up = np.zeros(count, np.bool_)

        def end(i: int, k: int, tallies: Tallies, lost: bool) -> None:
            gaps[k], given_up[k] = tallies.min_gap[i], lost
            times[k] = 0.0 if tallies.crashed[i] else max(tallies.min_ttc[i], SOON)
            offences[k] = tallies.violations[i]

        def begin_planned(i: int, k: int) -> None:
            begin(i, k)
            if actions is not None:
                planned[i] = actions[k]

        drivers = self._drivers
        planned = np.zeros((self._highways.num_envs, 1 if actions is None else actions.shape[1]), np.intp)
        if actions is not None:
            self._drivers = GivenActions(planned)
        try:
            self._drive(count, begin_planned, end, True)
        finally:
            self._drivers = drivers
        return BatchResult(gaps, times, offences, given_up)

    def _drive(
        self, count: int, begin: Callable[[int, int], None], end: Callable[[int, int, Tallies, bool], None], times: bool
    ) -> None:
        """Drive `count` episodes.

        Parameters
        ----------
        begin : called with an environment and the index of the episode that starts in it.
        end : called with the environment, the index, the tallies, and whether the first decision was a fallback.
        times : whether times to a collision are measured.
        """
        highways, e = self._highways, self._highways.num_envs
        seen, tallies = highways.simulator.seen, empty_tallies(e)
        place, going, left = np.full(e, -1), np.zeros(e, np.bool_), 0
        lost = np.zeros(e, np.bool_)
        scene = np.empty((highways.rows.shape[2], highways.rows.shape[3]))
        steps = np.zeros(e, np.intp)

        def follow(i: int) -> None:
            nonlocal left
            steps[i], going[i] = 0, left < count
            if not going[i]:
                highways.reset([0], [i])
                return
            place[i] = left
            begin(i, left)
            on_road = highways.write_rows(i, scene)
            begin_tally(tallies, i, scene, not on_road, times)
            self._measures.begin(i, float(scene[0, 3]))
            left += 1

        with one_thread():
            for i in range(e):
                follow(i)
            while going.any():
                actions, orders = self._drivers.act(seen.observations, steps)
                highways.step(actions, orders)
                lost = np.where(steps == 0, FALLBACKS[highways.records.tier], lost)
                tally(tallies, highways.records, highways.rows, highways.off_road, seen.reward, going, times)
                self._measures.add(highways.records, highways.rows, highways.off_road, seen.reward, going)
                steps += going
                over = seen.terminated | seen.truncated
                for i in np.flatnonzero(over & going).tolist():
                    end(i, int(place[i]), tallies, bool(lost[i]))
                    follow(i)
                for i in np.flatnonzero(over & ~going).tolist():
                    highways.reset([0], [i])

    def _row(self, seed: int, tallies: Tallies, i: int) -> dict[str, Any]:
        crashed, attribution = bool(tallies.crashed[i]), "none"
        if crashed:
            # Crashes are rare enough to be driven again, one frame at a time.
            variant = ShieldVariant() if self._config.mode == "none" else variant_for(self._config)
            attribution = run_episode(self._setting, self._policy, variant, seed, simulator="compiled").attribution
        steps, frames = int(tallies.steps[i]), int(tallies.frames[i])
        return {
            **dict.fromkeys(UNMEASURED, float("nan")),
            "setting": self._setting.name,
            "policy": policy_label(self._policy),
            "mode": self._config.mode,
            "seed": seed,
            "crashed": crashed,
            "off_road": bool(tallies.off_road[i]),
            "attribution": attribution,
            "return": float(tallies.total[i]),
            "steps": steps,
            "mean_speed": float(tallies.speeds[i] / tallies.counted[i]),
            "overridden": int(tallies.overridden[i]),
            "held_back": int(tallies.held_back[i]),
            "frames": frames,
            "frames_overridden": int(tallies.frames_overridden[i]),
            "violations": int(tallies.violations[i]),
            "min_margin": float(tallies.min_margin[i]),
            "min_gap": float(tallies.min_gap[i]),
            "simulator": "compiled",
            "rules": rules_text(rules_in(tallies.broken[i])),
            "fallbacks": int(tallies.fallbacks[i]),
            "frame_override_share": float(tallies.frames_overridden[i] / frames),
            "mean_reward": float(tallies.total[i] / steps),
            **self._measures.columns(i, steps),
        }
