"""The rules of the road: whether the motion of a vehicle in a frame was permitted. The certificate rests on this
predicate.

The occupancy (`dynamics.traffic.occupancy`) bounds everything that this predicate permits, for all time. From one frame
to the next, a vehicle may:

1. *speed*: change its speed within `braking` and `acceleration`, up to `max_speed`, and reverse no faster than
   `reversing_speed`;
2. *way*: advance along the road by its speed, less what turning takes (`turning_loss`, `turning_action` and the rates
   at which they recover), and move sideways by no more than its speed. Its heading may take more from the coming
   frame's distance where the ego's fail-safe keeps its room, and so may its speed on a bend (`bend_acceleration`);
3. *lanes*: stay in the lanes that its body touches. It may touch another lane where the ego's fail-safe keeps its room;
4. *reversing*: reverse behind a vehicle ahead in its lanes, to at most `queue_distance` from it; further where the
   ego's fail-safe keeps its room;
5. *distance*: stay behind the ego and its buffer, if it is behind the ego in a lane that the ego owns. It may come
   beside the ego where the ego's fail-safe keeps its room;
6. *crash*: not crash with a vehicle other than the ego;
7. *braking*: brake harder than `comfortable_braking` only as needed for a vehicle ahead, or for one that may move in
   ahead (`dynamics.traffic.reaction`); harder where the ego's fail-safe keeps its room;
8. *appearing*: appear only where the ego's fail-safe keeps its room and its buffer. The past of a new vehicle is not
   known, so only the shield checks this rule (`shield.certificate.road.monitor`);
9. *size*: grow in size only where the ego's fail-safe keeps its room.

A crashed vehicle may brake at 1/s times its speed, as in highway-env, where that is more than `braking`. Otherwise the
rules are the same for it, except for the displacement by which highway-env separates it from an ego that it has crashed
into. Rules 1 and 2 are decided here. For rules 3, 4, 7 and 9, and for headings, this module finds the vehicles that
have taken more room. The shield checks whether the fail-safe still holds, and whether a vehicle that has come beside
the ego (rule 5) leaves it the room. Rules 1 and 2 refer to single frames: a bound that holds for one frame holds for
all that follow. `tests/dynamics/traffic/test_rules_of_the_road.py` tests this with arbitrary inputs.
"""

from __future__ import annotations

import math
from enum import IntFlag
from typing import NamedTuple

import numpy as np

from dynamics.compiled import kernel_inline, kernel_no_refcount, row_as_tuple
from dynamics.state import BoolArray, FloatArray, IntArray, Vehicle
from dynamics.traffic.motion_limits import ROUNDING, MotionBounds, MotionLimits, limits_of
from dynamics.traffic.occupancy import OtherVehicles
from dynamics.traffic.occupancy_kernels import lap_distance, least_next_position, straight_overshoot
from dynamics.traffic.tables import Motion, ReachableBodies, VehicleTables, bodies_in, motion_of

__all__ = [
    "EgoFootprint",
    "RoadRule",
    "RuleViolations",
    "check_motions",
    "footprint",
    "gap_between",
    "rule_violations",
]

_LENGTH, _WIDTH, _CRASHED = int(Vehicle.LENGTH), int(Vehicle.WIDTH), int(Vehicle.CRASHED)
_SPEED, _WAY, _LANES, _REVERSING, _DISTANCE, _CRASH, _BRAKING, _APPEARED, _SIZE = 1, 2, 4, 8, 16, 32, 64, 128, 256
_TOUCHING = 2.0
"""Distance below which two bodies count as crashed into one another: highway-env moves them apart in the frame of a
crash [m]."""
_STRAIGHT = 1e-6
"""Share of the coming frame's distance that a heading may always take."""
_SIDEWAYS = 1.0001
"""Factor by which the lateral displacement may exceed speed times time, for bends. No bound rests on it (rule 3
does)."""


class RoadRule(IntFlag):
    """The rules of the road, as bits. The text of a rule is its name in reports.

    Examples
    --------
    >>> str(RoadRule.WAY)
    'way'
    """

    SPEED = _SPEED
    WAY = _WAY
    LANES = _LANES
    REVERSING = _REVERSING
    DISTANCE = _DISTANCE
    CRASH = _CRASH
    BRAKING = _BRAKING
    APPEARED = _APPEARED
    SIZE = _SIZE

    def __str__(self) -> str:
        """Name of the rule in reports."""
        return str(self.name).lower()


