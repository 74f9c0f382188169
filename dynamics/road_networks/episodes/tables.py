"""Where everything is in the tables that a scene is made from."""

from __future__ import annotations

__all__ = [
    "AT",
    "BOUND_FOR",
    "DRAWN",
    "EGO_ROW",
    "FACING",
    "FAST",
    "FAST_SPREAD",
    "FIRST_LANE",
    "GOAL",
    "GOALS",
    "HEADED",
    "INTEGERS",
    "LANES",
    "LAW",
    "MANY",
    "MAY_CHANGE",
    "NORMAL",
    "NUMBERS",
    "PLACE",
    "PLACE_SPREAD",
    "QUEUE",
    "SCATTERED",
    "STEADY",
    "TRIES",
    "UNIFORM",
    "VARIES",
    "WANTED",
    "WHOSE",
]

PLACE, PLACE_SPREAD, FAST, FAST_SPREAD, FACING, WANTED = range(6)
"""Numbers of a row: where along the lane [m] and how fast [m/s] a vehicle is, and how far a draw takes that; where
along the lane its heading is taken, NaN for where it is; the speed that it wants if not its own, NaN for that. FAST is
NaN for the limit of its lane. In a queue PLACE is the spacing, and nothing is drawn of it."""
NUMBERS = 6

WHOSE, LAW, MANY, TRIES, FIRST_LANE, LANES, DRAWN, HEADED, GOAL, GOALS, VARIES, MAY_CHANGE, BOUND_FOR = range(13)
"""Integers of a row: EGO_ROW or 1 for the traffic; AT, SCATTERED or QUEUE; how many vehicles, and how often a place is
looked for for each; the first lane, and of how many it is drawn; STEADY, UNIFORM or NORMAL, what is drawn; whether it
is headed along its lane, not along x; the first goal, -1 without a route, and of how many it is drawn; whether its
parameters are drawn; whether it may change lanes; the lane that it is bound for, -1 for its own."""
INTEGERS = 13

EGO_ROW = 0
AT, SCATTERED, QUEUE = range(3)
STEADY, UNIFORM, NORMAL = range(3)
