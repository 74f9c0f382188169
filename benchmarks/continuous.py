"""What filtering throttle and steering costs, against a policy's own `predict` in the same run, with one thread.

    python benchmarks/continuous.py [--decisions 2000] [--deadline 10]

highway-v0 with ContinuousAction at 20 Hz. The proposals are those of a lane keeper at constant speed (which verify,
mostly) and of full throttle (which do not). Frames and predictions are measured in turn.
"""

from __future__ import annotations

import argparse
from time import perf_counter
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from stable_baselines3 import PPO

from dynamics.scenes.scene import SceneReader
from dynamics.vehicle.actuators import Actuators
from shield import ShieldConfig
from shield.pipelines.decide import DecisionCore
from shield.pipelines.inputs import InputPipeline

CONFIG = {"action": {"type": "ContinuousAction"}, "simulation_frequency": 20, "policy_frequency": 20, "duration": 30}


def measure(decisions: int, throttle: bool) -> tuple[list[float], list[float], list[float]]:
    """Times [ms] of passed and of filtered frames, and of the policy's `predict`."""
    env = gym.make("highway-v0", config=CONFIG)
    net = {"net_arch": {"pi": [256, 256], "vf": [256, 256]}}
    policy = PPO("MlpPolicy", env, policy_kwargs=net, device="cpu", seed=0)
    actuators = Actuators.of(env.unwrapped.action_type)  # type: ignore[attr-defined]
    procedure, reader = InputPipeline(ShieldConfig(), actuators), SceneReader(env)
    core = DecisionCore(procedure)
    passed: list[float] = []
    filtered: list[float] = []
    own: list[float] = []
    seed, done, obs = 0, True, None
    while len(own) < decisions:
        if done:
            obs, _ = env.reset(seed=seed)
            core.reset()
            procedure.prepare(reader.read())
            seed += 1
        start = perf_counter()
        policy.predict(obs, deterministic=True)
        own.append(1e3 * (perf_counter() - start))
        scene = reader.read()
        v, psi = float(scene.ego[3]), float(scene.ego_road[2])
        wheel = -0.5 * psi - 0.01 * (scene.ego_road[1] - scene.road.centers[scene.road.lane_at(scene.ego_road[1])])
        proposal = np.array([5.0 if throttle else 0.3 * (18.0 - v), float(np.clip(wheel, -0.2, 0.2))])
        start = perf_counter()
        decision = core.decide(scene, proposal)
        (filtered if decision.overridden else passed).append(1e3 * (perf_counter() - start))
        obs, _, terminated, truncated, _ = env.step(actuators.normalised(decision.executed))
        done = terminated or truncated
    env.close()
    return passed, filtered, own


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--decisions", type=int, default=2000, help="frames for each kind of proposal")
    parser.add_argument("--deadline", type=float, default=10.0, help="deadline of a frame [ms]")
    options = parser.parse_args()
    torch.set_num_threads(1)
    calm, wild = measure(options.decisions, False), measure(options.decisions, True)
    own = float(np.median(calm[2] + wild[2]))
    table = Table("path", "frames", "p50 ms", "p99 ms", "p99 / p50", "x PPO predict", f"> {options.deadline:g} ms")
    rows: list[tuple[str, Any]] = [("passed", calm[0] + wild[0]), ("filtered", calm[1] + wild[1])]
    rows.append(("PPO predict [256, 256]", calm[2] + wild[2]))
    for name, times in rows:
        if times:
            low, high = np.percentile(times, [50, 99])
            late = int(np.sum(np.array(times) > options.deadline))
            cells = (f"{low:.3f}", f"{high:.3f}", f"{high / low:.1f}", f"{low / own:.1f}", str(late))
            table.add_row(name, str(len(times)), *cells)
    Console().print(table)


if __name__ == "__main__":
    main()
