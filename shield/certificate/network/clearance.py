"""How far a path of the ego stays from every place where the others can be, on a network of roads.

Notation
--------
As in `dynamics.road_networks.reachable.strips`. The ego's body with its buffer takes s from `box[0]` to `box[1]` of a
lane, and r from `box[2]` to `box[3]`. Whoever is at x on the way to that lane has its body between x - FAR - HALF and
x - NEAR + HALF, within its band. The *separation* is the greater of the gaps along and across, negative where both
overlap.

Who owes what: one that comes up from behind in the ego's own lane brakes for it, `Duty.braking` at least, once the ego
has been visible there for `Duty.reaction` frames, and on a road where nobody looks beyond the end of the own lane no
sooner than it has come into that lane itself. One that has yet to come over from a lane that ends may as well drive
past, and the strip of that lane reaches over: it brakes, and owes its distance, where the ego is visible in the lane
that ends, too. With `Duty.gives_way`, one with less right of way than the ego has does the same before any lane, from
when the ego has it: if it can stay behind the ego's body by braking so, it does. Nobody else yields: who crosses, joins
or comes the other way is where the strips say.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dynamics.compiled import inlined, uncounted
from dynamics.highway_simulator.layout import LANE_LENGTH
from dynamics.road_networks.geometry.lanes import Lanes
from dynamics.road_networks.geometry.layout import AMPLITUDE, PULSATION, SHAPE, SINE
from dynamics.road_networks.reachable.strips import (
    ALWAYS,
    BACK,
    FAR,
    FRONT,
    HALF,
    HIGH,
    KEEP,
    LOW,
    NEAR,
    SEVERAL,
    START,
    curvature,
    is_dead_end,
)
from dynamics.state import BoolArray, FloatArray, Vehicle
from dynamics.traffic.rules_of_the_road import Ego, gap_between
from shield.certificate.network.projection import FAR_OFF
from shield.certificate.network.workspace import Others, Road, Trial

__all__ = ["ASKED", "BELIEVED", "CLEAR", "MADE", "STRICT", "find_coming_over", "judge"]

_LENGTH, _SPEED = int(Vehicle.LENGTH), int(Vehicle.SPEED)
STRICT, BELIEVED, ASKED = 0, 1, 2
"""What those who owe the ego their distance are trusted with: to answer to its buffer, with time to react, as anybody
behind it; to keep their distance; to brake at once, where that keeps them behind its body."""

CLEAR = -1e-6
"""The least margin of a path that is clear [m]; less is more than rounding."""
MADE = -1e-9
"""The least margin of a path that is taken anew [m]. The difference to `CLEAR` is a budget: what rounding and the
tolerances of `shield.certificate.network.monitor` take from a path, frame by frame, adds up."""
_NEARLY = 1e-3
"""Ways to one lane that differ by less are taken to be the same one [m]."""
_ENDLESS = 100_000
"""Frames: whoever has not come to rest by then is not counted on to."""


@uncounted
def _sag(lanes: Lanes, lane: int, length: float, way: float) -> float:
    """How far across a lane the front of a body moves that points along it and goes straight on for some way [m]."""
    bend = curvature(lanes, lane)
    if lanes.ids[lane, SHAPE] == SINE:
        bend = abs(lanes.rows[lane, AMPLITUDE]) * lanes.rows[lane, PULSATION] * lanes.rows[lane, PULSATION]
    return 0.5 * bend * (length * way + way * way)


@uncounted
def _sag_of(others: Others, road: Road, j: int) -> float:
    """`_sag` of the body of strip j in a frame, at most [m]."""
    i = others.marks[j, 0]
    row = others.rows[i]
    way = max(others.drive[i, 0], row[_SPEED], 0.0) * road.period
    return _sag(road.lanes, others.marks[j, 1], row[_LENGTH], way)


@uncounted
def _aside(road: Road, lane: int, its: float, speed: float) -> float:
    """How much further apart than the ego's buffer its body and another have to be across a lane [m], with the other's
    `_sag_of` and the ego at some speed: highway-env moves both straight on for the coming frame, and has them collide
    if they meet. On a lane that bends the inner one of the two comes nearer so, the outer one does not."""
    body = road.body
    own = _sag(road.lanes, lane, 2 * body.length, max(speed, 0.0) * road.period)
    return max(max(its, own) - (body.across - body.width), 0.0)


@inlined
def _beside(box: FloatArray, row: FloatArray, aside: float) -> float:
    """The gap across a strip [m], less what is kept `aside`: where one gets to it that has come from beside, it is back
    in the middle by then."""
    if box[0] - row[HALF] + row[NEAR] >= row[BACK]:
        return max(box[2] - row[KEEP], -row[KEEP] - box[3]) - aside
    return max(box[2] - row[HIGH], row[LOW] - box[3]) - aside


@inlined
def _arrival(v: float, way: float, drive: FloatArray, acceleration: float, dt: float) -> float:
    """How fast one can be at most in its first frame beyond so much way [m/s], wherever between two frames it comes
    there. With the least share of the way that it gets along its lanes, v (v - a dt) + 2 a way / share becomes greater
    in no frame, however it drives: so neither does this. One that creeps and steers hard may get less of the way: it is
    taken to be as fast as it can be when it has come to creep no more."""
    step, most = acceleration * dt, drive[2] / drive[1]
    v = max(v, drive[3] + step)
    reserve = max(v * (v - step), 0.0) + 2 * acceleration * max(way, 0.0) / drive[1]
    half = 0.5 + most
    return half * step + math.sqrt(reserve + (half * half - 2 * most) * step * step)


class _Brakes(NamedTuple):
    """How one brakes for the ego: `delay` frames after it sees it, which it does from frame `since` on, `anywhere` or
    as `Duty.ahead` says; and how far its front is ahead of its middle [m]. That is `FRONT`, as the body is now, of who
    owes the ego its distance, which may not move it further ahead. Of others it is `HALF`: on an arc the front moves
    ahead where a body shifts towards the centre, and that is permitted."""

    since: int
    delay: int
    anywhere: bool
    front: float


@uncounted
def _followed(
    others: Others, road: Road, trial: Trial, rears: FloatArray, j: int, brakes: _Brakes, rests: bool
) -> float:
    """The least separation of the ego from one that comes up behind it in strip j and brakes for it [m]; anything
    negative where it is. `rears` are boxes like the trial's: it stays behind their rear where it is not beside the
    trial's."""
    conduct, duty, dt = road.conduct, road.duty, road.period
    i, row, lane = others.marks[j, 0], others.numbers[j], others.marks[j, 1]
    boxes, first, last = trial.boxes, trial.met[lane, 0], trial.met[lane, 1]
    top, most = max(others.drive[i, 0], others.rows[i, 3]), others.drive[i, 2]
    v0 = max(others.rows[i, 3], 0.0)
    v, x, waited, least, k = v0, 0.0, 0, np.inf, 0
    within, sag = row[NEAR] <= 0, _sag_of(others, road, j)
    while k <= last or (rests and v > 0.0):
        if k > _ENDLESS:
            return -1.0
        m = min(k, last)
        box, rear = boxes[lane, m], rears[lane, m, 0]
        # Both move between two frames.
        ahead = x + v * most * dt - row[NEAR]
        if k >= first and box[0] < FAR_OFF and ahead >= row[START]:
            if not rear < FAR_OFF:
                rear = box[0]
            beside = _beside(box, row, _aside(road, lane, sag, trial.path[m, 3]))
            least = min(least, max(rear - brakes.front - ahead, beside))
            if least < CLEAR:
                return least
        there = brakes.anywhere or x >= row[NEAR]
        if there and not brakes.anywhere and not within:
            # One that is slower may be further into the lane in its first frame there, and faster.
            v = max(v, min(_arrival(v0, row[NEAR], others.drive[i], conduct.acceleration, dt), top))
            x = row[NEAR] + v * most * dt
            within = True
        waited = waited + 1 if k >= brakes.since and there else 0
        x += v * most * dt
        v = max(v - duty.braking * dt, 0.0) if waited > brakes.delay else min(v + conduct.acceleration * dt, top)
        k += 1
    return least


