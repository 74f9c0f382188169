"""Sensors for the benchmarks of perception, whose noise is of another kind than they say: a driver and what it sees."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np

from dynamics.state import FloatArray
from shield import PerceptionConfig, ShieldedEnv
from shield.perception.perceiving import ObservationPerception
from shield.perception.spec import STATE, ObservationSpec

__all__ = ["KINDS", "Blurred", "drive", "perception_of", "shielded"]

KINDS = ("gaussian", "tails", "biased")
"""Normal noise; Student's t with 3 degrees of freedom times what is said to be the standard deviation (it has 1.73 of
them); and normal noise about a mean that is off by one standard deviation."""
SEEN = {"type": "Kinematics", "vehicles_count": 15, "see_behind": True}


class Blurred(gym.ObservationWrapper[Any, Any, Any]):
    """Noise on everybody's x, y, vx and vy but the ego's.

    Attributes
    ----------
    sensor_noise : what the sensor says of itself, standard deviations of x, y [m], vx and vy [m/s], (4,).
    times : how many times as large the noise is. exact, drawn : what was there, and what was added, last time.
    """

    sensor_delay = 0

    def __init__(self, env: gym.Env[Any, Any], sigma: FloatArray, kind: str = "gaussian") -> None:
        super().__init__(env)
        self.sensor_noise, self.kind, self.times = np.asarray(sigma, float), kind, 1.0
        self._rng = np.random.default_rng(0)
        self.exact: Any = None
        self.drawn: Any = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment; a seed makes the noise the same again."""
        self._rng, self.times = np.random.default_rng([seed or 0, 7]), 1.0
        observation, info = self.env.reset(seed=seed, options=options)
        spec = ObservationSpec.of(self.unwrapped)
        half = [(high - low) / 2 for low, high in (spec.ranges[name] for name in STATE)]  # type: ignore[index]
        self._at, self._shares = [spec.features.index(name) for name in STATE], self.sensor_noise / half
        return self.observation(observation), info

    def observation(self, observation: Any) -> Any:
        """What the sensor shows."""
        rows: FloatArray = np.array(observation, float)
        shape, rng = (len(rows), len(STATE)), self._rng
        noise = rng.standard_t(3, shape) if self.kind == "tails" else rng.standard_normal(shape)
        noise += self.kind == "biased"
        noise[0] = 0.0
        noise[np.abs(rows).max(axis=1) == 0] = 0.0
        self.exact, self.drawn = rows, noise * self._shares
        return self.shown(self.times)

    def shown(self, times: float) -> Any:
        """What it would have shown last, with noise so many times as large."""
        rows = self.exact.copy()
        rows[:, self._at] += times * self.drawn
        return rows


def shielded(sigma: FloatArray, kind: str, config: PerceptionConfig) -> tuple[ShieldedEnv, Blurred]:
    """A shield that sees 15 vehicles through such a sensor, and the sensor."""
    sensor = Blurred(gym.make("highway-fast-v0", config={"observation": SEEN}), sigma, kind)
    return ShieldedEnv(sensor, perception=config), sensor


def perception_of(env: ShieldedEnv) -> ObservationPerception:
    """What makes the scenes of a shielded environment."""
    reader: Any = env.filter.reader  # type: ignore[union-attr]
    found: ObservationPerception = reader.perception
    return found


def drive(env: ShieldedEnv, seed: int) -> Any:
    """Each decision's info, of an episode of a policy that always asks for FASTER."""
    env.reset(seed=seed)
    over = False
    while not over:
        *_, terminated, truncated, info = env.step(3)
        over = terminated or truncated
        yield info
