"""`BirdsEye`: bird's-eye frames of highway-env's environments and of their compiled copies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from dynamics.errors import SceneError
from dynamics.state import FloatArray
from dynamics.world_model.draw_kernels import DrawWork, SceneBodies, draw, draw_all
from dynamics.world_model.road_pictures import RoadPicture, road_picture
from dynamics.world_model.view import DRIVABLE, EGO, MARKINGS, OTHERS, RELATIVE_SPEED, FrameView

__all__ = ["BirdsEye", "composite"]


class BirdsEye:
    """Draws frames around the ego.

    Parameters
    ----------
    view : part of the scene that the frames show.

    Examples
    --------
    >>> import gymnasium as gym, highway_env
    >>> env = gym.make("highway-fast-v0")
    >>> _ = env.reset(seed=0)
    >>> BirdsEye().frame(env).shape
    (5, 64, 64)
    """

    def __init__(self, view: FrameView | None = None) -> None:
        self.view = FrameView() if view is None else view
        self._numbers, self._work = self.view.numbers, DrawWork.of(self.view.size)
        self._network: Any = None
        self._road: RoadPicture | None = None

    @property
    def space(self) -> gym.spaces.Box:
        """Space of a frame, which Stable-Baselines3 takes for an image."""
        return gym.spaces.Box(0, 255, self.view.shape, np.uint8)

    def frame(self, env: gym.Env[Any, Any], out: NDArray[np.uint8] | None = None) -> NDArray[np.uint8]:
        """Frame of a live environment of highway-env, around its first ego.

        Parameters
        ----------
        out : array of shape `view.shape` to write to; a new one by default.

        Raises
        ------
        SceneError
            If the environment has no ego or no road yet, or its road has lanes of another shape.
        """
        base = cast(Any, env.unwrapped)
        road, ego = getattr(base, "road", None), getattr(base, "vehicle", None)
        if road is None or ego is None:
            raise SceneError("a frame shows the road around an ego of highway-env; reset the environment first")
        others = [body for body in (*road.vehicles, *road.objects) if body is not ego]
        bodies = np.array([_row(body) for body in (ego, *others)], float)
        made = np.empty(self.view.shape, np.uint8) if out is None else out
        draw(bodies, 0, self._picture(road.network), self._numbers, self._work, made)
        return made

    def frames(
        self,
        simulator: Any,
        network: Any,
        out: NDArray[np.uint8],
        which: Sequence[int] | NDArray[Any] | None = None,
    ) -> NDArray[np.uint8]:
        """Frames of compiled environments in their present states.

        Parameters
        ----------
        simulator : a `Simulator` or a `RoadSimulator`. network : its `RoadNetwork`.
        out : frames of all environments, (e, 5, rows, columns) uint8, written at `which`.
        which : the environments; all by default.

        Returns
        -------
        `out`.
        """
        worlds = simulator.worlds if hasattr(simulator, "worlds") else simulator.episodes.worlds
        e, m = simulator.num_envs, worlds.f.shape[2]
        counts = getattr(worlds, "counts", None)
        bodies_of_each = np.full(e, m, np.int64) if counts is None else np.ascontiguousarray(counts[:, 1])
        chosen = np.arange(e) if which is None else np.asarray(which, np.int64)
        scenes = SceneBodies(worlds.f, worlds.g, worlds.p, bodies_of_each)
        if len(self._work.bodies) < m:
            self._work = DrawWork.of(self.view.size, m)
        draw_all(scenes, chosen, self._picture(network), self._numbers, self._work, out)
        return out

    def _picture(self, network: Any) -> RoadPicture:
        """Picture of the network, drawn when it changes."""
        if self._road is None or network is not self._network:
            self._road, self._network = road_picture(network), network
        return self._road


def _row(body: Any) -> tuple[float, ...]:
    heading = float(body.heading)
    x, y = body.position
    return (
        float(x),
        float(y),
        np.cos(heading),
        np.sin(heading),
        float(body.speed),
        float(body.LENGTH),
        float(body.WIDTH),
    )


def composite(frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Colour picture of a frame or of frames, (..., rows, columns, 3) uint8: the road grey, markings white, the ego
    green; others blue where slower than the ego, red where faster.
    """
    parts: FloatArray = frame.astype(float)
    drivable, markings, ego = (parts[..., k, :, :, None] for k in (DRIVABLE, MARKINGS, EGO))
    others, speed = parts[..., OTHERS, :, :, None] / 255, parts[..., RELATIVE_SPEED, :, :, None]
    faster = np.clip((speed - 128) / 127, -1, 1)
    colour = np.concatenate([150 + 105 * faster, 150 - 100 * np.abs(faster), 150 - 105 * faster], axis=-1)
    picture = (70 * drivable + 150 * markings) / 255 * np.ones(3)
    picture = picture * (1 - others) + colour * others
    # A standing ego has a quarter of the brightness, and is opaque all the same.
    opaque = np.minimum(4 * ego / 255, 1)
    picture = picture * (1 - opaque) + np.array([60, 230, 90]) * opaque
    return np.asarray(np.clip(picture + 0.5, 0, 255), np.uint8)
