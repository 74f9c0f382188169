"""Who is who from one observation to the next, and what each is doing: assignment, and three Kalman filters for each.

Notation
--------
State of a vehicle: x [m], y [m], vx, vy [m/s] in the world's directions. Lanes lie along x. From one observation to the
next a vehicle does one of three things, which change at random:

- *calm*, it drives on: along x it keeps its velocity, but for an acceleration that is white noise, and across it is
  drawn to the middle of the nearest lane;
- *free*, it does not keep to a lane: across, too, it keeps its velocity but for white noise;
- *brisk*: both accelerations are large. In frames of 0.2 s highway-env's cars swing to and fro by 1 m as they change
  lanes.

All are drawn, slowly, to the speed that traffic has. So each vehicle has an estimate for each, and the probability of
each (the interacting multiple model of Blom and Bar-Shalom 1988); mean and covariance are those of the mixture. Which
row of an observation is whom is the assignment of least total Mahalanobis distance, and a little for each row that
somebody is further up or down than before, with those further apart than a gate left over: they are new, or out of
sight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm
from scipy.optimize import linear_sum_assignment

from dynamics.state import BoolArray, FloatArray, IntArray
from shield.perception import filter_kernels as filters
from shield.perception.filters import Course
from shield.perception.matching import settled

__all__ = ["Motions", "Surprise", "Tracks", "ahead_of", "follow", "sides"]

_GATE = 36.0
"""Squared Mahalanobis distance beyond which two are not the same: chi^2 with 4 degrees exceeds it once in 4 million."""
_LOST = 400.0
"""Squared distance within which somebody new may be whoever was expected, and not seen."""
_SETTLING, _WAVER = 1.0, 0.15
"""One that keeps to its lane is drawn to its middle within this [s], and strays from it by this [m]."""
_RATES = np.array([[-0.1, 0.05, 0.05], [1.0, -1.1, 0.1], [0.5, 1.0, -1.5]])
"""How often one that does this does that instead [1/s]."""
_MODES = 3
_USUAL = np.array([0.8, 0.1, 0.1])
"""How likely each is of somebody who has never been seen."""
_FRAME = 0.2
"""Accelerations last for this [s] where more than one frame is foreseen at once."""


class Motions(NamedTuple):
    """How vehicles move.

    Attributes
    ----------
    calm, free, brisk : standard deviations of the accelerations along x and y [m/s^2].
    centers : of the lanes, along y, (lanes,) [m]; without any, a calm one keeps its velocity across as well.
    cruise : the speed along the road that everybody is drawn to, by how much they differ in it [m/s], and how slowly
        they are drawn [s] (an Ornstein-Uhlenbeck process). It says something only where the sensor says little.
    sideways : standard deviation of the velocity across of somebody who has never been seen [m/s].
    """

    calm: tuple[float, float] = (2.0, 1.0)
    free: tuple[float, float] = (2.0, 3.0)
    brisk: tuple[float, float] = (4.0, 20.0)
    centers: FloatArray | None = None
    cruise: tuple[float, float, float] = (21.0, 2.5, 10.0)
    sideways: float = 1.5


class Surprise(NamedTuple):
    """What was expected of k vehicles against what was seen of them, at one observation.

    Those are among them, too, who are further from where somebody was expected than the gate, but not by far: what they
    show is new, and counts against whoever was expected.

    Attributes
    ----------
    distances : squared Mahalanobis distances, the least of the three estimates', (k,).
    scores : in standard deviations of a normal distribution, of x, y, vx and vy, (k, 4); see `filters.scores`.
    steps : of those who were seen at the observation before, too: by how much what is seen of x, y, vx and vy has
        changed, but for how far one comes at the speed that it is thought to have, (l, 4) [m], [m/s].
    """

    distances: FloatArray
    scores: FloatArray
    steps: FloatArray


def _none(*shape: int) -> FloatArray:
    return np.zeros((0, *shape))


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """n vehicles that are followed.

    Attributes
    ----------
    ids : which is which, (n,); never given twice.
    means, covariances : of each estimate, calm, free and brisk, (n, 3, 4) and (n, 3, 4, 4). chances : of each, (n, 3).
    missed : for how many observations in a row each has not been seen, (n,). places : row in which each was seen last,
        (n,); NaN where rows say nothing.
    next_id : of the next newcomer.
    seen : what was seen last of each, (n, 4).
    surprise : what was expected against what was seen at the last observation; None before the second,
        and where nobody asks.
    innovation : squared Mahalanobis distance between what was expected of each and what was seen, the least of the
        three, (n,); NaN of who has just come or was not seen.
    """

    ids: IntArray = field(default_factory=lambda: np.zeros(0, np.intp))
    means: FloatArray = field(default_factory=lambda: _none(_MODES, 4))
    covariances: FloatArray = field(default_factory=lambda: _none(_MODES, 4, 4))
    chances: FloatArray = field(default_factory=lambda: _none(_MODES))
    missed: IntArray = field(default_factory=lambda: np.zeros(0, np.intp))
    places: FloatArray = field(default_factory=lambda: np.zeros(0))
    next_id: int = 1
    innovation: FloatArray = field(default_factory=lambda: np.zeros(0))
    seen: FloatArray = field(default_factory=lambda: _none(4))
    surprise: Surprise | None = None

    @property
    def mean(self) -> FloatArray:
        """Of all estimates together, (n, 4)."""
        return filters.mixture(self.chances, self.means, self.covariances)[0]

    @property
    def covariance(self) -> FloatArray:
        """Of all together, (n, 4, 4)."""
        return filters.mixture(self.chances, self.means, self.covariances)[1]


def follow(
    tracks: Tracks,
    seen: FloatArray,
    noise: FloatArray,
    dt: float,
    motions: Motions,
    patience: int = 0,
    places: IntArray | None = None,
    watched: bool = False,
) -> Tracks:
    """The tracks after one more observation.

    Parameters
    ----------
    tracks : before it. seen : states of those seen, (m, 4), in any order.
    noise : covariance of one of these, (4, 4). dt : time since the observation before [s].
    patience : for how many observations in a row somebody may be missing.
    places : rows in which those seen are, (m,), where these are sorted by what is there; None where they say nothing.
    watched : whether `Tracks.surprise` is filled in.
    """
    at = np.full(len(seen), np.nan) if places is None else places.astype(float)
    changes, course, pushed, centers = _foreseen(dt, motions)
    before = tracks.chances, tracks.means, tracks.covariances
    chances, means, covariances = filters.expected(*before, changes, course, pushed, centers)
    away, size = filters.distances(means, covariances, seen, noise)
    least, cost = filters.costs(away, tracks.places, at)
    rows, columns = linear_sum_assignment(cost)
    apart = least[rows, columns]
    surprise = None
    if watched and len(rows):
        near = apart <= _LOST
        pair = rows[near], columns[near]
        found = filters.scores(chances, means, covariances, seen, noise, *pair)
        surprise = Surprise(apart[near], found, _steps(tracks, seen, dt, *pair))
    last = tracks.missed, tracks.places, tracks.seen
    pairs = settled(rows, columns, apart, _GATE, patience, *last, at, seen)
    expected, same = (chances, means, covariances), (pairs.rows, pairs.columns)
    chances, means, covariances = filters.taken_in(*expected, seen, noise, away, size, *same)
    about = pairs.missed, pairs.places, tracks.next_id, pairs.innovation, pairs.seen, surprise
    everybody = Tracks(tracks.ids, means, covariances, chances, *about)
    if pairs.whole:
        return everybody
    kept, unknown = pairs.missed <= patience, pairs.unknown
    return _joined(everybody, kept, _newcomers(tracks.next_id, seen[unknown], at[unknown], noise, motions))


def _steps(tracks: Tracks, seen: FloatArray, dt: float, rows: IntArray, columns: IntArray) -> FloatArray:
    """See `Surprise.steps`."""
    before = tracks.missed[rows] == 0
    rows, columns = rows[before], columns[before]
    steps: FloatArray = seen[columns] - tracks.seen[rows]
    steps[:, :2] -= dt * tracks.mean[rows, 2:]
    return steps


def _joined(one: Tracks, kept: BoolArray, other: Tracks) -> Tracks:
    """Those who are kept of one, and the other."""
    names = "ids", "means", "covariances", "chances", "missed", "places", "innovation", "seen"
    joined = {name: np.concatenate([getattr(one, name)[kept], getattr(other, name)]) for name in names}
    return Tracks(**joined, next_id=other.next_id, surprise=one.surprise)


def _newcomers(first_id: int, seen: FloatArray, at: FloatArray, noise: FloatArray, motions: Motions) -> Tracks:
    """Those who are seen for the first time."""
    n = len(seen)
    mean, about = _born(seen, noise, motions)
    return Tracks(
        first_id + np.arange(n),
        np.repeat(mean[:, None], _MODES, axis=1),
        np.broadcast_to(about, (n, _MODES, 4, 4)),
        np.broadcast_to(_USUAL, (n, _MODES)),
        np.zeros(n, np.intp),
        at,
        first_id + n,
        np.full(n, np.nan),
        seen,
    )


def _born(seen: FloatArray, noise: FloatArray, motions: Motions) -> tuple[FloatArray, FloatArray]:
    """Means (n, 4) and covariance (4, 4) of newcomers: what is seen of them, and how fast somebody drives. The noise of
    a velocity is taken to be no one else's."""
    mean, about = seen.copy(), noise.copy()
    for k, (usual, spread) in ((2, motions.cruise[:2]), (3, (0.0, motions.sideways))):
        seen_by = noise[k, k]
        about[k, k] = seen_by * spread**2 / (seen_by + spread**2)
        mean[:, k] += seen_by / (seen_by + spread**2) * (usual - seen[:, k])
    return mean, about


