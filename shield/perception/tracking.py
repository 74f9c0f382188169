"""Tracking of vehicles over observations: assignment, and three Kalman filters for each vehicle.

Notation
--------
State of a vehicle: x [m], y [m], vx, vy [m/s] in the world frame. Lanes lie along x. From one observation to the next a
vehicle follows one of three motion models, between which it changes at random:

- *lane keeping*: it keeps its velocity along x, with white-noise acceleration, and is drawn to the centre of the
nearest lane;
- *free*: it keeps its velocity along and across the road, with white-noise accelerations;
- *manoeuvring*: both accelerations are large. In frames of 0.2 s highway-env's vehicles oscillate by 1 m as they change
  lanes.

In all models the speed approaches the usual speed of traffic slowly. Each vehicle has an estimate for each model, and
the probability of each (the interacting multiple model of Blom and Bar-Shalom 1988). Mean and covariance are those of
the mixture.

The assignment of observed vehicles to tracks has the least total cost: the squared Mahalanobis distance, plus a small
cost for each row by which the vehicle has moved in the table. Pairs beyond a gate do not match: the observed vehicle is
new, and the tracked one is out of sight.
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
from shield.perception.filters import Matches, Mixtures, StateTransition
from shield.perception.matching import CandidatePairs, LastObservation, ObservedVehicles, apply_gate

__all__ = ["Innovations", "MotionModels", "Tracks", "bounds_of", "predict_tracks", "update_tracks"]

_GATE = 36.0
"""Squared Mahalanobis distance beyond which two vehicles do not match: chi^2 with 4 degrees of freedom exceeds it once
in 4 million."""
_LOST = 400.0
"""Squared distance within which a new vehicle may be the expected one that was not seen."""
_SETTLING, _LATERAL_WANDER = 1.0, 0.15
"""A vehicle that keeps its lane returns to the centre with this time constant [s], and has this standard deviation from
it [m]."""
_RATES = np.array([[-0.1, 0.05, 0.05], [1.0, -1.1, 0.1], [0.5, 1.0, -1.5]])
"""Transition rates from one model (row) to another (column) [1/s]."""
_MODES = 3
_USUAL = np.array([0.8, 0.1, 0.1])
"""Initial probabilities of the models."""
_FRAME = 0.2
"""Correlation time of accelerations [s], where a prediction covers more than one frame."""


class MotionModels(NamedTuple):
    """Parameters of the motion models.

    Attributes
    ----------
    lane_keeping, free, manoeuvring : standard deviations of the accelerations along x and y [m/s^2].
    centers : lane centres along y, (lanes,) [m]. Without them, a lane-keeping vehicle keeps its lateral velocity.
    usual_speed : usual speed along the road, its standard deviation [m/s], and the time constant of the approach [s]
        (an Ornstein-Uhlenbeck process). It has an effect only where the sensor is imprecise.
    sideways : prior standard deviation of the lateral velocity of a new vehicle [m/s].
    """

    lane_keeping: tuple[float, float] = (2.0, 1.0)
    free: tuple[float, float] = (2.0, 3.0)
    manoeuvring: tuple[float, float] = (4.0, 20.0)
    centers: FloatArray | None = None
    usual_speed: tuple[float, float, float] = (21.0, 2.5, 10.0)
    sideways: float = 1.5


class Innovations(NamedTuple):
    """Predicted against observed states of k vehicles, at one observation.

    A pair slightly beyond the gate is included too. Its observed vehicle gets a new track, and counts as a deviation of
    the expected one.

    Attributes
    ----------
    distances : squared Mahalanobis distances, the least of the three models', (k,).
    scores : normal scores of x, y, vx and vy, (k, 4); see `filters.scores`.
    steps : change of the observed x, y, vx and vy since the previous observation, less the distance driven at the
        estimated velocity, (l, 4) [m], [m/s]. Only of vehicles that were seen at the previous observation too.
    """

    distances: FloatArray
    scores: FloatArray
    steps: FloatArray


def _none(*shape: int) -> FloatArray:
    """Empty array with the given shape after the first axis."""
    return np.zeros((0, *shape))


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """n tracked vehicles.

    Attributes
    ----------
    ids : identity of each, (n,); no identity is used twice.
    means, covariances : of each model, lane keeping, free and manoeuvring, (n, 3, 4) and (n, 3, 4, 4). chances : of
        each model, (n, 3).
    missed : number of consecutive observations that each was missing from, (n,).
    places : row in which each was last seen, (n,); NaN where rows carry no information.
    next_id : identity of the next new vehicle.
    seen : last observed state of each, (n, 4).
    surprise : predicted against observed states at the last observation; None before the second, and without `watched`.
    innovation : squared Mahalanobis distance between prediction and observation, the least of the three models', (n,).
        NaN for a vehicle that is new or was not seen.
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
    surprise: Innovations | None = None

    @property
    def mean(self) -> FloatArray:
        """Mean of the mixture, (n, 4)."""
        return filters.mixture(self.chances, self.means, self.covariances)[0]

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the mixture, (n, 4, 4)."""
        return filters.mixture(self.chances, self.means, self.covariances)[1]


def update_tracks(
    tracks: Tracks,
    seen: FloatArray,
    noise: FloatArray,
    dt: float,
    motions: MotionModels,
    missed_limit: int = 0,
    places: IntArray | None = None,
    watched: bool = False,
) -> Tracks:
    """The tracks after one more observation.

    Parameters
    ----------
    tracks : before it. seen : observed states, (m, 4), in any order.
    noise : covariance of an observed state, (4, 4). dt : time since the previous observation [s].
    motions : parameters of the motion models.
    missed_limit : consecutive observations that a vehicle may be missing from.
    places : rows of the observed vehicles, (m,), where rows are sorted by distance; None where they carry no
        information.
    watched : whether to fill in `Tracks.surprise`.
    """
    at = np.full(len(seen), np.nan) if places is None else places.astype(float)
    changes, transition, pushed, centers = _prediction_parameters(dt, motions)
    before = tracks.chances, tracks.means, tracks.covariances
    chances, means, covariances = filters.predict(*before, changes, transition, pushed, centers)
    away, size = filters.distances(means, covariances, seen, noise)
    least, cost = filters.costs(away, tracks.places, at)
    rows, columns = linear_sum_assignment(cost)
    apart = least[rows, columns]
    surprise = None
    if watched and len(rows):
        near = apart <= _LOST
        pair = rows[near], columns[near]
        found = filters.scores(chances, means, covariances, seen, noise, *pair)
        surprise = Innovations(apart[near], found, _steps(tracks, seen, dt, *pair))
    last, observed = LastObservation(tracks.missed, tracks.places, tracks.seen), ObservedVehicles(at, seen)
    pairs = apply_gate(CandidatePairs(rows, columns, apart), _GATE, missed_limit, last, observed)
    expected, same = Mixtures(chances, means, covariances), Matches(pairs.rows, pairs.columns)
    chances, means, covariances = filters.measurement_update(expected, seen, noise, (away, size), same)
    about = pairs.missed, pairs.places, tracks.next_id, pairs.innovation, pairs.seen, surprise
    everybody = Tracks(tracks.ids, means, covariances, chances, *about)
    if pairs.whole:
        return everybody
    kept, unknown = pairs.missed <= missed_limit, pairs.unknown
    return _joined(everybody, kept, _newcomers(tracks.next_id, seen[unknown], at[unknown], noise, motions))


def _steps(tracks: Tracks, seen: FloatArray, dt: float, rows: IntArray, columns: IntArray) -> FloatArray:
    """See `Innovations.steps`."""
    before = tracks.missed[rows] == 0
    rows, columns = rows[before], columns[before]
    steps: FloatArray = seen[columns] - tracks.seen[rows]
    steps[:, :2] -= dt * tracks.mean[rows, 2:]
    return steps


def _joined(one: Tracks, kept: BoolArray, other: Tracks) -> Tracks:
    """The kept tracks of one, and all tracks of the other."""
    names = "ids", "means", "covariances", "chances", "missed", "places", "innovation", "seen"
    joined = {name: np.concatenate([getattr(one, name)[kept], getattr(other, name)]) for name in names}
    return Tracks(**joined, next_id=other.next_id, surprise=one.surprise)


def _newcomers(first_id: int, seen: FloatArray, at: FloatArray, noise: FloatArray, motions: MotionModels) -> Tracks:
    """Tracks of vehicles that are seen for the first time."""
    n = len(seen)
    mean, about = _initial_estimate(seen, noise, motions)
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


def _initial_estimate(seen: FloatArray, noise: FloatArray, motions: MotionModels) -> tuple[FloatArray, FloatArray]:
    """Means (n, 4) and covariance (4, 4) of new vehicles, from the observation and the prior of the velocity.

    The noise of a velocity is taken to be uncorrelated with the other components.
    """
    mean, about = seen.copy(), noise.copy()
    for k, (usual, spread) in ((2, motions.usual_speed[:2]), (3, (0.0, motions.sideways))):
        seen_by = noise[k, k]
        about[k, k] = seen_by * spread**2 / (seen_by + spread**2)
        mean[:, k] += seen_by / (seen_by + spread**2) * (usual - seen[:, k])
    return mean, about


def bounds_of(tracks: Tracks, bound: float | FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lower and upper bounds of x, y, vx and vy, (n, 4) and (n, 4): quantiles of the mixture.

    Parameters
    ----------
    bound : standard deviations of a normal distribution with the same probability of being exceeded. One number for
        all, or below and above for each component, (2, 4).
    """
    bounds = np.full((2, 4), float(bound)) if isinstance(bound, float | int) else bound
    return filters.quantiles(tracks.chances, tracks.means, tracks.covariances, bounds)


