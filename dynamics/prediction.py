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
from dynamics.bends import Bends
from dynamics.road import Road
from dynamics.state import FloatArray, RoadState, Vehicle

__all__ = ["Occupancy", "Surroundings", "constant_velocity", "predict_occupancy"]


_ALL = slice(None)


def constant_velocity(states: FloatArray, frames: int, dt: float) -> FloatArray:
    """Straight motion at constant speed: road states (m, 4) to (m, frames, 4) for frames 1..K."""
    out = np.repeat(states[:, None, :], frames, axis=1)
    t = dt * np.arange(1, frames + 1)
    speed, heading = states[:, RoadState.SPEED, None], states[:, RoadState.HEADING, None]
    out[..., RoadState.S] += speed * np.cos(heading) * t
    out[..., RoadState.R] += speed * np.sin(heading) * t
    return out


@dataclass(frozen=True, slots=True)
class Occupancy:
    """Where m vehicles can be over K frames.

    Attributes
    ----------
    rear : least s of the body, (m, K) [m].
    front : greatest s of the body without any duty to react, (m, K) [m].
    low, high : lateral extent, (m,) [m].
    """

    rear: FloatArray
    front: FloatArray
    low: FloatArray
    high: FloatArray

    def rectangles(self) -> FloatArray:
        """(K, m, 4): s_min, s_max, r_min, r_max [m]."""
        k = self.rear.shape[1]
        low, high = (np.repeat(a[None], k, axis=0) for a in (self.low, self.high))
        return np.stack([self.rear.T, self.front.T, low, high], axis=-1)


