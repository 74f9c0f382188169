"""Columns and rows of the arrays of road networks, in addition to those of `dynamics.highway_simulator.layout`."""

from __future__ import annotations

from dynamics.highway_simulator import layout

__all__ = [
    "ACROSS",
    "ACROSS_X",
    "ACROSS_Y",
    "ALONG",
    "ALONG_X",
    "ALONG_Y",
    "AMPLITUDE",
    "CIRCULAR",
    "COLUMNS",
    "COUNT",
    "CROSSES",
    "DIRECTION",
    "DYNAMICAL",
    "ENDS",
    "FIRST",
    "FORBIDDEN",
    "FRAMES",
    "ID",
    "IDS",
    "LANE_HEADING",
    "LATERAL_SPEED",
    "LEADS_BACK",
    "LEAST_X",
    "LEAST_Y",
    "LEAVES",
    "MOST_X",
    "MOST_Y",
    "ORIGIN_X",
    "ORIGIN_Y",
    "PHASE",
    "PRIORITY",
    "PULSATION",
    "QUARTER",
    "RADIUS",
    "REACH",
    "ROAD",
    "ROUTE",
    "ROUTE_END",
    "SHAPE",
    "SINE",
    "STRAIGHT",
    "TO",
    "USES_CONTROLLERS",
    "YAW_RATE",
    "YIELDS",
    "F",
    "G",
]

(
    LANE_HEADING,
    _WIDTH,
    _LENGTH,
    _LIMIT,
    ORIGIN_X,
    ORIGIN_Y,
    ALONG_X,
    ALONG_Y,
    ACROSS_X,
    ACROSS_Y,
    AMPLITUDE,
    PULSATION,
    PHASE,
    RADIUS,
    DIRECTION,
    QUARTER,
    LEAST_X,
    LEAST_Y,
    MOST_X,
    MOST_Y,
) = range(20)
"""Columns of the lanes' numbers, including those of `dynamics.highway_simulator.layout`.

ALONG and ACROSS are unit vectors of a straight lane, and of the line that a sine winds around. ORIGIN is its start, or
the centre of a circle. DIRECTION is 1 clockwise and -1 otherwise, QUARTER a quarter turn in it [rad]. PHASE is the
phase of a sine, or the angle at which an arc starts [rad]. LEAST and MOST bound the box around the centre line [m].
"""
COLUMNS = 20

SHAPE, ROAD, ID, COUNT, FIRST, TO, FORBIDDEN, PRIORITY, ENDS, LEAVES, CROSSES = range(11)
"""Columns of the lanes' integers.

ROAD: the road of the lane; ID: the lane's index in it; COUNT: number of its lanes; FIRST: its first lane; TO: the node
that it leads to.
FORBIDDEN, PRIORITY: as in highway-env. ENDS: 1 if no road continues it, `LEADS_BACK` if only roads that lead back do.
LEAVES: vehicles vanish near its end. CROSSES: it leads from a node where roads part to a node where roads join, so that
ways cross there.
"""
LEADS_BACK = 2
"""Value of `ENDS` where only roads that lead back continue a lane."""
IDS = 11

STRAIGHT, SINE, CIRCULAR = range(3)
"""Shapes of lanes."""

ALONG, ACROSS, LATERAL_SPEED, YAW_RATE = range(layout.F, layout.F + 4)
"""Rows of `f` beyond those of a straight highway: s and r of a vehicle on its own lane [m]; and for a bicycle with tyre
slip, its lateral speed [m/s] and yaw rate [rad/s]."""
F = layout.F + 4

ROUTE, ROUTE_END, YIELDS, FRAMES, USES_CONTROLLERS, DYNAMICAL = range(layout.G, layout.G + 6)
"""Rows of `g` beyond those of a straight highway.

ROUTE, ROUTE_END: the next entry of a vehicle's route, and the one after its last, -1 without a route. YIELDS: whether
it yields. FRAMES: in the first column, the number of frames of the road.
LAW: whether an ego with throttle and steering follows controllers instead of constant inputs. DYNAMICAL: whether it has
tyre slip.
"""
G = layout.G + 6

REACH = 4.0
"""Distance from the box around its lane within which a body's closest lane is searched among the nearby lanes only
[m]."""

assert (_WIDTH, _LENGTH, _LIMIT) == (layout.LANE_WIDTH, layout.LANE_LENGTH, layout.LANE_LIMIT)
