"""The compiled networks against highway-env in the same run, in turns: decisions of random meta-actions, resets,
observations and rewards included, with `RoadSimulator`, many environments in a call, and with `CompiledFrames` around
highway-env; and their frames alone (no observation and no reward on either side).

    python benchmarks/networks.py [--decisions 60] [--environments 64]

Processor seconds, so that other work on the machine counts as little as it can. Seeds from 0.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable
from time import process_time
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np

from dynamics.road_networks.episodes.simulator import RoadSimulator
from dynamics.road_networks.simulation.compiled_frames import CompiledFrames
from dynamics.road_networks.simulation.simulator import NetworkSimulator
from evaluation.settings import setting_of

IDS = (
    *("merge-v0", "merge-v1", "merge-generic-v0", "roundabout-v0", "roundabout-v1", "roundabout-generic-v0"),
    *("exit-v0", "exit-v1", "two-way-v0", "u-turn-v0", "u-turn-v1", "intersection-v0", "intersection-v1"),
    "intersection-v2",
)
_AT_ONCE = 6
"""Decisions of highway-env between two turns."""


def seconds(work: Callable[[], object]) -> float:
    """Processor seconds that something takes."""
    start = process_time()
    work()
    return process_time() - start


def episodes(env: gym.Env[Any, Any], decisions: int) -> Callable[[], None]:
    """Drives on by so many decisions at each call, from episode to episode."""
    env.action_space.seed(0)
    env.reset(seed=0)

    def work() -> None:
        for _ in range(decisions):
            *_, terminated, truncated, _ = env.step(env.action_space.sample())
            if terminated or truncated:
                env.reset()

    return work


def whole(env_id: str, decisions: int, count: int) -> tuple[float, float, float]:
    """Seconds of a decision: highway-env, with its frames compiled, and compiled altogether."""
    plain = setting_of(env_id).make()
    theirs, framed = episodes(plain, _AT_ONCE), episodes(CompiledFrames(setting_of(env_id).make()), _AT_ONCE)
    simulator, space = RoadSimulator(env_id, count), plain.action_space
    simulator.reset(range(count))
    turns = max(1, decisions // _AT_ONCE)
    given = [np.array([space.sample() for _ in range(count)]) for _ in range(20)]
    for actions in given:  # so that episodes are at all of their stages
        simulator.step(actions, again=True)

    def ours() -> None:
        for actions in given[:_AT_ONCE]:
            simulator.step(actions, again=True)

    spent = np.array([(seconds(theirs), seconds(framed), seconds(ours)) for _ in range(turns)]).sum(axis=0)
    return tuple(spent / (turns * _AT_ONCE) / (1, 1, count))


def frames(env_id: str, decisions: int) -> tuple[float, float]:
    """Seconds of the frames of a decision: highway-env's `_simulate`, and `NetworkSimulator.step` of one scene."""
    env = setting_of(env_id).make().unwrapped
    if not isinstance(env.action_space, gym.spaces.Discrete):
        return np.nan, np.nan
    theirs = ours = 0.0
    count, seed = 0, -1
    while count < decisions:
        seed += 1
        env.reset(seed=seed)
        simulator, rng = NetworkSimulator(env), np.random.default_rng(seed)
        while not env.vehicle.crashed and env.time < 10:
            action = int(rng.integers(env.action_space.n))
            env.time += 1 / env.config["policy_frequency"]
            theirs += seconds(lambda action=action: env._simulate(action))
            ours += seconds(lambda action=action, simulator=simulator: simulator.step(action))
            count += 1
    return theirs / count, ours / count


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--decisions", type=int, default=60)
    parser.add_argument("--environments", type=int, default=64)
    arguments = parser.parse_args()
    warnings.filterwarnings("ignore", category=DeprecationWarning)
    gym.logger.min_level = gym.logger.ERROR
    frames(IDS[0], 1)
    whole(IDS[0], 1, 1)
    print(
        "| environment | highway-env ms | frames compiled ms | ratio | all compiled µs | ratio "
        "| frames alone: highway-env ms | compiled ms | ratio |"
    )
    print(f"| :-- |{' --: |' * 8}")
    for env_id in IDS:
        theirs, framed, ours = whole(env_id, arguments.decisions, arguments.environments)
        cells = [f"{1e3 * theirs:.1f}", f"{1e3 * framed:.2f}", f"{theirs / framed:.0f}"]
        cells += [f"{1e6 * ours:.0f}", f"**{theirs / ours:.0f}**"]
        one, other = frames(env_id, arguments.decisions)
        cells += ["", "", ""] if np.isnan(one) else [f"{1e3 * one:.1f}", f"{1e3 * other:.2f}", f"{one / other:.0f}"]
        print(f"| {env_id} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