def sides(tracks: Tracks, bound: float | FloatArray) -> tuple[FloatArray, FloatArray]:
    """Between what each of x, y, vx and vy is, (n, 4) and (n, 4): quantiles of the mixture, so likely to be exceeded as
    `bound` standard deviations of one normal distribution are; one for all, or below and above of each, (2, 4)."""
    bounds = np.full((2, 4), float(bound)) if isinstance(bound, float | int) else bound
    return filters.quantiles(tracks.chances, tracks.means, tracks.covariances, bounds)


def ahead_of(tracks: Tracks, late: float, motions: Motions) -> Tracks:
    """Where those who are followed are `late` [s] after they were seen, with nothing seen since: calm ones go on as
    such, and all others as free ones (nobody swings for so long)."""
    if not late or not len(tracks.ids):
        return tracks
    share = math.sqrt(min(_FRAME / late, 1.0))
    calm, free = ((share * a, share * b) for a, b in (motions.calm, motions.free))
    _, course, pushed, centers = _foreseen(late, motions._replace(calm=calm, free=free, brisk=free))
    means, covariances = filters.moved(tracks.means, tracks.covariances, course, pushed, centers)
    return replace(tracks, means=means, covariances=covariances)


def _foreseen(dt: float, motions: Motions) -> tuple[FloatArray, Course, FloatArray, FloatArray]:
    """How likely each change is within a step, (3, 3), what is foreseen of it, what the accelerations of each filter
    add, (3, 4, 4), and the centres of the lanes."""
    centers = np.zeros(0) if motions.centers is None else motions.centers
    modes = motions.calm, motions.free, motions.brisk
    return _changes(dt), _course(dt, motions.cruise), _pushed(dt, modes), centers


