"""A sensor that is not exact: noise, dropout and delay on Kinematics observations, by the names of their features."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import numpy as np

from dynamics.state import FloatArray
from shield.errors import ConfigError
from shield.perception.spec import STATE, ObservationSpec

__all__ = ["SENSORS", "SensorModel", "SensorNoise", "get_sensor"]


@dataclass(frozen=True, slots=True)
class SensorModel:
    """What is wrong with a sensor.

    Attributes
    ----------
    sigma : standard deviation of the noise of each feature, of x, y, vx and vy.
    normalised : whether these are in normalised units, a share of half the feature's range, and not in m and m/s.
    dropout : probability with which each row is empty.
    delay : for how many decisions what is shown is out of date.
    ego : whether the ego's own row is as noisy and late as the others'; what is relative is to where the ego was.

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

    def __post_init__(self) -> None:
        for name, value in self.sigma.items():
            if name not in STATE or not 0 <= value < np.inf:
                raise ConfigError(f"noise is from 0 on, of {', '.join(STATE)}; got {name!r}: {value!r}")
        if not 0 <= self.dropout < 1 or type(self.delay) is not int or self.delay < 0:
            raise ConfigError(f"dropout is in [0, 1) and delay a whole number, got {self.dropout!r}, {self.delay!r}")


def _all(sigma: float) -> dict[str, float]:
    return dict.fromkeys(STATE, sigma)


SENSORS: Mapping[str, SensorModel] = MappingProxyType(
    {
        "exact": SensorModel(),
        "metric-0.5": SensorModel(_all(0.5)),
        "metric-2": SensorModel(_all(2.0)),
        "metric-2-late": SensorModel(_all(2.0), dropout=0.1, delay=1),
        "normalised-0.2": SensorModel(_all(0.2), normalised=True),
        "normalised-0.5": SensorModel(_all(0.5), normalised=True),
    }
)
"""Sensors by name: noise of 0.5 and 2 m and m/s, the latter with a tenth of the rows missing and a decision late, and
noise in normalised units."""


def get_sensor(name: str) -> SensorModel:
    """A sensor by its name.

    Raises
    ------
    ConfigError
        That lists those that there are.
    """
    if name not in SENSORS:
        raise ConfigError(f"unknown sensor {name!r}; have {', '.join(SENSORS)}")
    return SENSORS[name]


class SensorNoise(gym.ObservationWrapper[Any, Any, Any]):
    """Shows what a bad sensor shows; drawn by the seed of the reset.

    Noise is drawn anew whenever something is observed, at the frames between two decisions too where somebody looks.
    What is clipped is clipped before. An empty row is all zeros.

    Parameters
    ----------
    env : an environment of highway-env with a Kinematics observation.
    model : what is wrong with it.

    Attributes
    ----------
    sensor_noise : standard deviations of x, y [m], vx, vy [m/s] of what is shown, (4,); known after the first reset.
    sensor_delay : for how many frames it is out of date.
    """

    def __init__(self, env: gym.Env[Any, Any], model: SensorModel) -> None:
        super().__init__(env)
        self.model, self._rng = model, np.random.default_rng(0)
        self._past: deque[tuple[int, Any]] = deque()
        self._shares: FloatArray = np.zeros(0)
        self.sensor_noise: FloatArray = np.zeros(len(STATE))
        self.sensor_delay = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment; a seed makes the noise the same again."""
        if seed is not None:
            self._rng = np.random.default_rng([seed, 1])
        self._past.clear()
        observation, info = self.env.reset(seed=seed, options=options)
        base: Any = self.unwrapped
        spec, model = ObservationSpec.of(base), self.model
        config = base.config
        self.sensor_delay = model.delay * int(config["simulation_frequency"] // config["policy_frequency"])
        half = {name: 1.0 for name in spec.features}
        half.update({name: (high - low) / 2 for name, (low, high) in spec.ranges.items()})  # type: ignore[union-attr]
        told = {name: model.sigma.get(name, 0.0) for name in spec.features}
        self._shares = np.array([told[n] if model.normalised else told[n] / half[n] for n in spec.features])
        self.sensor_noise = np.array([self._shares[spec.features.index(n)] * half[n] for n in STATE])
        return self.observation(observation), info

    def observation(self, observation: Any) -> Any:
        """What the sensor shows of what is there."""
        now = int(self.unwrapped.steps)  # type: ignore[attr-defined]
        exact = np.array(observation)
        shown = self._late(now, exact).copy()
        if not self.model.ego:
            shown[0] = exact[0]
        rng, first = self._rng, 0 if self.model.ego else 1
        there = np.abs(shown).max(axis=1) > 0
        shown = (shown + there[:, None] * self._shares * self._drawn(rng, shown.shape, first)).astype(shown.dtype)
        gone = rng.random(len(shown)) < self.model.dropout
        gone[0] = False
        shown[gone] = 0.0
        return shown

    @staticmethod
    def _drawn(rng: np.random.Generator, shape: tuple[int, ...], first: int) -> FloatArray:
        drawn: FloatArray = rng.standard_normal(shape)
        drawn[:first] = 0.0
        return drawn

    def _late(self, now: int, observation: Any) -> Any:
        """What was there when what is shown now was seen."""
        if not self._past or self._past[-1][0] != now:
            self._past.append((now, observation))
        while len(self._past) > 1 and self._past[1][0] <= now - self.sensor_delay:
            self._past.popleft()
        return self._past[0][1]
