"""What the evaluation suite costs beside a bare loop, and what a second process or node gives.

    python benchmarks/evaluation_overhead.py [loop] [processes] [ray] [--rounds 5] [--episodes 20] [--jobs-episodes 200]
                                            [--only compiled]

- loop: processor time of `Experiment.run` with a store on the disk, over that of a loop that resets, predicts, steps
  and nothing else; the same environments, models, shields and seeds, in turns.
- processes, ray: wall time of one process over that of two, or of two Ray nodes of one core each on this machine (Ray
  has to be installed), in turns, both warm. Where other work takes cores, wall times say little: so beside it is twice
  the processor time of one process over that of all processes together, what two free cores would give at most.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from evaluation import Experiment
from evaluation.running.driver import Driver, DriverSpec
from evaluation.running.named_policies import start_episode
from evaluation.running.records import ShieldVariant, make_variants
from evaluation.settings import get_setting
from evaluation.threads import one_thread

FIRST_SEED = 1_150_000
SETTINGS = {
    "highway-fast, highway-env": ("highway-fast", "ppo-highway-fast", "highway-env"),
    "highway-fast, compiled": ("highway-fast", "ppo-highway-fast", "compiled"),
    "roundabout, compiled frames": ("roundabout", "ppo-roundabout", "auto"),
}
FASTER = 8
"""So many times as many episodes are driven where that is compiled: what a run costs once is spread over more."""


def bare(setting: str, policy: str, simulator: str, variants: list[ShieldVariant], seeds: range) -> None:
    """The same episodes without records."""
    for variant in variants:
        driver = Driver(DriverSpec(get_setting(setting), policy, variant, simulator=simulator))
        for seed in seeds:
            obs, _ = driver.env.reset(seed=seed)
            driver.env.action_space.seed(seed)
            start_episode(driver.policy, seed)
            done, state = False, None
            while not done:
                action, state = driver.driver.predict(obs, state, deterministic=True)
                obs, _, terminated, truncated, _ = driver.env.step(int(np.asarray(action).item()))
                done = bool(terminated or truncated)
        driver.env.close()


def suite(setting: str, policy: str, simulator: str, shields: list[str], seeds: range, **options: Any) -> None:
    """The same through the suite, kept on the disk as they finish."""
    with tempfile.TemporaryDirectory() as folder:
        Experiment(
            policy, setting, shields, episodes=len(seeds), seed=seeds.start, simulator=simulator,
            output=Path(folder, "x.parquet"), **options,
        ).run(progress=False)  # fmt: skip


def ratios(first: Callable[[range], None], second: Callable[[range], None], rounds: int, episodes: int) -> np.ndarray:
    """Processor and wall time of the second over that of the first in each round, (rounds, 2): in turns, with seeds
    of its own in each round."""
    found = []
    for k in range(-1, rounds):
        seeds = range(FIRST_SEED + (k + 1) * episodes, FIRST_SEED + (k + 2) * episodes)
        spent = {}
        for each in (first, second) if k % 2 else (second, first):
            start = np.array([time.process_time(), time.perf_counter()])
            with one_thread():
                each(seeds)
            spent[each] = np.array([time.process_time(), time.perf_counter()]) - start
        if k >= 0:  # the first round warms up
            found.append(spent[second] / spent[first])
    return np.array(found)


def loop(rounds: int, episodes: int, only: str) -> None:
    """Print the overhead over a bare loop, of the environments in whose name `only` is."""
    for name, (setting, policy, simulator) in SETTINGS.items():
        if only not in name:
            continue
        count = episodes if simulator == "highway-env" else FASTER * episodes
        for shield in ("none", "full"):
            variants = make_variants([shield], ["env"], None, ("simulator",), get_setting(setting))
            found = ratios(
                lambda seeds: bare(setting, policy, simulator, variants, seeds),  # noqa: B023
                lambda seeds: suite(setting, policy, simulator, [shield], seeds),  # noqa: B023
                rounds,
                count,
            )
            middle, low, high = 100 * (np.median(found, axis=0) - 1), 100 * (found.min(0) - 1), 100 * (found.max(0) - 1)
            print(
                f"loop: {name}, shield {shield}: {middle[0]:+.1f} % processor time ({low[0]:+.1f} to {high[0]:+.1f}), "
                f"{middle[1]:+.1f} % wall time ({low[1]:+.1f} to {high[1]:+.1f}); {count} episodes a round",
                flush=True,
            )


def family() -> dict[int, float]:
    """Processor time of this process and all below it, by process [s]."""
    parents, spent = {}, {}
    tick = os.sysconf("SC_CLK_TCK")
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                parts = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            parents[int(entry.name)] = int(parts[1])
            spent[int(entry.name)] = (int(parts[11]) + int(parts[12])) / tick
    mine, grown = {os.getpid()}, True
    while grown:
        more = {pid for pid, parent in parents.items() if parent in mine} - mine
        grown, mine = bool(more), mine | more
    return {pid: spent[pid] for pid in mine if pid in spent}


def measured(call: Callable[[], None]) -> tuple[float, float]:
    """Wall time of a call, and the processor time of all processes of this one, [s]."""
    before, start = family(), time.perf_counter()
    call()
    wall = time.perf_counter() - start
    return wall, sum(spent - before.get(pid, 0.0) for pid, spent in family().items())


def speed_up(name: str, one: dict[str, Any], two: dict[str, Any], rounds: int, episodes: int) -> None:
    """Print how much faster two are than one."""
    setting, policy, simulator = SETTINGS["highway-fast, highway-env"]
    walls, bounds = [], []
    for k in range(-1, rounds):
        seeds = range(FIRST_SEED + 50_000 + (k + 1) * episodes, FIRST_SEED + 50_000 + (k + 2) * episodes)
        seeds = seeds if k >= 0 else seeds[:8]  # the first round warms up
        found = {}
        for each, options in (("one", one), ("two", two)) if k % 2 else (("two", two), ("one", one)):
            found[each] = measured(lambda o=options, s=seeds: suite(setting, policy, simulator, ["full"], s, **o))
        if k >= 0:
            walls.append(found["one"][0] / found["two"][0])
            bounds.append(2 * found["one"][1] / found["two"][1])
    load = f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
    print(
        f"{name}: {np.median(walls):.2f} times as fast by wall time ({min(walls):.2f} to {max(walls):.2f}), at most "
        f"{np.median(bounds):.2f} by processor time ({min(bounds):.2f} to {max(bounds):.2f}); {load}",
        flush=True,
    )


@contextmanager
def two_nodes() -> Iterator[str]:
    """The address of a Ray cluster of two nodes of one core each."""
    import ray
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    cluster.add_node(num_cpus=1)
    try:
        yield cluster.address
    finally:
        ray.shutdown()
        cluster.shutdown()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*", choices=["loop", "processes", "ray"], default=["loop", "processes"])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--episodes", type=int, default=20, help="of a round, of the loop")
    parser.add_argument("--jobs-episodes", type=int, default=200, help="of a round, of processes and ray")
    parser.add_argument("--only", default="", help="of loop: environments whose name contains this")
    asked = parser.parse_args()
    if "loop" in asked.what:
        loop(asked.rounds, asked.episodes, asked.only)
    if "processes" in asked.what:
        speed_up("two processes", {"jobs": 1}, {"jobs": 2}, asked.rounds, asked.jobs_episodes)
    if "ray" in asked.what:
        with two_nodes() as address:
            there = {"engine": "ray", "address": address}
            speed_up("two Ray nodes", {"jobs": 1}, there, asked.rounds, asked.jobs_episodes)


if __name__ == "__main__":
    main()
