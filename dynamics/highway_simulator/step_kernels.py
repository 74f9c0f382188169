"""Kernels for many episodes at once: reset and step as one compiled call over environments."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.arithmetic import clip
from dynamics.highway_simulator.collisions import collide
from dynamics.highway_simulator.control import act
from dynamics.highway_simulator.grid import occupancy_grid
from dynamics.highway_simulator.lanes import on_lane, reachable
from dynamics.highway_simulator.layout import (
    ACCELERATION,
    COS,
    CRASHED,
    EGO,
    HEADING,
    KIND,
    LANE,
    LENGTH,
    SPEED,
    STEERING,
    TARGET,
    TARGET_SPEED,
    WIDTH,
    X,
    Y,
)
from dynamics.highway_simulator.motion import move
from dynamics.highway_simulator.neighbours import find, sort
from dynamics.highway_simulator.observe import kinematics
from dynamics.highway_simulator.random import seed_row
from dynamics.highway_simulator.scene import next_target_speed, spawn
from dynamics.state import FloatArray, IntArray

__all__ = [
    "Machine",
    "ObservationConfig",
    "Rules",
    "StepResults",
    "Work",
    "Worlds",
    "advance",
    "begin",
    "begin_next_episode",
    "finish",
    "first_equal_actions",
    "frame",
    "look",
    "reset_all",
    "step_all",
    "write_row",
]


class Machine(NamedTuple):
    """How numpy computes on this machine: `sums_of_numpy`, and the `addresses` of its loops."""

    sums: int
    products: int
    loops: IntArray


class Worlds(NamedTuple):
    """The state of e environments of m bodies (see `layout`).

    Attributes
    ----------
    f, g, p : (e, F, m), (e, G, m) and (e, P, m).
    order : (e, m), bodies by x.
    rows : (e, 6), the random generators. clock : (e,), time since the reset [s].
    """

    f: FloatArray
    g: IntArray
    p: FloatArray
    order: IntArray
    rows: NDArray[np.uint64]
    clock: FloatArray


class Rules(NamedTuple):
    """The constants of all environments.

    Attributes
    ----------
    lanes : (n, LANE_COLUMNS).
    numbers : frames of a decision, vehicles, ego's first lane or -1, whether the traffic checks for collisions, kinds
        of ego and traffic.
    times : duration of a frame, of a decision and of an episode [s].
    spacings : of ego and traffic, and exp(-lanes / 8).
    constants : (1 + c, P), of the ego and of the c classes of the traffic, which alternate.
    ranges : (6, 2), of the parameters that are drawn for each vehicle.
    target_speeds : of the ego [m/s]. labels : of each action: 0 left, 1 none, 2 right, 3 faster, 4 slower.
    reward : weights of collision, right lane, high speed and being on the road; the speeds mapped to 0 and 1 [m/s];
        whether it is normalised; and whether leaving the road ends an episode.
    """

    lanes: FloatArray
    numbers: tuple[int, int, int, int, int, int]
    times: tuple[float, float, float]
    spacings: tuple[float, float, float]
    constants: FloatArray
    ranges: FloatArray
    target_speeds: FloatArray
    labels: IntArray
    reward: tuple[float, float, float, float, float, float, bool, bool]


class ObservationConfig(NamedTuple):
    """The configuration of an observation: see `grid.occupancy_grid`, and `observe.kinematics` if `grid` is empty, (0,
    3)."""

    features: IntArray
    ranges: FloatArray
    switches: tuple[bool, bool, bool, bool, bool, bool]
    places: FloatArray
    grid: FloatArray


class Work(NamedTuple):
    """Buffers of the kernels, overwritten."""

    numbers: FloatArray
    busy: IntArray
    front: IntArray
    rear: IntArray
    corners: FloatArray
    pairs: IntArray
    seen: FloatArray


class StepResults(NamedTuple):
    """Results of a step, one entry for each environment.

    Attributes
    ----------
    observations : (e, bodies, features). terminal : the same at the end of an episode, before a reset.
    reward, terminated, truncated : (e,).
    parts : (e, 4), terms of the reward: crashed, right lane, high speed, on the road.
    speed : (e,), of the ego [m/s].
    """

    observations: NDArray[np.float32]
    terminal: NDArray[np.float32]
    reward: FloatArray
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    parts: FloatArray
    speed: FloatArray


@kernel_no_refcount
def _restart(worlds: Worlds, rules: Rules, e: int) -> None:
    """Draw a new scene in one environment."""
    numbers = rules.numbers
    f, g, p, row = worlds.f[e], worlds.g[e], worlds.p[e], worlds.rows[e]
    kinds = numbers[4], numbers[5]
    spawn(
        row,
        f,
        g,
        p,
        rules.lanes,
        numbers[1],
        kinds,
        rules.constants,
        rules.ranges,
        rules.spacings,
        rules.target_speeds,
        numbers[2],
        numbers[3] != 0,
    )
    worlds.clock[e] = 0.0
    for i in range(f.shape[1]):
        worlds.order[e, i] = i


@kernel_no_refcount
def _command(rules: Rules, f: FloatArray, g: IntArray, action: FloatArray) -> None:
    """Apply an action to the target command of the ego, or to its inputs."""
    if g[KIND, 0] != EGO:
        f[ACCELERATION, 0], f[STEERING, 0] = action[0], action[1]
        return
    label, lanes = rules.labels[int(action[0])], rules.lanes
    if label >= 3:
        f[TARGET_SPEED, 0] = next_target_speed(rules.target_speeds, f[SPEED, 0], label)
    elif label != 1:
        lane = min(max(g[TARGET, 0] + label - 1, 0), len(lanes) - 1)
        if reachable(lanes, lane, f[X, 0], f[Y, 0]):
            g[TARGET, 0] = lane


@kernel_inline
def advance(
    machine: Machine, worlds: Worlds, rules: Rules, work: Work, e: int, level: bool, throttle: float, wheel: float
) -> bool:
    """Advance one environment by a frame. `level` is the result of `sort` before the frame; the result is that after
    it."""
    f, g, p, order = worlds.f[e], worlds.g[e], worlds.p[e], worlds.order[e]
    vehicles, dt, lanes = rules.numbers[1], rules.times[0], rules.lanes
    find(f, g, order, level, work.front, work.rear)
    act(machine.sums, machine.loops, f, g, p, lanes, work.front, work.rear, work.numbers, work.busy, vehicles)
    if not math.isnan(throttle):
        f[ACCELERATION, 0] = throttle
    if not math.isnan(wheel):
        f[STEERING, 0] = wheel
    move(machine.loops, f, g, p, lanes, work.numbers, work.busy, vehicles, dt)
    level = sort(f, order)
    collide(machine.sums, machine.products, f, g, p, order, work.corners, work.pairs, vehicles, dt)
    return level


@kernel_no_refcount
def _judge(rules: Rules, f: FloatArray, g: IntArray, parts: FloatArray) -> tuple[float, bool]:
    """The reward of a decision, and whether the ego is on the road."""
    collision, right, fast, on_road, slow_end, fast_end, normalised, _ = rules.reward
    lanes, lane = rules.lanes, g[TARGET, 0] if g[KIND, 0] == EGO else g[LANE, 0]
    on = on_lane(lanes, g[LANE, 0], f[X, 0], f[Y, 0], 0.0)
    parts[0] = float(g[CRASHED, 0])
    parts[1] = lane / max(len(lanes) - 1, 1)
    parts[2] = clip((f[SPEED, 0] * f[COS, 0] - slow_end) / (fast_end - slow_end), 0.0, 1.0)
    parts[3] = 1.0 if on else 0.0
    reward = 0 + collision * parts[0]
    reward += right * parts[1]
    reward += fast * parts[2]
    reward += on_road * parts[3]
    if normalised:
        reward = 0.0 + (reward - collision) / (fast + right - collision)
    return reward * parts[3], on


@kernel_no_refcount
def _show(
    machine: Machine, worlds: Worlds, rules: Rules, view: ObservationConfig, work: Work, e: int, out: Any
) -> None:
    """Fill in the observation of one environment, `out` (rows, features)."""
    f, g, p, row = worlds.f[e], worlds.g[e], worlds.p[e], worlds.rows[e]
    if len(view.grid) > 0:
        occupancy_grid(
            f,
            g,
            rules.lanes,
            rules.numbers[1],
            view.features,
            view.ranges,
            view.places,
            view.grid,
            view.switches[2],
            work.seen,
            out,
        )
        return
    kinematics(
        machine.sums,
        row,
        f,
        g,
        p,
        rules.lanes,
        view.features,
        view.ranges,
        view.switches,
        work.busy,
        work.seen,
        out,
    )


@kernel_no_refcount
def finish(
    machine: Machine, worlds: Worlds, rules: Rules, view: ObservationConfig, work: Work, seen: StepResults, e: int
) -> None:
    """End a decision in one environment: observation, reward, and whether the episode ends; see `StepResults`."""
    f, g = worlds.f[e], worlds.g[e]
    _show(machine, worlds, rules, view, work, e, seen.observations[e])
    reward, on = _judge(rules, f, g, seen.parts[e])
    seen.reward[e], seen.speed[e] = reward, f[SPEED, 0]
    seen.terminated[e] = g[CRASHED, 0] != 0 or (rules.reward[7] and not on)
    seen.truncated[e] = worlds.clock[e] >= rules.times[2]


@kernel_no_refcount
def observe(
    machine: Machine, worlds: Worlds, rules: Rules, view: ObservationConfig, work: Work, seen: StepResults, e: int
) -> None:
    """Write the present observation of one environment to `seen.observations`; change nothing else."""
    _show(machine, worlds, rules, view, work, e, seen.observations[e])


@kernel_no_refcount
def begin_next_episode(
    machine: Machine, worlds: Worlds, rules: Rules, view: ObservationConfig, work: Work, seen: StepResults, e: int
) -> None:
    """Start the next episode in one environment; `seen.terminal` gets the last observation."""
    for k in range(seen.observations.shape[1]):
        for c in range(seen.observations.shape[2]):
            seen.terminal[e, k, c] = seen.observations[e, k, c]
    _restart(worlds, rules, e)
    _show(machine, worlds, rules, view, work, e, seen.observations[e])


@kernel_no_refcount
def begin(worlds: Worlds, rules: Rules, e: int, action: FloatArray) -> None:
    """Begin a decision in one environment: apply its action."""
    worlds.clock[e] += rules.times[1]
    _command(rules, worlds.f[e], worlds.g[e], action)


@kernel_no_refcount
def first_equal_actions(worlds: Worlds, rules: Rules, count: int, work: FloatArray, first: IntArray) -> None:
    """For each meta-action, the first one that leads to the same target lane and speed, in the first `count`
    environments, `first` (e, actions), written.

    Parameters
    ----------
    work : buffer, (actions + 1, 2), overwritten.
    """
    actions = first.shape[1]
    for e in range(count):
        f, g = worlds.f[e], worlds.g[e]
        target, speed = g[TARGET, 0], f[TARGET_SPEED, 0]
        for a in range(actions):
            work[actions, 0] = a
            _command(rules, f, g, work[actions])
            work[a, 0], work[a, 1] = g[TARGET, 0], f[TARGET_SPEED, 0]
            g[TARGET, 0], f[TARGET_SPEED, 0] = target, speed
            first[e, a] = a
            for b in range(a - 1, -1, -1):
                if work[b, 0] == work[a, 0] and work[b, 1] == work[a, 1]:
                    first[e, a] = b


@kernel_inline
def write_row(f: FloatArray, g: IntArray, p: FloatArray, i: int, row: FloatArray) -> None:
    """A body as a row, (7,): x, y [m], heading [rad], speed [m/s], length, width [m], crashed."""
    row[0], row[1], row[2], row[3] = f[X, i], f[Y, i], f[HEADING, i], f[SPEED, i]
    row[4], row[5], row[6] = p[LENGTH, i], p[WIDTH, i], float(g[CRASHED, i])


@kernel_inline
def look(worlds: Worlds, rules: Rules, e: int, rows: FloatArray) -> bool:
    """Write the bodies of one environment to `rows`, (m, 7), see `frame`, and return whether the ego is on the road."""
    f, g, p, lanes = worlds.f[e], worlds.g[e], worlds.p[e], rules.lanes
    for i in range(f.shape[1]):
        write_row(f, g, p, i, rows[i])
    return on_lane(lanes, g[LANE, 0], f[X, 0], f[Y, 0], 0.0)


@kernel_no_refcount
def frame(
    machine: Machine, worlds: Worlds, rules: Rules, work: Work, e: int, throttle: float, wheel: float, rows: FloatArray
) -> bool:
    """Advance one environment by a frame, and return whether the ego is on the road afterwards.

    Parameters
    ----------
    throttle, wheel : inputs of the ego in place of those of its controllers [m/s^2, rad]; NaN for its controllers.
    rows : (m, 7), written: x, y [m], heading [rad], speed [m/s], length, width [m], crashed, of each body.
    """
    advance(machine, worlds, rules, work, e, sort(worlds.f[e], worlds.order[e]), throttle, wheel)
    return look(worlds, rules, e, rows)


@kernel_no_refcount
def reset_all(
    machine: Machine,
    worlds: Worlds,
    rules: Rules,
    view: ObservationConfig,
    work: Work,
    seen: StepResults,
    which: IntArray,
    seeds: IntArray,
) -> None:
    """Reset environments. With a negative seed, the environment's generator continues."""
    for k in range(len(which)):
        e = which[k]
        if seeds[k] >= 0:
            seed_row(worlds.rows[e], seeds[k])
        _restart(worlds, rules, e)
        _show(machine, worlds, rules, view, work, e, seen.observations[e])
        seen.speed[e], seen.parts[e, 0] = worlds.f[e, SPEED, 0], 0.0


@kernel_no_refcount
def step_all(
    machine: Machine,
    worlds: Worlds,
    rules: Rules,
    view: ObservationConfig,
    work: Work,
    seen: StepResults,
    actions: FloatArray,
    first: int,
    last: int,
    again: bool,
) -> None:
    """One decision in each of the environments from `first` to `last`, `last` excluded; with `again`, ended episodes
    are reset."""
    for e in range(first, last):
        begin(worlds, rules, e, actions[e])
        level = sort(worlds.f[e], worlds.order[e])
        for _ in range(rules.numbers[0]):
            level = advance(machine, worlds, rules, work, e, level, math.nan, math.nan)
        finish(machine, worlds, rules, view, work, seen, e)
        if again and (seen.terminated[e] or seen.truncated[e]):
            begin_next_episode(machine, worlds, rules, view, work, seen, e)
