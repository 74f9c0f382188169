"""Driving episodes: one record each, paired over the same seeds, in parallel.

A seed fixes the traffic and everything random in the policy, so the records (but for the
latencies) are the same whatever the number of jobs.
"""

from __future__ import annotations

import math
import os
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from threading import Thread
from typing import Any, cast

import gymnasium as gym
import joblib
import numpy as np
import pandas as pd
from rich.console import Console
from rich.progress import Progress

from dynamics.roads.path import PathRoad
from evaluation.measuring.attribution import AttributionRules, attribute_from_simulator_state
from evaluation.measuring.recorder import History, Recorder, Track
from evaluation.running.driving_model import driving_model
from evaluation.running.named_policies import Policy, make_policy, policy_label, start_episode
from evaluation.running.records import EpisodeRecord, Variant
from evaluation.running.simulators import environment
from evaluation.running.store import Store
from evaluation.settings import Setting, get_setting
from evaluation.threads import one_thread
from shield import Shield, ShieldedEnv
from shield.decision import Reason, Tier
from shield.errors import ConfigError

__all__ = ["Driver", "run_episode", "run_paired"]

_CHUNK = 25


@dataclass(slots=True)
class _Tally:
    """Counts that an episode adds up, decision by decision."""

    overridden: int = 0
    frames_overridden: int = 0
    violations: int | None = 0
    rules: Counter[str] = field(default_factory=Counter)
    min_margin: float = float("nan")
    reasons: Counter[str] = field(default_factory=Counter)
    tiers: Counter[str] = field(default_factory=Counter)
    latencies: list[float] = field(default_factory=list)

    def add(self, shield: Mapping[str, Any]) -> None:
        self.overridden += bool(shield["overridden"])
        self.frames_overridden += int(shield["frames_overridden"])
        violations = shield["violations"]
        if violations is None or self.violations is None:
            self.violations = None
        else:
            self.violations += int(violations)
        self.rules.update(shield["rules"])
        if np.isfinite(shield["margin"]):
            self.min_margin = float(np.fmin(self.min_margin, shield["margin"]))
        self.reasons[Reason(shield["reason"]).value] += 1
        self.tiers[Tier(shield["tier"]).value] += 1
        self.latencies.append(float(shield["latency_ms"]))


_UNSHIELDED: dict[str, Any] = {
    "overridden": False,
    "frames_overridden": 0,
    "violations": None,
    "rules": {},
    "margin": float("nan"),
    "reason": Reason.NONE.value,
    "tier": Tier.OFF.value,
}


class Driver:
    """One variant, ready to drive episode after episode in the same environment.

    Parameters
    ----------
    setting, policy, variant, algorithm, model, simulator, sensor : as in `run_episode`.

    Attributes
    ----------
    env : with the shield around it, where that is its door. policy : bare. driver : what proposes, with the shield
        around it where that is its door. recorder : of the last episode.
    """

    recorder: Recorder

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
        self.label = _label(policy, model)
        learned = driving_model(model, self.env)
        self.policy: Policy = make_policy(policy, self.env, algorithm, learned) if isinstance(policy, str) else policy
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
        self.rules = AttributionRules(assumptions=variant.config.assumptions, braking=variant.config.braking)

    def run(self, seed: int) -> EpisodeRecord:
        """Drive the episode with this seed to its end."""
        tally, total, steps, info = _Tally(), 0.0, 0, dict[str, Any]()
        for reward, info in self.decisions(seed):
            tally.add(self._shield_info(info))
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
            **_driving(history),
            mean_jerk=history.mean_jerk(),
            mean_lateral_acceleration=history.mean_lateral_acceleration(),
            overridden=tally.overridden,
            reasons=dict(tally.reasons),
            tiers=dict(tally.tiers),
            frames=len(history.states) - 1,
            frames_overridden=tally.frames_overridden,
            violations=tally.violations,
            min_margin=tally.min_margin,
            min_gap=history.min_gap(),
            latencies=tuple(tally.latencies) if self.variant.door != "none" else (),
            simulator=self.simulator,
            rules=dict(tally.rules),
            **_arrival(info, self.env, history),
        )

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
        self.recorder = Recorder(env)
        state, steps, done = None, 0, False
        while not done:
            action, state = self.driver.predict(obs, state, episode_start=np.array([steps == 0]), deterministic=True)
            steps += 1
            if before is not None:
                before(steps)
            obs, reward, terminated, truncated, info = env.step(_plain(action))
            yield float(reward), info
            done = bool(terminated or truncated)

    def _shield_info(self, info: Mapping[str, Any]) -> Mapping[str, Any]:
        if self.variant.door == "none":
            return {**_UNSHIELDED, "latency_ms": 0.0}
        if self.shield is not None:
            return {**self.shield.report(), "latency_ms": 1e3 * self.shield.latency}
        assert isinstance(self.env, ShieldedEnv)
        return {**info["shield"], "latency_ms": 1e3 * self.env.latency}


