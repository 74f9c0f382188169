"""Initial positions of vehicles in highway-env's environments on road networks, as tables for `placing.Scene`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from typing import Any

import numpy as np
from highway_env.envs.exit_env import ExitEnv
from highway_env.envs.merge_env import MergeEnv, MergeGenericEnv
from highway_env.envs.roundabout_env import RoundaboutEnv, RoundaboutGenericEnv
from highway_env.envs.two_way_env import TwoWayEnv
from highway_env.envs.u_turn_env import UTurnEnv

from dynamics.road_networks.episodes.tables import AT, INTEGERS, NORMAL, NUMBERS, QUEUE, SCATTERED, STEADY, UNIFORM
from dynamics.state import FloatArray, IntArray

__all__ = ["PlacementTables", "placement_tables"]

LaneKey = tuple[str, str, int]
_NAN = math.nan
_DEPARTURES = ("we", "sx"), ("sx", "se"), ("ee", "nx"), ("nx", "ne"), ("eer", "ees"), ("ner", "nes"), ("wer", "wes")
"""The roads of roundabout-generic on which traffic is placed."""


@dataclass(frozen=True, slots=True)
class _Row:
    """A row of the tables."""

    lane: int
    place: float
    speed: float
    _: KW_ONLY
    ego: bool = False
    distribution: int = AT
    many: int = 1
    tries: int = 1
    lanes: int = 1
    drawn: int = STEADY
    spreads: tuple[float, float] = (0.0, 0.0)
    headed: bool = True
    facing: float = _NAN
    wanted: float = _NAN
    goals: tuple[int, int] = (-1, 1)
    varies: bool = False
    changes: bool = True
    bound_for: int = -1

    @property
    def numbers(self) -> list[float]:
        """The row of `PlacementTables.tables` with NUMBERS columns."""
        return [self.place, self.spreads[0], self.speed, self.spreads[1], self.facing, self.wanted]

    @property
    def integers(self) -> list[int]:
        """The row of `PlacementTables.tables` with INTEGERS columns."""
        drawing = [0 if self.ego else 1, self.distribution, self.many, self.tries, self.lane, self.lanes, self.drawn]
        return [*drawing, int(self.headed), *self.goals, int(self.varies), int(self.changes), self.bound_for]


@dataclass(frozen=True)
class PlacementTables:
    """The tables of `placing.Scene` that differ between environments.

    Attributes
    ----------
    rows : numbers and integers of each row, see `tables`.
    goals : names of the goal nodes, in the order of their numbers.
    roads : over which vehicles are scattered: first lane and number of lanes. stretches : s of scattered vehicles, by
        lane [m].
    apart, along, odds, packed : as of `Scene`.
    """

    rows: list[_Row]
    goals: tuple[str, ...] = ()
    roads: Sequence[tuple[int, int]] = ((0, 0),)
    stretches: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    apart: float = 0.0
    along: bool = False
    odds: Sequence[float] = ()
    packed: float = 0.0

    def tables(self) -> tuple[FloatArray, IntArray]:
        """The rows, (n, NUMBERS) and (n, INTEGERS)."""
        numbers = np.array([row.numbers for row in self.rows], float).reshape(-1, NUMBERS)
        return numbers, np.array([row.integers for row in self.rows], np.int64).reshape(-1, INTEGERS)


def _merge(base: Any, numbers: Mapping[LaneKey, int]) -> PlacementTables:
    """Vehicles of `MergeEnv`."""
    first = numbers["a", "b", 0]
    rows = [_Row(numbers["a", "b", 1], 30.0, 30.0, ego=True, headed=False)]
    for place, speed in ((90.0, 29.0), (70.0, 31.0), (5.0, 31.5)):
        rows.append(_Row(first, place, speed, lanes=2, drawn=UNIFORM, spreads=(5.0, 1.0), headed=False))
    return PlacementTables([*rows, _Row(numbers["j", "k", 0], 110.0, 20.0, headed=False, wanted=30.0)])


def _merge_generic(base: Any, numbers: Mapping[LaneKey, int]) -> PlacementTables:
    """Vehicles of `MergeGenericEnv`."""
    config = base.config
    count = int(config["lanes_count"])
    lanes = [numbers["a", "b", k] for k in range(count)]
    length = config["before_merge_length"] + config["converge_merge_length"] + config["parallel_merge_length"]
    scattered: dict[str, Any] = {"distribution": SCATTERED, "many": max(0, int(config["vehicles_count"])), "tries": 10}
    return PlacementTables(
        [
            _Row(lanes[-1], 30.0, 30.0, ego=True, headed=False),
            _Row(lanes[0], 0.0, 30.0, drawn=UNIFORM, spreads=(0.0, 2.0), headed=False, **scattered),
            _Row(numbers["j", "k", 0], 60.0, 20.0, headed=False, wanted=30.0),
        ],
        roads=[(lanes[0], count)],
        stretches={lane: (0.0, float(length)) for lane in lanes},
        apart=15.0,
        along=True,
    )


def _roundabout(base: Any, numbers: Mapping[LaneKey, int]) -> PlacementTables:
    """Vehicles of `RoundaboutEnv`."""
    goals = ("exr", "sxr", "nxr", "nxs")
    destination, anywhere = base.config["incoming_vehicle_destination"], (0, 3)
    fixed = anywhere if destination is None else (range(3)[destination], 1)
    drawn: dict[str, Any] = {"drawn": NORMAL, "spreads": (2.0, 2.0), "varies": True}
    return PlacementTables(
        [
            _Row(numbers["ser", "ses", 0], 125.0, 8.0, ego=True, facing=140.0, goals=(3, 1)),
            _Row(numbers["we", "sx", 1], 5.0, 16.0, goals=fixed, **drawn),
            _Row(numbers["we", "sx", 0], 20.0, 16.0, goals=anywhere, **drawn),
            _Row(numbers["we", "sx", 0], -20.0, 16.0, goals=anywhere, **drawn),
            _Row(numbers["eer", "ees", 0], 50.0, 16.0, goals=anywhere, **drawn),
        ],
        goals,
    )


def _roundabout_generic(base: Any, numbers: Mapping[LaneKey, int]) -> PlacementTables:
    """Vehicles of `RoundaboutGenericEnv`."""
    config, graph = base.config, base.road.network.graph
    goals = ("exr", "sxr", "nxr", "wxr", "nxs")
    destination = config.get("incoming_vehicle_destination")
    aims = (0, 4) if destination is None else (range(4)[min(destination, 3)], 1)
    own = graph["ser"]["ses"][0].length - 2.5
    roads = [(numbers[a, b, 0], len(graph[a][b])) for a, b in _DEPARTURES]
    lengths = {numbers[a, b, k]: lane.length for a, b in _DEPARTURES for k, lane in enumerate(graph[a][b])}
    drawn: dict[str, Any] = {"drawn": NORMAL, "spreads": (0.0, 2.0), "varies": True}
    scattered: dict[str, Any] = {"distribution": SCATTERED, "many": max(0, int(config["vehicles_count"])), "tries": 10}
    return PlacementTables(
        [
            _Row(numbers["ser", "ses", 0], own, 8.0, ego=True, goals=(4, 1)),
            _Row(0, 0.0, 14.0, goals=aims, **drawn, **scattered),
        ],
        goals,
        roads=roads,
        stretches={lane: (5.0, max(5.0, length - 5.0)) for lane, length in lengths.items()},
        apart=7.0,
    )


def _exit(base: Any, numbers: Mapping[LaneKey, int]) -> PlacementTables:
    """Vehicles of `ExitEnv`."""
    config = base.config
    count, first = int(config["lanes_count"]), numbers["0", "1", 0]
    lanes = np.arange(count)
    odds = (lanes / lanes.sum()).cumsum()
    odds /= odds[-1]
    spacing, many = 1 / config["vehicles_density"], max(0, int(config["vehicles_count"]))
    queued: dict[str, Any] = {"lanes": count, "goals": (0, 1), "changes": False}
    return PlacementTables(
        [
            _Row(first, float(config["ego_spacing"]), 25.0, ego=True, distribution=QUEUE),
            _Row(first, spacing, _NAN, distribution=QUEUE, many=many, **queued),
        ],
        ("3",),
        odds=odds.tolist(),
        packed=float(np.exp(-5 / 40 * count)),
    )


def _two_way(base: Any, numbers: Mapping[LaneKey, int]) -> PlacementTables:
    """Vehicles of `TwoWayEnv`."""
    own, oncoming = numbers["a", "b", 1], numbers["b", "a", 0]
    drawn: dict[str, Any] = {"drawn": NORMAL, "changes": False}
    rows = [_Row(own, 30.0, 30.0, ego=True, headed=False)]
    rows += [_Row(own, 70.0 + 40.0 * k, 24.0, spreads=(10.0, 2.0), **drawn) for k in range(3)]
    far = {"spreads": (10.0, 5.0), "bound_for": oncoming, **drawn}
    return PlacementTables(rows + [_Row(oncoming, 200.0 + 100.0 * k, 20.0, **far) for k in range(2)])


def _u_turn(base: Any, numbers: Mapping[LaneKey, int]) -> PlacementTables:
    """Vehicles of `UTurnEnv`."""
    there, bend, back = ("a", "b"), ("b", "c"), ("c", "d")
    traffic = [
        ((*there, 0), 25.0, 13.5),
        ((*there, 1), 56.0, 14.5),
        ((*bend, 1), 0.5, 4.5),
        ((*bend, 0), 17.5, 5.5),
        ((*back, 0), 1.0, 3.5),
        ((*back, 1), 30.0, 5.5),
    ]
    drawn: dict[str, Any] = {"drawn": NORMAL, "spreads": (2.0, 2.0), "goals": (0, 1)}
    rows = [_Row(numbers[*there, 0], 0.0, 16.0, ego=True, headed=False, goals=(0, 1))]
    rows += [_Row(numbers[lane], s, speed, varies=k == 0, **drawn) for k, (lane, s, speed) in enumerate(traffic)]
    return PlacementTables(rows, ("d",))


_PLACES: tuple[tuple[type, Callable[[Any, Mapping[LaneKey, int]], PlacementTables]], ...] = (
    (MergeGenericEnv, _merge_generic),
    (MergeEnv, _merge),
    (RoundaboutGenericEnv, _roundabout_generic),
    (RoundaboutEnv, _roundabout),
    (ExitEnv, _exit),
    (TwoWayEnv, _two_way),
    (UTurnEnv, _u_turn),
)


def placement_tables(base: Any, numbers: Mapping[LaneKey, int]) -> PlacementTables | None:
    """The tables of an environment, unwrapped and reset; None for an intersection, which has none (see `arrivals`).

    Parameters
    ----------
    numbers : of the lanes, by highway-env's index.
    """
    return next((make(base, numbers) for kind, make in _PLACES if isinstance(base, kind)), None)
