"""Map of a scenario: pieces in order, joined to one road network."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from evaluation.scenarios.frames import RoadFrame
from evaluation.scenarios.pieces import BUILDERS, Piece, Port, turning_circle
from evaluation.scenarios.wide_network import WideNetwork
from shield.errors import ConfigError

__all__ = ["SUBMAPS", "ScenarioMap", "build_map", "check_counts", "order_of"]

SUBMAPS: Mapping[str, int] = MappingProxyType({"merge": 2, "intersection": 2, "roundabout": 2, "straight": 4})
"""Default number of pieces of each kind."""


@dataclass(frozen=True, slots=True)
class ScenarioMap:
    """A road network with open ends.

    Attributes
    ----------
    network : highway-env's network, with a faster search for the nearest lane.
    spawns : roads on which vehicles enter, as (node, node); the first is the west end.
    exits : roads on which vehicles leave, by the name of their end node.
    pieces : the pieces, in order.
    """

    network: WideNetwork
    spawns: tuple[tuple[str, str], ...]
    exits: Mapping[str, tuple[str, str]]
    pieces: tuple[Piece, ...]


def order_of(counts: Mapping[str, int]) -> tuple[str, ...]:
    """The kinds of the pieces from one end of the map to the other.

    Roundabouts are at the ends, where vehicles turn; a turning circle replaces a missing one. Straights are spread
    evenly among the other kinds, which alternate.

    Examples
    --------
    >>> order_of({"roundabout": 1, "intersection": 1, "straight": 1})
    ('roundabout', 'straight', 'intersection', 'turning circle')
    """
    left = {kind: counts.get(kind, 0) for kind in SUBMAPS}
    ends = ["roundabout" if left["roundabout"] > end else "turning circle" for end in range(2)]
    left["roundabout"] = max(left["roundabout"] - 2, 0)
    others: list[str] = []
    while any(left[kind] for kind in SUBMAPS if kind != "straight"):
        for kind in SUBMAPS:
            if kind != "straight" and left[kind]:
                left[kind] -= 1
                others.append(kind)
    straights = ["straight"] * left["straight"]
    placed = [((i + 0.5) / len(row), kind) for row in (straights, others) for i, kind in enumerate(row)]
    between = [kind for _, kind in sorted(placed, key=lambda each: each[0])]
    return ends[0], *between, ends[1]


def build_map(counts: Mapping[str, int] = SUBMAPS) -> ScenarioMap:
    """Join pieces to a map.

    The map begins in the west. At intersections it goes on to the right and to the left in alternation, so that it does
    not cross itself. Every exit can be reached from every spawn.

    Parameters
    ----------
    counts : number of pieces of each kind in `SUBMAPS`; 0 for kinds that are not named.

    Raises
    ------
    ConfigError
        If a count is no whole number from 0 on, a kind is unknown, or all counts are 0.

    Examples
    --------
    >>> course = build_map({"straight": 2})
    >>> [piece.name for piece in course.pieces]
    ['turning circle-1', 'straight-1', 'straight-2', 'turning circle-2']
    >>> course.spawns[0], list(course.exits)
    (('west.in', 'turning circle-1.back.yield'), ['west.out', 'turning circle-2.front.out'])
    >>> len(course.network.shortest_path("west.in", "west.out")) > 2
    True
    """
    check_counts(counts)
    entry = Port(RoadFrame(), "west.in", "west.out")
    pieces: list[Piece] = []
    made: dict[str, int] = {}
    ends, entries = [entry.entering], [entry.leaving]
    turns = 0
    for kind in order_of(counts):
        made[kind] = made.get(kind, 0) + 1
        build = BUILDERS.get(kind, turning_circle)
        piece = build(f"{kind}-{made[kind]}", entry)
        side = "front"
        if kind == "intersection":
            side, turns = ("right", "left")[turns % 2], turns + 1
        pieces.append(piece)
        entry = piece.ports[side]
        others = [port for name, port in piece.ports.items() if name != side]
        ends += [port.leaving for port in others]
        entries += [*(port.entering for port in others), *piece.ramps]
    ends.append(entry.leaving)
    entries.append(entry.entering)
    return _joined(pieces, entries, ends)


def check_counts(counts: Any) -> None:
    """Raise a `ConfigError` unless the counts of pieces make a map."""
    if not isinstance(counts, Mapping):
        raise ConfigError(f"submap_counts maps {', '.join(SUBMAPS)} to whole numbers, not {counts!r}")
    for kind, count in counts.items():
        if kind not in SUBMAPS:
            raise ConfigError(f"unknown submap {kind!r}; have {', '.join(SUBMAPS)}")
        if isinstance(count, bool) or not isinstance(count, int) or count < 0:
            raise ConfigError(f"submap_counts[{kind!r}] is a whole number from 0 on, not {count!r}")
    if not any(counts.values()):
        raise ConfigError(f"submap_counts needs at least one of {', '.join(SUBMAPS)}")


def _joined(pieces: list[Piece], entries: list[str], ends: list[str]) -> ScenarioMap:
    edges = [edge for piece in pieces for edge in piece.edges]
    network = WideNetwork((edge.start, edge.end, lane) for edge in edges for lane in edge.lanes)
    spawns, exits = {}, {}
    for edge in edges:
        if edge.start in entries:
            spawns[edge.start] = (edge.start, edge.end)
        if edge.end in ends:
            exits[edge.end] = (edge.start, edge.end)
    return ScenarioMap(
        network,
        tuple(spawns[node] for node in entries),
        {node: exits[node] for node in ends},
        tuple(pieces),
    )
