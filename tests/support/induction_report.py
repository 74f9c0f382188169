"""Plans that are not good a frame later: `PYTHONPATH=.:tests/support python tests/support/induction_report.py`."""

from __future__ import annotations

import argparse
import time
from collections import Counter
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from edge_riders import EdgeRider, Skidder, ride
from induction import Tally, drive, make
from spoiling_followers import spoil

__all__ = ["POLICIES", "policy_for"]

LEFT, IDLE, RIGHT, FASTER, SLOWER = range(5)
POLICIES = {"meta": ("faster", "random", "changing"), "inputs": ("throttle", "swerving", "weaving", "random", "wild")}


def policy_for(action: str, name: str) -> Any:
    """A named policy for meta-actions ("meta"), or for throttle and steering ("inputs")."""
    return _meta(name) if action == "meta" else _inputs(name)


def _meta(name: str) -> Any:
    def propose(env: Any, rng: np.random.Generator, obs: Any) -> int:
        if name == "faster":
            return FASTER
        if name == "changing":
            return int(rng.choice([LEFT, RIGHT, FASTER], p=[0.35, 0.35, 0.3]))
        return int(rng.integers(5))

    return propose


def _inputs(name: str) -> Any:
    held = np.zeros(2)

    def propose(env: Any, rng: np.random.Generator, obs: Any) -> np.ndarray:
        if name == "throttle":
            return np.array([1.0, 0.0], dtype=np.float32)
        if name == "swerving":
            if rng.random() < 0.3:
                held[:] = rng.choice([1.0, 1.0, 0.0, -0.5]), rng.normal(0, 0.1)
            return held.astype(np.float32)
        if name == "wild":
            if rng.random() < 0.15:
                held[:] = rng.uniform(-0.5, 1.0), 0.5 * rng.choice([0.0, 1.0, -1.0, rng.uniform(-1, 1)])
            return held.astype(np.float32)
        if name == "weaving":
            t = env.unwrapped.time
            return np.array([1.0, 0.1 * np.sin(2 * np.pi * t / 4)], dtype=np.float32)
        return np.array([rng.uniform(-1, 1), rng.uniform(-1, 1)], dtype=np.float32)

    return propose


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--actions", nargs="*", default=["meta", "inputs"])
    parser.add_argument("--hz", nargs="*", type=int, default=[5, 8, 10, 15, 30, 60])
    parser.add_argument("--policies", nargs="*", default=None)
    parser.add_argument("--traffic", nargs="*", default=["native", "riders", "skidders"])
    parser.add_argument("--episodes", type=int, default=2, help="of each cell")
    parser.add_argument("--frames", type=int, default=600, help="of an episode at most")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    every = Tally()
    for action, hz, traffic in product(options.actions, options.hz, options.traffic):
        for name in options.policies or POLICIES[action]:
            if name not in POLICIES[action]:
                continue
            tally, start = Tally(), time.perf_counter()
            for seed in range(options.seed, options.seed + options.episodes):
                kind = {"riders": EdgeRider, "skidders": Skidder}.get(traffic)
                prepare = None if kind is None else partial(ride, seed=seed, kind=kind)
                more: dict[str, Any] = {}
                if traffic == "spoilers":
                    prepare = partial(spoil, seed=seed)
                    more = {"lanes_count": 3, **({"policy_frequency": hz} if action == "inputs" else {})}
                one = drive(make(action, hz, **more), policy_for(action, name), seed, options.frames, prepare)
                for lost in one.lost:
                    print(f"    seed {seed} {lost}", flush=True)
                tally.add(one)
            every.add(tally)
            clauses = dict(Counter(lost.clause for lost in tally.lost))
            print(
                f"{action:7}{hz:>3} Hz {traffic:8}{name:9} frames {tally.frames:>6} judged {tally.judged:>6} named "
                f"{tally.named:>4} lost {len(tally.lost):>4} {clauses} {dict(tally.tiers)} "
                f"{time.perf_counter() - start:.0f} s",
                flush=True,
            )
    print(f"in all: frames {every.frames}, judged {every.judged}, named {every.named}, lost {len(every.lost)}")
    print({rule: n for rule, n in every.rules.items() if n})


if __name__ == "__main__":
    main()
