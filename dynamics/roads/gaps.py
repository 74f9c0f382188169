"""Gaps between the lanes of a map.

highway-env checks whether the vehicle's centre is on the lane that is nearest in position and heading
(`Vehicle.on_road`, `AbstractLane.distance_with_heading`). Where neighbouring lanes of a bend are not concentric, the
edge of one need not reach the edge of the next. In racetrack-v0 a strip 8 cm wide and 28 m long, in the middle of its
road, belongs to no lane. Where sections meet, the nearest lane may be one that has ended.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.compiled import compiled
from dynamics.state import FloatArray, wrap_to_pi

__all__ = ["Gaps"]

_STEP = 0.1
"""Spacing of the table along the road [m]."""
_ACROSS = np.arange(-0.3, 0.3005, 0.01)
"""Lateral positions that are checked, relative to the middle between two lanes' centres [m]."""
_WIDER = 0.02
"""Margin by which a gap is widened on either side [m]."""
_HEADINGS = (-0.8, 0.0, 0.8)
"""Headings that are checked [rad]. The nearer of two lanes changes only between the headings of these lanes."""
_BEYOND = 8.0
"""Distance beyond a lane's ends, and beside it, within which it may be the nearest [m]."""


@compiled
def _meets(paths: Any, low: Any, high: Any, length: float) -> Any:
    """Whether any state of each path (n, K, 4) lies between `low` and `high` (places, m), (n,)."""
    out, places = np.zeros(paths.shape[0], np.bool_), low.shape[0]
    for i in range(paths.shape[0]):
        for k in range(paths.shape[1]):
            s, r = paths[i, k, 0], paths[i, k, 1]
            if not np.isfinite(s + r):
                continue
            if length > 0:
                s -= length * np.floor(s / length)
            if not 0 <= s < places * _STEP:
                continue
            at = min(int(s / _STEP), places - 1)
            for j in range(low.shape[1]):
                if low[at, j] < r < high[at, j]:
                    out[i] = True
    return out


@dataclass(frozen=True, slots=True, eq=False)
class Gaps:
    """Strips along a road, between neighbouring lanes, that none of its map's lanes covers.

    Parameters
    ----------
    low, high : lateral extent of each strip for s in [i, i + 1] x 0.1 m, (stretches, lanes - 1) [m]; +inf and -inf
        where there is none.
    lap : length of a closed road [m], 0 of an open one.
    """

    low: FloatArray
    high: FloatArray
    lap: float = 0.0

    @classmethod
    def of(cls, road: Any, lanes: list[Any]) -> Gaps | None:
        """The gaps between the lanes of a map that was read as `road`; None without any."""
        middles = 0.5 * (road.centers[:-1] + road.centers[1:])
        if not middles.size:
            return None
        stretches = int(np.ceil(road.length / _STEP))
        s, middle, across = np.meshgrid((np.arange(stretches) + 0.5) * _STEP, middles, _ACROSS, indexing="ij")
        poses = road.to_world(np.stack([s, middle + across, 0 * s, 0 * s], axis=-1))
        off = _off_road(poses, lanes)
        if not off.any():
            return None
        r = middle + across
        low, high = np.where(off, r, np.inf).min(axis=-1) - _WIDER, np.where(off, r, -np.inf).max(axis=-1) + _WIDER
        # Each stretch was checked at its middle; a gap that begins in the next one may begin in this one.
        before, after = (np.clip(np.arange(stretches) + i, 0, stretches - 1) for i in (-1, 1))
        if road.closed:
            before[0], after[-1] = stretches - 1, 0
        low = np.minimum(low, np.minimum(low[before], low[after]))
        high = np.maximum(high, np.maximum(high[before], high[after]))
        return cls(low, high, road.length if road.closed else 0.0)

    def met(self, paths: FloatArray) -> Any:
        """Whether the vehicle's centre is in a gap in any frame of each path (n, K, 4) of road states, (n,) bool."""
        return _meets(paths, self.low, self.high, self.lap)


def _off_road(poses: FloatArray, lanes: list[Any]) -> Any:
    """Whether the nearest lane to each place (..., k, 4), at any of the headings, does not contain it."""
    shape = (len(_HEADINGS), *poses.shape[:-1])
    nearest, on = np.full(shape, np.inf), np.ones(shape, dtype=bool)
    center = poses[..., poses.shape[-2] // 2, :2]
    for lane in lanes:
        along, across, _ = _local(lane, center)
        near = (along > -_BEYOND) & (along < lane.length + _BEYOND) & (np.abs(across) < _BEYOND)
        along, across, direction = _local(lane, poses[near][..., :2])
        beyond = np.maximum(along - lane.length, 0.0) + np.maximum(-along, 0.0)
        inside = np.abs(across) <= lane.width_at(0.0) / 2
        inside &= (along >= -lane.VEHICLE_LENGTH) & (along < lane.length + lane.VEHICLE_LENGTH)
        for i, heading in enumerate(_HEADINGS):
            distance = np.abs(across) + beyond + np.abs(wrap_to_pi(poses[near][..., 2] + heading - direction))
            nearer = distance < nearest[i][near]
            nearest[i][near] = np.where(nearer, distance, nearest[i][near])
            on[i][near] = np.where(nearer, inside, on[i][near])
    return ~on.all(axis=0)


def _local(lane: Any, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position along and across a lane of the map [m] and the lane's direction there [rad], of points (..., 2).

    It uses highway-env's own arithmetic. Lanes that just meet have points on both edges, which `arcs.project` would
    round to the outside of both.
    """
    kind = type(lane).__name__
    if kind == "StraightLane":
        away = points - lane.start
        along = away @ lane.direction
        return along, away @ lane.direction_lateral, np.full(along.shape, float(lane.heading))
    if kind == "CircularLane":
        away = points - lane.center
        turned = wrap_to_pi(np.arctan2(away[..., 1], away[..., 0]) - lane.start_phase)
        across = lane.direction * (lane.radius - np.hypot(away[..., 0], away[..., 1]))
        return lane.direction * lane.radius * turned, across, lane.start_phase + turned + lane.direction * np.pi / 2
    flat = np.array([lane.local_coordinates(point) for point in points.reshape(-1, 2)]).reshape(*points.shape[:-1], 2)
    return flat[..., 0], flat[..., 1], np.vectorize(lane.heading_at, otypes=[float])(flat[..., 0])
