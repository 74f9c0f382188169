"""Overlay of the shield's prediction and decision on highway-env's rendering, for `RecordVideo` or a notebook."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import NDArray
from PIL import Image

from dynamics.errors import SceneError
from dynamics.state import FloatArray
from evaluation.measuring.recorder import read_road
from evaluation.report.draw import Shot, WorldFrame, draw, without_decision
from evaluation.report.proposal import action_labels, ego_copy, proposed_path
from evaluation.report.reachable_areas import ReachableAreas
from shield import Shield, ShieldedEnv
from shield.decision import Decision
from shield.errors import ConfigError
from shield.filters.network import NetworkFilter

__all__ = ["ShieldOverlay"]

_LEAST_WIDTH = 1000
"""Least width of the picture, which the caption needs [px]; smaller pictures are enlarged."""


class ShieldOverlay(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """A wrapper with the decision in its `render`: proposed, executed and fail-safe paths, reason and margin.

    Frames between two decisions, which highway-env passes to a registered `RecordVideo`, have the overlay as well.

    Parameters
    ----------
    env : an environment made with `render_mode="rgb_array"`, with a `ShieldedEnv` in or around it. From its next
        decision on, the shield records what is drawn (`ShieldedEnv.record`).
    shield : the `Shield` around the policy, if there is one instead of a `ShieldedEnv`.

    Raises
    ------
    ConfigError
        If there is no shield, or the environment renders nothing.
    SceneError
        At the first `render`, if the road is neither one of parallel lanes nor a network.

    Examples
    --------
    >>> import gymnasium as gym, highway_env
    >>> env = gym.make("highway-fast-v0", render_mode="rgb_array")
    >>> env = ShieldOverlay(ShieldedEnv(env))
    >>> obs, _ = env.reset(seed=0)
    >>> _ = env.step(3)
    >>> env.render().shape
    (412, 1200, 3)
    """

    def __init__(self, env: gym.Env[Any, Any], shield: Shield | None = None) -> None:
        RecordConstructorArgs.__init__(self, _disable_deepcopy=True, shield=shield)
        gym.Wrapper.__init__(self, env)
        self._shield = _inside(env) if shield is None else shield
        if env.render_mode != "rgb_array":
            raise ConfigError(f"have gym.make(..., render_mode='rgb_array'); this is {env.render_mode!r}")
        self._shield.record()
        self._base = cast(Any, env.unwrapped)
        self._areas = ReachableAreas(self._base)
        self._ego: Any = None
        self._begun = 0
        self._drawn: list[Decision] | None = None
        self._proposal: FloatArray | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment, and forget the last decision."""
        self._ego = None
        return self.env.reset(seed=seed, options=options)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment, and mark the ego's state as the start of the proposal's path."""
        self.mark()
        return self.env.step(action)

    def mark(self) -> None:
        """Mark the ego's state at a decision. `step` calls it.

        Call it between `predict` and `step` to draw a decision that is not executed yet.
        """
        self._ego, self._begun = ego_copy(self._base), self._base.steps

    def render(self) -> Any:
        """The picture, (height, width, 3) uint8."""
        image = self.env.render()
        if not self._base.viewer.enabled:
            # highway-env draws nothing under SDL's dummy driver otherwise.
            self._base.viewer.enabled = True
            image = self.env.render()
        if not isinstance(image, np.ndarray):
            return image
        zoom = -(-_LEAST_WIDTH // image.shape[1])
        image = _enlarged(image, zoom)
        shot = self._shot(image, zoom)
        return np.asarray(without_decision(image) if shot is None else draw(shot), dtype=np.uint8)

    def _shot(self, image: NDArray[np.uint8], zoom: int) -> Shot | None:
        decision, frames = self._shield.last_decision, _frames(self._shield)
        if self._ego is None or decision is None:
            return None
        base, simulated, filters = self._base, self._shield.config.simulates, _filters(self._shield)
        in_world = simulated or isinstance(filters, NetworkFilter)
        road = WorldFrame() if in_world else read_road(base.road.network)
        if road is None:
            raise SceneError("this road cannot be drawn on; have single roads of parallel lanes, straight or curved")
        surface, ego, dt = base.viewer.sim_surface, base.vehicle, 1.0 / base.config["simulation_frequency"]
        if frames is not self._drawn:
            # Each decision has a list of its own.
            self._drawn = frames
            self._proposal = proposed_path(base, self._ego, decision.proposed, road)
        frame = frames[-1] if frames else None
        if frame is not None and frame.plan is not None:
            # The picture shows the state after the frame.
            frame = replace(frame, plan=frame.plan[1:])
        return Shot(
            image=image,
            origin=(float(surface.origin[0]), float(surface.origin[1])),
            scaling=float(surface.scaling) * zoom,
            road=road,
            dt=dt,
            time=base.steps * dt,
            speed=float(ego.speed),
            size=(float(ego.LENGTH), float(ego.WIDTH)),
            actions=action_labels(base.action_type),
            decision=decision,
            frame=frame,
            age=base.steps - self._begun,
            period=max(1, round(1.0 / (dt * base.config["policy_frequency"]))),
            proposal=self._proposal,
            simulated=simulated,
            areas=self._areas.now(filters),
            words=decision.explain().text if decision.overridden or decision.tier.fallback else "",
        )


def _inside(env: Any) -> ShieldedEnv:
    """The `ShieldedEnv` among the wrappers of an environment; raises `ConfigError` without one."""
    layer = env
    while isinstance(layer, gym.Wrapper):
        if isinstance(layer, ShieldedEnv):
            return layer
        layer = layer.env
    raise ConfigError("there is no ShieldedEnv inside this environment; around a policy, pass shield=")


def _filters(shield: Shield | ShieldedEnv) -> Any:
    """The filter of the environment's actions."""
    return shield.filter if isinstance(shield, ShieldedEnv) else shield.filters[0]


def _frames(shield: Shield | ShieldedEnv) -> list[Decision]:
    """The decisions about frames since the last decision."""
    return shield.frame_decisions if isinstance(shield, ShieldedEnv) else shield.frame_decisions[0]


def _enlarged(image: NDArray[np.uint8], zoom: int) -> NDArray[np.uint8]:
    height, width, _ = image.shape
    return np.asarray(Image.fromarray(image).resize((zoom * width, zoom * height), Image.Resampling.LANCZOS))
