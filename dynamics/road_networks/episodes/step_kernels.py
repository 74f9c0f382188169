"""Kernels for many episodes on one road network: reset and step as one compiled call over environments."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynamics.compiled import kernel_no_refcount
from dynamics.highway_simulator.arrays import Machine
from dynamics.highway_simulator.layout import CRASHED, EGO, KIND, SPEED
from dynamics.highway_simulator.random import seed_row
from dynamics.road_networks.episodes.arrivals import (
    ArrivalRules,
    IntersectionRules,
    clear_and_spawn,
    spawn_intersection,
)
from dynamics.road_networks.episodes.observe import AHEAD, KinematicsWork, RoadObservationConfig, kinematics
from dynamics.road_networks.episodes.placing import ResetTables, place_row
from dynamics.road_networks.episodes.rewards import RewardRules, reward_of_decision
from dynamics.road_networks.episodes.time_to_collision import TimeAheadWork, time_ahead
from dynamics.road_networks.geometry.layout import FRAMES
from dynamics.road_networks.simulation.frame_kernels import (
    NetworkRules,
    NetworkWork,
    NetworkWorlds,
    advance,
    command,
    ego_of,
    hold,
    traffic_of,
)
from dynamics.state import FloatArray, IntArray

__all__ = [
    "EpisodeRules",
    "EpisodeWork",
    "Episodes",
    "RoadStepResults",
    "begin",
    "finish",
    "reset_all",
    "start_next_episode",
    "step_all",
]


class Episodes(NamedTuple):
    """The state of all environments: roads, random generators (e, 6), and number of decisions since the reset (e,)."""

    worlds: NetworkWorlds
    rows: NDArray[np.uint64]
    decisions: IntArray


class EpisodeRules(NamedTuple):
    """The constants of all environments."""

    drive: NetworkRules
    scene: ResetTables
    coming: ArrivalRules
    sight: RoadObservationConfig
    worth: RewardRules


class EpisodeWork(NamedTuple):
    """Buffers of the kernels, overwritten: of the frames, and of an observation."""

    drive: NetworkWork
    near: IntArray
    away: FloatArray
    seen: FloatArray
    stack: IntArray
    ahead: FloatArray


class RoadStepResults(NamedTuple):
    """Results of a step, one entry for each environment.

    Attributes
    ----------
    observations : (e, rows, features). terminal : the same at the end of an episode, before a reset.
    reward, terminated, truncated : (e,).
    parts : (e, 5), terms of the reward (`rewards.NAMES`).
    speed : (e,), of the ego [m/s]. crashed : (e,), whether the ego has crashed.
    full : (e,), whether a vehicle may not have entered for lack of room.
    """

    observations: NDArray[np.float32]
    terminal: NDArray[np.float32]
    reward: FloatArray
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    parts: FloatArray
    speed: FloatArray
    crashed: NDArray[np.bool_]
    full: NDArray[np.bool_]


@kernel_no_refcount
def _restart(machine: Machine, episodes: Episodes, rules: EpisodeRules, work: EpisodeWork, e: int) -> None:
    """Draw a new scene in one environment."""
    worlds, row, scene = episodes.worlds, episodes.rows[e], rules.scene
    worlds.clock[e], episodes.decisions[e] = 0.0, 0
    if len(rules.coming.arms) > 0:
        spawn_intersection(machine, worlds, IntersectionRules(rules.drive, scene, rules.coming), work.drive, row, e)
        return
    f, g, p = worlds.f[e], worlds.g[e], worlds.p[e]
    traffic, n = traffic_of(machine, worlds, rules.drive.network, e), 0
    for k in range(len(scene.rows)):
        n = place_row(row, scene, traffic, work.drive.numbers, n, k)
    worlds.counts[e, 0] = n
    for j in range(scene.standing.shape[1]):
        for k in range(f.shape[0]):
            f[k, n] = scene.standing[k, j]
        for k in range(g.shape[0]):
            g[k, n] = scene.standing_ids[k, j]
        for k in range(p.shape[0]):
            p[k, n] = scene.standing_sizes[k, j]
        n += 1
    worlds.counts[e, 1] = n
    g[FRAMES, 0] = 0
    for i in range(n):
        worlds.order[e, i] = i


@kernel_no_refcount
def _show(
    machine: Machine,
    episodes: Episodes,
    rules: EpisodeRules,
    work: EpisodeWork,
    e: int,
    out: NDArray[np.float32],
) -> None:
    """Fill in the observation of one environment, `out` (rows, features)."""
    worlds, view = episodes.worlds, rules.sight
    ego, traffic = ego_of(worlds.g[e]), traffic_of(machine, worlds, rules.drive.network, e)
    if view.kind == AHEAD:
        buffers = TimeAheadWork(work.stack, work.ahead)
        time_ahead(traffic, view, ego, rules.drive.target_speeds, worlds.counts[e, 0], buffers, out)
        return
    kinematics(episodes.rows[e], traffic, view, ego, KinematicsWork(work.near, work.away, work.seen), out)


@kernel_no_refcount
def begin(machine: Machine, episodes: Episodes, rules: EpisodeRules, e: int, action: FloatArray) -> None:
    """Begin a decision in one environment: apply its action."""
    worlds = episodes.worlds
    worlds.clock[e] += rules.drive.times[1]
    episodes.decisions[e] += 1
    ego = ego_of(worlds.g[e])
    if worlds.g[e, KIND, ego] == EGO:
        command(machine, worlds, rules.drive, e, ego, int(action[0]))
    else:
        hold(worlds, e, action[0], action[1])


@kernel_no_refcount
def finish(
    machine: Machine,
    episodes: Episodes,
    rules: EpisodeRules,
    work: EpisodeWork,
    seen: RoadStepResults,
    e: int,
    action: FloatArray,
) -> None:
    """End a decision in one environment: observation, reward, and whether the episode ends; then vehicles leave and
    enter."""
    worlds, worth = episodes.worlds, rules.worth
    _show(machine, episodes, rules, work, e, seen.observations[e])
    ego, traffic = ego_of(worlds.g[e]), traffic_of(machine, worlds, rules.drive.network, e)
    which = int(action[0]) if traffic.g[KIND, ego] == EGO else -1
    speeds, vehicles = rules.drive.target_speeds, worlds.counts[e, 0]
    seen.reward[e], seen.terminated[e] = reward_of_decision(traffic, worth, speeds, ego, vehicles, which, seen.parts[e])
    seen.speed[e], seen.crashed[e] = traffic.f[SPEED, ego], traffic.g[CRASHED, ego] != 0
    cut = worth.decisions > 0 and episodes.decisions[e] >= worth.decisions
    seen.truncated[e] = cut or worlds.clock[e] >= worth.duration
    if len(rules.coming.arms) > 0:
        constants = IntersectionRules(rules.drive, rules.scene, rules.coming)
        has_space = clear_and_spawn(machine, worlds, constants, work.drive, episodes.rows[e], e)
        seen.full[e] = seen.full[e] or not has_space


@kernel_no_refcount
def reset_all(
    machine: Machine,
    episodes: Episodes,
    rules: EpisodeRules,
    work: EpisodeWork,
    seen: RoadStepResults,
    which: IntArray,
    seeds: IntArray,
) -> None:
    """Reset environments. With a negative seed, the environment's generator continues."""
    for k in range(len(which)):
        e = which[k]
        if seeds[k] >= 0:
            seed_row(episodes.rows[e], seeds[k])
        _restart(machine, episodes, rules, work, e)
        _show(machine, episodes, rules, work, e, seen.observations[e])
        seen.speed[e], seen.crashed[e] = episodes.worlds.f[e, SPEED, ego_of(episodes.worlds.g[e])], False