class RuleViolations(NamedTuple):
    """The rules that the vehicles violated in a frame.

    Attributes
    ----------
    broken : violations of rules 1, 2, 5 and 6 by each vehicle, (m,) of `RoadRule` bits.
    grown : of rules 2, 3, 4, 7 and 9, which count as violations only where the ego's fail-safe loses its room, (m,) of
        `RoadRule` bits.
    """

    broken: IntArray
    grown: IntArray


class EgoFootprint(NamedTuple):
    """The ego in the world frame, for the check of the other vehicles.

    Attributes
    ----------
    x, y : position [m]. heading [rad]. speed [m/s].
    along, across : half extents of its footprint with the buffer [m].
    body_along, body_across : half extents of its body alone [m].
    crashed : whether it has crashed in this frame. wrecked : in this frame or before.
    """

    x: float
    y: float
    heading: float
    speed: float
    along: float
    across: float
    body_along: float
    body_across: float
    crashed: bool
    wrecked: bool = False


@kernel_no_refcount
def gap_between(ego: EgoFootprint, along: float, across: float, rows: FloatArray, i: int, dt: float) -> float:
    """Greatest gap along the directions of the sides of two rectangles [m], see `dynamics.scenes.rectangles`, while
    both move for `dt` along their headings [s].

    Parameters
    ----------
    ego : the first rectangle, with half extents `along` and `across` [m].
    rows, i : vehicle rows (m, 7), and the index of the other vehicle.
    """
    dx, dy = ego.x - rows[i, 0], ego.y - rows[i, 1]
    ux, uy, wx, wy = math.cos(ego.heading), math.sin(ego.heading), math.cos(rows[i, 2]), math.sin(rows[i, 2])
    c, s = abs(ux * wx + uy * wy), abs(uy * wx - ux * wy)
    length, width = 0.5 * rows[i, _LENGTH], 0.5 * rows[i, _WIDTH]
    # Half of the ego's displacement relative to the vehicle.
    px, py = 0.5 * dt * (ego.speed * ux - rows[i, 3] * wx), 0.5 * dt * (ego.speed * uy - rows[i, 3] * wy)
    dx, dy = dx + px, dy + py
    mine = abs(dx * ux + dy * uy) - abs(px * ux + py * uy) - along - length * c - width * s
    beside = abs(dy * ux - dx * uy) - abs(py * ux - px * uy) - across - length * s - width * c
    theirs = abs(dx * wx + dy * wy) - abs(px * wx + py * wy) - length - along * c - across * s
    by = abs(dy * wx - dx * wy) - abs(py * wx - px * wy) - width - along * s - across * c
    return max(max(mine, beside), max(theirs, by))


class _Progress(NamedTuple):
    """Motion of one vehicle in a frame.

    Attributes
    ----------
    v0, v : speed before and now [m/s]. ds, dr : displacement along and across the road [m].
    wrecked : whether the vehicle had crashed before.
    """

    v0: float
    v: float
    ds: float
    dr: float
    wrecked: bool


@kernel_inline
def _breaks_speed(limits: MotionBounds, it: _Progress) -> bool:
    """Rule 1, *speed*."""
    rate, hardest = (it.v - it.v0) / limits.period, limits.braking
    if it.wrecked:
        slowest, dt = it.v0, limits.period / limits.frames
        for _ in range(int(limits.frames)):
            slowest -= max(limits.braking, slowest) * dt
        hardest = max((it.v0 - slowest) / limits.period + ROUNDING, limits.braking)
    sped = not it.v <= max(it.v0, limits.fastest) + ROUNDING or not it.v >= -limits.reversing
    most_rate = min(limits.acceleration, limits.power / max(it.v0, 1e-3) + ROUNDING)
    return sped or not (-hardest <= rate <= most_rate)


@kernel_inline
def _breaks_way(limits: MotionBounds, it: _Progress, most: float, budget: float, action: float) -> bool:
    """Rule 2, *way*: the displacement, and what turning takes.

    Parameters
    ----------
    most : greatest metres of s in a metre driven. budget, action : turning allowances that are left.
    """
    way = it.v0 * limits.period
    back = not it.ds >= min(way, 0.0) * most - ROUNDING
    ahead = not it.ds <= max(way, 0.0) * most + ROUNDING
    if back or ahead or not abs(it.dr) <= abs(way) * _SIDEWAYS + ROUNDING:
        return True
    return not min(budget, action) >= -ROUNDING


