"""Settings of scenes that are made from observations."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from shield.errors import ConfigError
from shield.perception.unseen import Unseen

__all__ = ["BOUNDS", "PerceptionConfig"]

BOUNDS = ("gaussian", "conformal")
"""Valid `PerceptionConfig.bounds`."""


@dataclass(frozen=True, slots=True)
class PerceptionConfig:
    """Settings of `ObservationPerception`.

    Attributes
    ----------
    unseen : what is assumed of those who are not seen.
    calm, brisk : standard deviations of the others' accelerations along and across the road [m/s^2], of those who drive
        on, by which what is seen of them is smoothed, and of those who do something else (see `tracking`).
    noise : standard deviations of x, y [m], vx and vy [m/s] of those observed; None for what the sensor says of itself
        (its attribute `sensor_noise`), and without that what 32 bits leave of a number; "estimate" for what innovations
        say, whatever the sensor says of itself (`learned.Noise`).
    bound : a body is taken to reach as far, and to be as fast behind the ego and as slow ahead, as is exceeded no more
        often than so many standard deviations of a normal distribution.
    bounds : whether that is so of the estimates themselves, "gaussian", or of what was found to be exceeded as often
        where the next observation was foretold, "conformal" (`learned.Conformal`).
    monitor : whether a sensor that does not behave as it is thought to is noticed (`monitor.Monitor`), and answered
        with the widest bounds that there are and no guarantee.
    carry : whether what was learned of the sensor is carried from one episode to the next; else each begins anew.
    patience : for how many observations in a row somebody may be missing who has been seen; None for 3 where noise is
        told, and 0 elsewhere.
    cruise : the speed that traffic has, by how much it differs [m/s], and how slowly everybody comes to it [s]; it says
        something only where the sensor says little.
    delay : for how many simulation frames what is shown of the others is out of date, beyond what the sensor says of
        itself (its attribute `sensor_delay`); the ego's own row is not.

    Raises
    ------
    ConfigError
        If one is out of range.
    """

    unseen: Unseen = field(default_factory=Unseen)
    calm: tuple[float, float] = (2.0, 1.0)
    brisk: tuple[float, float] = (4.0, 20.0)
    cruise: tuple[float, float, float] = (21.0, 2.5, 10.0)
    noise: tuple[float, float, float, float] | Literal["estimate"] | None = None
    bound: float = 2.0
    bounds: Literal["gaussian", "conformal"] = "gaussian"
    monitor: bool = False
    carry: bool = True
    patience: int | None = None
    delay: int = 0

    def __post_init__(self) -> None:
        if not all(math.isfinite(a) and a > 0 for a in (*self.calm, *self.brisk)):
            raise ConfigError(f"accelerations are above 0, got calm {self.calm} and brisk {self.brisk}")
        if np.shape(self.cruise) != (3,) or not all(math.isfinite(a) and a > 0 for a in self.cruise):
            raise ConfigError(f"cruise is a speed, a deviation and a time, three numbers above 0, got {self.cruise!r}")
        if self.noise not in (None, "estimate") and not _four(self.noise):
            raise ConfigError(f'noise is of x, y, vx and vy, four numbers from 0 on, or "estimate", not {self.noise!r}')
        if self.bounds not in BOUNDS:
            raise ConfigError(f"unknown bounds {self.bounds!r}; have {', '.join(BOUNDS)}")
        counts = 0 if self.patience is None else self.patience, self.delay
        if not 0 <= self.bound < math.inf or any(type(n) is not int or n < 0 for n in counts):
            raise ConfigError(
                f"bound, patience and delay are from 0 on, got {self.bound!r}, {counts[0]!r}, {counts[1]!r}"
            )


def _four(noise: Any) -> bool:
    return np.shape(noise) == (4,) and all(0 <= sigma < math.inf for sigma in noise)