@kernel_no_refcount
def start_next_episode(
    machine: Machine, episodes: Episodes, rules: EpisodeRules, work: EpisodeWork, seen: RoadStepResults, e: int
) -> None:
    """Start the next episode in one environment; `seen.terminal` gets the last observation."""
    for k in range(seen.observations.shape[1]):
        for c in range(seen.observations.shape[2]):
            seen.terminal[e, k, c] = seen.observations[e, k, c]
    _restart(machine, episodes, rules, work, e)
    _show(machine, episodes, rules, work, e, seen.observations[e])


@kernel_no_refcount
def step_all(
    machine: Machine,
    episodes: Episodes,
    rules: EpisodeRules,
    work: EpisodeWork,
    seen: RoadStepResults,
    actions: FloatArray,
    part: tuple[int, int, bool],
) -> None:
    """One decision in each of the environments of a part: from its first to its last number, the last excluded. With
    its third entry, ended episodes are reset."""
    first, last, again = part
    for e in range(first, last):
        begin(machine, episodes, rules, e, actions[e])
        for _ in range(rules.drive.numbers[0]):
            advance(machine, episodes.worlds, rules.drive, work.drive, e)
        finish(machine, episodes, rules, work, seen, e, actions[e])
        if again and (seen.terminated[e] or seen.truncated[e]):
            start_next_episode(machine, episodes, rules, work, seen, e)