@kernel_inline
def _heads_off(i: int, states: FloatArray, stretch: FloatArray, motion: Motion, bodies: ReachableBodies) -> bool:
    """Rule 2, *way*, for the heading of vehicle i: whether it takes more from the coming frame's distance than turning
    may. highway-env tests for crashes with the positions that constant velocity along the heading gives in that
    frame."""
    v = states[i, 3]
    coming = v * math.cos(states[i, 2]) * motion.dt
    if (1 - _STRAIGHT) * v * motion.dt <= coming <= max(v, 0.0) * motion.dt:
        return False
    forth = coming <= max(v, 0.0) * motion.dt + ROUNDING
    if stretch.shape[1] > 0:
        coming = min(coming * stretch[0, i], coming * stretch[1, i])
    least = least_next_position(i, states, stretch, motion, bodies) - ROUNDING
    return not (forth and states[i, 0] + coming >= least)


@kernel_inline
def _touches_more(i: int, before: ReachableBodies, now: ReachableBodies) -> bool:
    """Rule 3, *lanes*: whether vehicle i may reach further across the road than before."""
    return not (now.low[i] >= before.low[i] - ROUNDING and now.high[i] <= before.high[i] + ROUNDING)


@kernel_inline
def _comes_beside(i: int, rows: FloatArray, ego: EgoFootprint, period: float) -> bool:
    """Rule 5, *distance*, for a vehicle i that was behind the ego. highway-env tests for crashes with the positions
    that constant velocities give in the coming frame."""
    touches = gap_between(ego, ego.along, ego.across, rows, i, 0.0) < 0
    return touches or gap_between(ego, ego.body_along, ego.body_across, rows, i, period) <= 0


@kernel_inline
def _is_pushed(i: int, rows: FloatArray, ego: EgoFootprint, wrecked: bool) -> bool:
    """Whether highway-env may have moved vehicle i because the ego has crashed into it."""
    pushed = ego.crashed or (ego.wrecked and wrecked)
    return pushed and gap_between(ego, ego.body_along, ego.body_across, rows, i, 0.0) < _TOUCHING


@kernel_inline
def _brakes_harder(i: int, limits: MotionBounds, it: _Progress, brakes0: FloatArray, brakes: FloatArray) -> bool:
    """Rule 7, *braking*: whether vehicle i has braked harder than its bound, or may brake harder than by the bound
    before. The bounds, (m, K) each, are those before and now."""
    frames, allowed = int(limits.frames), 0.0
    for k in range(frames):
        allowed += brakes0[i, k] if k < brakes0.shape[1] else limits.braking
    harder = not it.v0 - it.v <= (allowed + ROUNDING) * limits.period / limits.frames
    for k in range(brakes.shape[1] - frames):
        harder = harder or brakes[i, k] > brakes0[i, k + frames] + ROUNDING
    return harder


@kernel_inline
def _overshoots_more(i: int, limits: MotionBounds, it: _Progress, rows0: FloatArray, rows: FloatArray) -> bool:
    """Rule 2, *way*, for the speed of vehicle i on a bend: whether straight motion leads further off the bend than
    before."""
    if not limits.curvature > 0:
        return False
    dt, slowest = limits.period / limits.frames, limits.bend_speed
    was = straight_overshoot(limits.curvature, rows0[i, _LENGTH], max(abs(it.v0), slowest) * dt)
    now = straight_overshoot(limits.curvature, rows[i, _LENGTH], max(abs(it.v), slowest) * dt)
    return not now <= was + ROUNDING


@kernel_inline
def _has_grown(i: int, rows0: FloatArray, rows: FloatArray) -> bool:
    """Rule 9, *size*."""
    longer = not rows[i, _LENGTH] <= rows0[i, _LENGTH] + ROUNDING
    return longer or not rows[i, _WIDTH] <= rows0[i, _WIDTH] + ROUNDING


