"""Scenes from the observations of one environment's policy, with the interface of a `SceneReader`."""

from __future__ import annotations

from dataclasses import replace
from math import inf
from typing import Any

import gymnasium as gym
import numpy as np

from dynamics.road_networks.simulation.kinematics import without_data_frames
from dynamics.scenes.scene import Scene, SceneReader
from dynamics.state import FloatArray
from shield.config import PERCEPTIONS
from shield.errors import ConfigError, SceneError
from shield.perception.clipping import check_ranges
from shield.perception.grid_perception import GridPerception
from shield.perception.grid_spec import GridSpec, Spec, spec_of
from shield.perception.learned import Learned
from shield.perception.perceiving import ObservationPerception, PerceptionConfig
from shield.perception.spec import ObservationSpec
from shield.perception.unwrapping import check_wrappers, latest, stacked_in

__all__ = ["NO_OBSERVED_SCENES", "ObservedScenes", "observe_now", "perception_of", "scenes_of"]

NO_OBSERVED_SCENES = (
    "scenes are made from observations for meta-actions on a straight highway; elsewhere take perception='simulator'"
)
"""Message where scenes cannot be made from observations."""


class ObservedScenes:
    """Scenes from observations, with the interface of a `SceneReader`.

    Parameters
    ----------
    env : the environment. Its road map, clock and target command are read, and its observation at frames between two
        decisions. The ego's own state is read only for a grid, which does not show it.
    config : settings.
    """

    def __init__(self, env: Any, config: PerceptionConfig | None = None) -> None:
        base = env.unwrapped
        self._base, self._env, self._config = base, env, PerceptionConfig() if config is None else config
        self._inner = SceneReader(base)
        self._perception: ObservationPerception | GridPerception | None = None
        self._shown: tuple[int, Any] | None = None

    @property
    def actions(self) -> tuple[str, ...]:
        """Labels of the meta-actions, by index."""
        return self._inner.actions

    @property
    def perception(self) -> ObservationPerception | GridPerception:
        """The perception that makes the scenes; available after `check`."""
        if self._perception is None:
            raise SceneError("nothing has been observed yet; call reset() first")
        return self._perception

    def check(self) -> None:
        """Begin an episode: read the road map and the observation's specification.

        Raises
        ------
        ConfigError
            If observations cannot be read, or clipping hides required values.
        """
        self._inner.check()
        if self._inner.map.heading:
            raise SceneError("observations are read on roads along x only")
        base, config = self._base, self._base.config
        dt = 1 / config["simulation_frequency"]
        frames = int(config["simulation_frequency"] // config["policy_frequency"])
        check_wrappers(self._env)
        spec = spec_of(base)
        ego, road = base.vehicle, self._inner.map
        speeds = [float(ego.speed), *map(float, getattr(ego, "target_speeds", ()))]
        without_data_frames(base.observation_type)  # `read` observes at each frame
        settings, sensor = self._config, _sensor_of(self._env)
        if sensor is not None and isinstance(spec, ObservationSpec):
            x, y, vx, vy = (float(sigma) for sigma in sensor.sensor_noise)
            settings = replace(settings, noise=settings.noise or (x, y, vx, vy))
            settings = replace(settings, delay=settings.delay + sensor.sensor_delay)
            # A noisy value may be beyond the range that it was clipped to.
            spec = replace(spec, clip=False, sensor_range=float(getattr(sensor, "sensor_range", inf)))
        check_ranges(spec, speeds, (road.centers + road.origin[1]).tolist())
        before = self._perception
        kept = before.learned if isinstance(before, ObservationPerception) and settings.carry else None
        self._perception = perception_of(spec, self._inner.map, (dt, frames), settings, kept)
        self._shown = None

    def show(self, observation: Any) -> None:
        """Present the policy's observation; columns that wrappers have added are cut off."""
        added, rows = _added(self._env), np.asarray(observation)
        self._shown = int(self._base.steps), rows[..., :-added] if added and rows.ndim > 1 else observation

    def read(self) -> Scene:
        """The present scene.

        Raises
        ------
        SceneError
            If there is no observation, or it cannot be read.
        """
        frame = int(self._base.steps)
        if self._shown is None or self._shown[0] != frame:
            self._shown = frame, observe_now(self._env)
        shown = latest(self._shown[1], self.perception.spec.shape, stacked_in(self._env))
        perception = self.perception
        if isinstance(perception, ObservationPerception):
            return perception.see(shown, frame, self._inner.control)
        return perception.see(shown, frame, self._inner.control, self._own(perception.spec.body))

    def _own(self, body: tuple[float, float]) -> FloatArray:
        """The ego's row, (7,), which a vehicle measures by itself and a grid does not show."""
        ego = self._base.vehicle
        if ego is None:
            raise SceneError("the environment has no ego vehicle; call reset() first")
        return np.array([*ego.position, ego.heading, ego.speed, *body, 0.0])


def perception_of(
    spec: Spec,
    road: Any,
    timing: tuple[float, int],
    config: PerceptionConfig,
    learned: Learned | None = None,
) -> ObservationPerception | GridPerception:
    """Perception for observations of a specification; parameters as of either class. A grid has no estimates.

    Raises
    ------
    ConfigError
        If the grid is unsuitable.
    """
    if isinstance(spec, GridSpec):
        return GridPerception(spec, road, timing, config)
    return ObservationPerception(spec, road, timing, config, learned)


def observe_now(env: Any) -> Any:
    """Present observation of an environment: highway-env's, seen through each `ObservationWrapper`.

    Wrappers that add columns (with an attribute `added_features`) are skipped, and nothing is stacked.
    """
    if env is env.unwrapped:
        return env.observation_type.observe()
    seen = observe_now(env.env)
    return env.observation(seen) if isinstance(env, gym.ObservationWrapper) and not _adds(env) else seen


def _adds(env: Any) -> int:
    """Number of columns that a wrapper adds at the end of an observation."""
    return len(getattr(type(env), "added_features", ()))


def _added(env: Any) -> int:
    """Number of columns that all wrappers add."""
    return 0 if env is env.unwrapped else _adds(env) + _added(env.env)


def _sensor_of(env: Any) -> Any:
    """The outermost wrapper that states its noise and delay; None without one."""
    while env is not env.unwrapped:
        if hasattr(type(env), "sensor_noise") or "sensor_noise" in vars(env):
            return env
        env = env.env
    return None


def scenes_of(perception: str | PerceptionConfig, env: Any) -> ObservedScenes | None:
    """Scene reader of an environment; None for the simulator's state.

    Parameters
    ----------
    perception : one of `shield.config.PERCEPTIONS`, or settings of "observation".

    Raises
    ------
    ConfigError
        If there is no such perception.
    """
    if isinstance(perception, PerceptionConfig):
        return ObservedScenes(env, perception)
    if perception not in PERCEPTIONS:
        raise ConfigError(f"unknown perception {perception!r}; have {', '.join(PERCEPTIONS)}, or a PerceptionConfig")
    return None if perception == "simulator" else ObservedScenes(env)
