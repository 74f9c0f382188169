"""Prediction of the lane that each tracked vehicle will be in.

Notation
--------
y, v : lateral position [m] and lateral speed [m/s] of a vehicle, normally distributed in each of the tracker's three
    models (lane-keeping, free and manoeuvring; see `shield.perception.tracking`).

A *free* or *manoeuvring* vehicle is changing lanes. It moves on for a while, and settles in the lane around y + reach
v, with the deviation `stray`. highway-env's own vehicles steer by v = (goal - y) / 0.6 s, with a delayed heading. A
*lane-keeping* vehicle is in its present lane until it begins a change. Most vehicles change soon if the change has a
lane-change incentive and the new follower need not brake too hard (MOBIL, see `dynamics.traffic.mobil`); few change
otherwise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from dynamics.state import BoolArray, FloatArray
from dynamics.traffic.mobil import COMFORT, GAP, TIME, TWICE_ROOT
from shield.errors import ConfigError
from shield.perception.tracking import Tracks

__all__ = ["LANE_CHANGE_MODEL", "LaneChangeModel", "lane_chances", "lane_change_gains"]

_LANE_KEEPING = 0
_X, _Y, _VX, _VY = range(4)
_DRAWS = 16
"""Number of samples of all states, for the probability that a change has an incentive."""
_BESIDE = 3.0
"""A vehicle at most this far from the centre of a lane counts as in it, for highway-env's traffic [m]."""
_LEAST_GAIN, _MOST_BRAKING = 0.2, 2.0
"""MOBIL's least incentive of a change, and the greatest braking that it may impose on the new follower [m/s^2]."""


class LaneChangeModel(NamedTuple):
    """Parameters of lane changes.

    Attributes
    ----------
    reach : time after which a vehicle that is changing lanes settles, at its present lateral speed [s].
    stray : standard deviation of its distance from there [m].
    eager : probability that a lane-keeping vehicle has changed lanes by the end of the prediction, where that has an
        incentive, for an exactly known position.
    idle : the same where it has no incentive.
    fade : longitudinal standard deviation at which `eager` is halved: an incentive from uncertain positions is often an
        error [m].
    doubt : probability that a vehicle which seems to change lanes keeps its lane.
    """

    reach: float
    stray: float
    eager: float
    idle: float
    fade: float
    doubt: float


LANE_CHANGE_MODEL = LaneChangeModel(reach=0.48, stray=1.0, eager=0.65, idle=0.0026, fade=1.0, doubt=0.45)
"""Fitted to highway-env's vehicles, 2 s ahead: `python benchmarks/intent.py --fit --seed 5004 --episodes 12`."""


def lane_chances(
    tracks: Tracks, wished: FloatArray, centers: FloatArray, habits: LaneChangeModel = LANE_CHANGE_MODEL
) -> FloatArray:
    """Probability of each lane that each vehicle will be in it, (n, lanes); each row sums to 1.

    Parameters
    ----------
    tracks : n tracked vehicles, on a road along x.
    wished : probability that a change has an incentive, (n, 2), from `lane_change_gains`.
    centers : lane centres along y, ascending, (lanes,) [m].
    habits : parameters of lane changes, for one prediction time.

    Raises
    ------
    ConfigError
        If there is no lane, or the centres do not ascend.
    """
    _check(centers)
    means, covariances, reach = tracks.means, tracks.covariances, habits.reach
    y, v = means[:, :, _Y], means[:, :, _VY]
    spread, with_v, of_v = covariances[:, :, _Y, _Y], covariances[:, :, _Y, _VY], covariances[:, :, _VY, _VY]
    goes = spread + 2 * reach * with_v + reach**2 * of_v + habits.stray**2
    then = _in_lanes(y + reach * v, np.sqrt(goes), centers)
    eager = habits.eager / (1 + np.sqrt(tracks.covariance[:, _X, _X]) / habits.fade)
    below, above = np.maximum(habits.idle, eager * wished.T)
    # If both changes have an incentive, highway-env's vehicles choose the lane above.
    stays = _changed(_in_lanes(y, np.sqrt(spread), centers), below * (1 - above), above)
    moves = (1 - habits.doubt) * then + habits.doubt * stays
    moves[:, _LANE_KEEPING] = stays[:, _LANE_KEEPING]
    found: FloatArray = np.einsum("nj,njk->nk", tracks.chances, moves)
    return found