@uncounted
def _comes_over(others: Others, road: Road, j: int) -> bool:
    """Whether the vehicle of strip j has to come over to its lane, from one beside it that ends."""
    marks, over = others.marks, road.ways.over
    if marks[j, 2] != SEVERAL:
        return marks[j, 2] >= 0 and over[marks[marks[j, 2], 1]] == marks[j, 1]
    comes = False
    for k in range(others.found[0]):
        comes = comes or (marks[k, 0] == marks[j, 0] and over[marks[k, 1]] == marks[j, 1])
    return comes


@uncounted
def find_coming_over(others: Others, road: Road, found: BoolArray) -> None:
    """Write for each strip whether its vehicle has to come over to its lane, from one beside it that ends, (k,)."""
    for j in range(len(found)):
        found[j] = _comes_over(others, road, j)


@uncounted
def _is_seen(others: Others, road: Road, trial: Trial, j: int, k: int) -> bool:
    """Whether the vehicle of strip j sees the ego in its lane in frame k. One that has yet to come over to it, from a
    lane that ends, sees the ego there where it is visible in the lane that ends as well."""
    while trial.seen[others.marks[j, 1], k]:
        if not _comes_over(others, road, j):
            return True
        j = others.marks[j, 2]
        if j == SEVERAL:
            return False
    return False


