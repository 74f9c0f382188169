"""Where the other vehicles can be: constant velocity, and worst-case occupancy under `Assumptions`.

Notation
--------
Road frame. Frame k = 1..K after the scene. The occupancy of a vehicle at frame k is the rectangle [rear_k, front_k] x
[low, high]: the hull of all places that its body can reach. Positions follow the simulator's explicit Euler steps
(s_{k+1} = s_k + v_k dt), so the bound holds exactly and not only approximately.

Along the road, the rear is that of a vehicle that brakes from now on as hard as it may. It brakes at
`comfortable_braking`, and at up to `braking` from when a vehicle ahead may require that (`dynamics.traffic.reaction`).
It loses what it may lose by turning (`turning_loss`), makes no progress below `slow_speed`, and may reverse behind a
standing vehicle. The front is that of a vehicle that accelerates at `acceleration`, until it has to brake for the ego.
Across the road, a vehicle stays in the lanes that its body touches now or, at constant velocity, one frame ahead. Its
position and heading within them do not matter. So late aborts of a lane change, lateral wander and sliding need no
rules of their own. The bound does not cover a further lane that the vehicle may come to touch. It may do so only where
the ego's fail-safe keeps its room, see `dynamics.traffic.rules_of_the_road`.

Source: Responsibility-Sensitive Safety (Shalev-Shwartz et al. 2017), set-based prediction (Althoff and Magdici 2016),
with the reaction of highway-env's own traffic.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.roads.straight import Road
from dynamics.state import FloatArray, IntArray, RoadState, Vehicle
from dynamics.traffic.assumptions import Assumptions
from dynamics.traffic.occupancy_kernels import (
    LaneMarkings,
    front_of,
    fronts,
    least_rest_positions,
    rears,
    touched_lanes,
    update_turning_allowances,
)
from dynamics.traffic.reaction import LapPosition, ReactionWork, hardest_braking
from dynamics.traffic.tables import Motion, ReachableBodies, Tables, VehicleBodies, VehicleTables, bodies_of, motion_of

__all__ = [
    "Occupancy",
    "OtherVehicles",
    "PreviousTables",
    "VehiclesOnRoad",
    "buffer_shape",
    "constant_velocity",
    "curvature_of",
    "derive_tables",
    "horizons",
    "motion_settings",
    "order_by_position",
]


_STRAIGHT, _NO_GROWTH = np.zeros((2, 0)), np.zeros((0, 2))
_NOBODY = np.zeros((0, 4))
_LENGTH, _SIZE = int(Vehicle.LENGTH), [int(Vehicle.LENGTH), int(Vehicle.WIDTH)]
_CAR = 6.0
"""Length up to which a vehicle turns as a car does [m]; a longer one loses more distance by turning."""
_REACTING = 3.0
"""Time over which the hardest braking of each vehicle is computed; afterwards it may brake at `braking` [s]."""
_COARSE = 3.5
"""Relative increase of the turning allowances for each second that a frame lasts: controllers act once a frame
[1/s]."""


def constant_velocity(states: FloatArray, frames: int, dt: float) -> FloatArray:
    """Straight motion at constant speed: road states (m, 4) to (m, frames, 4) for frames 1..K."""
    out = np.repeat(states[:, None, :], frames, axis=1)
    t = dt * np.arange(1, frames + 1)
    speed, heading = states[:, RoadState.SPEED, None], states[:, RoadState.HEADING, None]
    out[..., RoadState.S] += speed * np.cos(heading) * t
    out[..., RoadState.R] += speed * np.sin(heading) * t
    return out


@dataclass(frozen=True, slots=True)
class Occupancy:
    """Where m vehicles can be over K frames.

    Attributes
    ----------
    rear : least s of the body, (m, K) [m].
    front : greatest s of the body, without a reaction to the ego, (m, K) [m].
    low, high : lateral extent, (m,) [m].
    """

    rear: FloatArray
    front: FloatArray
    low: FloatArray
    high: FloatArray

    def rectangles(self) -> FloatArray:
        """(K, m, 4): s_min, s_max, r_min, r_max [m]."""
        k = self.rear.shape[1]
        low, high = (np.repeat(a[None], k, axis=0) for a in (self.low, self.high))
        return np.stack([self.rear.T, self.front.T, low, high], axis=-1)


@lru_cache(maxsize=16)
def motion_settings(a: Assumptions, dt: float) -> tuple[Motion, FloatArray]:
    """The bounds on the motion; and their numbers, followed by `marking_tolerance` and
    `lateral_deviation`, (19,)."""
    motion = Motion(
        a.braking,
        a.acceleration,
        a.power,
        a.max_speed,
        a.min_speed,
        a.slow_speed,
        a.turning_loss * (1 + _COARSE * dt),
        a.turning_action * (1 + _COARSE * dt),
        a.turning_loss_back,
        a.turning_action_back,
        a.turning_action_in_one_second,
        min(a.comfortable_braking, a.braking),
        a.reversing_speed,
        a.queue_distance,
        a.queue_speed,
        a.runout_time,
        dt,
    )
    return motion, np.array([*motion, a.marking_tolerance, a.lateral_deviation], dtype=float)


@kernel_no_refcount
def order_by_position(states: FloatArray, order: IntArray) -> None:
    """The vehicles in decreasing order of s, `order` (m,), written. Vehicles with an unknown position (NaN) come
    last."""
    # Insertion sort from the last row to the first: most often the rows are in increasing order of s.
    m = states.shape[0]
    for n in range(m):
        i, k = m - 1 - n, n
        s = states[i, 0]
        while k > 0:
            other = states[order[k - 1], 0]
            # Among equals, and among unknown positions, the lower row comes first.
            if other > s or (s != s and other == other):
                break
            order[k] = order[k - 1]
            k -= 1
        order[k] = i


class VehiclesOnRoad(NamedTuple):
    """Vehicles and the bends of their road.

    Attributes
    ----------
    others, states : vehicle rows (m, 7) and road states (m, 4). growth, stretch : see `touched_lanes` and `rear_of`.
    """

    others: FloatArray
    states: FloatArray
    growth: FloatArray
    stretch: FloatArray


class PreviousTables(NamedTuple):
    """Road states (m, 4), `Tables.numbers` and `Tables.recent` of the frame before; of no vehicles if there is none."""

    states: FloatArray
    numbers: FloatArray
    recent: FloatArray


@kernel_inline
def derive_tables(
    vehicles: VehiclesOnRoad,
    lanes: LaneMarkings,
    settings: FloatArray,
    place: LapPosition,
    before: PreviousTables,
    tables: Tables,
    work: ReactionWork,
) -> None:
    """Fill in the tables of `OtherVehicles`.

    Parameters
    ----------
    settings : the numbers of `motion_settings`. place : see `hardest_braking`.
    tables : written.
    work : buffers, overwritten, (m,) and `buffer_shape`.
    """
    others, states, stretch, states0 = vehicles.others, vehicles.states, vehicles.stretch, before.states
    marks, brakes, recent, order, ways = tables.marks, tables.brakes, tables.recent, work.order, work.ways
    motion, bodies, m = motion_of(settings), bodies_of(marks, tables.numbers, brakes, recent), states.shape[0]
    reachable = VehicleBodies(others, states, bodies)
    touched_lanes(others, states, vehicles.growth, lanes, bodies)
    for i in range(m):
        swing = max(others[i, _LENGTH] / _CAR, 1.0)
        bodies.swing[i], bodies.budget[i], bodies.action[i] = swing, swing * motion.loss, swing * motion.action
    if states0.shape[0] == m:
        last = bodies_of(marks, before.numbers, brakes, before.recent)
        update_turning_allowances(states0, last, states, stretch, motion, place.lap, bodies)
    else:
        for i in range(m):
            for k in range(recent.shape[1]):
                recent[i, k] = 0.0
    order_by_position(states, order)
    hardest_braking(reachable, stretch, motion, place, work)
    least_rest_positions(others, states, stretch, motion, order, bodies)
    for i in range(m):
        nose = ways[0, 0, :2]
        front_of(i, reachable, stretch, motion, 0, nose)
        bodies.noses[0, i], bodies.noses[1, i] = nose[0], nose[1]


def curvature_of(road: Road) -> float:
    """Greatest curvature of any vehicle's path on a road [1/m]; 0 on a straight road."""
    return 0.0 if road.bends is None else float(road.bends.tightest)


