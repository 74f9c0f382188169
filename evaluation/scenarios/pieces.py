"""Pieces of a map: straights, merges, intersections and roundabouts.

A builder takes the port to attach to, and returns a piece with ports of its own, without side effects. Every road has
two lanes in a direction, and lane i continues as lane i of every road that follows. So a vehicle reaches every exit
without a lane change, and no lane ends except at an exit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from evaluation.scenarios.frames import ARM_SPEED, ROAD_SPEED, TURN_SPEED, Kind, Lines, RoadFrame, RoadLanes

__all__ = ["BUILDERS", "Edge", "Piece", "Port", "intersection", "merge", "roundabout", "straight", "turning_circle"]

ARM = 50.0
"""Length of an arm of a crossing [m]."""
_STRAIGHT = 80.0
_RAMP, _TAPER, _AFTER, _APART = 60.0, 80.0, 60.0, 12.0
"""Merge: lengths of the ramp beside the road, of the taper, and of the road behind; distance of the ramp to the right
[m]."""
_HALF = 15.0
"""Distance from the centre of an intersection to its arms [m]; right turns have radii of 9 and 13 m."""
_RING, _ENTRY = 18.0, 16.0
"""Radius of the line inside a roundabout's two lanes, and of the line beside its entries and exits [m]."""
_REACH = float(np.sqrt((_RING + _ENTRY) ** 2 - _ENTRY**2))
"""Distance from the centre of a roundabout to its arms [m]; from there an entry, which turns right, touches the ring.
"""
_TOUCH = float(np.arctan2(_ENTRY, _REACH))
"""Angle between an arm and the point of contact with the ring [rad]."""
_FIRST, _SECOND = 3, 1
"""Priorities of the through road and of the crossing road, as in highway-env's intersection; a left turn has one less.
"""
_INSIDE, _ENTERING = 2, 0
"""Priorities on a ring or a main road, and on an entry."""


@dataclass(frozen=True, slots=True)
class Edge:
    """A road: two lanes from a node of the network to another."""

    start: str
    end: str
    lanes: RoadLanes


@dataclass(frozen=True, slots=True)
class Port:
    """Connection to another piece.

    Attributes
    ----------
    frame : frame on the axis of the road, heading out of the piece.
    leaving : node where vehicles leave the piece.
    entering : node where vehicles enter the piece.
    """

    frame: RoadFrame
    leaving: str
    entering: str

    @classmethod
    def named(cls, name: str, frame: RoadFrame) -> Port:
        """A port with nodes of the same name."""
        return cls(frame, f"{name}.out", f"{name}.in")


@dataclass(frozen=True, slots=True)
class Piece:
    """A part of a road network.

    Attributes
    ----------
    name : prefix of the names of its nodes.
    edges : its roads.
    ports : ports by their direction as seen from the entry: "front", "left", "right".
    ramps : nodes where vehicles can only enter.
    """

    name: str
    edges: tuple[Edge, ...]
    ports: Mapping[str, Port]
    ramps: tuple[str, ...] = ()


def straight(name: str, entry: Port) -> Piece:
    """A two-way road with two lanes in each direction."""
    front = Port.named(f"{name}.front", entry.frame.at(_STRAIGHT, 0.0))
    kind = Kind(ROAD_SPEED, _INSIDE)
    edges = (
        Edge(entry.leaving, front.leaving, entry.frame.straight((0.0, 0.0), (_STRAIGHT, 0.0), kind)),
        Edge(front.entering, entry.entering, entry.frame.straight((_STRAIGHT, 0.0), (0.0, 0.0), kind)),
    )
    return Piece(name, edges, {"front": front})


def merge(name: str, entry: Port) -> Piece:
    """A merge of two ramp lanes into the two lanes of a road; the ramp gives way."""
    frame, joint, ramp, taper = entry.frame, f"{name}.joint", f"{name}.ramp.in", f"{name}.taper"
    along = f"{name}.along"
    begin, end = _RAMP + _TAPER, _RAMP + _TAPER + _AFTER
    front = Port.named(f"{name}.front", frame.at(end, 0.0))
    main = Kind(ROAD_SPEED, _INSIDE)
    side = Kind(ARM_SPEED, _ENTERING)
    edges = (
        Edge(entry.leaving, along, frame.straight((0.0, 0.0), (_RAMP, 0.0), main)),
        Edge(along, joint, frame.straight((_RAMP, 0.0), (begin, 0.0), main._replace(lines=Lines.MOUTH))),
        Edge(joint, front.leaving, frame.straight((begin, 0.0), (end, 0.0), main)),
        Edge(front.entering, entry.entering, frame.straight((end, 0.0), (0.0, 0.0), main)),
        Edge(ramp, taper, frame.straight((0.0, _APART), (_RAMP, _APART), side)),
        Edge(taper, joint, frame.shift((_RAMP, _APART), (begin, 0.0), side._replace(lines=Lines.EDGE))),
    )
    return Piece(name, edges, {"front": front}, (ramp,))


