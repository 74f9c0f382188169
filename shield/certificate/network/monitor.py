"""Monitor: whether the other vehicles keep to the rules of the road on a network, frame by frame.

From one frame to the next, a vehicle may do the following. `dynamics.road_networks.reachable.prediction` bounds what
follows from that for all time.

1. *speed*: brake and accelerate within `DrivingBounds`, up to the limit of the lanes ahead of it;
2. *ways*: be inside one of its reachable intervals, along and across the lane. Its body reaches no further out, and it
is on its way back to the centre. It may take another lane where the ego's fail-safe keeps its room;
3. *reversing*: reverse only where the ego's fail-safe keeps its room;
4. *crash*: not crash;
5. *distance*: with a distance obligation, brake for the ego as long as that helps. By braking at
`NetworkFollowerResponse.braking` it stays behind the ego's body on its fail-safe;
6. *right of way*, where that is assumed: brake for the ego where the fail-safe would lose its room otherwise. This
holds for a vehicle that has been expected to wait for longer than its reaction time.

The heading may also violate rule 2. The vehicle then points so far out of its lanes that it collides with the ego's
body in the coming frame, as highway-env counts collisions (`shield.certificate.network.next_frame`). A body with a
number that is not finite violates the rule that checks this number.

Rules 1, 4 and 5 are checked always. The others are checked where the ego's fail-safe loses its room. The same holds for
vehicles that have *appeared* or *grown*. A wreck or an object may never appear, nor *move*: it stays inside the
rectangle that it was taken to fill a frame before. For a wreck that is its whole sliding distance; for an object with a
speed, the distance of the coming frame. A vehicle that becomes an object has appeared.

`UNFORESEEN` reports a gap in the certificate: the fail-safe has lost its room to a vehicle without a violation. Then a
test fails.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np

from dynamics.errors import SceneError
from dynamics.road_networks.reachable.strips import (
    BODY_HALF,
    CENTRED_FROM,
    CENTRED_HALF,
    FAR,
    FRONT,
    HIGH,
    LOW,
    NEAR,
    START,
    end_of_lane,
)
from dynamics.state import BoolArray, FloatArray, IntArray, Vehicle
from shield.certificate.network.tolerances import CLEAR, NEW_PATH_MARGIN
from shield.certificate.network.workspace import NetworkContext, NetworkVehicles

__all__ = ["NetworkMonitor", "NetworkObservation", "NetworkRule", "check_readable"]

_SLACK, _PLACE, _SAME = 1e-10, 1e-10, 1e-10
"""Bounds on the rounding errors of a frame in a speed [m/s], a place [m] and a size [m]. They add up: a path begins
with `NEW_PATH_MARGIN` and the rules are checked below that. The rest to `CLEAR` is enough for some hundred frames:
each may take 10 s times the first of these and a few times the second."""
_SHARE = 1e-12
"""The same for a row of `NetworkVehicles.drive`, which is multiplied by the whole length of a path."""
_STILL = 1e-6
"""A body whose band moves by less in a frame has not moved across its lane [m]; rounding on arcs is less."""
_CORNERS = np.array([[0.5, 0.5], [0.5, -0.5], [-0.5, -0.5], [-0.5, 0.5]])
"""Corners of a rectangle, as shares of its length and width, (4, 2)."""


class NetworkRule(StrEnum):
    """The rules that a vehicle can violate. The value is the name of the rule in reports."""

    SPEED = "speed"
    WAYS = "ways"
    CRASH = "crash"
    APPEARED = "appeared"
    MOVED = "moved"
    GROWN = "grown"
    REVERSING = "reversing"
    DISTANCE = "distance"
    RIGHT_OF_WAY = "right of way"
    UNFORESEEN = "unforeseen"


@dataclass(frozen=True, slots=True)
class NetworkObservation:
    """A scene as the monitor keeps it.

    Attributes
    ----------
    questioned : the simulator's vehicle objects, which identify them, (m,). others : where they can be.
    stand : standing bodies, including wrecks, (b,).
    unreadable : bodies that could not be read, with the columns of `Vehicle` that are not readable.
    colliding : vehicles that collide with the ego's body in the coming frame, see
        `shield.certificate.network.next_frame.collisions`.
    """

    identities: list[Any]
    others: NetworkVehicles
    stand: tuple[Any, ...] = ()
    unreadable: Mapping[Any, frozenset[Vehicle]] = field(default_factory=dict)
    colliding: Mapping[Any, bool] = field(default_factory=dict)


def check_readable(seen: NetworkObservation) -> None:
    """Raise if a body could not be read.

    Raises
    ------
    SceneError
        Its message names the quantity and the type of the body.
    """
    for body, columns in seen.unreadable.items():
        names = ", ".join(column.name.lower() for column in sorted(columns))
        raise SceneError(f"{names} of a {type(body).__name__} is not finite, or beyond what a road has")


@dataclass(slots=True, eq=False)
class NetworkMonitor:
    """Monitor of the other vehicles in one episode.

    Attributes
    ----------
    last : scene of the last frame; None before the first.
    breaking : rules that each vehicle violated in it.
    offenders : violators that the ego's fail-safe has lost its room to.
    by_rule : number of violations of each rule; a violation that lasts for several frames counts once.
    culprits : vehicles with any violation in this episode.
    """

    last: NetworkObservation | None = None
    breaking: dict[Any, set[NetworkRule]] = field(default_factory=dict)
    offenders: set[Any] = field(default_factory=set)
    by_rule: dict[NetworkRule, int] = field(default_factory=dict)
    culprits: set[Any] = field(default_factory=set)

    @property
    def count(self) -> int:
        """Number of violations in this episode."""
        return sum(self.by_rule.values())

    def next(
        self, now: NetworkObservation, clear: set[Any], margins: FloatArray | None, road: NetworkContext, late: set[Any]
    ) -> None:
        """Check the motions from the last scene to the one a frame later.

        Parameters
        ----------
        now : the later scene.
        clear : vehicles that the ego's fail-safe was clear of when it was chosen, and those with a distance obligation.
        margins : separation of the fail-safe from each vehicle now, (m,) [m]; None if there is no fail-safe.
        road : road and assumptions.
        late : vehicles that could keep their distance by braking in the last scene, and no longer can.
        """
        last, breaking = self.last, {body: set(map(_of_column, columns)) for body, columns in now.unreadable.items()}
        self.last = now
        for body, broken in breaking.items():
            self._name(body, broken - self.breaking.get(body, set()))
        if last is None:
            self.breaking = breaking
            return
        before = {body: i for i, body in enumerate(last.identities)}
        there = set(now.identities)
        for body in last.identities:
            if body not in there and getattr(body, "crashed", False):
                self._name(body, {NetworkRule.CRASH})
        for body, broken in _of_standing(last, now):
            breaking[body] = broken
            self._name(body, broken - self.breaking.get(body, set()))
        for i, body in enumerate(now.identities):
            hits = margins is not None and body in now.colliding
            suffers = margins is not None and bool(margins[i] < CLEAR)
            less = margins is not None and bool(margins[i] < NEW_PATH_MARGIN)
            j = before.get(body)
            if j is None:
                broken = {NetworkRule.APPEARED} if suffers or hits else set()
            else:
                suffers, less, hits = suffers and body in clear, less and body in clear, hits and body in clear
                broken = self._broken(last.others, j, now.others, i, road, less or hits, body in late)
                if hits and now.colliding[body]:
                    broken.add(NetworkRule.WAYS)
                if (suffers or hits) and not broken and body not in self.offenders:
                    broken = {NetworkRule.UNFORESEEN}
            if broken:
                breaking[body] = broken
                self._name(body, broken - self.breaking.get(body, set()))
            if suffers:
                self.offenders.add(body)
            else:
                self.offenders.discard(body)
        self.breaking = breaking

    def _name(self, body: Any, rules: set[NetworkRule]) -> None:
        """Count the rules that a vehicle begins to violate."""
        self.culprits.add(body)
        for rule in rules:
            self.by_rule[rule] = self.by_rule.get(rule, 0) + 1

    def judge(self, now: NetworkObservation, questioned: set[Any], road: NetworkContext, late: set[Any]) -> set[Any]:
        """Those of the vehicles `questioned` that have violated a rule so far, or do so from the last scene to this
        one. The rules are checked whether or not the fail-safe loses its room; `late` as in `next`."""
        found = questioned & self.culprits
        if self.last is not None:
            before = {body: i for i, body in enumerate(self.last.identities)}
            for i, body in enumerate(now.identities):
                j = before.get(body)
                if body not in questioned:
                    continue
                if j is None or self._broken(self.last.others, j, now.others, i, road, True, body in late):
                    found.add(body)
        return found

    def _broken(
        self,
        old: NetworkVehicles,
        j: int,
        new: NetworkVehicles,
        i: int,
        road: NetworkContext,
        suffers: bool,
        late: bool,
    ) -> set[NetworkRule]:
        """Rules that vehicle j of the last scene has violated on its way to being vehicle i of the new one.

        `suffers` is whether the fail-safe loses its room to it, `late` whether it can no longer keep its distance by
        braking.
        """
        broken, bounds, dt = set(), road.bounds, road.period
        v0, v = float(old.rows[j, 3]), float(new.rows[i, 3])
        slowest = v0 - bounds.braking * dt
        fastest = max(min(v0 + bounds.acceleration * dt, old.drive[j, 0]), v0)
        if not slowest - _SLACK <= v <= fastest + _SLACK:
            broken.add(NetworkRule.SPEED)
        if suffers and v < 0:
            broken.add(NetworkRule.REVERSING)
        if suffers and (new.rows[i, 4:6] > old.rows[j, 4:6] + _SAME).any():
            broken.add(NetworkRule.GROWN)
        if suffers and not _inside(old, j, new, i, road):
            broken.add(NetworkRule.WAYS)
        if v > max(v0 - road.response.braking * dt, 0.0) + _SLACK:
            if late:
                broken.add(NetworkRule.DISTANCE)
            if suffers and new.gives[i].max(initial=0) > road.response.reaction:
                broken.add(NetworkRule.RIGHT_OF_WAY)
        return broken


def _of_column(column: Vehicle) -> NetworkRule:
    """The rule that a body violates if this column of its row is not finite."""
    if column is Vehicle.SPEED:
        return NetworkRule.SPEED
    return NetworkRule.GROWN if column in (Vehicle.LENGTH, Vehicle.WIDTH) else NetworkRule.WAYS


def _of_standing(last: NetworkObservation, now: NetworkObservation) -> Iterator[tuple[Any, set[NetworkRule]]]:
    """Violations by standing bodies that have appeared, or left the rectangles that they filled. A vehicle that has
    become a wreck has crashed, which `NetworkMonitor.next` counts."""
    before, driving = {body: i for i, body in enumerate(last.stand)}, set(last.identities)
    for i, body in enumerate(now.stand):
        if body not in before:
            if body not in driving or not getattr(body, "crashed", False):
                yield body, {NetworkRule.APPEARED}
        elif _leaves(last.others.things[before[body]], now.others.things[i]):
            yield body, {NetworkRule.MOVED}


def _leaves(old: FloatArray, new: FloatArray) -> bool:
    """Whether the rectangle `new` extends beyond the rectangle `old`; both are vehicle rows, (7,)."""
    corners = new[4:6] * _CORNERS @ _axes(new[2]) + new[:2] - old[:2]
    return bool((np.abs(corners @ _axes(old[2]).T) > 0.5 * old[4:6] + _SAME).any())


def _axes(heading: float) -> FloatArray:
    """Unit vectors along and across a heading [rad], (2, 2)."""
    cos, sin = np.cos(heading), np.sin(heading)
    return np.array([[cos, sin], [-sin, cos]])


def _inside(old: NetworkVehicles, j: int, new: NetworkVehicles, i: int, road: NetworkContext) -> bool:
    """Whether the reachable intervals of vehicle i begin inside those that were predicted for it a frame before, as
    vehicle j.

    `shield.certificate.network.clearance.least_separation` reads the quantities below. None of them may become worse
    for the ego from one frame to the next while no rule is violated. The right column names the rule that bounds each;
    "here" is this function:

    ====================================  ==============================================================================
    speed                                 *speed*; *reversing* where it is negative
    length, width                         *grown*
    x, y, heading                         the reachable intervals; `next_frame` also checks the heading
    `least`, `most`                       they follow from the speed and `drive`
    `drive`, all columns                  here
    `marks`: lane                         here
    `marks`: the interval before          here, as it is read: whether the ego blocks every way there (`shut`), if the
                                          body has moved across its lane. Otherwise the judgement of the ego's own path
                                          has changed, and the loss of a plan is *unforeseen*
    `NEAR`, `FAR`                         here: the distance of a frame is between `least` and `most`, and within the
                                          lane and its `LaneContinuations.overruns`
    `LOW`, `HIGH`, `BODY_HALF`            here
    `FRONT`                               here; it is read only for vehicles with a distance obligation
    `START`                               here, where the vehicle is so far back, or may roll back so far
    `CENTRED_FROM`                        here, as `CENTRED_FROM - NEAR`, where the band is wider than `CENTRED_HALF`
    `CENTRED_HALF`                        *grown*: on one lane it depends on the length and the width alone
    `ranks`                               here
    `obliged`, `gives`                       *distance*, *right of way*: the filter keeps them
                                          (`shield.certificate.network.obligations`)
    `things`                              *appeared*, *moved*
    ====================================  ==============================================================================
    """
    if not _is_no_faster(old.drive[j], new.drive[i]):
        return False
    count0, count = int(old.found[0]), int(new.found[0])
    mine, its = np.flatnonzero(old.marks[:count0, 0] == j), np.flatnonzero(new.marks[:count, 0] == i)
    least, most, obliged, rearmost = old.least[j, 1], old.most[j, 1], old.obliged[j].any(), new.least[i].min()
    furthest = old.least[j].max()
    shifts = _shifts(old, mine, new, its)
    for k in its:
        row, lane = new.numbers[k], new.marks[k, 1]
        end = end_of_lane(road.lanes.rows, road.ways.after, lane) + road.ways.overruns[lane]
        same = mine[old.marks[mine, 1] == lane]
        rows = old.numbers[same]
        # A later pass is contained in one whose start the vehicle is not certain to have left.
        rear = (-row[FAR] >= least - rows[:, FAR] - _PLACE) | (furthest <= rows[:, FAR] + rows[:, START])
        along = rear & (-row[NEAR] <= most - rows[:, NEAR] + _PLACE)
        along &= -row[NEAR] <= np.maximum(end, -rows[:, NEAR]) + _PLACE
        along &= max(row[START], rearmost - row[FAR]) >= rows[:, START] - _PLACE
        # The plan skips intervals whose ways the ego blocks. They stay blocked where the body has moved across its
        # lane.
        kept = (new.ranks[k] <= old.ranks[same]) & (~old.shut[same] | new.shut[k] | ~shifts)
        if not (along & _is_within(row, rows, obliged) & kept).any():
            return False
    return True


def _is_within(row: FloatArray, rows: FloatArray, obliged: np.bool_) -> BoolArray:
    """Whether the band of an interval and the body in it are within those of each of the intervals `rows`, (k,). `owes`
    is whether the vehicle has a distance obligation."""
    across = (row[LOW] >= rows[:, LOW] - _PLACE) & (row[HIGH] <= rows[:, HIGH] + _PLACE)
    # A vehicle beside the centre has to be back there after the same distance as before.
    settles = (max(row[HIGH], -row[LOW]) <= row[CENTRED_HALF]) | (
        row[CENTRED_FROM] - row[NEAR] <= rows[:, CENTRED_FROM] - rows[:, NEAR] + _PLACE
    )
    # The front in its present pose matters for vehicles that have to stay behind the ego.
    fits = (row[BODY_HALF] <= rows[:, BODY_HALF] + _PLACE) & (~obliged | (row[FRONT] <= rows[:, FRONT] + _PLACE))
    within: BoolArray = across & settles & fits
    return within


def _shifts(old: NetworkVehicles, mine: IntArray, new: NetworkVehicles, its: IntArray) -> bool:
    """Whether a body has moved across a lane that it is on, or onto another lane. `mine` and `its` are the rows of its
    reachable intervals, before and now."""
    for k in its[new.marks[its, 2] < 0]:
        same = mine[old.marks[mine, 1] == new.marks[k, 1]]
        sides = np.abs(old.numbers[same][:, [LOW, HIGH]] - new.numbers[k, [LOW, HIGH]])
        if not (sides <= _STILL).all(axis=1).any():
            return True
    return False


def _is_no_faster(old: FloatArray, new: FloatArray) -> bool:
    """Whether a vehicle advances no further by a row of `NetworkVehicles.drive` than by that of the frame before, at
    any speed."""
    # The speed that it accelerates to; the greatest share of s gained per metre; the speed below which it gains less.
    more = new[[0, 2, 3]] <= old[[0, 2, 3]] + _SHARE
    # The least share of s gained per metre, and the share gained below that speed.
    less = new[[1, 4]] >= old[[1, 4]] - _SHARE
    return bool(more.all() and less.all())
