"""Distance obligations of followers, and lanes that the ego owns: which vehicles a plan has to stay clear of."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dynamics.compiled import compiled, kernel_inline, kernel_no_refcount
from dynamics.roads.straight import nearest
from dynamics.state import BoolArray, FloatArray, IntArray, Vehicle
from dynamics.traffic.mobil import LaneSight, TrafficInLanes, lane_change_incentives
from dynamics.traffic.rules_of_the_road import EgoFootprint, gap_between
from dynamics.traffic.tables import VehicleBodies
from shield.certificate.road.clauses.clause_inputs import EarlierVehicles, LaneDistances, LaneState, PlannedPath
from shield.certificate.road.clauses.entering import mark_entrants, neighbours
from shield.certificate.road.clauses.footprint import Footprint, across_of, reach_across, reach_along
from shield.certificate.road.clauses.others import TOUCH, RoadVehicles

__all__ = [
    "EgoInScene",
    "VisibilityParameters",
    "fill_vehicles",
    "find_unobligated",
    "in_reach",
    "mark_relied_on",
    "update_lanes",
    "updated_lanes",
]

_LENGTH, _WIDTH = int(Vehicle.LENGTH), int(Vehicle.WIDTH)
_LONG = 10**6
"""Number of frames that stands for any longer time."""
_BESIDE = 1.0
"""Tolerance of the lateral range between the ego's position and the place where a plan stops, beyond the effect of the
heading [m]."""
_LEFT = 0.5
"""Lateral distance of the ego's buffer from a band at which the ego counts as having left the band [m]: a turning
buffer sways."""
_CORNER = 0.5
"""Greatest distance by which a corner of a follower may come beside a corner of the ego's buffer [m]."""


class VisibilityParameters(NamedTuple):
    """Parameters of visibility: when a vehicle sees the ego, and when it may still enter a lane.

    Attributes
    ----------
    distance : distance from a lane's centre within which a vehicle is visible in that lane [m].
    slack : tolerance on the gain of a vehicle that enters a lane [m/s^2].
    reaction : number of frames of visibility after which no vehicle begins to enter the ego's lane.
    settled : number of frames of visibility after which no vehicle enters it any more.
    simultaneous_merge : whether a vehicle may enter a lane that the ego is about to enter. width : of a lane [m].
    """

    distance: float
    slack: float
    reaction: int
    settled: int
    simultaneous_merge: bool
    width: float


@kernel_inline
def in_reach(others: RoadVehicles, limits: tuple[float, float], followers: bool, rows: IntArray) -> int:
    """Number of vehicles that can come into reach of the ego; their rows are written to the beginning of `rows`, (v,),
    in order.

    Parameters
    ----------
    others : the vehicles, (v,).
    limits : greatest distance that the ego travels, and perception range, (2,) [m].
    followers : whether followers count.
    """
    distance, perception = limits[0], limits[1]
    least, size, ahead, behind = others.least, others.size, others.ahead, others.behind
    count = 0
    for j in range(ahead.shape[0]):
        # Written so that a distance that is not a number excludes no vehicle.
        if least[j] - size[j] > distance or not abs(ahead[j]) - size[j] <= perception:
            continue
        # A follower may still be braking, and coming nearer, long after the ego stands: no follower is too far away.
        if behind[j] and not followers:
            continue
        rows[count] = j
        count += 1
    return count


@kernel_inline
def _comes_back(
    state: FloatArray, path: FloatArray, turned: FloatArray, size: Footprint, low: float, high: float
) -> bool:
    """Whether the ego leaves the band from `low` to `high` [m], now or on its path, and is in the band again later. It
    has left the band when its buffer is more than `_LEFT` away. No vehicle keeps a place free that the ego has left.
    `state` is the ego now, (4,)."""
    lat, frames = size.across, path.shape[0]
    least, most = state[1], state[1]
    for k in range(frames):
        least, most = min(least, path[k, 1]), max(most, path[k, 1])
    # The ego extends to either side by its half width at least, at any heading of a path.
    if most - lat < high and least + lat > low:
        return False
    half = reach_across(size, state[2])
    left = not (state[1] - half < high + _LEFT and state[1] + half > low - _LEFT)
    for k in range(frames):
        r, half = path[k, 1], across_of(size, turned[0, k], turned[1, k])
        inside = r - half < high and r + half > low
        if inside and left:
            return True
        left = left or not (r - half < high + _LEFT and r + half > low - _LEFT)
    return False