def predict_tracks(tracks: Tracks, late: float, motions: MotionModels) -> Tracks:
    """Prediction of the tracks, `late` [s] after the last observation. Lane-keeping vehicles keep their lane, and all
    others are free, because no vehicle oscillates for so long."""
    if not late or not len(tracks.ids):
        return tracks
    share = math.sqrt(min(_FRAME / late, 1.0))
    lane_keeping, free = ((share * a, share * b) for a, b in (motions.lane_keeping, motions.free))
    _, transition, pushed, centers = _prediction_parameters(
        late, motions._replace(lane_keeping=lane_keeping, free=free, manoeuvring=free)
    )
    means, covariances = filters.predict_state(tracks.means, tracks.covariances, transition, pushed, centers)
    return replace(tracks, means=means, covariances=covariances)


def _prediction_parameters(
    dt: float, motions: MotionModels
) -> tuple[FloatArray, StateTransition, FloatArray, FloatArray]:
    """Parameters of a prediction step: transition probabilities, (3, 3), deterministic part, process noise of each
    filter, (3, 4, 4), and lane centres."""
    centers = np.zeros(0) if motions.centers is None else motions.centers
    modes = motions.lane_keeping, motions.free, motions.manoeuvring
    return _changes(dt), _transition(dt, motions.usual_speed), _pushed(dt, modes), centers


