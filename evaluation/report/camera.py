"""Camera that takes highway-env's own picture in each simulation frame, off-screen."""

from __future__ import annotations

import os
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from dynamics.roads.straight import Road, StraightRoad
from dynamics.state import FloatArray, RoadState, State
from evaluation.measuring.recorder import read_road
from evaluation.report.draw import Shot, WorldFrame
from evaluation.report.proposal import action_labels, ego_copy, proposed_path
from evaluation.report.reachable_areas import ReachableAreas
from shield import ShieldedEnv
from shield.filters.network import NetworkFilter

__all__ = ["Camera"]


class Camera:
    """Records one episode of a shielded environment that was made with `render_mode="rgb_array"`.

    Parameters
    ----------
    env : the environment, after `reset`. On a road network plans and areas are in the world frame.
    """

    def __init__(self, env: ShieldedEnv) -> None:
        self._env = env
        self._base = cast(Any, env.unwrapped)
        os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
        self._base.render()  # makes the viewer
        self._base.enable_auto_render = False
        self._viewer: Any = self._base.viewer
        self._viewer.enabled = True  # highway-env draws nothing under SDL's dummy driver otherwise
        self._road: Road | WorldFrame = read_road(self._base.road.network) or WorldFrame()
        in_world = env.config.simulates or isinstance(env.filter, NetworkFilter)
        self._frame: Road | WorldFrame = WorldFrame() if in_world else self._road
        self._viewer.observer_vehicle = SimpleNamespace(position=np.zeros(2))
        self._dt = 1.0 / self._base.config["simulation_frequency"]
        self._areas = ReachableAreas(self._base)
        self._taken: list[dict[str, Any]] = []
        self._keep = True
        self._frames = 0
        inner = self._base.road.step

        def step(dt: float) -> None:
            if self._keep:
                self._take()
            self._frames += 1
            inner(dt)

        self._base.road.step = step

    def start(self, keep: bool) -> None:
        """Prepare for a step; with `keep` its frames are recorded. Call before each step."""
        self._taken, self._keep = [], keep
        self._ego = ego_copy(self._base)

    def _take(self) -> None:
        ego = self._base.vehicle
        self._viewer.observer_vehicle.position = self._middle(ego)
        self._viewer.display()
        surface = self._viewer.sim_surface
        self._taken.append(
            {
                "image": np.array(self._viewer.get_image(), dtype=np.uint8),
                "origin": (float(surface.origin[0]), float(surface.origin[1])),
                "scaling": float(surface.scaling),
                "speed": float(ego.speed),
                "size": (float(ego.LENGTH), float(ego.WIDTH)),
                "time": self._frames * self._dt,
                "areas": self._areas.now(self._env.filter),
            }
        )

    def _middle(self, ego: Any) -> FloatArray:
        """Centre of the picture: the ego, or on a straight road the road's centre line beside it [m]."""
        state = np.array([*ego.position, ego.heading, ego.speed])
        if isinstance(self._road, StraightRoad):
            state = self._road.to_road(state)
            state[RoadState.R] = self._road.centers.mean()
            state = self._road.to_world(state)
        return np.asarray(state[: State.Y + 1])

    def develop(self) -> list[Shot]:
        """The shots of the last step, with its decisions."""
        env, frames = self._env, self._env.frame_decisions
        actions = action_labels(self._base.action_type)
        record = env.last_decision
        assert record is not None
        proposal = proposed_path(self._base, self._ego, record.proposed, self._frame)
        words = record.explain().text if record.overridden or record.tier.fallback else ""
        period = max(1, round(1.0 / (self._dt * self._base.config["policy_frequency"])))
        return [
            Shot(
                **taken,
                road=self._frame,
                dt=self._dt,
                actions=actions,
                decision=record,
                frame=frames[i] if i < len(frames) else None,
                age=i,
                period=period,
                proposal=proposal,
                simulated=env.config.simulates,
                words=words,
            )
            for i, taken in enumerate(self._taken)
        ]
