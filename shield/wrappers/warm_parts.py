"""Parts of all compiled code; `shield warm` compiles them in advance."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType

from dynamics.road_networks.episodes.simulator import RoadSimulator
from shield.batch.highways import ShieldedHighways
from shield.certificate.simulated.highways import SimulatedHighways
from shield.certificate.simulated.roads import SimulatedRoads
from shield.compiling import announced
from shield.pipelines.warm_up import warm_up
from shield.wrappers.warm_filters import (
    warm_up_explanations,
    warm_up_networks,
    warm_up_simulated,
    warm_up_simulated_inputs,
)

__all__ = ["PARTS"]


def _compiled_highway() -> None:
    with announced("compiled highway"):
        highways = ShieldedHighways("highway-fast-v0", 1)
        highways.reset([0])
        highways.masks()
        highways.step([3])


def _simulated_compiled_highway() -> None:
    with announced("compiled highway, simulated traffic"):
        highways = SimulatedHighways("highway-fast-v0", 1)
        highways.reset([0])
        highways.masks()
        highways.step([3])


def _compiled_networks() -> None:
    with announced("compiled networks"):
        RoadSimulator("merge-v0", 1).step([1])


def _simulated_compiled_networks() -> None:
    with announced("compiled networks, simulated traffic"):
        roads = SimulatedRoads("merge-v0", 1)
        roads.reset([0])
        roads.masks()
        roads.step([1])


PARTS: Mapping[str, Callable[[], None]] = MappingProxyType(
    {
        "worst case on highways": warm_up,
        "simulated highways": partial(warm_up_simulated, False),
        "simulated networks": partial(warm_up_simulated, True),
        "simulated throttle and steering": warm_up_simulated_inputs,
        "worst case on networks": warm_up_networks,
        "simulated explanations on highways": partial(warm_up_explanations, False),
        "simulated explanations on networks": partial(warm_up_explanations, True),
        "compiled highway": _compiled_highway,
        "compiled highway, simulated traffic": _simulated_compiled_highway,
        "compiled networks": _compiled_networks,
        "compiled networks, simulated traffic": _simulated_compiled_networks,
    }
)
"""Function that compiles each part, or loads it from the disk. `shield.compiling` has compile times under the same
names. The parts with "compiled" in front are for many environments at once."""