@uncounted
def _is_owed(others: Others, road: Road, trial: Trial, j: int, since: int, contact: int) -> bool:
    """Whether the vehicle of strip j owes the ego its distance there up to frame `contact`, with the ego visible in its
    lane from frame `since` on. Before it has come into that lane it does as long as it owes it in the one before, and
    the ego stays visible there."""
    i, row, before = others.marks[j, 0], others.numbers[j], others.marks[j, 2]
    if row[NEAR] <= 0 or road.duty.ahead:
        lane, k = others.marks[j, 1], since
    elif before >= 0 and others.numbers[before, NEAR] <= 0:
        row, lane, k = others.numbers[before], others.marks[before, 1], 0
        while k <= contact and _is_seen(others, road, trial, before, k):
            k += 1
        k = 0 if k > contact else 1
    else:
        return False
    # It was behind a frame ago. On a ring one that is ahead of the ego comes up behind it as well.
    came = row[FRONT] - row[NEAR] - max(others.rows[i, 3], 0.0) * road.period
    return k == 0 and others.owes[i, lane] and came + CLEAR <= trial.rears[lane, 0] < FAR_OFF


@uncounted
def _waits(
    others: Others, road: Road, trial: Trial, j: int, contact: int, bad: int, there: bool, lenient: bool
) -> float:
    """The least separation from one with less right of way that waits before strip j [m]; negative where it need not or
    cannot."""
    i, row, lane = others.marks[j, 0], others.numbers[j], others.marks[j, 1]
    since = contact + 1
    while since > 0 and road.rights[trial.own[since - 1]] > others.ranks[j]:
        since -= 1
    if since > bad or row[HALF] - row[NEAR] > trial.boxes[lane, bad, 0]:
        return -1.0
    delay, given = road.duty.reaction, others.gives[i, lane]
    if lenient and given > 0 and since == 0:
        delay = max(delay - given, 0)
    return _followed(others, road, trial, trial.boxes, j, _Brakes(since, delay, True, row[HALF]), there)


@uncounted
def _is_shut(others: Others, road: Road, j: int) -> bool:
    """Whether the ego stands in every way that leads to strip j. Where several do, each has to be shut, and to have
    been judged before."""
    marks, numbers, ways, before = others.marks, others.numbers, road.ways, others.marks[j, 2]
    if before >= 0:
        return others.shut[before]
    if before != SEVERAL:
        return False
    some, lane = False, marks[j, 1]
    for k in range(others.found[0]):
        if marks[k, 0] != marks[j, 0]:
            continue
        leads = ways.over[marks[k, 1]] == lane
        for c in range(ways.after.shape[1]):
            if ways.after[marks[k, 1], c] == lane:
                ends = ways.ends[marks[k, 1], c]
                near = numbers[k, NEAR] + road.lanes.rows[marks[k, 1], LANE_LENGTH] - ends[0] - ends[2]
                leads = leads or abs(near - numbers[j, NEAR]) < _NEARLY
        if leads:
            if k >= j or not others.shut[k]:
                return False
            some = True
    return some


