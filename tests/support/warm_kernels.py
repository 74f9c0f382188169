"""Compiles the large kernels before the tests, each in one process: workers of pytest would all compile the same ones.

python tests/support/warm_kernels.py
"""

from __future__ import annotations

from joblib import Parallel, delayed

from dynamics.networks.episodes.simulator import RoadSimulator
from shield.batch.highways import ShieldedHighways
from shield.doors.warm_doors import warm_up_exact, warm_up_exact_inputs, warm_up_roads
from shield.exact.highways import ExactHighways
from shield.exact.roads import ExactRoads


def shielded() -> None:
    highways = ShieldedHighways("highway-fast-v0", 1)
    highways.reset([0])
    highways.masks()
    highways.step([3])


def exact() -> None:
    highways = ExactHighways("highway-fast-v0", 1)
    highways.reset([0])
    highways.masks()
    highways.step([3])
    warm_up_exact(False)


def networks() -> None:
    warm_up_exact(True)
    warm_up_exact_inputs()
    roads = ExactRoads("merge-v0", 1)
    roads.reset([0])
    roads.masks()
    roads.step([1])


def roads() -> None:
    RoadSimulator("merge-v0", 1).step([1])


def worst_case() -> None:
    warm_up_roads()


if __name__ == "__main__":
    Parallel(n_jobs=-1)(delayed(each)() for each in (shielded, exact, networks, worst_case, roads))
