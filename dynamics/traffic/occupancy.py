"""Where the others can be: constant velocity, and worst-case occupancy under `Assumptions`.

Notation
--------
Road frame. Frame k = 1..K after the scene. The occupancy of a vehicle at frame k is the rectangle
[rear_k, front_k] x [low, high]: the hull of every place that its body can be at. Positions follow the
simulator's explicit Euler steps (s_{k+1} = s_k + v_k dt), so the bound is exact and not only nearly so.

Along the road: the rear is that of a vehicle that brakes from now on as hard as it may: at `calm_braking`, and at up to
`braking` from when what is ahead of it may ask for that (`dynamics.traffic.reaction`). It loses what it may lose by
turning (`turning_loss`), is not counted on to get anywhere below `slow_speed`, and may reverse from what stands ahead
of it.
The front is that of one that accelerates at `acceleration`, until it owes the ego its braking.
Across: a vehicle stays in the lanes that its body touches, one frame ahead at constant velocity included. Where it is
in them and how it is turned makes no difference, so that a lane change that is aborted late, a car that wavers and one
that slides need no rule of their own. That it may touch a lane more is not in the bound: it has to leave the room for
the ego's fail-safe then, and `dynamics.traffic.permits` says so.

Source: Responsibility-Sensitive Safety (Shalev-Shwartz et al. 2017), set-based prediction (Althoff and Magdici
2016), with the reaction of highway-env's own traffic.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from dynamics.roads.straight import Road
from dynamics.state import FloatArray, RoadState, Vehicle
from dynamics.traffic.assumptions import Assumptions
from dynamics.traffic.occupancy_kernels import Bodies, Lanes, Motion, floors, fronts, rears, spend, strips
from dynamics.traffic.reaction import brakings

__all__ = ["Occupancy", "Surroundings", "constant_velocity"]


_STRAIGHT = np.zeros((2, 0))
_CAR = 6.0
"""Length up to which a vehicle turns as a car does; a longer one swings further [m]."""
_REACTING = 3.0
"""Time for which it is looked at how hard each may brake; afterwards, it may as hard as anybody [s]."""
_COARSE = 3.5
"""By what share vehicles swing further for each second that a frame lasts: their controllers act once a frame."""


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


@lru_cache(maxsize=16)
def _motion(a: Assumptions, dt: float) -> Motion:
    return Motion(
        a.braking,
        a.acceleration,
        a.power,
        a.max_speed,
        a.min_speed,
        a.slow_speed,
        a.turning_loss * (1 + _COARSE * dt),
        a.turning_action * (1 + _COARSE * dt),
        a.turning_loss_back,
        a.turning_action_back,
        a.turning_burst,
        min(a.calm_braking, a.braking),
        a.reversing_speed,
        a.queue_distance,
        a.queue_speed,
        a.runout_time,
        dt,
    )


class Surroundings:
    """The others of one scene, and where they can come to be.

    Parameters
    ----------
    others : vehicle rows (m, 7).
    states : the same in the road frame (m, 4).
    road : the road that they are on.
    assumptions : what they keep to.
    dt : duration of a frame [s].
    before : the same others a frame before, in the same order, from which follows what each may still lose of its way
        by turning; without it, all of `assumptions.turning_loss`.
    ego : where the ego is along the road, for whom those behind it may have to brake [m]; NaN without one.

    Attributes
    ----------
    bodies : lanes that they touch, and bounds on where their bodies come to be, see `Bodies`.
    low, high : edges of the lanes touched, (m,) [m]; `hull` is both, (2, m).
    lane : index of the lane nearest to each vehicle, (m,).
    reach : half the length that its body covers along the road at any heading, (m,) [m].
    stretch : least and greatest metres of s in a metre driven, each (m,); None on a straight road.
    """

    def __init__(
        self,
        others: FloatArray,
        states: FloatArray,
        road: Road,
        assumptions: Assumptions,
        dt: float = 1 / 15,
        before: Surroundings | None = None,
        ego: float = float("nan"),
    ) -> None:
        others, states = np.ascontiguousarray(others, float), np.ascontiguousarray(states, float)
        self.others, self.states, self.assumptions, self.dt = others, states, assumptions, float(dt)
        m, a, bends = len(states), assumptions, road.bends
        self.motion, self.hull = _motion(a, self.dt), np.empty((2, m))
        swing = np.maximum(others[:, Vehicle.LENGTH] / _CAR, 1.0)
        self.bodies = Bodies(
            lane=np.empty(m, np.intp),
            first=np.empty(m, np.intp),
            last=np.empty(m, np.intp),
            low=self.hull[0],
            high=self.hull[1],
            reach=np.empty(m),
            budget=swing * self.motion.loss,
            action=swing * self.motion.action,
            swing=swing,
            brakes=np.empty((m, int(np.ceil(_REACTING / self.dt)))),
            recent=np.zeros((m, max(int(np.ceil(1 / self.dt - 1e-9)), 1))),
            floor=np.empty(m),
        )
        growth = np.zeros((m, 2))
        self.stretch: tuple[FloatArray, FloatArray] | None = None
        self.stretches = _STRAIGHT
        if bends is not None and m:
            growth = np.array([bends.growth(*size) for size in others[:, [Vehicle.LENGTH, Vehicle.WIDTH]]])
        # What a bend adds to a body is no reason to take it to be in the next lane.
        strips(others, states, growth, Lanes(road.centers, float(road.width), a.lean, a.waver, self.dt), self.bodies)
        self.low, self.high = self.hull
        self.lane, self.reach = self.bodies.lane, self.bodies.reach
        if bends is not None:
            (least, greatest), (least_high, greatest_high) = bends.stretch(self.low), bends.stretch(self.high)
            self.stretch = np.minimum(least, least_high), np.maximum(greatest, greatest_high)
            self.stretches = np.stack(self.stretch)
        self.lap = float(getattr(road, "length", 0.0)) if getattr(road, "closed", False) else 0.0
        if before is not None:
            spend(before.states, before.bodies, states, self.stretches, self.motion, self.lap, self.bodies)
        order = np.argsort(-states[:, 0])
        brakings(others, states, self.stretches, self.motion, self.lap, float(ego), order, self.bodies)
        floors(others, states, self.stretches, self.motion, order, self.bodies)

    def rear(self, frames: int, hold: int = 0, rows: Any = None) -> FloatArray:
        """Least s of each body after 1..K frames, (m, K) [m]; of those in `rows` only, where given. The last column
        stands for all frames from then on.

        `hold` is a number of frames of constant speed that are *expected* before the worst case starts. With
        `hold` > 0 the result is a forecast and not a bound.
        """
        rows = np.arange(len(self.states)) if rows is None else rows
        out = np.empty((len(rows), frames))
        rears(rows, self.others, self.states, self.stretches, self.motion, self.bodies, hold, out)
        return out

    def front(self, frames: int, hold: int = 0, rows: Any = None) -> FloatArray:
        """Greatest s of each body after 1..K frames, with no duty to react, (m, K) [m]; of those in `rows` only, where
        given."""
        rows = np.arange(len(self.states)) if rows is None else rows
        out = np.empty((len(rows), frames))
        fronts(rows, self.states, self.stretches, self.motion, self.bodies, hold, out)
        return out

    def occupancy(self, frames: int, hold: int = 0) -> Occupancy:
        """Worst-case occupancy over frames 1..K."""
        rear, front = self.rear(frames, hold), self.front(frames, hold)
        return Occupancy(rear, front, self.low, self.high)