def _plain(action: Any) -> Any:
    """A single integer out of its array; any other action as it is."""
    array = np.asarray(action)
    return int(array.item()) if array.size == 1 and array.dtype.kind in "iu" else action


def _arrival(info: Mapping[str, Any], env: gym.Env[Any, Any], history: History) -> dict[str, Any]:
    """Whether the goal was reached, and how fast; a crash on arrival is no success. An intersection says it itself."""
    base = cast(Any, env.unwrapped)
    if "is_success" in info:
        reached = bool(np.all(info["is_success"]))
    elif hasattr(base, "has_arrived"):
        reached = bool(base.has_arrived(base.vehicle))
    else:
        return {"success": None, "arrival_speed": math.nan}
    success = reached and history.crash_frame is None
    speed = abs(float(history.ego[-1, Track.SPEED]))
    return {"success": success, "arrival_speed": speed if success else math.nan}


def _driving(history: History) -> dict[str, Any]:
    """Speed, way and lanes of the ego, up to a crash."""
    crash, road = history.crash_frame, history.road
    ego = history.ego if crash is None else history.ego[: crash + 1]
    driving = {"duration": (len(ego) - 1) * history.dt, "mean_speed": float(ego[:, Track.SPEED].mean())}
    if road is None:
        steps = np.diff(ego[:, [Track.S, Track.R]], axis=0)
        way = float(np.hypot(steps[:, 0], steps[:, 1]).sum())
        return driving | {"distance": way, "lane_changes": np.nan, "laps": np.nan}
    way = float(ego[-1, Track.S] - ego[0, Track.S])
    lanes = [road.lane_at(float(r)) for r in ego[:, Track.R]]
    closed = isinstance(road, PathRoad) and road.closed
    return driving | {
        "distance": way,
        "lane_changes": float(np.count_nonzero(np.diff(lanes))),
        "laps": way / road.length if closed else np.nan,
    }


