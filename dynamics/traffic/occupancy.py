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

from dynamics.roads.bends import Bends
from dynamics.roads.straight import Road
from dynamics.state import FloatArray, RoadState, Vehicle
from dynamics.traffic.assumptions import Assumptions
from dynamics.traffic.occupancy_kernels import HIGH, LOW, REACH, hulls, rears
from dynamics.vehicle.bicycle import LENGTH

__all__ = ["Occupancy", "Surroundings", "constant_velocity", "predict_occupancy"]


_STRAIGHT = np.zeros((2, 0))


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
    low, high : lateral hull of where it can be, (m,) [m]; `hull` is both, (2, m).
    reach : half the length that its body covers along the road, (m,) [m].
    stretch : least and greatest metres of s in a metre driven, each (m,); None on a straight road.
    """

    def __init__(self, others: FloatArray, states: FloatArray, road: Road, assumptions: Assumptions) -> None:
        others, states = np.ascontiguousarray(others, float), np.ascontiguousarray(states, float)
        self.others, self.states, self.assumptions = others, states, assumptions
        bends, m = road.bends, states.shape[0]
        tolerance = assumptions.keeping_heading + (bends.slip(LENGTH) if bends is not None else 0.0)
        self.lane, self.moving, self._found = np.empty(m, np.intp), np.empty(m, np.bool_), np.empty((5, m))
        hulls(
            others,
            states,
            road.centers,
            float(road.width),
            tolerance,
            assumptions.keeping_offset,
            assumptions.max_heading,
            self.lane,
            self.moving,
            self._found,
        )
        self.hull = self._found[: HIGH + 1]
        self.low, self.high, self.reach = self._found[LOW], self._found[HIGH], self._found[REACH]
        self.stretch: tuple[FloatArray, FloatArray] | None = None
        self._stretches = _STRAIGHT
        if bends is not None:
            self._bend(bends)

    def _bend(self, bends: Bends) -> None:
        """Grow what was computed as on a straight road by what the bends cost at worst."""
        least, _ = bends.stretch(self.low)
        _, greatest = bends.stretch(self.high)
        least_high, greatest_low = bends.stretch(self.high)[0], bends.stretch(self.low)[1]
        self.stretch = np.minimum(least, least_high), np.maximum(greatest, greatest_low)
        self._stretches = np.stack(self.stretch)
        sizes = self.others[:, [Vehicle.LENGTH, Vehicle.WIDTH]]
        grown = np.array([bends.growth(*size) for size in sizes]).reshape(-1, 2)
        self._found[REACH] += grown[:, 0]
        self._found[LOW] -= grown[:, 1]
        self._found[HIGH] += grown[:, 1]

    def rear(self, frames: int, dt: float, hold: int = 0, rows: Any = None) -> FloatArray:
        """Least s of each body after 1..K frames, (m, K) [m]; of those in `rows` only, where given.

        `hold` is a number of frames of constant speed that are *expected* before the worst case starts. With
        `hold` > 0 the result is a forecast and not a bound.
        """
        a = self.assumptions
        rows = np.arange(len(self.states)) if rows is None else rows
        out = np.empty((len(rows), frames))
        rears(
            rows,
            self.others,
            self.states,
            self.moving,
            self._found,
            self._stretches,
            a.braking,
            a.min_speed,
            hold,
            dt,
            out,
        )
        return out

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
