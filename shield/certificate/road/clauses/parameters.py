"""Settings of the clauses as one array, which is made once and passed to every compiled call."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from dynamics.compiled import kernel_inline, row_as_tuple
from dynamics.state import FloatArray
from dynamics.traffic.assumptions import Assumptions
from dynamics.traffic.motion_limits import bend_speed_of
from shield.certificate.road.clauses.followers import VisibilityParameters
from shield.certificate.road.clauses.separation import FollowerResponse

__all__ = ["ClauseSettings", "follower_response_of", "settings_from", "settings_of", "visibility_of"]

_GAINS = 1.0
"""Error bound on the gain that a vehicle expects from entering a lane [m/s^2]."""


class ClauseSettings(NamedTuple):
    """Settings of the clauses.

    Attributes
    ----------
    seen : distance from a lane's centre within which a vehicle is visible there [m].
    reaction, settled : numbers of frames, see `VisibilityParameters`.
    acceleration, braking : response of a follower [m/s^2], see `FollowerResponse`. max_speed : [m/s]. power :
        [m^2/s^3].
    hardest : greatest deceleration of any vehicle [m/s^2]. gains : see `VisibilityParameters.slack` [m/s^2].
    simultaneous_merge, cut_in : 1 if vehicles may enter a lane that the ego is about to enter, and if they may cut
        in.
    width : of a lane [m]. lateral_deviation : greatest lateral deviation of a body from the centre of its lane [m].
    perception : range [m]. dt : frame [s].
    curvature : greatest of any vehicle's path [1/m]; 0 on a straight road. bend_speed : speed up to which vehicles take
        the bends [m/s]; see `Assumptions.bend_acceleration`.
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
    simultaneous_merge: float
    cut_in: float
    width: float
    lateral_deviation: float
    perception: float
    dt: float
    curvature: float
    bend_speed: float


@lru_cache(maxsize=64)
def settings_of(a: Assumptions, width: float, perception: float, curvature: float, dt: float) -> FloatArray:
    """The numbers of `ClauseSettings`, (17,)."""
    return np.array(
        ClauseSettings(
            a.visible_distance,
            _frames(a.reaction_time, dt),
            _frames(a.settle_time, dt),
            a.acceleration,
            a.follower_braking,
            a.max_speed,
            a.power,
            a.braking,
            _GAINS,
            a.simultaneous_merge,
            a.cut_in,
            width,
            a.lateral_deviation,
            perception,
            dt,
            curvature,
            bend_speed_of(a, curvature),
        ),
        dtype=float,
    )


def _frames(time: float, dt: float) -> int:
    """Number of frames of duration `dt` that cover `time` [s]."""
    return int(np.ceil(time / dt - 1e-9))


@kernel_inline
def settings_from(row: FloatArray) -> ClauseSettings:
    """The numbers, by their names."""
    return ClauseSettings(*row_as_tuple(row, 17))


@kernel_inline
def follower_response_of(x: ClauseSettings, hold: int) -> FollowerResponse:
    """Follower response model, with `hold` frames of constant speed expected first."""
    return FollowerResponse(x.seen, int(x.reaction), x.acceleration, x.braking, x.max_speed, x.power, hold, x.dt)


@kernel_inline
def visibility_of(x: ClauseSettings) -> VisibilityParameters:
    """Parameters of visibility."""
    return VisibilityParameters(x.seen, x.gains, int(x.reaction), int(x.settled), x.simultaneous_merge > 0, x.width)
