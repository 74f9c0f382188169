"""Simulation of a refused proposal in a copy of the environment, in highway-env itself."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import gymnasium as gym
import numpy as np
from highway_env.envs.common.action import DiscreteMetaAction

from evaluation.measuring.recorder import is_off_road
from evaluation.measuring.rectangles import separation
from evaluation.replay.record import WhatIf, poses
from evaluation.running.named_policies import make_policy, start_episode
from shield.explanation import number

__all__ = ["LASTS", "copy_without_recorder", "follow", "what_if"]

LASTS = 4.0
"""Duration of the simulation, with the actions after the proposal [s]."""


def copy_without_recorder(env: Any) -> Any:
    """A copy of an environment without recorders and supervision, with the state of its random generators."""
    copied = deepcopy(env)
    base = copied.unwrapped
    base.road.__dict__.pop("step", None)  # a recorder's `step` is bound to the original road
    for vehicle in base.road.vehicles:
        vehicle.__dict__.pop("act", None)
    return copied


class _StateRecorder:
    """Records the states of all bodies in each frame: x, y, heading, speed, length, width, by body."""

    def __init__(self, base: Any) -> None:
        self._base, inner = base, base.road.step
        self.frames: list[dict[Any, list[float]]] = []
        self.crash: int | None = None
        self.off_road = False
        self._read()

        def step(dt: float) -> None:
            inner(dt)
            self._read()

        base.road.step = step

    def _read(self) -> None:
        road = self._base.road
        bodies = [*road.vehicles, *(each for each in road.objects if each.solid)]
        self.frames.append({v: [*v.position, v.heading, v.speed, v.LENGTH, v.WIDTH] for v in bodies})
        if self._base.vehicle.crashed and self.crash is None:
            self.crash = len(self.frames) - 1
        self.off_road = self.off_road or is_off_road(self._base)


def follow(copied: Any, action: Any, policy: str, seed: int) -> tuple[_StateRecorder, str]:
    """Simulate an action in a copy, and then go on for `LASTS` seconds or to a crash.

    After a meta-action the ego drives with IDLE, else with the policy, unshielded.

    Parameters
    ----------
    copied : result of `copy_without_recorder`; it is driven.
    action : the first action.
    policy : name of the policy.
    seed : seed of the policy.

    Returns
    -------
    The recorded states, and what drove after the action, in words.
    """
    base = copied.unwrapped
    watched, frames = _StateRecorder(base), round(LASTS * base.config["simulation_frequency"])
    meta = isinstance(base.action_type, DiscreteMetaAction) and "IDLE" in base.action_type.actions_indexes
    then = "IDLE" if meta else f"{policy}, unshielded"
    driver: Any = None
    while True:
        obs, *_ = copied.step(action)  # also beyond the end of the episode
        if watched.crash is not None or len(watched.frames) > frames:
            return watched, then
        if meta:
            action = base.action_type.actions_indexes["IDLE"]
            continue
        if driver is None:
            driver = make_policy(policy, copied)
            start_episode(driver, seed)
        action, _ = driver.predict(obs, deterministic=True)


def what_if(
    copied: gym.Env[Any, Any], action: Any, policy: str, seed: int, buffer: tuple[float, float], column: dict[Any, int]
) -> WhatIf:
    """Simulate a refused proposal, see `follow`, and measure its result.

    Parameters
    ----------
    copied, action, policy, seed : as in `follow`.
    buffer : buffer along and across the ego [m].
    column : index of each body in the replay, by the object in the copy.
    """
    base: Any = copied.unwrapped
    watched, then = follow(copied, action, policy, seed)
    ego, dt = base.vehicle, 1.0 / base.config["simulation_frequency"]
    frames = watched.frames[: len(watched.frames) if watched.crash is None else watched.crash + 1]
    path = np.array([frame[ego] for frame in frames])
    gap, within, nearest, first = np.inf, False, None, len(path) - 1
    for k, frame in enumerate(frames):
        others = [body for body in frame if body is not ego]
        if not others:
            continue
        rows = np.array([frame[body] for body in others])
        gaps = separation(path[k], rows)
        within = within or bool((separation(path[k] + [0, 0, 0, 0, 2 * buffer[0], 2 * buffer[1]], rows) <= 0).any())
        if gaps.min() < gap:
            gap, nearest, first = float(gaps.min()), others[int(gaps.argmin())], k
    time = dt * (first if watched.crash is None else watched.crash)
    gap = 0.0 if watched.crash is not None else gap
    near = [] if nearest is None else [frame[nearest] for frame in frames if nearest in frame]
    lasts = dt * (len(path) - 1)
    return WhatIf(
        then,
        _text(watched, gap, within, time, lasts),
        watched.crash is not None,
        watched.off_road,
        time,
        gap,
        within,
        column.get(nearest, -1),
        poses(path),
        poses(np.array(near)) if near else [],
    )


def _text(watched: _StateRecorder, gap: float, within: bool, time: float, lasts: float) -> str:
    """The result in words."""
    off = ", and leaves the road" if watched.off_road else ""
    if watched.crash is not None:
        return f"the ego crashes after {number(time)} s{off}"
    if not np.isfinite(gap):
        return f"the ego is alone for {number(lasts)} s{off}"
    near = "comes within the buffer" if within else "keeps out of the buffer"
    return (
        f"no crash in {number(lasts)} s; the ego {near}, with {number(gap, 2)} m at least, after {number(time)} s{off}"
    )
