"""Verification of candidate trajectories against reachable intervals: a margin in metres, not a boolean.

Notation
--------
Road frame. The ego's footprint is inflated by the buffer along and across its heading psi. Its half extents along and
across the road are

    h_s = (L/2 + b_lon) |cos psi| + (W/2 + b_lat) |sin psi|
    h_r = (L/2 + b_lon) |sin psi| + (W/2 + b_lat) |cos psi|

The separation from a rectangle is the greater of the longitudinal and the lateral gap, negative when both overlap. The
margin of a trajectory is the least separation over all frames and vehicles.

Distance obligations (Responsibility-Sensitive Safety): a vehicle behind the ego, in a lane that the ego *owns*, must
keep its distance. The ego owns the lane that it starts in. It owns a lane that it enters once a plan to stop there has
been verified against the vehicles behind; until then, the ego has to keep clear of them. A plan must also end inside
its lane, so that an ego at rest blocks no other lane.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from dynamics.deprecation import RenamedText
from dynamics.scenes.scene import Scene
from dynamics.state import BoolArray, FloatArray, IntArray, RoadState, Vehicle
from dynamics.traffic.motion_limits import bend_speed_of
from dynamics.traffic.occupancy import OtherVehicles, curvature_of
from dynamics.traffic.occupancy_kernels import straight_overshoot
from dynamics.traffic.rules_of_the_road import EgoFootprint, footprint
from dynamics.traffic.tables import VehicleTables
from dynamics.vehicle.rollout_kernels import table_of
from shield.certificate.road.clauses.all_clauses import (
    CUT_IN_BINDS,
    NOTHING_BINDS,
    ROOM_BINDS,
    SEPARATION_BINDS,
    CandidatePaths,
    SceneArrays,
    evaluate_paths,
)
from shield.certificate.road.clauses.clause_inputs import EarlierVehicles, EgoArrays, LaneState
from shield.certificate.road.clauses.edge import lanes_touched
from shield.certificate.road.clauses.followers import in_reach
from shield.certificate.road.clauses.footprint import Footprint
from shield.certificate.road.clauses.others import RoadVehicles, empty_vehicles, vehicles_from
from shield.certificate.road.clauses.parameters import settings_of
from shield.certificate.road.clauses.scene import SceneBuffers, find_relied_on, prepare_scene
from shield.config import Buffer, ShieldConfig
from shield.decision import ROUNDING

__all__ = [
    "CLAUSES",
    "NOTHING",
    "ROUNDING",
    "Binding",
    "Clearance",
    "PathVerifier",
    "SceneBefore",
    "footprint_of",
    "least_bad",
    "least_bad_evasion",
]


CLAUSES = {
    NOTHING_BINDS: "",
    SEPARATION_BINDS: "separation",
    CUT_IN_BINDS: RenamedText("cut-in", "slip-in"),
    ROOM_BINDS: "room",
}
"""Names of the clauses in records."""
_NOBODY, _NO_LANES = np.zeros(0, dtype=bool), np.zeros((0, 0), dtype=bool)


@dataclass(frozen=True, slots=True)
class Binding:
    """The clause and the vehicle that a margin comes from.

    Attributes
    ----------
    clause : its name, "" if no vehicle is in reach. vehicle : row among the scene's others, -1 if there is none.
    """

    clause: str = ""
    vehicle: int = -1


NOTHING = Binding()
"""No clause binds, or none was evaluated."""


@dataclass(frozen=True, slots=True)
class Clearance:
    """Result for n trajectories.

    Attributes
    ----------
    margin : least separation beyond the buffer, (n,) [m]; +inf with no vehicle in reach, -inf in a gap of the map.
    clear : number of frames before the first negative separation, (n,); all frames if there is none.
    found : terms of the margins, (1 + q + c, n) [m]: the room in the lane that is stopped in; the least separation from
        each vehicle in reach, +inf for one with a distance obligation; and that from each vehicle that may cut in.
    rows : rows of the vehicles in reach, (q,).
    binds : binding clause and binding vehicle of each margin, (2, n).
    """

    margin: FloatArray
    clear: Any
    found: FloatArray | None = None
    rows: Any = None
    binds: Any = None

    @property
    def separations(self) -> FloatArray:
        """Least separation of each path from each vehicle in reach, (n, q) [m]."""
        assert self.found is not None
        return self.found[1 : 1 + len(self.rows)].T

    @property
    def cutting_in(self) -> FloatArray:
        """Least separation of each path from each vehicle that may cut in, (n, c) [m]."""
        assert self.found is not None
        return self.found[1 + len(self.rows) :].T

    @property
    def parts(self) -> FloatArray:
        """Terms of the margins, (n, q + c + 1) [m]: the separations of both kinds, and the room."""
        assert self.found is not None
        return np.vstack([self.found[1:], self.found[:1]]).T

    def binding(self, i: int) -> Binding:
        """The binding clause and the binding vehicle of path `i`."""
        if self.margin[i] == -np.inf:
            return Binding("gap of the map")
        return Binding(CLAUSES[int(self.binds[0, i])], int(self.binds[1, i]))


@dataclass(frozen=True, slots=True, eq=False)
class SceneBefore:
    """What a verifier takes from the scene before.

    Attributes
    ----------
    followers : vehicles with a distance obligation, (m,) bool; none by default.
    coming : whether each vehicle could enter each lane, (lanes, m) bool; by default those that may now.
    stored, entered : lane in which the stored plan stops, and lane that it enters on the way; None if there is none.
    """

    followers: Any = None
    coming: Any = None
    stored: int | None = None
    entered: int | None = None


_FIRST_SCENE = SceneBefore()


class PathVerifier:
    """Judges trajectories in one scene. Everything that depends on the scene alone is computed once.

    Parameters
    ----------
    scene : the scene.
    config : buffer, assumptions and perception range.
    visible : number of frames for which the ego has been visible in each lane, (lanes,); none by default.
    owned : lanes that the ego owns, (lanes,) bool; the one that it is in by default.
    around : the scene's surroundings, if they have been built already.
    ignored : vehicles to leave out, (m,) bool; none by default.
    before : what is known from the scene before.

    Attributes
    ----------
    size : the ego's footprint. behind, in_owned_lane : see `RoadVehicles`, (m,) bool.
    comes : whether each vehicle may enter each lane, (lanes, m).
    plan : `SceneBefore.stored` and `SceneBefore.entered`, -1 for None.
    """

    def __init__(
        self,
        scene: Scene,
        config: ShieldConfig,
        visible: Any = None,
        owned: Any = None,
        around: OtherVehicles | None = None,
        ignored: Any = None,
        before: SceneBefore = _FIRST_SCENE,
    ) -> None:
        self.ignored = _NOBODY if ignored is None else ignored
        self.plan = -1 if before.stored is None else before.stored, -1 if before.entered is None else before.entered
        self.scene, self.config, self.visible = scene, config, visible
        road, state, a, lanes = scene.road, scene.ego_road, config.assumptions, scene.road.centers.size
        if owned is None:
            owned = np.arange(lanes) == road.lane_at(float(state[RoadState.R]))
        self.owned = np.asarray(owned, dtype=bool)
        if around is None:
            ego = float(state[RoadState.S])
            around = OtherVehicles(scene.others, scene.others_road, road, a, scene.dt, None, ego)
        self.around = around
        self.size, self._size = footprint_of(
            float(scene.ego[Vehicle.LENGTH]), float(scene.ego[Vehicle.WIDTH]), config.buffer, road.bends
        )
        curvature, perception = curvature_of(road), float(config.perception_range)
        self._settings = settings_of(a, float(road.width), perception, curvature, scene.dt)
        self._table = table_of(road)
        self._visible = np.zeros(lanes, dtype=np.intp) if visible is None else np.asarray(visible, np.intp)
        in_sight = self._visible
        if visible is None:
            offset = np.abs(road.centers - state[RoadState.R])
            in_sight = np.where(offset <= a.visible_distance, np.iinfo(np.intp).max, 0)
        m = len(scene.others)
        self._of_others, cutting_in = empty_vehicles(m, lanes), np.empty((2 * m, 4))
        self._vehicles = VehicleTables(around.others, around.states, around.tables)
        self._ego = EgoArrays(scene.ego, state, self._size)
        ground = LaneState(road.centers, self.owned, in_sight)
        earlier = EarlierVehicles(
            _NOBODY if before.followers is None else before.followers,
            _NO_LANES if before.coming is None else before.coming,
        )
        out = SceneBuffers(self._of_others, cutting_in, np.empty((m, 4), np.bool_))
        count = prepare_scene(self._vehicles, self._ego, ground, self._settings, self.plan, earlier, out)
        flags = self._of_others.flags
        self._cutting_in, self.behind, self.in_owned_lane, self.comes = (
            cutting_in[:count],
            flags[0],
            flags[1],
            flags[2 + lanes :],
        )

    @cached_property
    def seen(self) -> EgoFootprint:
        """The ego with its buffer, in the world frame."""
        return footprint(self.scene.ego, self.config.buffer.longitudinal, self.config.buffer.lateral)

    @cached_property
    def others(self) -> RoadVehicles:
        """The other vehicles as the clauses read them."""
        named: Any = vehicles_from
        others: RoadVehicles = named.py_func(self.around.bodies, *self._of_others)
        return others

    def counted(self, before: tuple[BoolArray, BoolArray] | None) -> BoolArray:
        """Vehicles that the stored plan relies on to brake, (m,) bool, see `mark_relied_on`. `before` is `behind` and
        `in_owned_lane` of the scene before."""
        out = np.zeros(len(self.behind), dtype=bool)
        if self.plan[0] >= 0 and before is not None:
            lanes = LaneState(self.scene.road.centers, self.owned, self._visible)
            find_relied_on(self._vehicles, self._of_others, self._ego, lanes, self.plan, before, out)
        return out

    def entered(self, paths: FloatArray, fails: IntArray) -> tuple[IntArray, FloatArray, BoolArray, IntArray]:
        """The lane that the body enters on each path (n, K, 4), besides the owned ones and the one that it stops in,
        `fails` (n,); and the other results of `lanes_touched`."""
        size, road = self.size, self.scene.road
        body, side = (size.length, size.width, size.body_growth_across), 0.5 * road.width
        return lanes_touched(self.scene.ego_road, paths, body, road.centers, side, self.owned, fails)

    def without(self, ignored: BoolArray) -> PathVerifier:
        """The same for a scene without some vehicles, (m,) bool."""
        other = copy(self)
        other.ignored = ignored
        return other

    def without_cut_ins(self) -> PathVerifier:
        """The same without the precaution of cut-ins. The precaution may refuse plans, and the certificate does not
        rest on it: a vehicle that cuts in without leaving the fail-safe its room violates a rule."""
        other = copy(self)
        other._cutting_in = self._cutting_in[:0]
        return other

    def relevant(self, distance: float, followers: bool = True) -> Any:
        """Rows of the vehicles that can come into reach of an ego that travels at most `distance` [m].

        To leave out the rest cannot change a verdict: a vehicle ahead never comes further back than its least s.
        Without `followers`, all vehicles behind are left out.
        """
        rows = np.empty(len(self.scene.others), np.intp)
        return rows[: in_reach(self.others, (distance, float(self.config.perception_range)), followers, rows)]

    def clearance(self, paths: FloatArray, lanes: Any, fails: Any, hold: int = 0) -> Clearance:
        """Margin of each path against the worst case of the others.

        Parameters
        ----------
        paths : road states of the ego after frames 1..K, (n, K, 4).
        lanes, fails : lanes that each path commits to and stops in, (n,).
        hold : number of frames for which the others are *expected* to keep their speed (a forecast, not a bound).
        """
        around = self.around
        scene = SceneArrays(
            self._ego,
            LaneState(self.scene.road.centers, self.owned, self._visible),
            self._vehicles,
            self._of_others,
            self._cutting_in,
            around.stretch,
            self._settings,
            around.settings,
            self._table,
        )
        found, marks, rows = evaluate_paths(CandidatePaths(paths, lanes, fails), scene, hold, self.ignored)
        self._close_gaps(paths, found[0])
        return Clearance(found[0], marks[0], found[1:], rows, marks[1:])

    def of_each(self, result: Clearance, i: int = 0) -> FloatArray:
        """Separation of path `i` of a result from the places that each vehicle can reach, (m,) [m]; +inf out of
        reach. Where a path does not leave a vehicle on a bend its room, at most that room."""
        out = np.full(len(self.scene.others), np.inf)
        if result.found is not None:
            out[result.rows] = result.separations[i]
            if self.around.curvature > 0 and result.found[0, i] < 0 and len(out):
                out = np.minimum(out, result.found[0, i] + self._room_of_others())
        return out

    def _room_of_others(self) -> FloatArray:
        """How much more room a stop would have if each vehicle were the only one, (m,) [m]; see `room_of`."""
        around, size, dt = self.around, self.size, self.scene.dt
        speeds = np.abs(around.states[:, RoadState.SPEED])
        distances = np.maximum(speeds, bend_speed_of(around.assumptions, around.curvature)) * dt
        kernel: Any = straight_overshoot
        overshoots = kernel.py_func(around.curvature, around.others[:, Vehicle.LENGTH], distances)
        across: FloatArray = np.maximum(size.across, 0.5 * size.width + overshoots)
        found: FloatArray = across.max() - across
        return found

    def _close_gaps(self, paths: FloatArray, margin: FloatArray) -> None:
        """Set `margin` (n,) to -inf for paths through places where the map has no lane."""
        gaps = self.scene.road.gaps
        if gaps is not None:
            margin[gaps.met(paths) & ~np.isnan(margin)] = -np.inf


@lru_cache(maxsize=64)
def footprint_of(length: float, width: float, buffer: Buffer, bends: Any) -> tuple[Footprint, FloatArray]:
    """The ego's footprint, and its numbers, (8,). On a curve, the buffered footprint and the body extend further than
    on a straight road."""
    growth, body_growth = (0.0, 0.0), (0.0, 0.0)
    if bends is not None:
        growth = bends.growth(length + 2 * buffer.longitudinal, width + 2 * buffer.lateral)
        body_growth = bends.growth(length, width)
    half = 0.5 * length + buffer.longitudinal, 0.5 * width + buffer.lateral
    size = Footprint(*half, length, width, *growth, *body_growth)
    return size, np.array(size, dtype=float)


def least_bad(result: Clearance) -> int:
    """Index of the trajectory to execute if none verifies: the one that stays clear longest, then the largest
    margin."""
    margin = np.nan_to_num(result.margin, nan=-np.inf)
    return int(np.lexsort((margin, result.clear))[-1])


def least_bad_evasion(expected: Clearance, worst: Clearance) -> int:
    """Index of the trajectory to execute because of a violator: the one that is expected to stay clear longest. Among
    equals, the one that stays clear longest in the worst case, then the largest expected margin, then the first.

    In the forecast a braking vehicle keeps its speed; the worst case covers its braking.
    """
    margin = np.nan_to_num(expected.margin, nan=-np.inf)
    return int(np.lexsort((-np.arange(len(margin)), margin, worst.clear, expected.clear))[-1])
