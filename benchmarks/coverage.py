"""How often what is seen next is beyond its bounds, and the true state beyond those of the bodies, closed loop: always
FASTER behind the shield, which acts on these bounds, through sensors of 2 m and 2 m/s whose noise is as they say, has
tails, or is biased (`bad_sensors`).

    python benchmarks/coverage.py [--episodes 65] [--seed 100000] [--kinds gaussian,tails,biased] [--bound 2]
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from bad_sensors import KINDS, drive, perception_of, shielded
from scipy.special import ndtr

from dynamics.state import FloatArray
from shield import PerceptionConfig
from shield.perception.perceiving import ObservationPerception
from shield.perception.perception_settings import BOUNDS
from shield.perception.sighting import decode
from shield.perception.tracking import bounds_of

SIGMA = np.full(4, 2.0)


class Count:
    """Counts, each time the sensor is about to look again, what became of the last time.

    Attributes
    ----------
    steps, missed : vehicles seen, and how often beyond the bounds that there were before, (2, 4).
    states, outside : vehicles, and how often the true state was beyond the bounds, (2, 4).
    widths : sum of how far the bounds of each are apart, (4,).
    """

    def __init__(self) -> None:
        self.steps = self.states = self.crashes = 0
        self.missed, self.outside, self.widths = np.zeros((2, 4)), np.zeros((2, 4)), np.zeros(4)
        self._last: Any = None
        self._bounds: FloatArray = np.zeros((2, 4))

    def look(self, perception: ObservationPerception, sensor: Any) -> None:
        """Take in what the perception has made of the last observation."""
        tracks = perception.tracks
        if tracks is self._last or not len(tracks.ids):
            return
        surprise, before = tracks.surprise, self._bounds
        if surprise is not None and self._last is not None:
            # The bounds are those of before this observation was taken in.
            self.steps += len(surprise.scores)
            self.missed += np.stack([surprise.scores < -before[0], surprise.scores > before[1]]).sum(axis=1)
        self._last, self._bounds = tracks, perception.bounds
        low, high = bounds_of(tracks, self._bounds)
        truth, shown = (self._absolute(perception, rows) for rows in (sensor.exact, sensor.shown(1.0)))
        apart = np.abs(tracks.seen[:, None] - shown[None]).max(axis=2)
        known = (tracks.missed == 0) & (apart.min(axis=1, initial=np.inf) < 1e-6)
        there = truth[apart.argmin(axis=1)[known]]
        self.states += int(known.sum())
        self.outside += np.stack([there < low[known], there > high[known]]).sum(axis=1)
        self.widths += (high - low)[known].sum(axis=0)

    def begin(self) -> None:
        """Begin an episode."""
        self._last = None

    @staticmethod
    def _absolute(perception: ObservationPerception, rows: FloatArray) -> FloatArray:
        states = decode(perception.spec, rows).others.copy()
        states[:, 0] += perception.ego[0]
        return states


def measure(kind: str, bounds: str, bound: float, seeds: range) -> Count:
    """Drive episodes and count."""
    config = PerceptionConfig(bounds=bounds, bound=bound, monitor=False)  # type: ignore[arg-type]
    env, sensor = shielded(SIGMA, kind, config)
    found, observe = Count(), sensor.observation

    def watched(observation: Any) -> Any:
        if env.filter is not None and env.filter.reader._perception is not None:  # type: ignore[union-attr]
            perception = perception_of(env)
            perception._watched = True  # the scores of Gaussian bounds are asked for as well
            found.look(perception, sensor)
        return observe(observation)

    sensor.observation = watched  # type: ignore[method-assign]
    for seed in seeds:
        found.begin()
        *_, last = drive(env, seed)
        found.crashes += last["crashed"]
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=65)
    parser.add_argument("--seed", type=int, default=100_000)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--bound", type=float, default=2.0)
    asked = parser.parse_args()
    print(f"asked for: each side covered in {ndtr(asked.bound):.2%}")
    print(
        "| noise | bounds | vehicle-steps | next observation covered, worst side to best | off by at most, points |",
        end="",
    )
    print(" all sides | true state covered, worst side to best | mean width x, y, vx, vy | crashes of |")
    print("| :-- | :-- | --: | --: | --: | --: | --: | --: | --: |")
    for kind in asked.kinds.split(","):
        for bounds in BOUNDS:
            found = measure(kind, bounds, asked.bound, range(asked.seed, asked.seed + asked.episodes))
            seen, true = 1 - found.missed / found.steps, 1 - found.outside / found.states
            off = 100 * np.abs(seen - ndtr(asked.bound)).max()
            widths = ", ".join(f"{w:.1f}" for w in found.widths / found.states)
            print(
                f"| {kind} | {bounds} | {found.steps:,} | {seen.min():.2%} to {seen.max():.2%} | {off:.2f} | "
                f"{seen.mean():.2%} | {true.min():.2%} to {true.max():.2%} | {widths} | "
                f"{found.crashes} of {asked.episodes} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
