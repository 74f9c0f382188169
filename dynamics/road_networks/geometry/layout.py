"""Where everything is in the arrays, beyond what `dynamics.highway_simulator.layout` says."""

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
    "LAW",
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
"""Columns of the lanes' numbers, those of `dynamics.highway_simulator.layout` among them.

ALONG and ACROSS are unit vectors of a straight lane, and of the line that a sine winds around; ORIGIN is its start, or
the centre of a circle; DIRECTION is 1 clockwise and -1 otherwise, QUARTER a quarter of a turn in it [rad]. PHASE is
that of the sine, or where the arc starts. LEAST and MOST are a box around the centre line.
"""
COLUMNS = 20

SHAPE, ROAD, ID, COUNT, FIRST, TO, FORBIDDEN, PRIORITY, ENDS, LEAVES, CROSSES = range(11)
"""Columns of the lanes' integers: the road that a lane belongs to, its index in it, how many there are, the first of
them, and the node that the road leads to; ENDS: no road goes on from its end, or only one that leads back; LEAVES:
vehicles vanish near its end; CROSSES: it leads from where roads part to where roads join, so that ways cross there."""
IDS = 11

STRAIGHT, SINE, CIRCULAR = range(3)
"""Shapes of lanes."""

ALONG, ACROSS, LATERAL_SPEED, YAW_RATE = range(layout.F, layout.F + 4)
"""Rows of `f` beyond those of a straight highway: where a vehicle is on its own lane, s and r [m]; and of one with
tyres that slip, how fast it goes sideways [m/s] and turns [rad/s]."""
F = layout.F + 4

ROUTE, ROUTE_END, YIELDS, FRAMES, LAW, DYNAMICAL = range(layout.G, layout.G + 6)
"""Rows of `g` beyond those of a straight highway: the next entry of a vehicle's route, and the one after its last, -1
without a route; whether it yields; in the first column, the frames that the road has seen; and of an ego with throttle
and steering, whether it follows a law of its own instead of inputs that are held, and whether its tyres slip."""
G = layout.G + 6

REACH = 4.0
"""How far from the box around its lane a body is looked for among the lanes near that one alone [m]."""

assert (_WIDTH, _LENGTH, _LIMIT) == (layout.LANE_WIDTH, layout.LANE_LENGTH, layout.LANE_LIMIT)