def intersection(name: str, entry: Port) -> Piece:
    """A crossing of four arms without lights: the through road has the right of way, and left turns wait."""
    middle = entry.frame.at(ARM + _HALF, 0.0)
    arms = _arms(name, entry, middle, ARM + _HALF, ("left", "front", "right"))
    edges: list[Edge] = []
    for side, (turn, port) in enumerate(arms):
        frame, level = middle.at(0.0, 0.0, turn), (_FIRST, _SECOND)[side % 2]
        stop, begin = f"{name}.{_SIDES[side]}.stop", f"{name}.{_SIDES[side]}.begin"
        arm = Kind(ARM_SPEED, level)
        inside = Kind(TURN_SPEED, level, Lines.NONE)
        right, ahead, left = (f"{name}.{_SIDES[(side + quarter) % 4]}.begin" for quarter in (3, 2, 1))
        edges += [
            Edge(port.entering, stop, frame.straight((-ARM - _HALF, 0.0), (-_HALF, 0.0), arm)),
            Edge(stop, right, frame.arc((-_HALF, _HALF), _HALF, -0.5 * np.pi, 0.0, inside._replace(lines=Lines.EDGE))),
            Edge(stop, ahead, frame.straight((-_HALF, 0.0), (_HALF, 0.0), inside)),
            Edge(
                stop,
                left,
                frame.arc((-_HALF, -_HALF), _HALF, 0.5 * np.pi, 0.0, Kind(TURN_SPEED, level - 1, Lines.NONE)),
            ),
            Edge(begin, port.leaving, frame.straight((-_HALF, 0.0), (-ARM - _HALF, 0.0), arm)),
        ]
    return Piece(name, tuple(edges), {_SIDES[i]: arms[i][1] for i in range(1, 4)})


def roundabout(name: str, entry: Port) -> Piece:
    """A roundabout with four arms; the ring of two lanes has the right of way."""
    return _ring(name, entry, ("left", "front", "right"))


def turning_circle(name: str, entry: Port) -> Piece:
    """A roundabout with only the arm ahead, where vehicles turn at the end of a map."""
    return _ring(name, entry, ("front",))


BUILDERS: Mapping[str, Callable[[str, Port], Piece]] = MappingProxyType(
    {"merge": merge, "intersection": intersection, "roundabout": roundabout, "straight": straight}
)
"""Builders of the pieces, by kind."""

_SIDES = ("back", "left", "front", "right")
"""Sides of a crossing, from that of the entry on; each is a quarter turn to the right of the one before, as seen from
the centre."""


def _arms(name: str, entry: Port, middle: RoadFrame, length: float, sides: tuple[str, ...]) -> list[tuple[float, Port]]:
    """Arms of a crossing, in the order of `_SIDES`.

    Returns
    -------
    For each arm the heading of entering vehicles in the frame of the centre [rad], and its port. The port of the entry
    is seen from inside: vehicles that leave the piece there enter the piece before.
    """
    arms = [(0.0, Port(entry.frame.at(0.0, 0.0, np.pi), entry.entering, entry.leaving))]
    for side in sides:
        turn = 0.5 * np.pi * _SIDES.index(side)
        frame = middle.at(0.0, 0.0, turn).at(-length, 0.0, np.pi)
        arms.append((turn, Port.named(f"{name}.{side}", frame)))
    return arms


def _ring(name: str, entry: Port, sides: tuple[str, ...]) -> Piece:
    middle = entry.frame.at(ARM + _REACH, 0.0)
    arms = _arms(name, entry, middle, ARM + _REACH, sides)
    # Traffic drives on the right, so the ring runs counterclockwise on the screen: from an arm to the one on its right,
    # with the index one lower.
    names = ("back", *sides)
    inside = Kind(TURN_SPEED, _INSIDE)
    quarter, half, touch = 0.5 * np.pi, np.pi, _TOUCH
    edges: list[Edge] = []
    for k, (turn, port) in enumerate(arms):
        frame, own, following = middle.at(0.0, 0.0, turn), f"{name}.{names[k]}", f"{name}.{names[k - 1]}"
        gap = (turn - arms[k - 1][0]) % (2 * np.pi)
        edges += [
            Edge(
                port.entering,
                f"{own}.yield",
                frame.straight((-ARM - _REACH, 0.0), (-_REACH, 0.0), Kind(ARM_SPEED, _ENTERING)),
            ),
            Edge(
                f"{own}.yield",
                f"{own}.enter",
                frame.arc((-_REACH, _ENTRY), _ENTRY, -quarter, -touch, Kind(TURN_SPEED, _ENTERING, Lines.EDGE)),
            ),
            Edge(
                f"{own}.enter",
                f"{following}.exit",
                frame.arc((0.0, 0.0), _RING, half - touch, half + touch - gap, inside),
            ),
            Edge(
                f"{own}.exit",
                f"{own}.enter",
                frame.arc((0.0, 0.0), _RING, half + touch, half - touch, inside._replace(lines=Lines.MOUTH)),
            ),
            Edge(
                f"{own}.exit",
                f"{own}.begin",
                frame.arc((-_REACH, -_ENTRY), _ENTRY, touch, quarter, Kind(TURN_SPEED, _INSIDE, Lines.EDGE)),
            ),
            Edge(
                f"{own}.begin",
                port.leaving,
                frame.straight((-_REACH, 0.0), (-ARM - _REACH, 0.0), Kind(ARM_SPEED, _INSIDE)),
            ),
        ]
    return Piece(name, tuple(edges), {side: arms[k][1] for k, side in enumerate(names) if k})
