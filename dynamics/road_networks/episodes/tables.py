"""Columns of the tables from which an initial scene is drawn."""

from __future__ import annotations

__all__ = [
    "AT",
    "BOUND_FOR",
    "DESIRED_SPEED",
    "DRAWN",
    "EGO_ROW",
    "FACING",
    "FIRST_LANE",
    "GOAL",
    "GOALS",
    "HEADED",
    "INTEGERS",
    "LANES",
    "MAY_CHANGE",
    "NORMAL",
    "NUMBERS",
    "PLACE",
    "PLACEMENT",
    "PLACE_SPREAD",
    "QUEUE",
    "ROLE",
    "SCATTERED",
    "START_SPEED",
    "START_SPEED_SPREAD",
    "STEADY",
    "TRIES",
    "UNIFORM",
    "VARIES",
    "VEHICLES",
]

PLACE, PLACE_SPREAD, START_SPEED, START_SPEED_SPREAD, FACING, DESIRED_SPEED = range(6)
"""Numbers of a row.

PLACE, FAST: position along the lane [m] and speed [m/s] of a vehicle; PLACE_SPREAD, FAST_SPREAD: their half range or
standard deviation. FACING: position along the lane at which the heading is taken, NaN for the vehicle's own.
WANTED: target speed, NaN for its speed. FAST is NaN for the speed limit of its lane. In a queue PLACE is the spacing,
without a random draw.
"""
NUMBERS = 6

ROLE, PLACEMENT, VEHICLES, TRIES, FIRST_LANE, LANES, DRAWN, HEADED, GOAL, GOALS, VARIES, MAY_CHANGE, BOUND_FOR = range(
    13
)
"""Integers of a row.

WHOSE: EGO_ROW, or 1 for the traffic. LAW: AT, SCATTERED or QUEUE. MANY: number of vehicles; TRIES: attempts to place
each. FIRST_LANE, LANES: first lane, and number of lanes that it is drawn from. DRAWN: distribution, STEADY, UNIFORM or
NORMAL.
HEADED: whether the heading is along the lane, not along x. GOAL, GOALS: first goal, -1 without a route, and number of
goals that it is drawn from. VARIES: whether parameters are drawn. MAY_CHANGE: whether it may change lanes. BOUND_FOR:
its target lane, -1 for its own.
"""
INTEGERS = 13

EGO_ROW = 0
AT, SCATTERED, QUEUE = range(3)
STEADY, UNIFORM, NORMAL = range(3)
