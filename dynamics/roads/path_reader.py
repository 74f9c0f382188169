"""Read highway-env's road networks as one path: racetracks, lane keeping, and any other chain or loop of sections.

The sections of highway-env's racetracks do not meet exactly. Arcs are up to a degree too long, neighbours are up to
0.25 m and 0.09 rad apart, and not every lane is concentric with lane 0. The path follows lane 0:

* two sections are cut where their directions agree; if they touch there (within `TOUCH`), nothing else is changed;
* otherwise a biarc replaces the last and first metres (`BLEND`) of both, so that the path has no kink;
* biarcs between points of a sine replace it, close enough to stay within `SINE_ERROR` of it.

`PathRoad.deviation` is measured: the greatest lateral distance of any lane of the map from its centre on the path.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.errors import SceneError
from dynamics.roads.arcs import STRAIGHT, Arcs, biarc, place, project
from dynamics.roads.gaps import Gaps
from dynamics.roads.path import PathRoad
from dynamics.state import FloatArray, wrap_to_pi

__all__ = ["BLEND", "MAX_DEVIATION", "SINE_ERROR", "TOUCH", "read_network"]

BLEND = 5.0
"""Length that a biarc replaces on either side of an inexact joint [m]; less on a short section."""
TOUCH = 1e-7
"""Distance within which two sections count as meeting [m]."""
SINE_ERROR = 1e-3
"""Greatest distance between a sine and the biarcs that replace it [m]."""
MAX_DEVIATION = 0.5
"""Greatest accepted distance between a lane of the map and the lane of the path [m]."""
_SUPPORTED = (
    "supported are single chains or loops of sections with the same number of parallel lanes of one width, made of "
    "StraightLane, CircularLane or SineLane: highway-v0, highway-fast-v0, racetrack-v0, racetrack-large-v0, "
    "racetrack-oval-v0, u-turn-v0"
)
_NAMED = 4
"""Number of nodes in a message."""
_ROADS: dict[str, PathRoad] = {}
"""Cache of roads, by the description of their networks."""
_MOST_ROADS = 16
_NEAR = 5.0
"""Greatest distance of the joint of two sections from its nominal place [m]."""
_SAMPLE = 0.25
"""Distance between the points at which a lane of the map is compared with the path [m]."""


@dataclass(frozen=True, slots=True)
class _Section:
    """Lane 0 of a section of road in its own arc length, and the lanes beside it."""

    name: str
    lanes: list[Any]
    arcs: Arcs

    @property
    def length(self) -> float:
        return float(self.arcs.lengths.sum())

    def at(self, s: float) -> tuple[FloatArray, float]:
        """Pose (3,) and curvature [1/m] at arc length s [m]; the first and the last arc continue beyond the ends."""
        starts = np.concatenate([[0.0], np.cumsum(self.arcs.lengths)[:-1]])
        i = max(int(np.searchsorted(starts, s, side="right")) - 1, 0)
        k = self.arcs.curvatures[i]
        return place(self.arcs.poses[i], k, s - starts[i], 0.0), float(k)

    def locate(self, point: FloatArray) -> float:
        """Arc length of the point of lane 0 nearest to a world point (2,) [m]."""
        middles = place(self.arcs.poses, self.arcs.curvatures, self.arcs.lengths / 2, 0.0)
        s, r = project(middles, self.arcs.curvatures, point[0], point[1])
        best = int(np.argmin(np.abs(r) + np.maximum(np.abs(s) - self.arcs.lengths / 2, 0)))
        return float(self.arcs.lengths[:best].sum() + self.arcs.lengths[best] / 2 + s[best])

    def cut(self, a: float, b: float) -> Arcs:
        """The piece from a to b [m] of arc length; the first and the last arc continue beyond the ends where needed."""
        ends = np.cumsum(self.arcs.lengths)
        starts = np.concatenate([[0.0], ends[:-1]])
        low, high = np.maximum(starts, a), np.minimum(ends, b)
        low[0], high[-1] = a if a < ends[0] else low[0], b if b > starts[-1] else high[-1]
        keep = high - low > 1e-9
        poses = place(self.arcs.poses, self.arcs.curvatures, low - starts, 0.0)
        return Arcs(poses[keep], self.arcs.curvatures[keep], (high - low)[keep])


@dataclass(frozen=True, slots=True)
class _Joint:
    """End of one section and start of the next, in the arc length of each [m], and the pieces between them."""

    end: float
    start: float
    nominal: float
    between: list[Arcs]


def read_network(network: Any) -> PathRoad:
    """A highway-env `RoadNetwork` as a `PathRoad`; see the notes at the head of this module.

    s = 0 is the start of the first section (after its joint, on a loop); r = 0 is lane 0. A network equal to an earlier
    one, lane for lane, gives the same object.

    Raises
    ------
    SceneError
        If the network branches, or has other lanes, sections that do not meet, or lanes that are not parallel.
    """
    known = _description(network)
    if known in _ROADS:
        return _ROADS[known]
    sections, closed = _chain(network)
    pairs = list(zip(sections, sections[1:] + sections[:1] if closed else sections[1:], strict=False))
    joints = [_join(a, b) for a, b in pairs]
    starts = [joints[-1].start if closed else 0.0, *(j.start for j in joints)]
    ends = [*(j.end for j in joints), *([] if closed else [sections[-1].length])]
    parts: list[Arcs] = []
    for i, section in enumerate(sections):
        if ends[i] <= starts[i]:
            raise SceneError(f"section {section.name} has no length left between its joints; {_SUPPORTED}")
        parts.append(section.cut(starts[i], ends[i]))
        parts += joints[i].between if i < len(joints) else []
    nominal = [joints[-1].nominal if closed else 0.0, *(j.nominal for j in joints)]
    centers, width, forbidden = _lanes(sections)
    road = PathRoad(Arcs.join(parts), centers, width, closed, forbidden)
    deviation = max(_deviation(road, s, from_) for s, from_ in zip(sections, nominal, strict=False))
    if deviation > MAX_DEVIATION:
        raise SceneError(
            f"the lanes of this network are up to {deviation:.2f} m from parallel lanes along "
            f"{sections[0].name} … {sections[-1].name}; at most {MAX_DEVIATION} m is accepted; {_SUPPORTED}"
        )
    gaps = Gaps.of(road, [lane for s in sections for lane in s.lanes])
    road = PathRoad(road.pieces, centers, width, closed, forbidden, deviation, gaps)
    if len(_ROADS) >= _MOST_ROADS:
        _ROADS.clear()
    _ROADS[known] = road
    return road


def _description(network: Any) -> str:
    """A text that identifies a network: environments build an equal one at each reset."""
    sections = [(a, b, lanes) for a, to in network.graph.items() for b, lanes in to.items()]
    return repr([(a, b, [_config(lane) for lane in lanes]) for a, b, lanes in sections])


def _config(lane: Any) -> Any:
    """The parameters of a lane; for an unsupported lane, its class name."""
    kind = type(lane).__name__
    return lane.to_config() if kind in ("StraightLane", "CircularLane", "SineLane") else kind


def _chain(network: Any) -> tuple[list[_Section], bool]:
    """The sections in driving order, and whether the last one leads to the first."""
    edges = {a: list(to) for a, to in network.graph.items()}
    targets = [b for to in edges.values() for b in to]
    fork = [a for a, to in edges.items() if len(to) != 1] + [b for b in set(targets) if targets.count(b) != 1]
    if not edges or fork:
        raise SceneError(f"this network branches at {_some(sorted(set(fork)))}; {_SUPPORTED}")
    roots = [a for a in edges if a not in targets]
    node = first = roots[0] if roots else next(iter(edges))
    sections: list[_Section] = []
    while node in edges and (not sections or node != first):
        to = edges[node][0]
        sections.append(_read_section(f"{node}->{to}", network.graph[node][to]))
        node = to
    if len(sections) != len(edges):
        raise SceneError(f"this network has {len(edges)} sections that are not connected in one row; {_SUPPORTED}")
    return sections, not roots


def _some(nodes: list[str]) -> str:
    """The first few nodes, for a message."""
    if not nodes:
        return "no node: it is empty"
    more = len(nodes) - _NAMED
    return f"{', '.join(nodes[:_NAMED])}{f' and {more} more' if more > 0 else ''}"


def _read_section(name: str, lanes: list[Any]) -> _Section:
    """A section from its lanes."""
    kinds = sorted({type(lane).__name__ for lane in lanes})
    first = lanes[0]
    if kinds == ["StraightLane"]:
        arcs = Arcs(
            np.array([[*first.start, first.heading]], dtype=float), np.zeros(1), np.array([float(first.length)])
        )
    elif kinds == ["CircularLane"]:
        pose = np.array([[*first.position(0, 0), first.heading_at(0)]], dtype=float)
        arcs = Arcs(pose, np.array([first.direction / first.radius]), np.array([float(first.length)]))
    elif kinds == ["SineLane"]:
        arcs = _sine(first)
    else:
        raise SceneError(f"section {name} has lanes of kind {', '.join(kinds)}; {_SUPPORTED}")
    if not np.all(arcs.lengths > 0):
        raise SceneError(f"section {name} has no length; {_SUPPORTED}")
    return _Section(name, lanes, arcs)


def _sine(lane: Any) -> Arcs:
    """Biarcs through points of a sine; points are added until the biarcs are within 0.9 of `SINE_ERROR`."""
    n = 1 + int(lane.length * abs(lane.pulsation))
    fine = np.linspace(0.0, lane.length, 50 * n + 1)
    x = np.array([lane.position(t, 0.0) for t in fine])
    while True:
        poses = np.array([[*lane.position(t, 0.0), lane.heading_at(t)] for t in np.linspace(0.0, lane.length, n + 1)])
        arcs = biarc(poses[:-1], poses[1:])
        road = PathRoad(arcs, np.zeros(1), width=1e-6)
        states = np.column_stack([x, np.zeros((len(x), 2))])
        if np.abs(road.to_road(states)[:, 1]).max() < 0.9 * SINE_ERROR:
            return arcs
        n += max(n // 8, 1)


def _join(a: _Section, b: _Section) -> _Joint:
    """The joint from section a to section b."""
    pose, _ = a.at(a.length)
    onto = b.locate(pose[:2])
    facing = b.at(onto)[0]
    gap = float(np.hypot(*(facing - pose)[:2]))
    turn = float(abs(wrap_to_pi(facing[2] - pose[2])))
    if gap > 1.0 or turn > 0.5:
        raise SceneError(
            f"sections {a.name} and {b.name} do not meet: {gap:.2f} m and {turn:.2f} rad apart; {_SUPPORTED}"
        )
    end, start = _tangent(a, b, a.length, onto)
    pa, pb = a.at(end)[0], b.at(start)[0]
    if np.hypot(*(pa - pb)[:2]) < TOUCH and abs(wrap_to_pi(pa[2] - pb[2])) < TOUCH:
        return _Joint(end, start, max(onto, 0.0), [])
    before, after = min(BLEND, 0.4 * a.length), min(BLEND, 0.4 * b.length)
    blend = biarc(a.at(end - before)[0], b.at(start + after)[0])
    return _Joint(end - before, start + after, max(onto, 0.0), [blend])


def _tangent(a: _Section, b: _Section, end: float, start: float) -> tuple[float, float]:
    """Arc lengths near (end, start) at which a and b have one direction and lie across from one another.

    If there is none within `_NEAR`, (end, start) itself.
    """
    (pa, ka), (pb, kb) = a.at(end), b.at(start)
    if abs(ka - kb) < STRAIGHT:
        return end, start
    turn = float(wrap_to_pi(pb[2] - pa[2]))
    if abs(ka) < STRAIGHT or abs(kb) < STRAIGHT:
        # The common direction is that of the straight section; move along it.
        da, db = (0.0, -turn / kb) if abs(ka) < STRAIGHT else (turn / ka, 0.0)
        qa, qb = (
            place(pa, ka, da, 0.0),
            place(pb, kb, db, 0.0),
        )
        along = float((qb - qa)[:2] @ np.array([np.cos(qa[2]), np.sin(qa[2])]))
        da, db = (da + along, db) if abs(ka) < STRAIGHT else (da, db - along)
    else:
        # The normal at the joint passes through both centres.
        ca, cb = (p[:2] + np.array([-np.sin(p[2]), np.cos(p[2])]) / k for p, k in ((pa, ka), (pb, kb)))
        line = (ca - cb) * np.sign(1 / ka - 1 / kb)
        heading = float(np.arctan2(line[1], line[0])) - np.pi / 2
        da, db = float(wrap_to_pi(heading - pa[2])) / ka, float(wrap_to_pi(heading - pb[2])) / kb
    return (end + da, start + db) if max(abs(da), abs(db)) < _NEAR else (end, start)


def _lanes(sections: list[_Section]) -> tuple[FloatArray, float, tuple[bool, ...]]:
    """Lane centres (medians over the sections) [m], lane width [m], and which lanes are forbidden."""
    counts = {s.name: len(s.lanes) for s in sections}
    widths = sorted({float(lane.width) for s in sections for lane in s.lanes})
    if len(set(counts.values())) != 1 or len(widths) != 1:
        raise SceneError(f"the sections have lanes {counts} of widths {widths}; {_SUPPORTED}")
    rows = []
    for s in sections:
        point = s.lanes[0].position(s.lanes[0].length / 2, 0.0)
        across = [0.0]
        for lane in s.lanes[1:]:
            local = lane.local_coordinates(point)
            across.append(-float(local[1]))
        rows.append(across)
    centers = np.median(np.array(rows), axis=0)
    if np.any(np.diff(centers) <= 0):
        raise SceneError(f"lane centres must ascend with the lane index, got {centers}; {_SUPPORTED}")
    first = sections[0].lanes
    return centers, widths[0], tuple(bool(lane.forbidden) for lane in first)


def _deviation(road: PathRoad, section: _Section, start: float) -> float:
    """Greatest lateral distance between the section's lanes and those of the road [m], from `start` [m] of lane 0
    on."""
    worst = 0.0
    for lane, center in zip(section.lanes, road.centers, strict=True):
        # `start` is an arc length; a lane of the map measures its own length, up to 5 % shorter on a sine.
        t = np.arange(min(start, float(lane.length)), lane.length + _SAMPLE, _SAMPLE).clip(max=lane.length)
        points = np.array([lane.position(x, 0.0) for x in t])
        across = road.to_road(np.column_stack([points, np.zeros((len(t), 2))]))[:, 1] - center
        worst = max(worst, float(np.abs(across).max()))
    return worst