@kernel_inline
def check_motions(
    before: VehicleTables,
    after: VehicleTables,
    bounds: MotionLimits,
    behind: BoolArray,
    ego: EgoFootprint,
    found: RuleViolations,
) -> None:
    """`rule_violations` as a kernel: fill in `found`.

    Parameters
    ----------
    before, after : the vehicles in the scene before and in this scene, in the same order.
    behind, ego : see `rule_violations`.
    """
    limits, motion = MotionBounds(*row_as_tuple(bounds.row, 11)), motion_of(bounds.settings)
    rows0, states0, brakes0 = before.others, before.states, before.tables.brakes
    rows, states, brakes, stretch = after.others, after.states, after.tables.brakes, bounds.stretch
    bodies0, bodies = bodies_in(before).bodies, bodies_in(after).bodies
    for i in range(rows.shape[0]):
        bits, more, wrecked = 0, 0, rows0[i, _CRASHED] > 0
        ds = lap_distance(states[i, 0] - states0[i, 0], limits.lap)
        it = _Progress(states0[i, 3], states[i, 3], ds, states[i, 1] - states0[i, 1], wrecked)
        most = stretch[1, i] if stretch.shape[1] > 0 else 1.0
        # A vehicle that the ego has crashed into has violated no rule by the crash.
        pushed = _is_pushed(i, rows, ego, wrecked)
        if rows[i, _CRASHED] > 0 and not wrecked and not (ego.crashed and pushed):
            bits |= _CRASH
        if _breaks_speed(limits, it):
            bits |= _SPEED
        travels = limits.frames == 1 and not (wrecked and pushed)
        if travels and _breaks_way(limits, it, most, bodies.budget[i], bodies.action[i]):
            bits |= _WAY
        if behind[i] and _comes_beside(i, rows, ego, limits.period):
            bits |= _DISTANCE
        if _heads_off(i, states, stretch, motion, bodies) or _overshoots_more(i, limits, it, rows0, rows):
            more |= _WAY
        if _touches_more(i, bodies0, bodies):
            more |= _LANES
        if _has_grown(i, rows0, rows):
            more |= _SIZE
        harder = not wrecked and _brakes_harder(i, limits, it, brakes0, brakes)
        if harder:
            more |= _BRAKING
        drop = lap_distance(bodies0.floor[i] - bodies.floor[i], limits.lap)
        if not drop <= ROUNDING and not harder:
            more |= _REVERSING
        found.broken[i], found.grown[i] = bits, more


def footprint(ego: FloatArray, longitudinal: float, lateral: float, crashed: bool = False) -> EgoFootprint:
    """The ego as `rule_violations` takes it, from a vehicle row (7,) and its buffer along and across its heading
    [m]."""
    x, y, heading, speed, length, width = ego[: Vehicle.CRASHED].tolist()
    along, across = 0.5 * length, 0.5 * width
    return EgoFootprint(x, y, heading, speed, along + longitudinal, across + lateral, along, across, crashed)


def rule_violations(
    before: OtherVehicles | VehicleTables, after: OtherVehicles, period: float, behind: BoolArray, ego: EgoFootprint
) -> RuleViolations:
    """Which rules the vehicles violated between two scenes, `period` seconds apart.

    Parameters
    ----------
    before, after : the other vehicles in both scenes, in the same order; `after` is built with `before`.
    period : time between them [s]. Over more than one frame, the distance travelled (rule 2) is not checked.
    behind : vehicles that had to keep their distance from the ego in the scene before, (m,).
    ego : the ego after the frame.

    Examples
    --------
    >>> import numpy as np
    >>> from dynamics.roads.straight import StraightRoad
    >>> from dynamics.traffic.assumptions import Assumptions
    >>> def at(x, v, before=None):
    ...     row = np.array([[x, 0.0, 0.0, v, 5.0, 2.0, 0.0]])
    ...     return OtherVehicles(row, row[:, :4], StraightRoad.from_lanes(2), Assumptions.idm(), 0.1, before)
    >>> nobody, ego = np.zeros(1, bool), EgoFootprint(0.0, 4.0, 0.0, 20.0, 4.5, 1.3, 2.5, 1.0, False)
    >>> first = at(0.0, 20.0)
    >>> rule_violations(first, at(2.0, 19.5, first), 0.1, nobody, ego).broken.tolist()
    [0]
    >>> RoadRule(int(rule_violations(first, at(2.0, 19.0, first), 0.1, nobody, ego).broken[0]))
    <RoadRule.SPEED: 1>
    """
    frames = max(round(period / after.dt), 1)
    limits = limits_of(after.assumptions, (float(period), frames), after.lap, after.curvature)
    m = len(after.states)
    found = RuleViolations(np.zeros(m, np.intp), np.zeros(m, np.intp))
    old = VehicleTables(before.others, before.states, before.tables)
    new = VehicleTables(after.others, after.states, after.tables)
    check_motions(old, new, MotionLimits(after.stretch, after.settings, limits), behind, ego, found)
    return found
