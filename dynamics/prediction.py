"""Where the others can be: constant velocity, and worst-case occupancy under `Assumptions`.

Notation
--------
Road frame. Frame k = 1..K after the scene. The occupancy of a vehicle at frame k is the rectangle
[rear_k, front_k] x [low, high]: the hull of every place that its body can be at. Positions follow the
simulator's explicit Euler steps (s_{k+1} = s_k + v_k dt), so the bound is exact and not only nearly so.

Longitudinal: the rear is that of a vehicle that brakes at `braking` from now on, the front that of one that
accelerates at `acceleration` until it owes the ego its braking and then brakes at `follower_braking`.
Lateral: a vehicle that keeps its lane stays in it; one that is moving across can be anywhere between the lane
that it comes from and the one that it moves to (it may abort).

Source: Responsibility-Sensitive Safety (Shalev-Shwartz et al. 2017), set-based prediction (Althoff and Magdici
2016), with the reaction of highway-env's own traffic.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.assumptions import Assumptions
from dynamics.road import StraightRoad
from dynamics.state import FloatArray, RoadState, Vehicle

__all__ = ["Occupancy", "constant_velocity", "lateral_hull", "predict_occupancy", "travel"]


def constant_velocity(states: FloatArray, frames: int, dt: float) -> FloatArray:
    """Straight motion at constant speed: road states (m, 4) to (m, frames, 4) for frames 1..K."""
    out = np.repeat(states[:, None, :], frames, axis=1)
    t = dt * np.arange(1, frames + 1)
    speed, heading = states[:, RoadState.SPEED, None], states[:, RoadState.HEADING, None]
    out[..., RoadState.S] += speed * np.cos(heading) * t
    out[..., RoadState.R] += speed * np.sin(heading) * t
    return out


def travel(speed: FloatArray, rate: Any, frames: int, dt: float, hold: Any = 0) -> FloatArray:
    """Distance covered after 1..K Euler frames by vehicles that brake at `rate` after `hold` frames.

    Parameters
    ----------
    speed : (m,) [m/s]; never below 0 afterwards where it was above.
    rate : deceleration [m/s^2], scalar.
    hold : frames at constant speed first, scalar or broadcastable to (m, 1).

    Returns
    -------
    (m, frames) [m].
    """
    k = np.arange(frames)
    v = speed[:, None] - rate * dt * np.maximum(k - hold, 0)
    return np.cumsum(np.maximum(v, np.minimum(speed, 0.0)[:, None]), axis=1) * dt


@dataclass(frozen=True, slots=True)
class Occupancy:
    """Where m vehicles can be over K frames.

    Attributes
    ----------
    rear : least s of the body, (m, K) [m].
    front : greatest s of the body without any duty to react, (m, K) [m].
    low, high : lateral extent, (m,) [m].
    lane : index of the lane nearest to each vehicle now, (m,).
    state : road states now, (m, 4).
    reach : half the length that each body covers along the road, (m,) [m].
    """

    rear: FloatArray
    front: FloatArray
    low: FloatArray
    high: FloatArray
    lane: Any
    state: FloatArray
    reach: FloatArray

    def rectangles(self) -> FloatArray:
        """(K, m, 4): s_min, s_max, r_min, r_max [m]."""
        k = self.rear.shape[1]
        low, high = (np.repeat(a[None], k, axis=0) for a in (self.low, self.high))
        return np.stack([self.rear.T, self.front.T, low, high], axis=-1)


def lateral_hull(
    others: FloatArray, states: FloatArray, road: StraightRoad, assumptions: Assumptions
) -> tuple[FloatArray, FloatArray, Any, Any]:
    """Lateral extent of where each vehicle can be: low, high (m,) [m], its lane (m,), and whether it moves across.

    Parameters
    ----------
    others : vehicle rows (m, 7). states : the same in the road frame (m, 4).
    """
    centers = road.centers
    r, heading = states[:, RoadState.R], states[:, RoadState.HEADING]
    lane = np.clip(np.rint((r - centers[0]) / road.width), 0, centers.size - 1).astype(int)
    center = centers[lane]
    offset = r - center
    turning = np.abs(heading) > assumptions.keeping_heading
    moving = (turning | (np.abs(offset) > assumptions.keeping_offset)) & (others[:, Vehicle.SPEED] != 0)
    # Towards its heading, else back to the centre of its lane.
    toward = np.where(turning, np.sign(heading), -np.sign(offset))
    leaving = moving & (toward * offset >= 0)
    other_lane = np.clip(lane + np.where(leaving, toward, 0.0).astype(int), 0, centers.size - 1)
    end = centers[other_lane]
    bound = np.where(moving, np.maximum(assumptions.max_heading, np.abs(heading)), np.abs(heading))
    bound = np.maximum(bound, assumptions.keeping_heading)
    half = 0.5 * (others[:, Vehicle.WIDTH] + others[:, Vehicle.LENGTH] * np.sin(np.minimum(bound, np.pi / 2)))
    low = np.minimum(np.minimum(r, center), end) - half
    high = np.maximum(np.maximum(r, center), end) + half
    return low, high, lane, moving


def predict_occupancy(
    others: FloatArray,
    states: FloatArray,
    road: StraightRoad,
    assumptions: Assumptions,
    frames: int,
    dt: float,
    hold: int = 0,
) -> Occupancy:
    """Worst-case occupancy of the others over frames 1..K.

    Parameters
    ----------
    others : vehicle rows (m, 7). states : the same in the road frame (m, 4).
    hold : frames of constant speed that are *expected* before the worst case starts. With `hold` > 0 the
        result is a forecast and not a bound.
    """
    low, high, lane, moving = lateral_hull(others, states, road, assumptions)
    s, v = states[:, RoadState.S], states[:, RoadState.SPEED]
    heading = np.abs(states[:, RoadState.HEADING])
    bound = np.where(moving, np.maximum(assumptions.max_heading, heading), heading)
    reach = 0.5 * (
        others[:, Vehicle.LENGTH]
        + others[:, Vehicle.WIDTH] * np.sin(np.clip(bound, assumptions.keeping_heading, np.pi / 2))
    )
    k = np.maximum(np.arange(frames) - hold, 0)
    floor = np.minimum(v, assumptions.min_speed)[:, None]
    slow = np.maximum(v[:, None] - assumptions.braking * dt * k, floor)
    crashed = others[:, Vehicle.CRASHED] > 0
    if crashed.any():
        # highway-env: a crashed vehicle brakes at -1 * speed per second, and may have been about to.
        wreck = v[:, None] * (1 - dt) ** np.arange(frames)
        slow = np.where(crashed[:, None], np.minimum(slow, wreck), slow)
    # On a heading of up to `bound`, only the cosine of the speed advances along the road.
    rear = (s - reach)[:, None] + np.cumsum(np.minimum(slow, slow * np.cos(bound)[:, None]), axis=1) * dt
    fast = v[:, None] + assumptions.acceleration * dt * k
    fast = np.minimum(fast, np.maximum(v, assumptions.max_speed)[:, None])
    front = (s + reach)[:, None] + np.cumsum(fast, axis=1) * dt
    return Occupancy(rear, front, low, high, lane, states, reach)