def run_episode(
    setting: str | Setting,
    policy: str | Policy,
    variant: Variant | None = None,
    seed: int = 100_000,
    algorithm: str | None = None,
    model: str | None = None,
    simulator: str = "auto",
    sensor: str = "exact",
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
    """
    setting = get_setting(setting) if isinstance(setting, str) else setting
    driver = Driver(setting, policy, variant or Variant(), algorithm, model, simulator, sensor)
    try:
        with one_thread():
            return driver.run(seed)
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
    """
    setting = get_setting(setting) if isinstance(setting, str) else setting
    variants, seeds = list(variants), list(seeds)
    if not variants or not seeds:
        raise ConfigError(f"nothing to run: {len(variants)} variants, {len(seeds)} episodes")
    if jobs == 0:
        raise ConfigError("jobs must be at least 1, or -1 for one per core")
    if model not in (None, "bicycle") and policy != "mpc" and not any(v.door == "env" for v in variants):
        raise ConfigError("a model is for mpc and for the shield's door env; none of the two drives here")
    workers = joblib.effective_n_jobs(jobs)
    rows: list[dict[str, Any]] = []
    done: set[tuple[str, str, int]] = set()
    if store is not None:
        label = _label(policy, model)
        done = store.done(setting.name, label)
        rows = [row for row in store.rows if (row["setting"], row["policy"]) == (setting.name, label)]
    # One episode a call where each is kept as it finishes: the driver is, too.
    size = 1 if store is not None else min(_CHUNK, -(-len(seeds) // workers))
    calls = []
    for variant in variants:
        left = [seed for seed in seeds if (variant.place, variant.mode, seed) not in done]
        calls += [
            (setting, policy, variant, left[i : i + size], algorithm, model, simulator, sensor)
            for i in range(0, len(left), size)
        ]
    console, total, said = Console(stderr=True), len(seeds) * len(variants), 0
    with Progress(disable=not (progress and console.is_terminal), transient=True, console=console) as bar:
        task = bar.add_task(f"{setting.name}", total=total, completed=len(rows))
        for part in _results(calls, workers):
            rows += part
            if store is not None:
                store.add(part)
            bar.update(task, advance=len(part), description=f"{setting.name} ({_crashes(rows)})")
            if progress and not console.is_terminal and 10 * len(rows) // total > said:
                said = 10 * len(rows) // total
                text = f"{setting.name}: {len(rows)} of {total} episodes ({_crashes(rows)})"
                console.print(text, highlight=False, soft_wrap=True)
    order = {(v.place, v.mode): i for i, v in enumerate(variants)}
    place = {seed: i for i, seed in enumerate(seeds)}
    rows.sort(key=lambda row: (order[row["door"], row["mode"]], place[row["seed"]]))
    return pd.DataFrame(rows)


def _crashes(rows: list[dict[str, Any]]) -> str:
    """What has been found so far, by what stands between the policy and the environment."""
    driven: dict[str, list[int]] = {}
    for row in rows:
        name = "no shield" if row["door"] == "none" else f"{row['mode']} at {row['door']}"
        driven.setdefault(name, []).append(bool(row["crashed"]))
    return ", ".join(f"{name}: {sum(crashed)} of {len(crashed)} crashed" for name, crashed in driven.items())


def _label(policy: str | Policy, model: str | None) -> str:
    """The name that the episodes of a policy are reported under."""
    label = policy_label(policy) if isinstance(policy, str) else type(policy).__name__
    return label if model in (None, "bicycle") else f"{label}-{Path(str(model)).name}"


def _results(calls: list[tuple[Any, ...]], workers: int) -> Iterator[list[dict[str, Any]]]:
    if workers == 1:
        yield from (_run_chunk(*call) for call in calls)
        return
    # Workers that were started before the library was asked not to thread would still do so.
    with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
        pool = joblib.Parallel(n_jobs=workers, return_as="generator")
        yield from pool(joblib.delayed(_run_in_worker)(os.getpid(), *call) for call in calls)


def _run_in_worker(parent: int, *call: Any) -> list[dict[str, Any]]:
    _end_with(parent)
    return _run_chunk(*call)


@lru_cache(maxsize=1)
def _end_with(parent: int) -> None:
    """A worker whose parent was killed has nobody to work for."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    Thread(target=watch, daemon=True).start()


def _run_chunk(
    setting: Setting,
    policy: str | Policy,
    variant: Variant,
    seeds: list[int],
    algorithm: str | None,
    model: str | None,
    simulator: str,
    sensor: str,
) -> list[dict[str, Any]]:
    with one_thread():
        if len(seeds) == 1 and isinstance(policy, str):
            return [_kept(setting, policy, variant, algorithm, model, simulator, sensor).run(seeds[0]).row()]
        driver = Driver(setting, policy, variant, algorithm, model, simulator, sensor)
        try:
            return [driver.run(seed).row() for seed in seeds]
        finally:
            driver.env.close()


@lru_cache(maxsize=4)
def _kept(
    setting: Setting,
    policy: str,
    variant: Variant,
    algorithm: str | None,
    model: str | None,
    simulator: str,
    sensor: str,
) -> Driver:
    """A driver that is kept from one episode to the next."""
    return Driver(setting, policy, variant, algorithm, model, simulator, sensor)
