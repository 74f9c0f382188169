"""Which lane somebody is going to be in, of what a tracker knows of them.

Notation
--------
y, v : where a vehicle is across the road [m] and how fast it moves across [m/s], both normally distributed in each of
the tracker's three estimates (calm, free and brisk; see `shield.perception.tracking`).

Whoever is on the move, *free* or *brisk*, goes on across for a while, and settles in the lane that it has come to then:
y + reach v, give or take `stray`. So highway-env's own cars do it, who steer by v = (goal - y) / 0.6 s and a heading
that is late. Whoever is *calm* is in the lane that it is in, until it begins a change: most do soon where that lets
them accelerate more and their new follower need not brake too hard (MOBIL, see `dynamics.traffic.mobil`), and few
elsewhere.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from dynamics.state import BoolArray, FloatArray
from dynamics.traffic.mobil import COMFORT, GAP, TIME, TWICE_ROOT
from shield.errors import ConfigError
from shield.perception.tracking import Tracks

__all__ = ["HABITS", "Habits", "lane_chances", "wishes"]

_CALM = 0
_X, _Y, _VX, _VY = range(4)
_DRAWS = 16
"""Of where everybody is, to say how likely it is that a change would gain something."""
_BESIDE = 3.0
"""Who is no further from the middle of a lane is in it, for highway-env's traffic [m]."""
_LEAST_GAIN, _MOST_BRAKING = 0.2, 2.0
"""What a change has to gain, and how hard a new follower may have to brake for it [m/s^2]."""


class Habits(NamedTuple):
    """How vehicles change lanes.

    Attributes
    ----------
    reach : somebody on the move settles where it is after so long at its present speed across [s].
    stray : standard deviation of how far from there [m].
    eager : probability that a calm one is in the lane beside it by the time that is asked about, where that pays, of
        one that is seen exactly; idle : where it does not pay.
    fade : who is known to so much along the road is half as eager: that it pays was an error as often [m].
    doubt : of somebody on the move, that it is calm after all.
    """

    reach: float
    stray: float
    eager: float
    idle: float
    fade: float
    doubt: float


HABITS = Habits(reach=0.48, stray=1.0, eager=0.65, idle=0.0026, fade=1.0, doubt=0.45)
"""Of highway-env's cars, 2 s ahead: `python benchmarks/intent.py --fit --seed 5004 --episodes 12`."""


def lane_chances(tracks: Tracks, wished: FloatArray, centers: FloatArray, habits: Habits = HABITS) -> FloatArray:
    """Probability of each lane that each vehicle will be in it, (n, lanes); each row sums to 1.

    Parameters
    ----------
    tracks : n vehicles that are followed, on a road along x.
    wished : how likely each gains by a change, (n, 2), as of `wishes`.
    centers : of its lanes along y, ascending, (lanes,) [m].
    habits : how vehicles change lanes, and by when that is asked about.

    Raises
    ------
    ConfigError
        If there is no lane, or they do not ascend.
    """
    _check(centers)
    means, covariances, reach = tracks.means, tracks.covariances, habits.reach
    y, v = means[:, :, _Y], means[:, :, _VY]
    spread, with_v, of_v = covariances[:, :, _Y, _Y], covariances[:, :, _Y, _VY], covariances[:, :, _VY, _VY]
    goes = spread + 2 * reach * with_v + reach**2 * of_v + habits.stray**2
    then = _in_lanes(y + reach * v, np.sqrt(goes), centers)
    eager = habits.eager / (1 + np.sqrt(tracks.covariance[:, _X, _X]) / habits.fade)
    below, above = np.maximum(habits.idle, eager * wished.T)
    # Where both pay, highway-env's cars take the one above.
    stays = _changed(_in_lanes(y, np.sqrt(spread), centers), below * (1 - above), above)
    moves = (1 - habits.doubt) * then + habits.doubt * stays
    moves[:, _CALM] = stays[:, _CALM]
    found: FloatArray = np.einsum("nj,njk->nk", tracks.chances, moves)
    return found


