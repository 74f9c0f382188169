"""Whether the others keep to what is assumed of them on a network of roads, frame by frame.

What a vehicle may do from one frame to the next (`dynamics.road_networks.reachable.prediction` bounds what comes of it
for all time):

1. *speed*: brake and accelerate no harder than `Conduct` says, and no further than to the limit of the lanes before it;
2. *ways*: be where one of its strips says, along it and across, with its body no further out, and on the way back to
   the middle. It may take another lane where that leaves the room for the ego's fail-safe;
3. *reversing*: not go backwards where the ego's fail-safe suffers;
4. *no crash*;
5. *distance*: who is behind the ego in its lane, and owes it its distance, brakes for it as long as that helps: at the
   duty's braking it stays behind the ego's body, on its fail-safe;
6. *right of way*: where that is assumed, whoever has been counted on to wait for the ego, and has had the time to
   react, brakes for it where the fail-safe suffers otherwise.

Whoever points so far out of its lanes that it collides with the ego's body in the coming frame, as highway-env counts
collisions, has left its ways (`shield.certificate.network.next_frame`). A body with a number that is not finite breaks
the rule that the number is judged by.
Rules 1, 4 and 5 are judged alone, the others where the ego's fail-safe suffers; so are bodies that have *appeared* or
*grown*. A wreck or an object never may appear, nor *move*: it stays inside the rectangle that it was taken to fill a
frame before, which for a wreck is all of the way that it slides, and for an object that of the coming frame if it has a
speed. A vehicle that becomes an object has appeared. `UNFORESEEN` is for the sake of honesty: the
fail-safe has come to suffer from one who has broken no rule. That is a hole in the certificate, and a test fails.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np

from dynamics.errors import SceneError
from dynamics.road_networks.reachable.strips import BACK, FAR, FRONT, HALF, HIGH, KEEP, LOW, NEAR, START
from dynamics.state import FloatArray, IntArray, Vehicle
from shield.certificate.network.clearance import CLEAR, MADE
from shield.certificate.network.workspace import Others, Road

__all__ = ["Breach", "Seen", "Watch", "check_readable"]

_SLACK, _PLACE, _SAME = 1e-10, 1e-10, 1e-10
"""What rounding may add in a frame to a speed [m/s], a place and a size [m]. It adds up: a path begins with `MADE`, the
rules are judged below that, and what is left to `CLEAR` is enough for some hundred frames, each of which may take 10 s
times the first of these and a few times the second."""
_SHARE = 1e-12
"""The same of a row of `Others.drive`, which is multiplied by all of the way of a path."""
_STILL = 1e-6
"""A body whose band moves by less in a frame has not moved across its lane [m]; rounding on arcs is less."""
_CORNERS = np.array([[0.5, 0.5], [0.5, -0.5], [-0.5, -0.5], [-0.5, 0.5]])


class Breach(StrEnum):
    """The rules that a vehicle can break."""

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
class Seen:
    """A scene: who was there, where they could be, what stood there, wrecks included; which bodies could not be read,
    with the columns of `Vehicle` that are not readable; and who collides with the ego's body in the coming frame, see
    `shield.certificate.network.next_frame.collisions`."""

    who: list[Any]
    others: Others
    stand: tuple[Any, ...] = ()
    unreadable: Mapping[Any, frozenset[Vehicle]] = field(default_factory=dict)
    colliding: Mapping[Any, bool] = field(default_factory=dict)


def check_readable(seen: Seen) -> None:
    """Raise where some body could not be read.

    Raises
    ------
    SceneError
        That says what is not readable, and of which body.
    """
    for body, columns in seen.unreadable.items():
        names = ", ".join(column.name.lower() for column in sorted(columns))
        raise SceneError(f"{names} of a {type(body).__name__} is not finite, or beyond what a road has")


@dataclass(slots=True, eq=False)
class Watch:
    """What has been seen of the others in an episode.

    Attributes
    ----------
    last : the scene seen last; None before the first.
    breaking : who was breaking which rule in it. offenders : who has broken one, and is in the way of the fail-safe.
    by_rule : how often each rule has been broken; frame after frame by the same vehicle counts once.
    culprits : who has ever broken one.
    """

    last: Seen | None = None
    breaking: dict[Any, set[Breach]] = field(default_factory=dict)
    offenders: set[Any] = field(default_factory=set)
    by_rule: dict[Breach, int] = field(default_factory=dict)
    culprits: set[Any] = field(default_factory=set)

    @property
    def count(self) -> int:
        """How often a rule has been broken."""
        return sum(self.by_rule.values())

    def next(self, now: Seen, clear: set[Any], margins: FloatArray | None, road: Road, late: set[Any]) -> None:
        """Take in the scene one frame later.

        Parameters
        ----------
        clear : of whom the ego's fail-safe stayed clear when it was chosen, and those who owed it their distance.
        margins : how far it stays from each now, (m,) [m]; None without one.
        late : who could have kept its distance by braking in the scene before, and no longer can.
        """
        last, breaking = self.last, {body: set(map(_of_column, columns)) for body, columns in now.unreadable.items()}
        self.last = now
        for body, broken in breaking.items():
            self._name(body, broken - self.breaking.get(body, set()))
        if last is None:
            self.breaking = breaking
            return
        before = {body: i for i, body in enumerate(last.who)}
        there = set(now.who)
        for body in last.who:
            if body not in there and getattr(body, "crashed", False):
                self._name(body, {Breach.CRASH})
        for body, broken in _of_standing(last, now):
            breaking[body] = broken
            self._name(body, broken - self.breaking.get(body, set()))
        for i, body in enumerate(now.who):
            hits = margins is not None and body in now.colliding
            suffers = margins is not None and bool(margins[i] < CLEAR)
            less = margins is not None and bool(margins[i] < MADE)
            j = before.get(body)
            if j is None:
                broken = {Breach.APPEARED} if suffers or hits else set()
            else:
                suffers, less, hits = suffers and body in clear, less and body in clear, hits and body in clear
                broken = self._broken(last.others, j, now.others, i, road, less or hits, body in late)
                if hits and now.colliding[body]:
                    broken.add(Breach.WAYS)
                if (suffers or hits) and not broken and body not in self.offenders:
                    broken = {Breach.UNFORESEEN}
            if broken:
                breaking[body] = broken
                self._name(body, broken - self.breaking.get(body, set()))
            if suffers:
                self.offenders.add(body)
            else:
                self.offenders.discard(body)
        self.breaking = breaking

    def _name(self, body: Any, rules: set[Breach]) -> None:
        """Count the rules that somebody has come to break."""
        self.culprits.add(body)
        for rule in rules:
            self.by_rule[rule] = self.by_rule.get(rule, 0) + 1

    def judge(self, now: Seen, who: set[Any], road: Road, late: set[Any]) -> set[Any]:
        """Who of these has broken a rule so far, or does from the scene seen last to this one, wherever it is; `late`
        as in `next`."""
        found = who & self.culprits
        if self.last is not None:
            before = {body: i for i, body in enumerate(self.last.who)}
            for i, body in enumerate(now.who):
                j = before.get(body)
                if body not in who:
                    continue
                if j is None or self._broken(self.last.others, j, now.others, i, road, True, body in late):
                    found.add(body)
        return found

    def _broken(self, old: Others, j: int, new: Others, i: int, road: Road, suffers: bool, late: bool) -> set[Breach]:
        broken, conduct, dt = set(), road.conduct, road.period
        v0, v = float(old.rows[j, 3]), float(new.rows[i, 3])
        slowest = v0 - conduct.braking * dt
        fastest = max(min(v0 + conduct.acceleration * dt, old.drive[j, 0]), v0)
        if not slowest - _SLACK <= v <= fastest + _SLACK:
            broken.add(Breach.SPEED)
        if suffers and v < 0:
            broken.add(Breach.REVERSING)
        if suffers and (new.rows[i, 4:6] > old.rows[j, 4:6] + _SAME).any():
            broken.add(Breach.GROWN)
        if suffers and not _inside(old, j, new, i):
            broken.add(Breach.WAYS)
        if v > max(v0 - road.duty.braking * dt, 0.0) + _SLACK:
            if late:
                broken.add(Breach.DISTANCE)
            if suffers and new.gives[i].max(initial=0) > road.duty.reaction:
                broken.add(Breach.RIGHT_OF_WAY)
        return broken


def _of_column(column: Vehicle) -> Breach:
    """The rule that a body breaks with a number that is not finite."""
    if column is Vehicle.SPEED:
        return Breach.SPEED
    return Breach.GROWN if column in (Vehicle.LENGTH, Vehicle.WIDTH) else Breach.WAYS


def _of_standing(last: Seen, now: Seen) -> Iterator[tuple[Any, set[Breach]]]:
    """Wrecks and objects that have appeared, or moved or grown out of the rectangles that they filled. A vehicle that
    has become a wreck has crashed, which is named elsewhere."""
    before, driving = {body: i for i, body in enumerate(last.stand)}, set(last.who)
    for i, body in enumerate(now.stand):
        if body not in before:
            if body not in driving or not getattr(body, "crashed", False):
                yield body, {Breach.APPEARED}
        elif _leaves(last.others.things[before[body]], now.others.things[i]):
            yield body, {Breach.MOVED}


def _leaves(old: FloatArray, new: FloatArray) -> bool:
    """Whether one rectangle reaches out of another; both are vehicle rows (7,)."""
    corners = new[4:6] * _CORNERS @ _axes(new[2]) + new[:2] - old[:2]
    return bool((np.abs(corners @ _axes(old[2]).T) > 0.5 * old[4:6] + _SAME).any())


def _axes(heading: float) -> FloatArray:
    """Unit vectors along and across a heading [rad], (2, 2)."""
    cos, sin = np.cos(heading), np.sin(heading)
    return np.array([[cos, sin], [-sin, cos]])


def _inside(old: Others, j: int, new: Others, i: int) -> bool:
    """Whether what is foreseen of vehicle i now begins inside what was foreseen of it as vehicle j a frame before.

    `shield.certificate.network.clearance.judge` reads the quantities below. None of them may become worse for the ego
    from one frame to the next while no rule is broken. Each is bounded by the rule beside it; "here" is this function:

    ====================================  ==============================================================================
    speed                                 *speed*; *reversing* where it is negative
    length, width                         *grown*
    x, y, heading                         the strips; the heading in the coming frame also
    `shield.certificate.network.next_frame` `least`, `most`                       they follow from the speed and `drive`
    `drive`, all columns                  here
    `marks`: lane                         here
    `marks`: the strip before             here, as it is read: whether the ego stands in every way there (`shut`), where
                                          the body has moved across its lane; else the ego's own judgement has changed,
                                          and a plan that is lost so is *unforeseen*
    `NEAR`, `FAR`                         here: the way of a frame is between `least` and `most`
    `LOW`, `HIGH`, `HALF`                 here
    `FRONT`                               here; it is read only of who owes the ego its distance
    `START`                               here, where the vehicle is so far back, or may roll back so far
    `BACK`                                here, as `BACK - NEAR`, where the band is wider than `KEEP`
    `KEEP`                                *grown*: on one lane it grows with the length and the width alone
    `ranks`                               here
    `owes`, `gives`                       *distance*, *right of way*: the door counts them
    (`shield.certificate.network.obligations`) `things`                              *appeared*, *moved*
    ====================================  ==============================================================================
    """
    if not _is_no_faster(old.drive[j], new.drive[i]):
        return False
    count0, count = int(old.found[0]), int(new.found[0])
    mine, its = np.flatnonzero(old.marks[:count0, 0] == j), np.flatnonzero(new.marks[:count, 0] == i)
    least, most, owes, rearmost = old.least[j, 1], old.most[j, 1], old.owes[j].any(), new.least[i].min()
    furthest = old.least[j].max()
    shifts = _shifts(old, mine, new, its)
    for k in its:
        row, same = new.numbers[k], mine[old.marks[mine, 1] == new.marks[k, 1]]
        rows = old.numbers[same]
        # A later pass is contained in one whose start the vehicle never leaves for sure.
        rear = (-row[FAR] >= least - rows[:, FAR] - _PLACE) | (furthest <= rows[:, FAR] + rows[:, START])
        along = rear & (-row[NEAR] <= most - rows[:, NEAR] + _PLACE)
        along &= max(row[START], rearmost - row[FAR]) >= rows[:, START] - _PLACE
        across = (row[LOW] >= rows[:, LOW] - _PLACE) & (row[HIGH] <= rows[:, HIGH] + _PLACE)
        # Who is beside the middle has to be back there after as much way as before.
        settles = (max(row[HIGH], -row[LOW]) <= row[KEEP]) | (
            row[BACK] - row[NEAR] <= rows[:, BACK] - rows[:, NEAR] + _PLACE
        )
        # The front as it is now counts of who has to stay behind the ego.
        fits = (row[HALF] <= rows[:, HALF] + _PLACE) & (~owes | (row[FRONT] <= rows[:, FRONT] + _PLACE))
        # What the plan skips, since the ego stands in the way to it, stays so where the body has moved across its lane.
        kept = (new.ranks[k] <= old.ranks[same]) & (~old.shut[same] | new.shut[k] | ~shifts)
        if not (along & across & settles & fits & kept).any():
            return False
    return True


def _shifts(old: Others, mine: IntArray, new: Others, its: IntArray) -> bool:
    """Whether a body has moved across a lane that it is on, or come onto another; its strips are `mine`, then `its`."""
    for k in its[new.marks[its, 2] < 0]:
        same = mine[old.marks[mine, 1] == new.marks[k, 1]]
        sides = np.abs(old.numbers[same][:, [LOW, HIGH]] - new.numbers[k, [LOW, HIGH]])
        if not (sides <= _STILL).all(axis=1).any():
            return True
    return False


def _is_no_faster(old: FloatArray, new: FloatArray) -> bool:
    """Whether a vehicle gets no further by a row of `Others.drive` than by the one of the frame before, whatever its
    speed."""
    # The speed that it accelerates to, the most metres of s in a metre, and the speed below which it gains less.
    more = new[[0, 2, 3]] <= old[[0, 2, 3]] + _SHARE
    # The least metres of s in a metre, and what it gains then.
    less = new[[1, 4]] >= old[[1, 4]] - _SHARE
    return bool(more.all() and less.all())
