"""The numbers that the clauses judge by, as one array: it is made once, and goes into every compiled call."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from dynamics.compiled import inlined, numbers_of
from dynamics.state import FloatArray
from dynamics.traffic.assumptions import Assumptions
from shield.certificate.road.clauses.followers import Sight
from shield.certificate.road.clauses.separation import Duty

__all__ = ["Settings", "duty_of", "settings_from", "settings_of", "sight_of"]

_GAINS = 1.0
"""By how much one that enters a lane may be wrong about what it gains by it [m/s^2]."""


class Settings(NamedTuple):
    """What the clauses judge by.

    `seen`: distance from a lane's centre within which a vehicle is seen there [m]; `reaction`, `settled`: frames, see
    `Sight`; `acceleration`, `braking` [m/s^2], `max_speed` [m/s], `power` [m^2/s^3]: what one behind may do and owes,
    see `Duty`; `hardest`: braking of anybody [m/s^2]; `gains`: see `Sight.slack`; `blind`, `slip_in`: whether anybody
    enters a lane blindly, and slips in; `width` of a lane, `waver`: how far a body comes out of the middle of its
    lane, `perception` range [m]; `bent`: whether the road is; `dt`: duration of a frame [s].
    """

    seen: float
    reaction: float
    settled: float
    acceleration: float
    braking: float
    max_speed: float
    power: float
    hardest: float
    gains: float
    blind: float
    slip_in: float
    width: float
    waver: float
    perception: float
    bent: float
    dt: float


@lru_cache(maxsize=64)
def settings_of(a: Assumptions, width: float, perception: float, bent: bool, dt: float) -> FloatArray:
    """The numbers of `Settings`, (16,)."""
    return np.array(
        Settings(
            a.visible_distance,
            _frames(a.reaction_time, dt),
            _frames(a.settle_time, dt),
            a.acceleration,
            a.follower_braking,
            a.max_speed,
            a.power,
            a.braking,
            _GAINS,
            a.blind_merge,
            a.slip_in,
            width,
            a.waver,
            perception,
            bent,
            dt,
        ),
        dtype=float,
    )


def _frames(time: float, dt: float) -> int:
    return int(np.ceil(time / dt - 1e-9))


@inlined
def settings_from(row: FloatArray) -> Settings:
    """The numbers by their names."""
    return Settings(*numbers_of(row, 16))


@inlined
def duty_of(x: Settings, hold: int) -> Duty:
    """What a vehicle behind owes, `hold` frames of constant speed being expected before."""
    return Duty(x.seen, int(x.reaction), x.acceleration, x.braking, x.max_speed, x.power, hold, x.dt)


@inlined
def sight_of(x: Settings) -> Sight:
    """What decides about who sees whom."""
    return Sight(x.seen, x.gains, int(x.reaction), int(x.settled), x.blind > 0, x.width)
