"""Sensor wrapper for Kinematics observations: noise, bias, dropout, delay, range and false detections, by feature
names.
"""

from __future__ import annotations

from collections import deque
from math import inf, isfinite, sqrt
from typing import Any

import gymnasium as gym
import numpy as np

from dynamics.state import BoolArray, FloatArray
from evaluation.wrappers.ghosts import FalseDetections, in_units
from evaluation.wrappers.sensor_model import SENSORS, SensorModel, get_sensor
from shield.errors import ConfigError
from shield.perception.spec import STATE, ObservationSpec

__all__ = ["SENSORS", "SensorModel", "SensorNoise", "get_sensor"]


class SensorNoise(gym.ObservationWrapper[Any, Any, Any]):
    """Returns observations of a sensor with noise and faults, drawn from the seed of the reset.

    Noise is drawn anew for every observation, including those at frames between two decisions. Clipping of the inner
    observation comes before the noise. An empty row is all zeros. False detections have noise too.

    Parameters
    ----------
    env : an environment of highway-env with a Kinematics observation.
    model : noise and faults of the sensor.

    Attributes
    ----------
    sensor_noise : standard deviations of x, y [m], vx, vy [m/s], (4,); known after the first reset. They contain no
        tails, bias, false detections and changes.
    sensor_delay : age of an observation [frames].
    sensor_range : range ahead and behind, along x [m].

    Raises
    ------
    ConfigError
        If the model has false detections and the road is no straight highway.
    """

    def __init__(self, env: gym.Env[Any, Any], model: SensorModel) -> None:
        super().__init__(env)
        self.model, self._rng, self._ghostly = model, np.random.default_rng(0), np.random.default_rng(1)
        self._past: deque[tuple[int, Any]] = deque()
        self._range_shares: FloatArray = np.zeros(0)
        self.sensor_noise: FloatArray = np.zeros(len(STATE))
        self.sensor_delay, self.sensor_range = 0, model.range
        self._spec, self._off, self._dt = ObservationSpec(), np.zeros(0), 0.0
        self._ghosts: FalseDetections | None = None
        if model.ghosts and "lanes_count" not in self.unwrapped.config:  # type: ignore[attr-defined]
            raise ConfigError("ghosts are on straight highways: the environment's config has no 'lanes_count'")

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment; a seed makes the noise reproducible."""
        if seed is not None:
            self.redraw(seed)
        self._past.clear()
        observation, info = self.env.reset(seed=seed, options=options)
        base: Any = self.unwrapped
        spec, model = ObservationSpec.of(base), self.model
        config = base.config
        self._dt = 1 / config["simulation_frequency"]
        frames = int(config["simulation_frequency"] // config["policy_frequency"])
        self.sensor_delay = model.delay * frames
        half = {name: 1.0 for name in spec.features}
        half.update({name: (high - low) / 2 for name, (low, high) in spec.ranges.items()})  # type: ignore[union-attr]
        sigmas = {name: model.sigma.get(name, 0.0) for name in spec.features}
        self._range_shares = np.array([sigmas[n] if model.normalised else sigmas[n] / half[n] for n in spec.features])
        self.sensor_noise = np.array([self._range_shares[spec.features.index(n)] * half[n] for n in STATE])
        off = [model.bias.get(name, 0.0) / (1.0 if model.normalised else half[name]) for name in spec.features]
        self._off, self._spec = np.array(off), spec
        if model.ghosts:
            far = min(spec.distance, model.range)
            reach = far, far if spec.see_behind else min(spec.behind, far)
            lanes, timing = int(config["lanes_count"]), (self._dt, frames)
            self._ghosts = FalseDetections(model.ghosts, model.lasting, reach, lanes, timing, self._ghostly)
        return self.observation(observation), info

    def redraw(self, seed: int) -> None:
        """Use another seed for all random numbers from now on; past observations stay the same."""
        for rng, part in ((self._rng, 1), (self._ghostly, 2)):
            rng.bit_generator.state = np.random.default_rng([seed, part]).bit_generator.state

    def observation(self, observation: Any) -> Any:
        """The sensor's observation of an exact one."""
        now = int(self.unwrapped.steps)  # type: ignore[attr-defined]
        exact, model = np.array(observation), self.model
        shown = self._late(now, exact).copy()
        if not model.ego:
            shown[0] = exact[0]
        if isfinite(model.range):
            shown[1:][self._beyond(shown)[1:]] = 0.0
        if self._ghosts is not None:
            shown = self._ghosts.shown_in(self._spec, shown, self._states(shown[:1])[0], now)
        rng, first = self._rng, 0 if model.ego else 1
        there = np.abs(shown).max(axis=1) > 0
        shares = self._range_shares
        if model.change is not None and now * self._dt >= model.change[0]:
            shares = shares * model.change[1]
        noise = there[:, None] * shares * self._drawn(rng, shown.shape, first)
        if model.bias:
            there[:first] = False
            noise += there[:, None] * self._off
        shown = (shown + noise).astype(shown.dtype)
        gone = rng.random(len(shown)) < model.dropout
        gone[0] = False
        shown[gone] = 0.0
        return shown

    def _drawn(self, rng: np.random.Generator, shape: tuple[int, ...], first: int) -> FloatArray:
        """Random numbers with a standard deviation of 1."""
        tails = self.model.tails
        normal = tails == inf
        drawn: FloatArray = rng.standard_normal(shape) if normal else rng.standard_t(tails, shape)
        if not normal:
            drawn *= sqrt((tails - 2) / tails)
        drawn[:first] = 0.0
        return drawn

    def _states(self, rows: FloatArray) -> FloatArray:
        """x, y, vx, vy of rows in m and m/s, (n, 4)."""
        spec = self._spec
        return np.stack(
            [in_units(spec, name, rows[:, spec.features.index(name)].astype(float)) for name in STATE], axis=1
        )

    def _beyond(self, rows: FloatArray) -> BoolArray:
        """Rows of vehicles beyond the range, (rows,)."""
        x = self._states(rows)[:, 0]
        beyond: BoolArray = np.abs(x - x[0] if self._spec.absolute else x) > self.model.range
        return beyond

    def _late(self, now: int, observation: Any) -> Any:
        """The delayed observation."""
        if not self._past or self._past[-1][0] != now:
            self._past.append((now, observation))
        while len(self._past) > 1 and self._past[1][0] <= now - self.sensor_delay:
            self._past.popleft()
        return self._past[0][1]
