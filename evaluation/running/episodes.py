"""Driving episodes: one record each, paired over the same seeds, in parallel.

A seed fixes the traffic and everything random in the policy, so the records (but for the
latencies) are the same whatever the number of jobs.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import pandas as pd
from rich.console import Console
from rich.progress import Progress

from evaluation.measuring.attribution import AttributionRules, attribute_from_simulator_state
from evaluation.measuring.recorder import Recorder
from evaluation.running.counting import UNSHIELDED, Tally, arrival, driving
from evaluation.running.decision_log import DecisionLog
from evaluation.running.driving_model import driving_model
from evaluation.running.identity import check_files, hash_of_files
from evaluation.running.named_policies import Policy, make_policy, policy_label, start_episode
from evaluation.running.processes import Engine, Processes
from evaluation.running.records import EpisodeRecord, Variant
from evaluation.running.simulators import environment
from evaluation.running.store import Store
from evaluation.settings import Setting, get_setting
from evaluation.threads import one_thread
from shield import Shield, ShieldedEnv
from shield.decision import Decision, Verification
from shield.doors.adapters import refuse_misfits
from shield.errors import ConfigError

__all__ = ["Driver", "policy_name", "run_episode", "run_paired"]

_CHUNK = 25


class Driver:
    """One variant, ready to drive episode after episode in the same environment.

    Parameters
    ----------
    setting, policy, variant, algorithm, model, simulator, sensor : as in `run_episode`.

    Attributes
    ----------
    env : with the shield around it, where that is its door. policy : bare. driver : what proposes, with the shield
        around it where that is its door. recorder, log : of the last episode.
    """

    recorder: Recorder
    log: DecisionLog

    def __init__(
        self,
        setting: Setting,
        policy: str | Policy,
        variant: Variant,
        algorithm: str | None,
        model: str | None,
        simulator: str,
        sensor: str = "exact",
    ) -> None:
        self.setting, self.variant = setting, variant
        self.simulator, self.env = environment(setting, policy, variant, model, simulator, sensor)
        self.label = policy_name(policy, model)
        learned = driving_model(model, self.env)
        self.policy: Policy = make_policy(policy, self.env, algorithm, learned) if isinstance(policy, str) else policy
        refuse_misfits(self.policy, self.env)
        self.driver: Policy = self.policy
        self.shield: Shield | None = None
        if variant.door == "env":
            self.env = ShieldedEnv(
                self.env, variant.config, policy=self.policy, model=learned, perception=variant.perception
            )
        elif variant.door in ("policy", "actions"):
            frames = variant.door == "policy"
            self.shield = Shield(self.policy, self.env, variant.config, frames, variant.perception)
            self.driver = self.shield
        self._taken: tuple[Any, Any] = (None, None)
        """The last observation, and the action that was taken on it."""
        self.rules = AttributionRules(assumptions=variant.config.assumptions, braking=variant.config.braking)

    @property
    def verification(self) -> Verification:
        """What actions are verified against."""
        if self.variant.door == "none":
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
        after : called after each step with the time at which it began [s] and the shield's record of it.
        before : see `decisions`.
        """
        tally, total, steps, info = Tally(), 0.0, 0, dict[str, Any]()
        period = 1.0 / float(cast(Any, self.env.unwrapped).config["policy_frequency"])
        for reward, info in self.decisions(seed, before):
            told = self._shield_info(info)
            tally.add(told)
            shielded = self.env if self.shield is None else self.shield
            own = shielded.decisions if isinstance(shielded, ShieldedEnv | Shield) else []
            self.log.add(*self._taken, reward, told, own[0] if len(own) == 1 else None)
            if after is not None and isinstance(shielded, ShieldedEnv | Shield) and shielded.last_decision is not None:
                after(steps * period, shielded.last_decision)
            total += reward
            steps += 1
        history = self.recorder.history()
        return EpisodeRecord(
            setting=self.setting.name,
            policy=self.label,
            door=self.variant.place,
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
            latencies=tuple(tally.latencies) if self.variant.door != "none" else (),
            simulator=self.simulator,
            rules=dict(tally.rules),
            verification=self.verification.value,
            **self.log.columns(history, self.variant.door != "none"),
            **arrival(info, self.env, history),
        )

    def steps(self) -> dict[str, list[Any]]:
        """The decisions of the last episode, a list of each column (see `DecisionLog.steps`)."""
        return self.log.steps(self.recorder.history())

    def decisions(
        self, seed: int, before: Callable[[int], None] | None = None
    ) -> Iterator[tuple[float, dict[str, Any]]]:
        """Drive the episode with this seed to its end: the reward and the info of each decision.

        Parameters
        ----------
        before : called with the number of each decision, from 1 on, once it is taken and before it is carried out.
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
        if self.variant.door == "none":
            return {**UNSHIELDED, "latency_ms": 0.0}
        if self.shield is not None:
            return {**self.shield.report(), "latency_ms": 1e3 * self.shield.latency}
        assert isinstance(self.env, ShieldedEnv)
        return {**info["shield"], "latency_ms": 1e3 * self.env.latency}


def _plain(action: Any) -> Any:
    """A single integer out of its array; any other action as it is."""
    array = np.asarray(action)
    return int(array.item()) if array.size == 1 and array.dtype.kind in "iu" else action


def run_episode(
    setting: str | Setting,
    policy: str | Policy,
    variant: Variant | None = None,
    seed: int = 100_000,
    algorithm: str | None = None,
    model: str | None = None,
    simulator: str = "auto",
    sensor: str = "exact",
    after: Callable[[float, Decision], None] | None = None,
) -> EpisodeRecord:
    """Drive one episode.

    Parameters
    ----------
    setting, policy : by name or as objects; a policy may also be the path of an SB3 zip file.
    variant : what stands between the two; nothing by default.
    seed : seed of the traffic and of the policy.
    algorithm : the SB3 algorithm of a zip file without a manifest.
    model : what `mpc` and the predictive filter of door "env" plan with (see
        `evaluation.running.driving_model.driving_model`).
    simulator : one of `SIMULATORS`. sensor : a name in `evaluation.wrappers.SENSORS`, and channels. Of both see
        `evaluation.running.simulators.environment`.
    after : see `Driver.run`.
    """
    setting = get_setting(setting) if isinstance(setting, str) else setting
    driver = Driver(setting, policy, variant or Variant(), algorithm, model, simulator, sensor)
    try:
        with one_thread():
            return driver.run(seed, after)
    finally:
        driver.env.close()


def run_paired(
    setting: str | Setting,
    policy: str | Policy,
    variants: Iterable[Variant],
    seeds: Iterable[int],
    *,
    jobs: int = 1,
    algorithm: str | None = None,
    model: str | None = None,
    simulator: str = "auto",
    sensor: str = "exact",
    progress: bool = False,
    store: Store | None = None,
    steps: bool = False,
    engine: Engine | None = None,
) -> pd.DataFrame:
    """Drive every variant on the same seeds; one row per episode, by variant and then seed.

    Parameters
    ----------
    setting, policy, algorithm, model, simulator, sensor : as in `run_episode`.
    variants : what to compare.
    seeds : seeds of the episodes.
    jobs : processes; -1 for one per core.
    progress : whether to show a bar; where the output is no terminal, a line now and then.
    store : where each episode is written as it finishes; what is there is not driven again.
    steps : whether each row has a column "decisions", see `Driver.steps`.
    engine : what makes the calls, instead of `jobs` processes.
    """
    setting = get_setting(setting) if isinstance(setting, str) else setting
    variants, seeds = list(variants), list(seeds)
    if not variants or not seeds:
        raise ConfigError(f"nothing to run: {len(variants)} variants, {len(seeds)} episodes")
    if jobs == 0:
        raise ConfigError("jobs must be at least 1, or -1 for one per core")
    if model not in (None, "bicycle") and policy != "mpc" and not any(v.door == "env" for v in variants):
        raise ConfigError("a model is for mpc and for the shield's door env; none of the two drives here")
    engine = Processes(jobs) if engine is None else engine
    workers = engine.workers
    rows: list[dict[str, Any]] = []
    done: set[tuple[str, str, int]] = set()
    if store is not None:
        label = policy_name(policy, model)
        done = store.done(setting.name, label)
        rows = [row for row in store.rows if (row["setting"], row["policy"]) == (setting.name, label)]
        asked = {(variant.place, variant.mode, seed) for variant in variants for seed in seeds}
        rows = [row for row in rows if (row["door"], row["mode"], row["seed"]) in asked]
    # Few episodes a call where each is kept as it finishes: the driver is, too.
    size = min(_CHUNK if store is None else engine.most, -(-len(seeds) // workers))
    calls = []
    files = hash_of_files(policy, model) if isinstance(policy, str) else ""
    for variant in variants:
        driven = _Driven(setting, policy, variant, algorithm, model, simulator, sensor, files, steps, store is not None)
        left = [seed for seed in seeds if (variant.place, variant.mode, seed) not in done]
        calls += [(driven, left[i : i + size]) for i in range(0, len(left), size)]
    console, total, said = Console(stderr=True), len(seeds) * len(variants), 0
    driven_so_far: dict[str, list[int]] = {}
    _count(rows, driven_so_far)
    with Progress(disable=not (progress and console.is_terminal), transient=True, console=console) as bar:
        task = bar.add_task(f"{setting.name}", total=total, completed=len(rows))
        for part in engine.spread(_run_chunk, calls):
            rows += part
            if store is not None:
                store.add(part)
            if not progress:
                continue
            _count(part, driven_so_far)
            bar.update(task, advance=len(part), description=f"{setting.name} ({_crashes(driven_so_far)})")
            if not console.is_terminal and 10 * len(rows) // total > said:
                said = 10 * len(rows) // total
                text = f"{setting.name}: {len(rows)} of {total} episodes ({_crashes(driven_so_far)})"
                console.print(text, highlight=False, soft_wrap=True)
    order = {(v.place, v.mode): i for i, v in enumerate(variants)}
    place = {seed: i for i, seed in enumerate(seeds)}
    rows.sort(key=lambda row: (order[row["door"], row["mode"]], place[row["seed"]]))
    return pd.DataFrame(rows)


def _count(rows: Iterable[Mapping[str, Any]], driven: dict[str, list[int]]) -> None:
    """Add crashes and episodes, by what stands between the policy and the environment."""
    for row in rows:
        name = "no shield" if row["door"] == "none" else f"{row['mode']} at {row['door']}"
        counted = driven.setdefault(name, [0, 0])
        counted[0] += bool(row["crashed"])
        counted[1] += 1


def _crashes(driven: Mapping[str, list[int]]) -> str:
    """What has been found so far."""
    return ", ".join(f"{name}: {crashed} of {count} crashed" for name, (crashed, count) in driven.items())


def policy_name(policy: str | Policy, model: str | None) -> str:
    """The name that the episodes of a policy are reported under."""
    label = policy_label(policy) if isinstance(policy, str) else type(policy).__name__
    return label if model in (None, "bicycle") else f"{label}-{Path(str(model)).name}"


class _Driven(NamedTuple):
    """What is driven, as of `run_episode`; `files` are the hashes of what the policy is read from, `steps` whether
    decisions are written down, and `kept` whether the driver is kept from one call to the next."""

    setting: Setting
    policy: str | Policy
    variant: Variant
    algorithm: str | None
    model: str | None
    simulator: str
    sensor: str
    files: str
    steps: bool
    kept: bool

    def driver(self) -> Driver:
        """Ready to drive it.

        Raises
        ------
        PolicyError
            If the files of the policy have changed since the hashes were taken.
        """
        driver = Driver(*self[:-3])
        if isinstance(self.policy, str):
            check_files(self.policy, self.model, self.files)
        return driver


def _run_chunk(driven: _Driven, seeds: list[int]) -> list[dict[str, Any]]:
    with one_thread():
        if driven.kept and isinstance(driven.policy, str):
            driver = _kept(driven)
            return [_row(driver, seed, driven.steps) for seed in seeds]
        driver = driven.driver()
        try:
            return [_row(driver, seed, driven.steps) for seed in seeds]
        finally:
            driver.env.close()


def _row(driver: Driver, seed: int, steps: bool) -> dict[str, Any]:
    """The row of an episode."""
    row = driver.run(seed).row()
    return {**row, "decisions": json.dumps(driver.steps())} if steps else row


@lru_cache(maxsize=4)
def _kept(driven: _Driven) -> Driver:
    """A driver that is kept from one episode to the next, while the files that its policy is read from are the same."""
    return driven.driver()
