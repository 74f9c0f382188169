"""Rows and columns of the arrays of the simulator.

A scene of m bodies is a structure of arrays. The first body is the ego, the last ones may be standing obstacles. `f`
(F, m) float64 has continuous states, `g` (G, m) int64 has integers and flags, `p` (P, m) float64 has constants. Lanes
are rows of `lanes` (n, LANE_COLUMNS) float64, straight and along x.
"""

from __future__ import annotations

__all__ = [
    "ACCELERATION",
    "ACC_MAX",
    "ALLY",
    "A_GAP",
    "A_LEADER",
    "A_SPEED",
    "CHANGES",
    "CHECKS",
    "COMFORT",
    "CONTINUOUS",
    "COS",
    "CRASHED",
    "DELAY",
    "DELTA",
    "DIAGONAL",
    "DISTANCE",
    "EGO",
    "GAIN",
    "HEADING",
    "IDM",
    "IMPACTED",
    "IMPACT_X",
    "IMPACT_Y",
    "IMPOSED",
    "KIND",
    "LANE",
    "LANE_COLUMNS",
    "LANE_LENGTH",
    "LANE_LIMIT",
    "LANE_WIDTH",
    "LANE_Y",
    "LENGTH",
    "LINEAR",
    "MAX_SPEED",
    "MIN_SPEED",
    "OBSTACLE",
    "ON",
    "POLITENESS",
    "SIN",
    "SPEED",
    "STALE",
    "STEERING",
    "S_HEADING",
    "S_LATERAL",
    "TARGET",
    "TARGET_SPEED",
    "TIME",
    "TIMER",
    "TWICE_ROOT",
    "WIDTH",
    "F",
    "G",
    "P",
    "X",
    "Y",
]

X, Y, HEADING, SPEED, COS, SIN, STEERING, ACCELERATION, TARGET_SPEED, TIMER, IMPACT_X, IMPACT_Y = range(12)
"""Rows of `f` [m, rad, m/s, m/s^2, s]. COS and SIN are of the heading. IMPACT is the displacement that the next frame
applies after a collision [m]."""
F = 12

KIND, LANE, TARGET, CRASHED, IMPACTED, CHECKS, CHANGES, ON, STALE = range(9)
"""Rows of `g`. CHECKS: the body checks for collisions. CHANGES: it may change lanes. ON: the lanes on which it counts
as a neighbour, as bits. STALE: LANE may be outdated, and is updated in the next frame."""
G = 9

EGO, CONTINUOUS, IDM, LINEAR, OBSTACLE, ALLY = range(6)
"""Kinds: an ego with meta-actions or with throttle and steering, traffic by driving model, an obstacle, another ego
(with meta-actions)."""

(
    LENGTH,
    WIDTH,
    DIAGONAL,
    MAX_SPEED,
    MIN_SPEED,
    ACC_MAX,
    COMFORT,
    TWICE_ROOT,
    DISTANCE,
    TIME,
    DELTA,
    POLITENESS,
    GAIN,
    IMPOSED,
    DELAY,
    A_SPEED,
    A_LEADER,
    A_GAP,
    S_HEADING,
    S_LATERAL,
) = range(20)
"""Rows of `p`: constants of highway-env's vehicles. TWICE_ROOT is 2 sqrt(a b); A and S are parameters of the linear
model. For an ego with throttle and steering that follows controllers, ACC_MAX and COMFORT are its greatest deceleration
and acceleration."""
P = 20

LANE_Y, LANE_WIDTH, LANE_LENGTH, LANE_LIMIT = range(4)
"""Columns of `lanes`: centre line [m], width [m], length [m] from x = 0, speed limit [m/s]."""
LANE_COLUMNS = 4
