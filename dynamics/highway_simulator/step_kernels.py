"""Kernels for many episodes at once: reset and step as one compiled call over environments."""

from __future__ import annotations

import math
from typing import Any

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.arithmetic import clip
from dynamics.highway_simulator.arrays import (
    Bodies,
    LaneNeighbours,
    Machine,
    ObservationConfig,
    Rules,
    Simulation,
    StepResults,
    Work,
    Worlds,
)
from dynamics.highway_simulator.collisions import BodiesByX, collide
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
    "NO_INPUTS",
    "advance",
    "begin",
    "begin_next_episode",
    "finish",
    "first_equal_actions",
    "frame",
    "reset_all",
    "step_all",
    "write_row",
    "write_rows",
]

NO_INPUTS = math.nan, math.nan
"""Inputs of a frame in which the ego's controllers choose them, see `advance`."""


@kernel_inline
def _bodies(worlds: Worlds, rules: Rules, e: int) -> Bodies:
    """The bodies of one environment."""
    return Bodies(worlds.f[e], worlds.g[e], worlds.p[e], rules.lanes)


@kernel_no_refcount
def _restart(worlds: Worlds, rules: Rules, e: int) -> None:
    """Draw a new scene in one environment."""
    spawn(worlds.rows[e], _bodies(worlds, rules, e), rules)
    worlds.clock[e] = 0.0
    for i in range(worlds.order.shape[1]):
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
    machine: Machine, worlds: Worlds, rules: Rules, work: Work, e: int, level: bool, inputs: tuple[float, float]
) -> bool:
    """Advance one environment by a frame. `level` is the result of `sort` before the frame; the result is that after
    it. `inputs` are the ego's throttle [m/s^2] and front wheel angle [rad] in this frame, NaN for its controllers'."""
    throttle, wheel = inputs
    f, g, p, order = worlds.f[e], worlds.g[e], worlds.p[e], worlds.order[e]
    vehicles, dt, bodies = rules.numbers[1], rules.times[0], _bodies(worlds, rules, e)
    find(f, g, order, level, work.front, work.rear)
    act(machine, bodies, LaneNeighbours(work.front, work.rear), work.numbers, work.busy, vehicles)
    if not math.isnan(throttle):
        f[ACCELERATION, 0] = throttle
    if not math.isnan(wheel):
        f[STEERING, 0] = wheel
    move(machine.loops, bodies, work.numbers, work.busy, vehicles, dt)
    level = sort(f, order)
    collide(machine, BodiesByX(f, g, p, order, vehicles), work.corners, work.pairs, dt)
    return level


@kernel_no_refcount
def _reward_of_decision(rules: Rules, f: FloatArray, g: IntArray, parts: FloatArray) -> tuple[float, bool]:
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
    bodies = _bodies(worlds, rules, e)
    if len(view.grid) > 0:
        occupancy_grid(bodies, rules.numbers[1], view, work.seen, out)
        return
    kinematics(machine.sums, worlds.rows[e], bodies, view, work, out)


@kernel_no_refcount
def finish(
    machine: Machine, worlds: Worlds, rules: Rules, view: ObservationConfig, work: Work, seen: StepResults, e: int
) -> None:
    """End a decision in one environment: observation, reward, and whether the episode ends; see `StepResults`."""
    f, g = worlds.f[e], worlds.g[e]
    _show(machine, worlds, rules, view, work, e, seen.observations[e])
    reward, on = _reward_of_decision(rules, f, g, seen.parts[e])
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
def write_rows(worlds: Worlds, rules: Rules, e: int, rows: FloatArray) -> bool:
    """Write the bodies of one environment to `rows`, (m, 7), see `frame`, and return whether the ego is on the road."""
    f, g, p, lanes = worlds.f[e], worlds.g[e], worlds.p[e], rules.lanes
    for i in range(f.shape[1]):
        write_row(f, g, p, i, rows[i])
    return on_lane(lanes, g[LANE, 0], f[X, 0], f[Y, 0], 0.0)


@kernel_no_refcount
def frame(simulation: Simulation, e: int, throttle: float, wheel: float, rows: FloatArray) -> bool:
    """Advance one environment by a frame, and return whether the ego is on the road afterwards.

    Parameters
    ----------
    throttle, wheel : inputs of the ego in place of those of its controllers [m/s^2, rad]; NaN for its controllers.
    rows : (m, 7), written: x, y [m], heading [rad], speed [m/s], length, width [m], crashed, of each body.
    """
    machine, worlds, rules, _, work, _ = simulation
    advance(machine, worlds, rules, work, e, sort(worlds.f[e], worlds.order[e]), (throttle, wheel))
    return write_rows(worlds, rules, e, rows)


@kernel_no_refcount
def reset_all(simulation: Simulation, which: IntArray, seeds: IntArray) -> None:
    """Reset environments. With a negative seed, the environment's generator continues."""
    machine, worlds, rules, view, work, seen = simulation
    for k in range(len(which)):
        e = which[k]
        if seeds[k] >= 0:
            seed_row(worlds.rows[e], seeds[k])
        _restart(worlds, rules, e)
        _show(machine, worlds, rules, view, work, e, seen.observations[e])
        seen.speed[e], seen.parts[e, 0] = worlds.f[e, SPEED, 0], 0.0


@kernel_no_refcount
def step_all(simulation: Simulation, actions: FloatArray, first: int, last: int, again: bool) -> None:
    """One decision in each of the environments from `first` to `last`, `last` excluded; with `again`, ended episodes
    are reset."""
    machine, worlds, rules, view, work, seen = simulation
    for e in range(first, last):
        begin(worlds, rules, e, actions[e])
        level = sort(worlds.f[e], worlds.order[e])
        for _ in range(rules.numbers[0]):
            level = advance(machine, worlds, rules, work, e, level, NO_INPUTS)
        finish(machine, worlds, rules, view, work, seen, e)
        if again and (seen.terminated[e] or seen.truncated[e]):
            begin_next_episode(machine, worlds, rules, view, work, seen, e)
