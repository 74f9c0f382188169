"""Where everything is in the arrays of the simulator.

A scene of m bodies, of which the first is the ego and the last may be standing obstacles, is a structure of arrays:
`f` (F, m) float64 of what moves, `g` (G, m) int64 of what is counted, `p` (P, m) float64 of what stays. Lanes are rows
of `lanes` (n, LANE_COLUMNS) float64, straight and along x.
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
"""Rows of `f` [m, rad, m/s, m/s^2, s]. COS and SIN are of the heading; IMPACT is what the next frame moves it by."""
F = 12

KIND, LANE, TARGET, CRASHED, IMPACTED, CHECKS, CHANGES, ON, STALE = range(9)
"""Rows of `g`. CHECKS: it looks for collisions; CHANGES: it may change lanes; ON: lanes that others see it on, bits;
STALE: it may be in another lane than LANE, which a frame finds out."""
G = 9

EGO, CONTINUOUS, IDM, LINEAR, OBSTACLE, ALLY = range(6)
"""Kinds: an ego with meta-actions or with throttle and steering, traffic, what stands, another ego (meta-actions)."""

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
"""Rows of `p`: constants of highway-env's vehicles. TWICE_ROOT is 2 sqrt(a b); A and S are the linear model's. ACC_MAX
and COMFORT of an ego with throttle and steering are what a law of its own brakes and accelerates at most."""
P = 20

LANE_Y, LANE_WIDTH, LANE_LENGTH, LANE_LIMIT = range(4)
"""Columns of `lanes`: centre line [m], width [m], length [m] from x = 0, speed limit [m/s]."""
LANE_COLUMNS = 4
