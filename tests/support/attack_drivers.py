"""Drivers to make attacks of: laws for the throttle, laws for the wheel, and policies for the ego."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from driven_traffic import LANE, Body, Controller, Moment, Policy

__all__ = ["POLICIES", "policy_of"]

Law = Callable[[Moment], float]

LEFT, IDLE, RIGHT, FASTER, SLOWER = range(5)


def steer(own: Body, r: float, limit: float = 0.35, gain: float = 1.67, rate: float = 5.0) -> float:
    """Wheel angle that brings a bicycle to the lateral place `r` with at most `limit` of heading."""
    speed = own.speed if abs(own.speed) > 0.5 else 0.5
    want = float(np.clip(np.arcsin(np.clip(gain * (r - own.r) / speed, -1, 1)), -limit, limit))
    return turn(own, want, rate)


def turn(own: Body, heading: float, rate: float = 5.0) -> float:
    """Wheel angle that brings a bicycle to a heading."""
    speed = own.speed if abs(own.speed) > 0.5 else 0.5
    slip = np.arcsin(np.clip(0.5 * own.length / speed * rate * (heading - own.heading), -0.7, 0.7))
    return float(np.arctan(2 * np.tan(slip)))


def toward(own: Body, speed: float, dt: float, brake: float = 6.0, push: float = 3.0) -> float:
    """Acceleration that reaches a speed within bounds."""
    return float(np.clip((speed - own.speed) / dt, -brake, push))


# -- throttle ----------------------------------------------------------------------------------------------


def cruise(speed: float) -> Law:
    return lambda m: toward(m.own, speed, m.dt)


def then(time: float, first: Law, second: Law) -> Law:
    """One law until a time, another from there."""
    return lambda m: (first if m.time < time else second)(m)


def constant(acceleration: float, low: float = 0.0, high: float = 40.0) -> Law:
    """A constant acceleration until a speed bound is reached."""

    def law(m: Moment) -> float:
        if acceleration < 0:
            return max(acceleration, (low - m.own.speed) / m.dt) if m.own.speed > low else 0.0
        return min(acceleration, (high - m.own.speed) / m.dt) if m.own.speed < high else 0.0

    return law


def hound(ds: float, brake: float = 6.0, push: float = 3.0) -> Law:
    """Hold a place relative to the ego."""
    return lambda m: float(np.clip(2.0 * (m.ego.speed - m.own.speed) + 1.0 * (ds - m.ds), -brake, push))


def at_ego(ds: float, first: Law, second: Law) -> Law:
    """One law until the ego is as near as `ds` (from behind or ahead), another from there on."""
    seen = False

    def law(m: Moment) -> float:
        nonlocal seen
        seen = seen or abs(m.ds) <= ds
        return (second if seen else first)(m)

    return law


def below_zero(first: Law, rate: float, back: float) -> Law:
    """As `first`; once it has brought the vehicle to rest, in reverse to the speed `back`."""
    rested = False

    def law(m: Moment) -> float:
        nonlocal rested
        rested = rested or m.own.speed <= 0.05
        return max(-rate, (-back - m.own.speed) / m.dt) if rested else first(m)

    return law


# -- wheel -------------------------------------------------------------------------------------------------


def keep(r: float, limit: float = 0.35) -> Law:
    return lambda m: steer(m.own, r, limit)


def change(r: float, to: float, when: Callable[[Moment], bool], limit: float, gain: float = 1.67) -> Law:
    """Keep `r` until `when`, then go to `to`."""
    begun = False

    def law(m: Moment) -> float:
        nonlocal begun
        begun = begun or when(m)
        return steer(m.own, to if begun else r, limit, gain)

    return law


def abort(
    back: float, to: float, turn_at: float, limits: tuple[float, float], wait: Callable[[Moment], bool], drift: float
) -> Law:
    """Head for `to`; from `turn_at` on only drift there, until `wait` no longer says so, and then go back."""
    reached = returning = False
    sign = np.sign(to - back)

    def law(m: Moment) -> float:
        nonlocal reached, returning
        reached = reached or abs(m.own.r - to) <= turn_at
        returning = returning or (reached and not wait(m))
        if returning:
            return steer(m.own, back, limits[1], gain=8.0)
        if reached:
            return turn(m.own, sign * drift if abs(m.own.r - to) > 0.5 else 0.0)
        return steer(m.own, to, limits[0])

    return law


def waver(r: float, heading: float, frequency: float, phase: float, spring: float = 0.02) -> Law:
    """Heading as a sine, about a lateral place."""

    def law(m: Moment) -> float:
        want = heading * np.sin(2 * np.pi * (frequency * m.time + phase)) - spring * (m.own.r - r)
        return turn(m.own, float(np.clip(want, -0.6, 0.6)), rate=min(0.8 / m.dt, 12.0))

    return law


def zigzag(r: float, reach: float, heading: float) -> Law:
    """To and fro at a constant heading between two lateral places."""
    sign = 1.0

    def law(m: Moment) -> float:
        nonlocal sign
        sign = -1.0 if m.own.r > r + reach else 1.0 if m.own.r < r - reach else sign
        return turn(m.own, sign * heading, rate=min(0.8 / m.dt, 12.0))

    return law


def swing(wheel: float, frequency: float, phase: float, r: float) -> Law:
    """A large wheel angle to and fro: sideslip more than heading."""

    def law(m: Moment) -> float:
        sign = 1.0 if np.sin(2 * np.pi * (frequency * m.time + phase)) >= 0 else -1.0
        back = 0.6 * np.clip(-m.own.heading, -0.7, 0.7) if abs(m.own.heading) > 0.6 else 0.0
        return float(np.clip(sign * wheel + back + 0.05 * (r - m.own.r), -np.pi / 3, np.pi / 3))

    return law


def flick(r: float, heading: float, pattern: int, period: int, when: Callable[[Moment], bool]) -> Law:
    """Point at a heading for single frames, as the bits of `pattern` say, and straight in between."""

    def law(m: Moment) -> float:
        frame = round(m.time / m.dt)
        if when(m) and pattern >> (frame % period) & 1:
            return turn(m.own, heading, 1.0 / m.dt)
        return steer(m.own, r, 0.3, rate=1.0 / m.dt)

    return law


def controller(throttle: Law, wheel: Law) -> Controller:
    return lambda m: (throttle(m), wheel(m))


def noise(seed: int, hold: float, brake: float, push: float, wheel: float, lanes: int) -> Controller:
    """Piecewise constant random inputs, kept on the road."""
    rng = np.random.default_rng(seed)
    until, a, delta = 0.0, 0.0, 0.0

    def act(m: Moment) -> tuple[float, float]:
        nonlocal until, a, delta
        if m.time >= until - 1e-9:
            until = m.time + rng.exponential(hold)
            a = float(rng.choice([-brake, push, rng.uniform(-brake, push), 0.0]))
            delta = float(rng.choice([0.0, rng.uniform(-wheel, wheel), rng.normal(0, 0.1 * wheel)]))
        bold = max(m.own.speed, 4.0)
        wheel_now = delta * min(1.0, 10.0 / bold)
        if not -1.5 < m.own.r < LANE * (m.lanes - 1) + 1.5 or abs(m.own.heading) > 0.5:
            wheel_now = steer(m.own, float(np.clip(m.own.r, 0.0, LANE * (m.lanes - 1))), 0.2)
        return a, wheel_now

    return act


# -- policies of the ego -----------------------------------------------------------------------------------


def _nearest(m: Moment) -> Body:
    return min(m.others, key=lambda b: abs(b.s - m.own.s) + 0.5 * abs(b.r - m.own.r), default=m.own)


def _to_lane(m: Moment, r: float) -> int:
    if abs(r - m.own.r) < 1.5:
        return FASTER
    return LEFT if r < m.own.r else RIGHT


def _meta(name: str) -> Policy:
    def act(m: Moment, rng: np.random.Generator) -> Any:
        if name == "weave":
            return (LEFT, FASTER, RIGHT, FASTER)[round(m.time) % 4]
        if name == "random":
            return int(rng.integers(5))
        if name == "toward":
            return _to_lane(m, _nearest(m).r)
        if name == "goal":
            return _to_lane(m, m.goal)
        return IDLE if name == "steady" else FASTER

    return act


def _continuous(name: str) -> Policy:
    def act(m: Moment, rng: np.random.Generator) -> Any:
        straight = steer(m.own, LANE * round(m.own.r / LANE), 0.1)
        a, wheel = 1.0, straight
        if name == "weave":
            wheel = 0.08 * np.sin(2 * np.pi * m.time / 3)
        elif name == "random":
            a, wheel = rng.uniform(-1, 1), rng.normal(0, 0.15)
        elif name == "toward":
            other = _nearest(m)
            wheel = float(np.sign(other.r - m.own.r)) * rng.choice([0.03, 0.1, 0.3, 0.7])
            a = rng.choice([1.0, 0.3, 0.0])
        elif name == "goal":
            wheel = steer(m.own, m.goal, 0.35)
        elif name == "steady":
            a = 0.0
        return np.array([a, np.clip(wheel / (np.pi / 4), -1, 1)], dtype=np.float32)

    return act


POLICIES = ("faster", "goal", "weave", "toward", "random", "steady")


def policy_of(name: str, action: str) -> Policy:
    """A named policy for an action type."""
    return _meta(name) if action == "meta" else _continuous(name)