def lane_change_gains(tracks: Tracks, ego: FloatArray, centers: FloatArray) -> FloatArray:
    """Probability of each vehicle that a change to the lane below (in y) or above has an incentive by MOBIL, (n, 2).

    The probability is the share of 16 samples of all states. The desired speed of a vehicle is taken to be its present
    one.

    Parameters
    ----------
    tracks : n tracked vehicles. ego : x, y [m], vx, vy [m/s] of the ego, (4,).
    centers : lane centres along y, ascending, (lanes,) [m].

    Raises
    ------
    ConfigError
        If there is no lane, or the centres do not ascend.
    """
    _check(centers)
    n = len(tracks.ids) or len(tracks.means)
    root = np.linalg.cholesky(tracks.covariance + 1e-9 * np.eye(4))
    drawn = np.random.default_rng(0).standard_normal((_DRAWS, n, 4))
    others = tracks.mean + np.einsum("nij,knj->kni", root, drawn)
    states = np.concatenate([others, np.broadcast_to(ego, (_DRAWS, 1, 4))], axis=1)
    x, y, v = (states[:, :, k] for k in (_X, _Y, _VX))
    ahead = x[:, None, :] - x[:, :n, None]
    ahead[:, np.arange(n), np.arange(n)] = np.nan  # no vehicle is its own leader
    own = np.abs(y[:, :n, None] - centers).argmin(axis=2)
    around = np.concatenate([[np.nan], centers, [np.nan]])
    now = _gap_ratio(v[:, :n], *_next(ahead, v, _is_in(y, around[own + 1])))
    found = []
    for side in (0, 2):
        lane = _is_in(y, around[own + side])
        then, back = _gap_ratio(v[:, :n], *_next(ahead, v, lane)), _next(-ahead, v, lane)
        behind = back[1]
        imposed = np.where(np.isfinite(back[0]), _gap_ratio(behind, back[0], v[:, :n]), 0.0)
        there = ~np.isnan(around[own + side])
        pays = (COMFORT * (now**2 - then**2) >= _LEAST_GAIN) & (COMFORT * imposed**2 <= _MOST_BRAKING)
        found.append((pays & there).mean(axis=0))
    return np.stack(found, axis=1)


def _check(centers: FloatArray) -> None:
    """Raise `ConfigError` unless there is a lane and the centres ascend."""
    if not len(centers) or (np.diff(centers) <= 0).any():
        raise ConfigError(f"centers of lanes ascend, got {np.asarray(centers).tolist()}")


def _is_in(y: FloatArray, center: FloatArray) -> BoolArray:
    """Whether each vehicle is in the given lane of each tracked one, (draws, n, n + 1)."""
    found: BoolArray = np.abs(y[:, None, :] - center[:, :, None]) <= _BESIDE
    return found


def _next(ahead: FloatArray, v: FloatArray, counts: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Distance and speed of the nearest vehicle ahead among those that count, (draws, n); the distance is infinite
    without one."""
    away = np.where(counts & (ahead >= 0), ahead, np.inf)
    nearest = away.argmin(axis=2)
    return np.take_along_axis(away, nearest[:, :, None], 2)[:, :, 0], np.take_along_axis(v, nearest, 1)


def _gap_ratio(v: FloatArray, gap: FloatArray, leader: FloatArray) -> FloatArray:
    """IDM's d* / d of a vehicle at speed v behind a leader."""
    return (GAP + TIME * v + v * (v - leader) / TWICE_ROOT) / np.maximum(gap, 1e-2)


def _in_lanes(mean: FloatArray, spread: FloatArray, centers: FloatArray) -> FloatArray:
    """Probability of being nearest to each centre, (n, 3, lanes), of normal distributions across the road, (n, 3)."""
    marks = 0.5 * (centers[1:] + centers[:-1])
    below = ndtr((marks - mean[..., None]) / np.maximum(spread[..., None], 1e-9))
    return np.diff(below, axis=-1, prepend=0.0, append=1.0)


def _changed(now: FloatArray, below: FloatArray, above: FloatArray) -> FloatArray:
    """Probability of each lane after a change to the lane below or above, with the given probabilities, (n,). At the
    outermost lanes a change outward does not happen."""
    down, up = below[:, None, None] * now[:, :, 1:], above[:, None, None] * now[:, :, :-1]
    then = now.copy()
    then[:, :, 1:] -= down
    then[:, :, :-1] += down - up
    then[:, :, 1:] += up
    return then