@kernel_inline
def find_unobligated(
    others: RoadVehicles,
    limits: tuple[float, float],
    plan: PlannedPath,
    lanes: LaneState,
    state: FloatArray,
    size: Footprint,
    rows: IntArray,
) -> int:
    """Number of vehicles in reach that have no distance obligation on a path; their rows are written to the beginning
    of `rows`, (v,).

    A follower behind the ego and its buffer, in a lane that the ego owns, has a distance obligation, with two
    exceptions. It has none on a path that enters a lane that the ego does not own, if the follower touches that lane or
    may enter it. It has none on a path that leaves the follower's band and comes back. If the band contains the place
    where the ego stops, only that place counts for the second exception.

    Parameters
    ----------
    others, limits : as in `in_reach`.
    plan, lanes : the path, and the lanes of the scene. state, size : of the ego now: road state (4,), footprint.
    """
    lane, fail, owned, centers = plan.lane, plan.fail, lanes.owned, lanes.centers
    low, high, behind, in_owned = others.low, others.high, others.behind, others.in_owned_lane
    reached, count, stand = in_reach(others, limits, True, rows), 0, size.across + _LEFT
    for place in range(reached):
        j = rows[place]
        obliged = behind[j] and in_owned[j]
        if obliged:
            for entered in (lane, fail):
                if not owned[entered]:
                    touches = low[j] < centers[entered] + TOUCH and high[j] > centers[entered] - TOUCH
                    obliged = obliged and not (touches or others.comes[entered, j])
        if obliged:
            # A band may shrink during the plan, down to the place where the ego stops. The ego may come to own the lane
            # of that place meanwhile.
            least, most = low[j], high[j]
            if least < centers[fail] + stand and most > centers[fail] - stand:
                least, most = centers[fail] - stand, centers[fail] + stand
            obliged = not _comes_back(state, plan.path, plan.turned, size, least, most)
        if not obliged:
            rows[count] = j
            count += 1
    return count


@kernel_no_refcount
def mark_relied_on(
    others: RoadVehicles,
    state: FloatArray,
    size: Footprint,
    lanes: LaneState,
    plan: tuple[int, int],
    before: tuple[BoolArray, BoolArray],
    counted: BoolArray,
) -> None:
    """For each vehicle, whether a stored plan relies on it to brake, written to `counted`, (v,). These are the vehicles
    that were behind the ego a frame before and may be in its way. Vehicles that the plan leaves out for their distance
    obligation do not count.

    A vehicle with an obligation that has moved aside may have to be considered again, in two cases. It no longer
    reaches the place where the ego stops, and the plan may sway back into its band. Or the plan enters a lane on the
    way, and the vehicle may enter that lane too. The plan relies on both to leave it its room.

    Parameters
    ----------
    others : the vehicles, (v,). state, size : of the ego: road state (4,) and footprint.
    plan : lane in which the stored plan stops, and lane that it enters on the way, or -1.
    before : whether each vehicle was behind the ego in the scene before, and whether it was in an owned lane, (v,)
        bool.
    """
    centers, owned = lanes.centers, lanes.owned
    keeps = owned[plan[0]] and (plan[1] < 0 or owned[plan[1]])
    half, goal, stand = reach_across(size, state[2]) + _BESIDE, centers[plan[0]], size.across + _LEFT
    least, most = min(state[1], goal) - half, max(state[1], goal) + half
    for j in range(counted.shape[0]):
        low, high = others.low[j], others.high[j]
        near = plan[1] >= 0 or others.comes[plan[0], j] or (low < most and high > least)
        reaches = low < goal + stand and high > goal - stand
        counted[j] = before[0][j] and near and not (keeps and before[1][j] and others.in_owned_lane[j] and reaches)


@kernel_no_refcount
def update_lanes(
    r: float,
    frames: int,
    near: LaneDistances,
    plan: tuple[int, bool],
    lanes: LaneState,
    obliged: BoolArray,
    coming: BoolArray,
) -> None:
    """Advance by one scene, in place: frames of visibility in each lane, lanes owned, and vehicles that may enter each
    lane.

    Parameters
    ----------
    r : lateral position of the ego [m]. frames : number of frames since the scene before.
    plan : lane in which the stored fail-safe stops, or -1; and whether this is the first scene. Then the other vehicles
        are taken to have seen the ego for long.
    lanes : `visible` and `owned` are updated. Ownership begins when the ego touches the lane with a verified plan to
        stop there. It ends when its body has left the lane and no stored plan stops there.
    obliged : vehicles with a distance obligation, (m,).
    coming : whether each vehicle may enter each lane, (lanes, m) or (0, m). Where the ego is no longer visible in a
        lane, every vehicle without an obligation may enter it.
    """
    stored, first = plan
    centers, owned, visible = lanes.centers, lanes.owned, lanes.visible
    sight, touch, leave = near.sight, near.touch, near.leave
    here = nearest(centers, r)
    for j in range(centers.shape[0]):
        offset, last = abs(r - centers[j]), visible[j]
        visible[j] = (_LONG if first else last) + frames if offset <= sight else 0
        had = j == here if first else owned[j]
        owned[j] = (had and (offset < leave or j == stored)) or (j == stored and offset < touch)
        if not first and coming.shape[0] > 0 and last > 0 and visible[j] == 0:
            for i in range(coming.shape[1]):
                coming[j, i] = coming[j, i] or not obliged[i]