def wishes(tracks: Tracks, ego: FloatArray, centers: FloatArray) -> FloatArray:
    """Probability of each that a change into the lane below its own in y, and above, pays by MOBIL, (n, 2).

    Of everybody known, as far as it is known where they are: the share of 16 draws. The speed that somebody would like
    is taken to be the one that it has.

    Parameters
    ----------
    tracks : n vehicles that are followed. ego : x, y [m], vx, vy [m/s] of the ego, (4,).
    centers : of the lanes along y, ascending, (lanes,) [m].

    Raises
    ------
    ConfigError
        If there is no lane, or they do not ascend.
    """
    _check(centers)
    n = len(tracks.ids) or len(tracks.means)
    root = np.linalg.cholesky(tracks.covariance + 1e-9 * np.eye(4))
    drawn = np.random.default_rng(0).standard_normal((_DRAWS, n, 4))
    others = tracks.mean + np.einsum("nij,knj->kni", root, drawn)
    states = np.concatenate([others, np.broadcast_to(ego, (_DRAWS, 1, 4))], axis=1)
    x, y, v = (states[:, :, k] for k in (_X, _Y, _VX))
    ahead = x[:, None, :] - x[:, :n, None]
    ahead[:, np.arange(n), np.arange(n)] = np.nan  # nobody is ahead of itself
    own = np.abs(y[:, :n, None] - centers).argmin(axis=2)
    around = np.concatenate([[np.nan], centers, [np.nan]])
    now = _held_up(v[:, :n], *_next(ahead, v, _is_in(y, around[own + 1])))
    found = []
    for side in (0, 2):
        lane = _is_in(y, around[own + side])
        then, back = _held_up(v[:, :n], *_next(ahead, v, lane)), _next(-ahead, v, lane)
        behind = back[1]
        imposed = np.where(np.isfinite(back[0]), _held_up(behind, back[0], v[:, :n]), 0.0)
        there = ~np.isnan(around[own + side])
        pays = (COMFORT * (now**2 - then**2) >= _LEAST_GAIN) & (COMFORT * imposed**2 <= _MOST_BRAKING)
        found.append((pays & there).mean(axis=0))
    return np.stack(found, axis=1)


def _check(centers: FloatArray) -> None:
    if not len(centers) or (np.diff(centers) <= 0).any():
        raise ConfigError(f"centers of lanes ascend, got {np.asarray(centers).tolist()}")


def _is_in(y: FloatArray, center: FloatArray) -> BoolArray:
    """Who is in the lane that each asks about, (draws, n, n + 1)."""
    found: BoolArray = np.abs(y[:, None, :] - center[:, :, None]) <= _BESIDE
    return found


def _next(ahead: FloatArray, v: FloatArray, counts: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Distance and speed of the nearest ahead of each, of those who count, (draws, n); nobody is infinitely far."""
    away = np.where(counts & (ahead >= 0), ahead, np.inf)
    nearest = away.argmin(axis=2)
    return np.take_along_axis(away, nearest[:, :, None], 2)[:, :, 0], np.take_along_axis(v, nearest, 1)


def _held_up(v: FloatArray, gap: FloatArray, leader: FloatArray) -> FloatArray:
    """IDM's d* / d of somebody at speed v behind another."""
    return (GAP + TIME * v + v * (v - leader) / TWICE_ROOT) / np.maximum(gap, 1e-2)


def _in_lanes(mean: FloatArray, spread: FloatArray, centers: FloatArray) -> FloatArray:
    """Probability of being nearest to each center, (n, 3, lanes), of normal distributions across, (n, 3)."""
    marks = 0.5 * (centers[1:] + centers[:-1])
    below = ndtr((marks - mean[..., None]) / np.maximum(spread[..., None], 1e-9))
    return np.diff(below, axis=-1, prepend=0.0, append=1.0)


def _changed(now: FloatArray, below: FloatArray, above: FloatArray) -> FloatArray:
    """Probability of each lane after a change into the one below, or above, with that probability of each, (n,); where
    there is none, nobody changes."""
    down, up = below[:, None, None] * now[:, :, 1:], above[:, None, None] * now[:, :, :-1]
    then = now.copy()
    then[:, :, 1:] -= down
    then[:, :, :-1] += down - up
    then[:, :, 1:] += up
    return then
