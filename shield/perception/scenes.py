"""Scenes of what one environment's policy observes, in the place of a `SceneReader`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import gymnasium as gym

from dynamics.networks.kinematics import without_data_frames
from dynamics.scenes.scene import Scene, SceneReader
from shield.config import PERCEPTIONS
from shield.errors import ConfigError, SceneError
from shield.perception.perceiving import ObservationPerception, PerceptionConfig
from shield.perception.spec import ObservationSpec

__all__ = ["NO_OBSERVED_SCENES", "ObservedScenes", "scenes_of", "sense"]

NO_OBSERVED_SCENES = (
    "scenes are made from observations for meta-actions on a straight highway; elsewhere take perception='simulator'"
)
"""What is said where they are not."""


class ObservedScenes:
    """What stands in for a `SceneReader` at a door: scenes of what is observed.

    Parameters
    ----------
    env : the environment; of it are read the road map, the clock and what the ego has been told, and at frames between
        two decisions what it shows then.
    config : settings.
    """

    def __init__(self, env: Any, config: PerceptionConfig | None = None) -> None:
        base = env.unwrapped
        self._base, self._env, self._config = base, env, PerceptionConfig() if config is None else config
        self._inner = SceneReader(base)
        self._perception: ObservationPerception | None = None
        self._shown: tuple[int, Any] | None = None

    @property
    def actions(self) -> tuple[str, ...]:
        """Labels of the meta-actions, by index."""
        return self._inner.actions

    @property
    def perception(self) -> ObservationPerception:
        """What makes the scenes; known after the first."""
        if self._perception is None:
            raise SceneError("nothing has been observed yet; call reset() first")
        return self._perception

    def check(self) -> None:
        """Begin an episode: read the road map, and what observations mean."""
        self._inner.check()
        if self._inner.map.heading:
            raise SceneError("observations are read on roads along x only")
        base, config = self._base, self._base.config
        dt = 1 / config["simulation_frequency"]
        frames = int(config["simulation_frequency"] // config["policy_frequency"])
        spec = ObservationSpec.of(base)
        without_data_frames(base.observation_type)  # it is asked at each frame
        settings, sensor = self._config, _sensor_of(self._env)
        if sensor is not None:
            x, y, vx, vy = (float(sigma) for sigma in sensor.sensor_noise)
            settings = replace(settings, noise=settings.noise or (x, y, vx, vy))
            settings = replace(settings, delay=settings.delay + sensor.sensor_delay)
            # What is noisy may be beyond the range that it was clipped to.
            spec = replace(spec, clip=False)
        before = self._perception
        learned = before.learned if before is not None and settings.carry else None
        self._perception = ObservationPerception(spec, self._inner.map, (dt, frames), settings, learned)
        self._shown = None

    def show(self, observation: Any) -> None:
        """What the policy sees now."""
        self._shown = int(self._base.steps), observation

    def read(self) -> Scene:
        """The scene now.

        Raises
        ------
        SceneError
            If nothing has been observed, or that cannot be read.
        """
        frame = int(self._base.steps)
        if self._shown is None or self._shown[0] != frame:
            self._shown = frame, sense(self._env)
        return self.perception.see(self._shown[1], frame, self._inner.control)


def sense(env: Any) -> Any:
    """What an environment would observe now: what highway-env shows, seen through each `ObservationWrapper`."""
    if env is env.unwrapped:
        return env.observation_type.observe()
    seen = sense(env.env)
    return env.observation(seen) if isinstance(env, gym.ObservationWrapper) else seen


def _sensor_of(env: Any) -> Any:
    """The outermost wrapper that says of its own noise and delay; None without one."""
    while env is not env.unwrapped:
        if hasattr(type(env), "sensor_noise") or "sensor_noise" in vars(env):
            return env
        env = env.env
    return None


def scenes_of(perception: str | PerceptionConfig, env: Any) -> ObservedScenes | None:
    """What reads the scenes of an environment; None for the simulator's state.

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