@lru_cache(maxsize=16)
def _transition(dt: float, usual: tuple[float, float, float]) -> StateTransition:
    """Deterministic part of a step. `usual` is `MotionModels.usual_speed`."""
    usual_speed, _, slowly = usual
    keep, left = math.exp(-dt / slowly), math.exp(-dt / _SETTLING)
    reach = slowly * (1 - keep)
    stray, sway = (1 - left**2) * _LATERAL_WANDER**2, (_LATERAL_WANDER / _SETTLING) ** 2 + 1e-2
    return StateTransition(dt, keep, reach, usual_speed * (dt - reach), usual_speed * (1 - keep), left, stray, sway)


@lru_cache(maxsize=16)
def _changes(dt: float) -> FloatArray:
    """Transition probabilities between the models after `dt`, (3, 3)."""
    changes: FloatArray = expm(_RATES * dt)
    return changes


@lru_cache(maxsize=16)
def _pushed(dt: float, modes: tuple[tuple[float, float], ...]) -> FloatArray:
    """Process noise of each filter, from accelerations that are white from frame to frame, (filters, 4, 4)."""
    pushed = np.zeros((len(modes), 4, 4))
    for each, accelerations in zip(pushed, modes, strict=True):
        for axis, a in enumerate(accelerations):
            g = np.zeros(4)
            g[axis], g[axis + 2] = dt * dt / 2, dt
            each += a * a * np.outer(g, g)
            # highway-env moves a vehicle by the speed before the step: another half of dt.
            each[axis, axis] += (a * dt * dt / 4) ** 2
    return pushed
