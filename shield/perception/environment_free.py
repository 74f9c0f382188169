"""Scenes from the arguments of `predict` alone: the environment may be in another process, or on another machine."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from dynamics.scenes.scene import EgoControl, Scene, Target
from dynamics.state import FloatArray, RoadState, State, Vehicle
from dynamics.vehicle.controllers import speed_to_index
from dynamics.vehicle.rollouts import NO_LIMIT, Rollouts
from shield.errors import SceneError
from shield.perception.grid_perception import GridPerception
from shield.perception.grid_sighting import lane_in_grid
from shield.perception.grid_spec import GridSpec
from shield.perception.known import Known
from shield.perception.perceiving import ObservationPerception, PerceptionConfig
from shield.perception.scenes import perception_of
from shield.perception.sighting import decode
from shield.perception.unwrapping import latest

__all__ = ["EnvironmentFreeScenes"]

_STATE_TOLERANCE = 0.05
"""Tolerance between the observed and the commanded state of the ego, beyond the noise [m], [m/s]."""
_SIGMAS = 6.0


class EnvironmentFreeScenes:
    """Scenes from observations, with the interface of a `SceneReader`, without an environment.

    The clock is the count of decisions. The target command follows from the initial lane and speed and the actions
    chosen here. With a model of highway-env's controllers this gives the ego's state after each decision.

    Parameters
    ----------
    known : the prior map.
    config : settings.
    """

    def __init__(self, known: Known, config: PerceptionConfig | None = None) -> None:
        settings = PerceptionConfig() if config is None else config
        settings = replace(settings, noise=settings.noise or known.noise, delay=settings.delay + known.delay)
        self._known = known
        timing = known.dt, known.frames
        self._perception = perception_of(known.spec, known.road, timing, settings)
        self._rollouts = Rollouts(known.dt, known.road)
        # Estimated noise is unknown so far; the ego's own row is mostly exact.
        assumed = known.noise if settings.noise == "estimate" else settings.noise
        blurred = np.zeros(4) if assumed is None else np.asarray(assumed, dtype=float)
        self._astray = _STATE_TOLERANCE + _SIGMAS * np.array([blurred[1], np.hypot(*blurred[2:])])
        self.check()

    @property
    def actions(self) -> tuple[str, ...]:
        """Labels of the meta-actions, by index."""
        return self._known.actions

    @property
    def perception(self) -> ObservationPerception | GridPerception:
        """The perception that makes the scenes."""
        return self._perception

    def check(self) -> None:
        """Begin an episode."""
        self._perception.reset()
        self._decisions = -1
        self._shown: Any = None
        self._target: Target | None = None
        self._ego: FloatArray | None = None
        self._scene: Scene | None = None

    def show(self, observation: Any) -> None:
        """Present the policy's next observation, one decision after the previous one."""
        self._decisions += 1
        self._shown, self._scene = latest(observation, self._known.spec.shape, self._known.stacked), None

    def begins(self) -> bool:
        """Whether the observation begins an episode that was not announced: the longest duration is over, or the ego's
        state differs from the commanded one."""
        if self._decisions < 1:
            return False
        spec, road = self._known.spec, self._known.road
        if 0 < self._known.decisions <= self._decisions:
            return True
        if isinstance(spec, GridSpec):
            return False
        try:
            _, y, vx, vy = decode(spec, self._shown).ego
        except SceneError:
            return False
        return self._strays(np.array([0.0, y - road.origin[1], 0.0, np.hypot(vx, vy)]))

    def read(self) -> Scene:
        """The present scene.

        Raises
        ------
        SceneError
            If there is no observation, it cannot be read, or the ego's state differs from the commanded one.
        """
        if self._scene is not None:
            return self._scene
        if self._decisions < 0:
            raise SceneError("nothing has been observed yet; call predict() first")
        seen = self._shown, self._decisions * self._known.frames, self._control(Target(0, 0.0))
        if isinstance(self._perception, ObservationPerception):
            scene = self._perception.see(*seen)
        else:
            scene = self._perception.see(*seen, self._unseen_ego())
        if self._strays(scene.ego_road):
            raise SceneError(
                "the ego is not where its last action leads: step the environment once with each action that predict() "
                "returns, and mark the beginning of an episode with episode_start, or reset()"
            )
        if self._target is None:
            self._target = self._start(scene)
        self._scene = replace(scene, control=self._control(self._target))
        return self._scene

    def tell(self, action: int) -> None:
        """Record the action that the environment executes after the last observation."""
        scene = self._alone() if self._scene is None else self._scene
        if scene is None or not 0 <= action < len(self.actions):
            return
        target = self._target = scene.target_of(action)
        centers = self._known.road.centers
        command = np.tile([float(centers[target.lane]), target.speed, NO_LIMIT], (1, self._known.frames, 1))
        self._ego = self._rollouts.run(scene.ego_road, command)[0, -1]

    def _control(self, target: Target) -> EgoControl:
        return EgoControl(target, self._known.target_speeds, self.actions)

    def _start(self, scene: Scene) -> Target:
        """Initial target command of highway-env's ego: its lane, and the target speed nearest to its own."""
        speeds = self._known.target_speeds
        lane = self._known.road.lane_at(float(scene.ego_road[RoadState.R]))
        return Target(lane, speeds[speed_to_index(float(scene.ego[State.SPEED]), speeds)])

    def _unseen_ego(self) -> FloatArray:
        """The ego's row where observations do not show it: its initial state, and then the commanded one."""
        known = self._known
        if self._ego is None and self._decisions:
            raise SceneError(
                "the first observation of the episode could not be read: the ego's place is unknown until reset()"
            )
        if self._ego is None:
            centers, lane = known.road.centers, known.lane
            if lane is None and isinstance(known.spec, GridSpec):
                lane = lane_in_grid(known.spec, self._shown, centers)
            assert lane is not None
            return self._row(np.array([0.0, centers[lane], 0.0, known.speed]))
        return self._row(self._ego)

    def _row(self, place: FloatArray) -> FloatArray:
        """Vehicle row, (7,), of a road state, (4,)."""
        row = np.zeros(len(Vehicle))
        row[: len(State)] = self._known.road.to_world(place)
        row[[Vehicle.LENGTH, Vehicle.WIDTH]] = self._known.spec.body
        return row

    def _alone(self) -> Scene | None:
        """Scene with the ego's commanded state and no other vehicle, for an unreadable observation; None if that state
        is unknown."""
        if self._ego is None or self._target is None:
            return None
        row = self._row(self._ego)
        nobody, control = np.zeros((0, len(Vehicle))), self._control(self._target)
        return Scene(row, nobody, self._known.road, control, self._known.dt, self._known.frames, observed=True)

    def _strays(self, ego: FloatArray) -> bool:
        """Whether a road state of the ego, (4,), differs from the commanded one."""
        if self._ego is None or self._perception.config.delay:
            return False
        apart = np.abs(ego - self._ego)[[RoadState.R, RoadState.SPEED]]
        return bool((apart > self._astray).any())
