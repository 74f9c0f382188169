"""What riders along the edge of the rules find on networks of roads: `PYTHONPATH=.:tests/support python
tests/support/road_riders_report.py --frames 20000 --seed 970000`."""

from __future__ import annotations

import argparse
import time
from collections import Counter

from road_riders import ride_roads

ROADS = (
    *("merge-v0", "roundabout-v0", "roundabout-v0", "intersection-v0", "two-way-v0", "u-turn-v0", "exit-v0"),
    *("merge-v1", "roundabout-v1", "intersection-v2", "u-turn-v1", "exit-v1"),
)
RATES = (5, 10, 15, 15, 20, 30)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=20_000, help="how many to drive, of all episodes together")
    parser.add_argument("--seed", type=int, default=0, help="of the first episode")
    options = parser.parse_args()
    found, near, start, seed = Counter[str](), float("inf"), time.monotonic(), options.seed
    while found["frames"] < options.frames:
        env_id, rate = ROADS[seed % len(ROADS)], RATES[(seed // len(ROADS)) % len(RATES)]
        tally = ride_roads(env_id, seed, rate)
        found.update(episodes=1, frames=tally.frames, verified=tally.verified)
        if tally.verified:
            found.update(named=tally.named, owed=tally.owed > 0, unforeseen=tally.unforeseen > 0)
            found.update(clean_breaches=tally.clean > 0, clean_crashes=tally.crashed, lost=tally.lost > 0)
            near = min(near, tally.nearest)
            if tally.clean or tally.lost or tally.unforeseen:
                print(env_id, rate, "Hz, seed", seed, tally, flush=True)
        seed += 1
        if found["frames"] >= options.frames or found["episodes"] % 50 == 0:
            took = time.monotonic() - start
            print(dict(found), f"nearest {near:.4f} m, {took:.0f} s, seeds to {seed - 1}", flush=True)


if __name__ == "__main__":
    main()
