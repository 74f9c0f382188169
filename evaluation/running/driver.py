"""One variant of the shield that drives one episode after another in the same environment."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from evaluation.measuring.attribution import AttributionRules, attribute_from_simulator_state
from evaluation.measuring.recorder import Recorder
from evaluation.running.counting import UNSHIELDED, Tally, arrival, driving
from evaluation.running.decision_log import DecisionLog
from evaluation.running.driving_model import driving_model
from evaluation.running.named_policies import Policy, make_policy, policy_label, start_episode
from evaluation.running.records import EpisodeRecord, ShieldVariant
from evaluation.running.simulators import environment
from evaluation.settings import Setting
from shield import Shield, ShieldedEnv
from shield.decision import Decision, Verification
from shield.wrappers.policy_adapters import refuse_misfits

__all__ = ["Driver", "DriverSpec", "policy_name"]


class DriverSpec(NamedTuple):
    """Specification of a driver.

    Attributes
    ----------
    setting : the environment.
    policy : name, path of an SB3 zip file, or an object with `predict`.
    variant : the shield between policy and environment.
    algorithm : SB3 algorithm of a zip file without a manifest.
    model : dynamics model of `mpc` and of the predictive filter in a `ShieldedEnv` (see
        `evaluation.running.driving_model.driving_model`).
    simulator : one of `SIMULATORS`; see `evaluation.running.simulators.environment`.
    sensor : a name in `evaluation.wrappers.SENSORS`, and channels; see `evaluation.running.simulators.environment`.
    """

    setting: Setting
    policy: str | Policy
    variant: ShieldVariant
    algorithm: str | None = None
    model: str | None = None
    simulator: str = "auto"
    sensor: str = "exact"


class Driver:
    """One variant of the shield that drives one episode after another in the same environment.

    Parameters
    ----------
    spec : specification of the driver.

    Attributes
    ----------
    env : the environment, as a `ShieldedEnv` for `placement` "env".
    policy : the policy without a shield.
    driver : the policy that drives, as a `Shield` for `placement` "policy" and "actions".
    recorder, log : records of the last episode.
    """

    recorder: Recorder
    log: DecisionLog

    def __init__(self, spec: DriverSpec) -> None:
        setting, policy, variant, algorithm, model, simulator, sensor = spec
        self.setting, self.variant = setting, variant
        self.simulator, self.env = environment(setting, policy, variant, model, simulator, sensor)
        self.label = policy_name(policy, model)
        learned = driving_model(model, self.env)
        self.policy: Policy = make_policy(policy, self.env, algorithm, learned) if isinstance(policy, str) else policy
        refuse_misfits(self.policy, self.env)
        self.driver: Policy = self.policy
        self.shield: Shield | None = None
        if variant.placement == "env":
            self.env = ShieldedEnv(
                self.env, variant.config, policy=self.policy, model=learned, perception=variant.perception
            )
        elif variant.placement in ("policy", "actions"):
            frames = variant.placement == "policy"
            self.shield = Shield(self.policy, self.env, variant.config, frames, variant.perception)
            self.driver = self.shield
        self._taken: tuple[Any, Any] = (None, None)
        """The last observation, and the action of the policy for it."""
        self.rules = AttributionRules(assumptions=variant.config.assumptions, braking=variant.config.braking)

    @property
    def verification(self) -> Verification:
        """What actions are verified against."""
        if self.variant.placement == "none":
            return Verification.OFF
        shielded = self.env if self.shield is None else self.shield
        assert isinstance(shielded, ShieldedEnv | Shield)
        return shielded.verification

    def run(
        self,
        seed: int,
        after: Callable[[float, Decision], None] | None = None,
        before: Callable[[int], None] | None = None,
    ) -> EpisodeRecord:
        """Drive the episode with this seed to its end.

        Parameters
        ----------
        seed : seed of the episode.
        after : called after each step with the time of its start [s] and the shield's decision.
        before : see `decisions`.
        """
        tally, total, steps, info = Tally(), 0.0, 0, dict[str, Any]()
        period = 1.0 / float(cast(Any, self.env.unwrapped).config["policy_frequency"])
        for reward, info in self.decisions(seed, before):
            record = self._shield_info(info)
            tally.add(record)
            shielded = self.env if self.shield is None else self.shield
            own = shielded.decisions if isinstance(shielded, ShieldedEnv | Shield) else []
            self.log.add(*self._taken, reward, record, own[0] if len(own) == 1 else None)
            if after is not None and isinstance(shielded, ShieldedEnv | Shield) and shielded.last_decision is not None:
                after(steps * period, shielded.last_decision)
            total += reward
            steps += 1
        history = self.recorder.history()
        return EpisodeRecord(
            setting=self.setting.name,
            policy=self.label,
            placement=self.variant.place,
            mode=self.variant.mode,
            seed=seed,
            crashed=history.crash_frame is not None,
            off_road=history.off_road,
            attribution=attribute_from_simulator_state(history, self.rules).value,
            return_=total,
            steps=steps,
            **driving(history),
            mean_jerk=history.mean_jerk(),
            mean_lateral_acceleration=history.mean_lateral_acceleration(),
            overridden=tally.overridden,
            held_back=tally.held_back,
            reasons=dict(tally.reasons),
            tiers=dict(tally.tiers),
            frames=len(history.states) - 1,
            frames_overridden=tally.frames_overridden,
            violations=tally.violations,
            min_margin=tally.min_margin,
            min_gap=history.min_gap(),
            min_time_to_collision=history.min_time_to_collision(),
            min_headway=history.min_headway(),
            latencies=tuple(tally.latencies) if self.variant.placement != "none" else (),
            simulator=self.simulator,
            rules=dict(tally.rules),
            verification=self.verification.value,
            **self.log.columns(history, self.variant.placement != "none"),
            **arrival(info, self.env, history),
        )

    def steps(self) -> dict[str, list[Any]]:
        """Columns of the decisions of the last episode (see `DecisionLog.steps`)."""
        return self.log.steps(self.recorder.history())

    def decisions(
        self, seed: int, before: Callable[[int], None] | None = None
    ) -> Iterator[tuple[float, dict[str, Any]]]:
        """Drive the episode with this seed to its end, and yield the reward and the info of each decision.

        Parameters
        ----------
        seed : seed of the episode.
        before : called with the number of each decision, from 1 on, between the choice of the action and its execution.
        """
        env = self.env
        obs, _ = env.reset(seed=seed)
        env.action_space.seed(seed)  # highway-env makes a new space at each reset
        start_episode(self.policy, seed)
        self.recorder, self.log = Recorder(env), DecisionLog(env)
        state, steps, done = None, 0, False
        while not done:
            action, state = self.driver.predict(obs, state, episode_start=np.array([steps == 0]), deterministic=True)
            steps += 1
            if before is not None:
                before(steps)
            self._taken = obs, action
            obs, reward, terminated, truncated, info = env.step(_plain(action))
            yield float(reward), info
            done = bool(terminated or truncated)

    def _shield_info(self, info: Mapping[str, Any]) -> Mapping[str, Any]:
        if self.variant.placement == "none":
            return {**UNSHIELDED, "latency_ms": 0.0}
        if self.shield is not None:
            return {**self.shield.report(), "latency_ms": 1e3 * self.shield.latency}
        assert isinstance(self.env, ShieldedEnv)
        return {**info["shield"], "latency_ms": 1e3 * self.env.latency}


def _plain(action: Any) -> Any:
    """A single integer out of its array; any other action unchanged."""
    array = np.asarray(action)
    return int(array.item()) if array.size == 1 and array.dtype.kind in "iu" else action


def policy_name(policy: str | Policy, model: str | None) -> str:
    """Name of a policy in the reports of its episodes."""
    label = policy_label(policy) if isinstance(policy, str) else type(policy).__name__
    return label if model in (None, "bicycle") else f"{label}-{Path(str(model)).name}"
