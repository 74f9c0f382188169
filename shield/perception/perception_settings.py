"""Settings of perception from observations."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from dynamics.deprecation import accept_former_fields
from shield.errors import ConfigError
from shield.perception.unseen import Unseen

__all__ = ["BOUNDS", "PerceptionConfig"]

BOUNDS = ("gaussian", "conformal")
"""Valid `PerceptionConfig.bounds`."""


@accept_former_fields(
    {"calm": "lane_keeping", "brisk": "manoeuvring", "cruise": "usual_speed", "patience": "missed_limit"}
)
@dataclass(frozen=True, slots=True)
class PerceptionConfig:
    """Settings of `ObservationPerception`.

    Attributes
    ----------
    unseen : assumptions about unseen vehicles.
    lane_keeping, manoeuvring : standard deviations of the other vehicles' accelerations along and across the road
        [m/s^2], for vehicles that keep their lane and for vehicles that manoeuvre (see `tracking`).
    noise : standard deviations of the observed x, y [m], vx and vy [m/s]. None: the sensor's attribute `sensor_noise`,
        and without it the resolution of 32-bit numbers. "estimate": estimated from the observations, whatever the
        sensor states (`learned.Noise`).
    bound : bounds of positions and speeds, as a number of standard deviations of a normal distribution with the same
        probability of being exceeded.
    bounds : "gaussian": that probability is the filters'. "conformal": it is the observed frequency of prediction
        errors (`learned.Conformal`).
    monitor : whether to test that the sensor behaves as assumed (`sensor_monitor.Monitor`). An alarm gives the widest
        bounds and no guarantee.
    carry : whether estimates about the sensor are carried from one episode to the next.
    missed_limit : consecutive observations that a known vehicle may be missing from. None: 3 if the noise is
        configured, else 0.
    usual_speed : usual speed of traffic, its standard deviation [m/s], and the time constant with which speeds
        approach it [s]. It has an effect only where the sensor is imprecise.
    delay : simulation frames by which the observed vehicles are out of date, in addition to the sensor's attribute
        `sensor_delay`. The ego's own row is not delayed.

    Raises
    ------
    ConfigError
        If a value is out of range.
    """

    unseen: Unseen = field(default_factory=Unseen)
    lane_keeping: tuple[float, float] = (2.0, 1.0)
    manoeuvring: tuple[float, float] = (4.0, 20.0)
    usual_speed: tuple[float, float, float] = (21.0, 2.5, 10.0)
    noise: tuple[float, float, float, float] | Literal["estimate"] | None = None
    bound: float = 2.0
    bounds: Literal["gaussian", "conformal"] = "gaussian"
    monitor: bool = False
    carry: bool = True
    missed_limit: int | None = None
    delay: int = 0

    def __post_init__(self) -> None:
        if not all(math.isfinite(a) and a > 0 for a in (*self.lane_keeping, *self.manoeuvring)):
            raise ConfigError(
                f"accelerations are above 0, got lane_keeping {self.lane_keeping} and manoeuvring {self.manoeuvring}"
            )
        if np.shape(self.usual_speed) != (3,) or not all(math.isfinite(a) and a > 0 for a in self.usual_speed):
            raise ConfigError(
                f"usual_speed is a speed, a deviation and a time, three numbers above 0, got {self.usual_speed!r}"
            )
        if self.noise not in (None, "estimate") and not _four(self.noise):
            raise ConfigError(f'noise is of x, y, vx and vy, four numbers from 0 on, or "estimate", not {self.noise!r}')
        if self.bounds not in BOUNDS:
            raise ConfigError(f"unknown bounds {self.bounds!r}; have {', '.join(BOUNDS)}")
        counts = 0 if self.missed_limit is None else self.missed_limit, self.delay
        if not 0 <= self.bound < math.inf or any(type(n) is not int or n < 0 for n in counts):
            raise ConfigError(
                f"bound, missed_limit and delay are from 0 on, got {self.bound!r}, {counts[0]!r}, {counts[1]!r}"
            )


def _four(noise: Any) -> bool:
    """Whether the argument is four finite numbers of at least 0."""
    return np.shape(noise) == (4,) and all(0 <= sigma < math.inf for sigma in noise)