class Surroundings:
    """The others of one scene, and what follows from their present state alone.

    Parameters
    ----------
    others : vehicle rows (m, 7).
    states : the same in the road frame (m, 4).

    Attributes
    ----------
    lane : index of the lane nearest to each vehicle, (m,).
    moving : whether it moves across lanes, (m,).
    low, high : lateral hull of where it can be, (m,) [m].
    reach : half the length that its body covers along the road, (m,) [m].
    stretch : least and greatest metres of s in a metre driven, each (m,); None on a straight road.
    """

    def __init__(self, others: FloatArray, states: FloatArray, road: Road, assumptions: Assumptions) -> None:
        self.others, self.states, self.assumptions = others, states, assumptions
        bends = road.bends
        centers, tolerance = road.centers, assumptions.keeping_heading
        self.stretch: tuple[FloatArray, FloatArray] | None = None
        if bends is not None:
            tolerance += bends.slip
        self._tolerance = tolerance
        r, heading = states[:, RoadState.R], np.abs(states[:, RoadState.HEADING])
        length, width = others[:, Vehicle.LENGTH], others[:, Vehicle.WIDTH]
        lane = np.minimum(np.maximum(np.rint((r - centers[0]) / road.width), 0), centers.size - 1)
        self.lane = lane.astype(np.intp)
        center = centers[self.lane]
        offset = r - center
        self.moving = (heading > tolerance) | (np.abs(offset) > assumptions.keeping_offset)
        self.moving &= others[:, Vehicle.SPEED] != 0
        # Even one that keeps its lane may start to leave it at the next frame.
        turn = np.minimum(np.maximum(assumptions.max_heading, heading), np.pi / 2)
        self._cos = np.cos(turn)
        # v (1 - cos psi) <= tan(psi / 2) v sin psi: what a single lane change costs it along the road.
        self._change = np.tan(0.5 * turn) * road.width
        # The extent along the road is greatest at the heading of the diagonal, or as near to it as it can turn.
        diagonal = np.minimum(turn, np.arctan2(width, length))
        self.reach = 0.5 * (length * np.cos(diagonal) + width * np.sin(diagonal))
        half = 0.5 * (width + length * np.sin(np.minimum(np.maximum(heading, tolerance), np.pi / 2)))
        self.low, self.high = np.minimum(r, center) - half, np.maximum(r, center) + half
        across = np.flatnonzero(self.moving)
        if across.size:
            self._change[across] = np.inf
            self._widen(across, turn[across], half[across], centers)
        if bends is not None:
            self._bend(bends)

    def _bend(self, bends: Bends) -> None:
        """Grow what was computed as on a straight road by what the bends cost at worst."""
        least, _ = bends.stretch(self.low)
        _, greatest = bends.stretch(self.high)
        least_high, greatest_low = bends.stretch(self.high)[0], bends.stretch(self.low)[1]
        self.stretch = np.minimum(least, least_high), np.maximum(greatest, greatest_low)
        sizes = self.others[:, [Vehicle.LENGTH, Vehicle.WIDTH]]
        grown = np.array([bends.growth(*size) for size in sizes]).reshape(-1, 2)
        self.reach = self.reach + grown[:, 0]
        self.low, self.high = self.low - grown[:, 1], self.high + grown[:, 1]

    def _widen(self, across: Any, turn: FloatArray, half: FloatArray, centers: FloatArray) -> None:
        """Set the hull of those that move across: to the lane that they move to, on headings of up to `turn` [rad]."""
        r, psi, lane = self.states[across, RoadState.R], self.states[across, RoadState.HEADING], self.lane[across]
        center = centers[lane]
        offset = r - center
        turning = np.abs(psi) > self._tolerance
        # Towards its heading, else back to the centre of its lane.
        toward = np.where(turning, np.sign(psi), -np.sign(offset))
        leaving = toward * offset >= 0
        beside = np.minimum(np.maximum(lane + toward.astype(np.intp), 0), centers.size - 1)
        end = centers[np.where(leaving, beside, lane)]
        turned = 0.5 * (self.others[across, Vehicle.WIDTH] + self.others[across, Vehicle.LENGTH] * np.sin(turn))
        # One that is coming back to its lane's centre turns no further outwards than it is turned now.
        outer_low = np.where(~leaving & (offset < 0), half, turned)
        outer_high = np.where(~leaving & (offset > 0), half, turned)
        self.low[across] = np.minimum(np.minimum(r, center), end) - outer_low
        self.high[across] = np.maximum(np.maximum(r, center), end) + outer_high

    def rear(self, frames: int, dt: float, hold: int = 0, rows: Any = _ALL) -> FloatArray:
        """Least s of each body after 1..K frames, (m, K) [m]; of those in `rows` only, where given.

        `hold` is a number of frames of constant speed that are *expected* before the worst case starts. With
        `hold` > 0 the result is a forecast and not a bound.
        """
        a, v = self.assumptions, self.states[rows, RoadState.SPEED]
        braked = np.maximum(np.arange(-hold, frames - hold), 0)
        floor = np.minimum(v, a.min_speed)[:, None]
        slow = np.maximum(v[:, None] - a.braking * dt * braked, floor)
        crashed = self.others[rows, Vehicle.CRASHED] > 0
        if crashed.any():
            # highway-env: a crashed vehicle brakes at -1 * speed per second.
            wreck = v[:, None] * (1 - dt) ** np.arange(frames)
            slow = np.where(crashed[:, None], np.minimum(slow, wreck), slow)
        # On a heading of up to the bound, only the cosine of the speed advances along the road.
        way = np.cumsum(slow, axis=1) * dt
        loss = np.maximum(np.minimum((1 - self._cos[rows])[:, None] * way, self._change[rows][:, None]), 0.0)
        if hold:
            # One that keeps its lane is expected to go on doing so.
            loss = np.where(self.moving[rows][:, None], loss, 0.0)
        way -= loss
        if self.stretch is not None:
            way = np.minimum(way * self.stretch[0][rows][:, None], way * self.stretch[1][rows][:, None])
        return (self.states[rows, RoadState.S] - self.reach[rows])[:, None] + way

    def front(self, frames: int, dt: float, hold: int = 0) -> FloatArray:
        """Greatest s of each body after 1..K frames, with no duty to react, (m, K) [m]."""
        a, v = self.assumptions, self.states[:, RoadState.SPEED]
        fast = v[:, None] + a.acceleration * dt * np.maximum(np.arange(frames) - hold, 0)
        fast = np.minimum(fast, np.maximum(v, a.max_speed)[:, None])
        if self.stretch is not None:
            fast = fast * self.stretch[1][:, None]
        return (self.states[:, RoadState.S] + self.reach)[:, None] + np.cumsum(fast, axis=1) * dt

    def occupancy(self, frames: int, dt: float, hold: int = 0) -> Occupancy:
        """Worst-case occupancy over frames 1..K."""
        rear, front = self.rear(frames, dt, hold), self.front(frames, dt, hold)
        return Occupancy(rear, front, self.low, self.high)


def predict_occupancy(
    others: FloatArray,
    states: FloatArray,
    road: Road,
    assumptions: Assumptions,
    frames: int,
    dt: float,
    hold: int = 0,
) -> Occupancy:
    """Worst-case occupancy of the others over frames 1..K.

    Parameters
    ----------
    others : vehicle rows (m, 7). states : the same in the road frame (m, 4).
    hold : see `Surroundings.rear`.
    """
    return Surroundings(others, states, road, assumptions).occupancy(frames, dt, hold)
