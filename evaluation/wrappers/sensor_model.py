"""Sensor models with noise and faults, and sensors by name."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf, isfinite
from types import MappingProxyType

from evaluation.names import check_sensor
from evaluation.wrappers.checks import check_number
from shield.errors import ConfigError
from shield.perception.spec import STATE

__all__ = ["SENSORS", "SensorModel", "get_sensor"]


@dataclass(frozen=True, slots=True)
class SensorModel:
    """Noise and faults of a sensor.

    Attributes
    ----------
    sigma : standard deviation of the noise of each feature, of x, y, vx and vy.
    normalised : whether it is in normalised units, a share of half the feature's range, instead of m and m/s.
    dropout : probability of an empty row.
    delay : age of an observation [decisions].
    ego : whether the ego's own row has noise and delay too; relative rows then refer to the delayed ego.
    tails : degrees of freedom of a Student t distribution of the noise, scaled to `sigma`, and so above 2; infinite for
        a normal distribution.
    bias : constant error of each feature, in the unit of `sigma`; for the ego's row only with `ego`.
    range : range of the sensor ahead and behind, along x; vehicles beyond are not shown [m].
    ghosts : mean number of new false detections in a decision.
    lasting : number of simulation frames for which a false detection is shown.
    change : a time since the reset [s], and the factor of the standard deviations from then on; None for no change.

    Raises
    ------
    ConfigError
        If a feature is unknown, or a number is out of range.
    """

    sigma: Mapping[str, float] = field(default_factory=dict)
    normalised: bool = False
    dropout: float = 0.0
    delay: int = 0
    ego: bool = False
    tails: float = inf
    bias: Mapping[str, float] = field(default_factory=dict)
    range: float = inf
    ghosts: float = 0.0
    lasting: int = 3
    change: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for name, value in self.sigma.items():
            if name not in STATE or not 0 <= value < inf:
                raise ConfigError(f"noise is from 0 on, of {', '.join(STATE)}; got {name!r}: {value!r}")
        for name, value in self.bias.items():
            if name not in STATE or not isfinite(value):
                raise ConfigError(f"a bias is a finite number, of {', '.join(STATE)}; got {name!r}: {value!r}")
        if not 0 <= self.dropout < 1 or type(self.delay) is not int or self.delay < 0:
            raise ConfigError(f"dropout is in [0, 1) and delay a whole number, got {self.dropout!r}, {self.delay!r}")
        if not self.tails > 2:
            raise ConfigError(f"tails are above 2, below which no standard deviation exists, got {self.tails!r}")
        if not self.range > 0:
            raise ConfigError(f"range is above 0, got {self.range!r}")
        check_number("ghosts", self.ghosts, least=0.0)
        if type(self.lasting) is not int or self.lasting < 1:
            raise ConfigError(f"lasting is a whole number of frames from 1 on, got {self.lasting!r}")
        if self.change is not None:
            if len(self.change) != 2:
                raise ConfigError(f"change is a time and a factor, got {self.change!r}")
            for name, value in zip(("the time of a change", "its factor"), self.change, strict=True):
                check_number(name, value, least=0.0)


_NUMBER = re.compile(r"\d+(\.\d+)?")


def _all(value: float) -> dict[str, float]:
    return dict.fromkeys(STATE, value)


SENSORS: Mapping[str, SensorModel] = MappingProxyType(
    {
        "exact": SensorModel(),
        "metric-0.5": SensorModel(_all(0.5)),
        "metric-2": SensorModel(_all(2.0)),
        "metric-2-late": SensorModel(_all(2.0), dropout=0.1, delay=1),
        "normalised-0.2": SensorModel(_all(0.2), normalised=True),
        "normalised-0.5": SensorModel(_all(0.5), normalised=True),
        "heavy-0.5": SensorModel(_all(0.5), tails=3.0),
        "biased-0.5": SensorModel(_all(0.5), bias=_all(0.5)),
        "worsening-0.5": SensorModel(_all(0.5), change=(10.0, 3.0)),
        "ghosts": SensorModel(ghosts=0.2),
        "range-60": SensorModel(range=60.0),
    }
)
"""Sensors by name.

- `metric-0.5` and `metric-2` have noise of 0.5 and 2 m and m/s. `metric-2-late` also misses a tenth of the rows, and is
  one decision late.
- `normalised-0.2` and `normalised-0.5` have noise in normalised units.
- `heavy-0.5`, `biased-0.5` and `worsening-0.5` have noise of 0.5 m and m/s: heavy-tailed (Student t with 3 degrees of
  freedom), with a bias of 0.5 m and m/s, and 3 times as large from 10 s on.
- `ghosts` and `range-60` are exact, with one false detection in 5 decisions on average, and with a range of 60 m.
"""


def get_sensor(name: str) -> SensorModel:
    """A sensor by its name; `metric-S` and `normalised-S` have noise of any standard deviation S.

    Raises
    ------
    ConfigError
        With the valid names.
    """
    check_sensor(name)
    if name in SENSORS:
        return SENSORS[name]
    kind, _, sigma = name.partition("-")
    return SensorModel(_all(float(sigma)), normalised=kind == "normalised")