@uncounted
def judge(
    others: Others, road: Road, trial: Trial, bodies: FloatArray, count: int, rests: bool, trust: int
) -> tuple[float, int, int, float]:
    """The least separation from anybody along the first `count` places of a path, surveyed before.

    Parameters
    ----------
    trial : the path, and where it is on the lanes; its `margins`, from each vehicle, are written.
    bodies : boxes of the ego without its buffer, surveyed like the trial's; looked at where it is `ASKED`.
    rests : whether the ego stays at the last of them for good.
    trust : `STRICT`, `BELIEVED` or `ASKED`.

    Returns
    -------
    It [m], the vehicle that it is from (-1 for what stands), the first frame with less than 0, `count` for none; and
    the least separation from those who have broken no rule [m].
    """
    path, boxes, met, margins = trial.path, trial.boxes, trial.met, trial.margins
    rows, body, dt = road.lanes.rows, road.body, road.period
    worst, who, when, innocent = np.inf, -1, count, np.inf
    margins[:] = np.inf
    for j in range(others.things.shape[0]):
        for k in range(count):
            ego = Ego(path[k, 0], path[k, 1], path[k, 2], path[k, 3], body.along, body.across, 0.0, 0.0, False, False)
            gap = gap_between(ego, body.along, body.across, others.things, j, 0.0)
            gap = min(gap, gap_between(ego, body.length, body.width, others.things, j, dt))
            if gap < 0:
                when = min(when, k)
            if gap < worst:
                worst, who = gap, -1
            innocent = min(innocent, gap)
    for j in range(others.found[0]):
        i, lane, row = others.marks[j, 0], others.marks[j, 1], others.numbers[j]
        first, last = met[lane, 0], met[lane, 1]
        others.shut[j], others.waits[j] = _is_shut(others, road, j), False
        if others.shut[j] or last < first:
            continue
        end = ALWAYS if is_dead_end(road.ways, lane) else rows[lane, LANE_LENGTH]
        least, bad, contact, sag = np.inf, count, -1, _sag_of(others, road, j)
        there = rests and last == count - 1
        # Who has to stay behind the ego's body does not come to the next lane, where its rear is within this one. That
        # holds for any size, with the buffer and without: a frame later it may owe its distance to the body alone. And
        # it holds where the ego takes the middle, which is in any band: a frame later the band may be a narrower one.
        closes = there and trial.rears[lane, 1] <= end and boxes[lane, last, 2] < 0.0 < boxes[lane, last, 3]
        for k in range(first, last + 1):
            box = boxes[lane, k]
            if not box[0] < FAR_OFF:
                continue
            beside = _beside(box, row, _aside(road, lane, sag, path[k, 3]))
            # Both move between two frames: of one that rolls back the later frame counts.
            back = min(others.least[i, max(k - 1, 0)], others.least[i, k + 1]) - row[FAR]
            ahead = others.most[i, k + 1] - row[NEAR]
            if rests and k == count - 1:
                ahead = ALWAYS
                # Whoever rolls back does so until it stands.
                back = min(back, others.least[i, others.least.shape[1] - 1] - row[FAR])
            back, ahead = max(back, row[START]), min(ahead, max(end, -row[NEAR]))
            if back > ahead:
                continue
            along = max(box[0] - row[HALF] - ahead, back - row[HALF] - box[1])
            gap = max(along, beside)
            least = min(least, gap)
            if gap < 0:
                contact, bad = k, min(bad, k)
        if least < 0:
            since = contact + 1
            while since > 0 and _is_seen(others, road, trial, j, since - 1):
                since -= 1
            # Who is behind, and sees the ego from some frame on.
            box = boxes[lane, bad]
            if since <= contact:
                start = -row[NEAR] + row[HALF] <= box[0]
                owed = trust != STRICT and _is_owed(others, road, trial, j, since, contact)
                asked = owed and trust == ASKED
                if owed and trust == BELIEVED:
                    others.shut[j] = closes and contact == count - 1
                    least, bad = np.inf, count
                elif start or asked:
                    brakes = _Brakes(since, road.duty.reaction, road.duty.ahead, row[HALF])
                    if asked:
                        brakes = _Brakes(0, 0, True, row[FRONT])
                    stays = _followed(others, road, trial, bodies if asked else boxes, j, brakes, there)
                    if stays >= CLEAR:
                        others.shut[j] = closes and contact == count - 1
                        least, bad = stays, count
            if least < 0 and road.duty.gives_way:
                stays = _waits(others, road, trial, j, contact, bad, there, trust != STRICT)
                if stays >= CLEAR:
                    others.shut[j], others.waits[j] = closes and contact == count - 1, True
                    least, bad = stays, count
        margins[i] = min(margins[i], least)
        when = min(when, bad)
        if not others.offends[i]:
            innocent = min(innocent, least)
        if least < worst:
            worst, who = least, i
    return worst, who, when, innocent