@compiled
def updated_lanes(
    r: float,
    frames: int,
    near: LaneDistances,
    stored: int,
    lanes: LaneState,
    obliged: BoolArray,
    coming: BoolArray,
) -> tuple[IntArray, BoolArray, BoolArray]:
    """`update_lanes` with new arrays. In the first scene `visible` and `owned` are empty; `coming` may have any other
    shape if there is none."""
    centers, owned, visible = lanes.centers, lanes.owned, lanes.visible
    n, first = centers.shape[0], visible.shape[0] != centers.shape[0]
    seen, own, comes = np.zeros(n, np.intp), np.zeros(n, np.bool_), coming.copy()
    if not first:
        seen[:] = visible
        if owned.shape[0] == n:
            own[:] = owned
        else:
            own[nearest(centers, r)] = True
    coming = comes if comes.shape[0] == n else comes[:0]
    update_lanes(r, frames, near, (stored, first), LaneState(centers, own, seen), obliged, coming)
    return seen, own, comes


class EgoInScene(NamedTuple):
    """The ego in the present scene.

    Attributes
    ----------
    state : road state, (4,). size : footprint. seen : the ego in the world frame.
    lanes : of the scene.
    stored, entered : lane in which its stored plan stops, and lane that it enters on the way, or -1.
    """

    state: FloatArray
    size: Footprint
    seen: EgoFootprint
    lanes: LaneState
    stored: int
    entered: int


@kernel_no_refcount
def fill_vehicles(
    vehicles: VehicleBodies,
    ego: EgoInScene,
    earlier: EarlierVehicles,
    sight: VisibilityParameters,
    others: RoadVehicles,
    buffer: BoolArray,
) -> None:
    """Fill in `others`, the vehicles as the clauses read them; `buffer` is a buffer, (m, 4).

    Parameters
    ----------
    vehicles, ego : the scene. earlier : the other vehicles in the scene before.
    """
    rows, states, bodies = vehicles.rows, vehicles.states, vehicles.bodies
    state, size, owned, centers, visible = ego.state, ego.size, ego.lanes.owned, ego.lanes.centers, ego.lanes.visible
    followers, before = earlier.followers, earlier.comes
    lows, highs, floor, reach = bodies.low, bodies.high, bodies.floor, bodies.reach
    aheads, leasts, near, rs, across = others.ahead, others.least, others.size, others.r, others.across
    behinds, owned_flags = others.behind, others.in_owned_lane
    half, side = reach_along(size, state[2]), reach_across(size, state[2])
    for j in range(states.shape[0]):
        ahead = states[j, 0] - state[0]
        sin, cos = math.sin(states[j, 2]), math.cos(states[j, 2])
        # Whether a vehicle is behind follows from its present body; `reach` covers every heading that it may turn to.
        beyond = ahead + 0.5 * (rows[j, _LENGTH] * abs(cos) + rows[j, _WIDTH] * abs(sin)) + half
        behind, followed = beyond <= 0, followers.shape[0] > 0 and followers[j]
        if followed and not behind and beyond <= _CORNER:
            # The obligation lasts while a corner of the vehicle is beside a corner of the ego's buffer, until it
            # touches the buffer.
            behind = gap_between(ego.seen, ego.seen.along, ego.seen.across, rows, j, 0.0) >= 0
        low, high, in_owned = lows[j], highs[j], False
        for k in range(centers.shape[0]):
            in_owned = in_owned or (owned[k] and low < centers[k] + TOUCH and high > centers[k] - TOUCH)
        # The obligation lasts until the ego has left the band of the vehicle.
        in_owned = in_owned or (followed and low < state[1] + side and high > state[1] - side)
        aheads[j], behinds[j], owned_flags[j] = ahead, behind, in_owned
        leasts[j] = min(ahead, floor[j] - state[0])
        near[j] = reach[j] + size.along + size.growth_along + 2.0
        rs[j], across[j] = states[j, 1], states[j, 3] * sin
    if not sight.simultaneous_merge:
        for k in range(centers.shape[0]):
            for j in range(states.shape[0]):
                others.beside[k, j] = others.comes[k, j] = False
        return
    requested, tempted = buffer[:, :2], buffer[:, 2:]
    plan = (ego.stored, ego.entered)
    neighbours(others, centers, sight.width, before, visible, plan, requested)
    traffic = TrafficInLanes(states, across, bodies.lane, bodies.low, bodies.high)
    lane_change_incentives(traffic, LaneSight(centers, sight.distance, sight.slack), state, requested, tempted)
    mark_entrants(others, tempted, ego.lanes, before, plan, sight.reaction, sight.settled)