@lru_cache(maxsize=16)
def _course(dt: float, usual: tuple[float, float, float]) -> Course:
    cruise, _, slowly = usual
    keep, left = math.exp(-dt / slowly), math.exp(-dt / _SETTLING)
    reach = slowly * (1 - keep)
    stray, sway = (1 - left**2) * _WAVER**2, (_WAVER / _SETTLING) ** 2 + 1e-2
    return Course(dt, keep, reach, cruise * (dt - reach), cruise * (1 - keep), left, stray, sway)


@lru_cache(maxsize=16)
def _changes(dt: float) -> FloatArray:
    """Probabilities of doing this and, `dt` later, that, (3, 3)."""
    changes: FloatArray = expm(_RATES * dt)
    return changes


@lru_cache(maxsize=16)
def _pushed(dt: float, modes: tuple[tuple[float, float], ...]) -> FloatArray:
    """What white accelerations of a frame add to the covariance of each filter, (filters, 4, 4)."""
    pushed = np.zeros((len(modes), 4, 4))
    for each, accelerations in zip(pushed, modes, strict=True):
        for axis, a in enumerate(accelerations):
            g = np.zeros(4)
            g[axis], g[axis + 2] = dt * dt / 2, dt
            each += a * a * np.outer(g, g)
            # highway-env moves by the speed of before, another half of it.
            each[axis, axis] += (a * dt * dt / 4) ** 2
    return pushed