def buffer_shape(m: int, frames: int) -> tuple[int, int, int]:
    """Shape of the buffer `ways` of `derive_tables`, for m vehicles and a number of coming frames."""
    return 7, max(frames, 3), max(frames, m, 2)


class OtherVehicles:
    """The other vehicles of one scene, and where they can come to be.

    Parameters
    ----------
    others : vehicle rows (m, 7).
    states : the same in the road frame (m, 4).
    road : the road that they are on.
    assumptions : bounds on their behaviour.
    dt : duration of a frame [s].
    before : the same vehicles a frame before, in the same order. From it follows what each may still lose by turning;
        without it, all of `assumptions.turning_loss`.
    ego : position of the ego along the road [m], NaN without one. Vehicles behind it may have to brake for it.

    Attributes
    ----------
    tables : lanes that they touch, and bounds on the reachable places of their bodies; `bodies` names the rows.
    stretch : least and greatest metres of s in a metre driven, (2, m); no columns on a straight road.
    motion, settings : bounds on the motion, and the same as an array.
    lap : length of a closed road, 0 of an open one [m].
    curvature : greatest of any vehicle's path [1/m]; 0 on a straight road.
    """

    def __init__(
        self,
        others: FloatArray,
        states: FloatArray,
        road: Road,
        assumptions: Assumptions,
        dt: float = 1 / 15,
        before: OtherVehicles | VehicleTables | None = None,
        ego: float = float("nan"),
    ) -> None:
        others, states = np.ascontiguousarray(others, float), np.ascontiguousarray(states, float)
        self.others, self.states, self.assumptions, self.dt = others, states, assumptions, float(dt)
        self.motion, self.settings = motion_settings(assumptions, self.dt)
        self.lap = float(getattr(road, "length", 0.0)) if getattr(road, "closed", False) else 0.0
        self.curvature = curvature_of(road)
        self.tables = Tables.empty(len(states), *horizons(self.dt))
        tolerances = assumptions.marking_tolerance, assumptions.lateral_deviation
        lanes = LaneMarkings(road.centers, float(road.width), *tolerances, self.dt)
        growth, self.stretch = _NO_GROWTH, _STRAIGHT
        if road.bends is not None and len(states):
            growth, bends = np.array([road.bends.growth(*size) for size in others[:, _SIZE]]), road.bends
            touched_lanes(others, states, growth, lanes, self.bodies)
            ends = bends.stretch(self.low), bends.stretch(self.high)
            self.stretch = np.stack([np.minimum(ends[0][0], ends[1][0]), np.maximum(ends[0][1], ends[1][1])])
        last = PreviousTables(_NOBODY, self.tables.numbers, self.tables.recent)
        if before is not None:
            last = PreviousTables(before.states, before.tables.numbers, before.tables.recent)
        vehicles, place = VehiclesOnRoad(others, states, growth, self.stretch), LapPosition(self.lap, float(ego))
        ways = np.empty(buffer_shape(len(states), self.tables.brakes.shape[1]))
        work = ReactionWork(np.empty(len(states), np.intp), ways)
        derive_tables(vehicles, lanes, self.settings, place, last, self.tables, work)

    @cached_property
    def bodies(self) -> ReachableBodies:
        """The rows of the tables by name."""
        named: Any = bodies_of
        bodies: ReachableBodies = named.py_func(*self.tables)
        return bodies

    @property
    def low(self) -> FloatArray:
        """Lower edges of the lanes touched, (m,) [m]."""
        return self.tables.numbers[0]

    @property
    def high(self) -> FloatArray:
        """Upper edges of the lanes touched, (m,) [m]."""
        return self.tables.numbers[1]

    @property
    def reach(self) -> FloatArray:
        """Half the length that each body covers along the road at any heading, (m,) [m]."""
        return self.tables.numbers[2]

    @property
    def lane(self) -> IntArray:
        """Index of the lane nearest to each vehicle, (m,)."""
        return self.tables.marks[0]

    def rear(self, frames: int, hold: int = 0, rows: IntArray | None = None) -> FloatArray:
        """Least s of each body after 1..K frames, (m, K) [m]; of the vehicles in `rows` only, if given. The last column
        bounds all later frames as well.

        `hold` is a number of frames of constant speed that are *expected* before the worst case starts. With `hold` > 0
        the result is a forecast and not a bound.
        """
        rows = np.arange(len(self.states)) if rows is None else rows
        out = np.empty((len(rows), frames))
        vehicles = VehicleBodies(self.others, self.states, self.bodies)
        rears(rows, vehicles, self.stretch, self.motion, hold, out)
        return out

    def front(self, frames: int, hold: int = 0, rows: IntArray | None = None) -> FloatArray:
        """Greatest s of each body after 1..K frames, without a reaction to the ego, (m, K) [m]; of the vehicles in
        `rows` only, if given."""
        rows = np.arange(len(self.states)) if rows is None else rows
        out = np.empty((len(rows), frames))
        vehicles = VehicleBodies(self.others, self.states, self.bodies)
        fronts(rows, vehicles, self.stretch, self.motion, hold, out)
        return out

    def occupancy(self, frames: int, hold: int = 0) -> Occupancy:
        """Worst-case occupancy over frames 1..K."""
        rear, front = self.rear(frames, hold), self.front(frames, hold)
        return Occupancy(rear, front, self.low, self.high)


@lru_cache(maxsize=16)
def horizons(dt: float) -> tuple[int, int]:
    """Number of coming frames for which the hardest braking is computed, and number of frames in a second."""
    return int(np.ceil(_REACTING / dt)), max(int(np.ceil(1 / dt - 1e-9)), 1)
