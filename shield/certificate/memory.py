"""What a shield remembers of one vehicle from frame to frame, and what it computes once for each instant."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from dynamics.roads.straight import StraightRoad
from dynamics.scenes.scene import Scene
from dynamics.state import BoolArray, FloatArray, RoadState, State, Vehicle
from dynamics.traffic.occupancy import Surroundings
from dynamics.traffic.permits import footprint, permits
from dynamics.vehicle.controllers import KP_SPEED
from dynamics.vehicle.rollouts import Rollouts
from mpc.filter.nearest_point import nearest
from shield.certificate import alongside, kernels
from shield.certificate.kernels import TOUCH, lanes_held
from shield.certificate.manoeuvres import brake_candidates
from shield.certificate.monitor import AssumptionMonitor
from shield.certificate.verify import Binding, Surveyor
from shield.config import ShieldConfig

__all__ = ["Memory"]


@cache
def _warm_up() -> None:
    """Have the kernels compiled, or read from the disk, before a decision waits for them."""
    kernels.warm_up()
    alongside.warm_up()
    nearest(np.zeros(1), np.zeros((1, 2)), np.zeros(2), np.zeros(2), np.zeros(2))
    state, road = np.zeros(4), StraightRoad.from_lanes(1)
    Rollouts(0.1).run(state, np.zeros((1, 1, 3)))
    Rollouts(0.1).run_inputs(state, np.zeros((1, 1, 2)))
    Rollouts(0.1).stop(np.zeros((1, 1, 4)), np.zeros(1), 1.0, 1)
    others = np.zeros((1, 7)), state[None], road, ShieldConfig().assumptions, 0.1
    first = Surroundings(*others)
    second = Surroundings(*others, before=first)
    second.occupancy(1, 0.1)
    permits(first, second, 0.1, np.zeros(1, dtype=bool), footprint(np.zeros(7), 0.0, 0.0))


_LONG = 10**6
"""Frames that stand for as long as one likes."""


@dataclass(frozen=True, slots=True)
class FailSafe:
    """The stored fail-safe played on from now: the lane that it stops in, its path (K, 4), its margin [m], how far it
    stays from where each vehicle can be, (m,) [m], and what the margin comes from."""

    lane: int
    path: FloatArray
    margin: float
    separations: FloatArray
    binding: Binding


class Memory:
    """The memory of one shielded vehicle: stored plan, lanes that it owns, visibility clock, assumption monitor.

    Parameters
    ----------
    config : settings; `ShieldConfig()` by default.

    Attributes
    ----------
    stored_lane : where the fail-safe that was verified last comes to rest; None without one.
    monitor : counts how often the traffic has broken the assumptions.
    """

    _frames = 1
    """Simulation frames between two scenes."""

    def __init__(self, config: ShieldConfig | None = None) -> None:
        self.config = config if config is not None else ShieldConfig()
        self._rollouts: dict[tuple[float, Any], Rollouts] = {}
        _warm_up()
        self.reset()

    def reset(self) -> None:
        """Forget everything about the episode."""
        self.monitor = AssumptionMonitor(self.config)
        self.stored_lane: int | None = None
        self._visible: Any = None
        self._owned: Any = None
        self._followers: Any = None
        self._surveyor: Surveyor | None = None
        self._coming: Any = None
        self._frame: int | None = None
        self._around: Surroundings | None = None

    def _observe(self, scene: Scene) -> None:
        """Take in the next instant, once."""
        if scene.frame is not None and scene.frame == self._frame:
            return
        self._frame = scene.frame
        a, before = self.config.assumptions, self.monitor.before(scene) if self._frames == 1 else None
        around = Surroundings(scene.others, scene.others_road, scene.road, a, scene.dt, before)
        self._around = around
        centers, r = scene.road.centers, float(scene.ego_road[RoadState.R])
        if self._visible is None or self._visible.shape != centers.shape:
            # Whoever is there when it all begins has seen the ego for long.
            self._visible = np.where(np.abs(centers - r) <= a.visible_distance, _LONG, 0)
            self._owned = np.zeros(0, dtype=bool)
        swing = 0.5 * float(scene.ego[Vehicle.LENGTH]) * abs(math.sin(scene.ego_road[RoadState.HEADING]))
        touch, sight = TOUCH + 0.5 * float(scene.ego[Vehicle.WIDTH]) + swing, a.visible_distance
        stored = -1 if self.stored_lane is None else self.stored_lane
        visible, owned = self._visible, self._owned
        self._visible, self._owned = lanes_held(r, centers, self._frames, sight, touch, stored, visible, owned)
        if self._coming is not None and self._coming.shape[0] == centers.size:
            # Where the ego has got out of sight, anybody may come.
            self._coming = self._coming | ((visible > 0) & (self._visible == 0))[:, None]
        self._surveyor, self._followers = None, self.monitor.followers(scene)
        self._surveyor = survey = self._look(scene)
        self._coming = survey.others.comes
        self.monitor.update(
            scene,
            around,
            survey.others.behind,
            survey.others.held,
            self._frames * scene.dt,
            lambda: self._fail_safe(scene).separations,
        )

    def _fail_safe(self, scene: Scene, survey: Surveyor | None = None) -> FailSafe:
        """The stored fail-safe, from now on; where there is none, that of the ego's own lane."""
        lane = self.stored_lane
        if lane is None:
            lane = scene.road.lane_at(float(scene.ego_road[RoadState.R]))
        speed = float(scene.ego[State.SPEED]) - self.config.braking / KP_SPEED
        candidates = brake_candidates(scene, [lane], [speed], [lane], 1, self.config.braking)
        paths = self._rollouts_for(scene).run(scene.ego_road, candidates.commands)
        survey = survey if survey is not None else self._survey(scene)
        result = survey.clearance(paths, candidates)
        return FailSafe(lane, paths[0], float(result.margin[0]), survey.of_each(result), result.binding(0))

    def _rollouts_for(self, scene: Scene) -> Rollouts:
        key = scene.dt, getattr(scene.road, "profile", None)
        if key not in self._rollouts:
            self._rollouts[key] = Rollouts(scene.dt, scene.road)
        return self._rollouts[key]

    def _look(self, scene: Scene, ignored: BoolArray | None = None) -> Surveyor:
        marks = self._visible, self._owned, self._around, ignored, self._followers, self._coming, self.stored_lane
        return Surveyor(scene, self.config, *marks)

    def _lawful(self, scene: Scene) -> Surveyor:
        """A surveyor of this instant that leaves out those who have broken a rule."""
        return self._look(scene, self.monitor.offenders)

    def _survey(self, scene: Scene) -> Surveyor:
        """The surveyor of this instant."""
        if self._surveyor is None:
            self._surveyor = self._look(scene)
        return self._surveyor
