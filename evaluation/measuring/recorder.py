"""Recorder of all vehicles' states in an episode, frame by frame, from the simulator's state.

The recorder wraps `road.step` on the instance, or observes the compiled frames. It reads after each simulation frame
and changes nothing, so an episode is the same with and without it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import gymnasium as gym
import numpy as np
from highway_env.envs.parking_env import ParkingEnv

from dynamics.errors import SceneError
from dynamics.highway_simulator.env import CompiledHighwayEnv
from dynamics.road_networks.simulation.compiled_frames import CompiledFrames
from dynamics.roads.path import PathRoad
from dynamics.roads.path_reader import read_network
from dynamics.roads.straight import Road, StraightRoad
from dynamics.state import BoolArray, FloatArray, wrap_to_pi
from evaluation.measuring.jerk import jerk
from evaluation.measuring.nearest import least_clearance, least_headway, least_time_to_collision
from evaluation.measuring.rectangles import separation

__all__ = ["History", "Recorder", "Track", "is_off_road", "read_road"]


_AWAY = (1e6, 0.0, 0.0, 0.0, 0.0, 0.0, False)
"""State of a vehicle that is absent."""


class Track(IntEnum):
    """Columns of a history: [m], [m], [rad], [m/s], [m], [m], 0 or 1, 0 or 1; the first three in the road frame.

    A vehicle is off the road by highway-env's definition: its centre is in no lane. The column is set for the ego only.
    It is 0 on a parking lot, where only the spots are lanes.
    """

    S = 0
    R = 1
    HEADING = 2
    SPEED = 3
    LENGTH = 4
    WIDTH = 5
    CRASHED = 6
    OFF_ROAD = 7


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """Recorded states of an episode, or of its end.

    Attributes
    ----------
    states : shape (frames, vehicles, 8), columns `Track`; vehicle 0 is the ego. A vehicle that is not there yet, or no
        longer, is 1,000 km away and has no size. On a closed road the ego's S counts on from lap to lap, and S of the
        others is within half a lap of it.
    road : the road of the frame of S and R; None on a road network, where the states are in the world frame.
    dt : time between two frames [s].
    from_reset : whether the first frame is the scene after the reset.
    world : the states in the world frame; None on a straight road, where they are not needed.
    """

    states: FloatArray
    road: Road | None
    dt: float
    from_reset: bool = True
    world: FloatArray | None = None

    @property
    def ego(self) -> FloatArray:
        """The ego's states, (frames, 8)."""
        return self.states[:, 0]

    @property
    def crash_frame(self) -> int | None:
        """First frame in which the ego has crashed, or None."""
        crashed = np.flatnonzero(self.ego[:, Track.CRASHED])
        return int(crashed[0]) if crashed.size else None

    @property
    def off_road(self) -> bool:
        """Whether the ego's centre ever left the road."""
        return bool(self.ego[:, Track.OFF_ROAD].any())

    def gaps(self, frame: int) -> FloatArray:
        """Clearance between the ego and each other vehicle in a frame [m], (vehicles - 1,)."""
        world = self._world()[frame, :, : Track.CRASHED]
        return separation(world[:1], world[1:])

    def min_gap(self) -> float:
        """Least clearance between the ego and another vehicle, up to a crash [m]; inf without others."""
        if self.states.shape[1] < 2:
            return float("inf")
        if self.crash_frame is not None:
            return 0.0
        return float(least_clearance(self._world()))

    def min_time_to_collision(self) -> float:
        """Least time to a collision at constant velocities, see `least_time_to_collision`; 0 in a crash [s]."""
        if self.crash_frame is not None:
            return 0.0
        return float(least_time_to_collision(self._world()))

    def min_headway(self) -> float:
        """Least time headway up to a crash [s], see `least_headway`; NaN on a road network, inf without a vehicle
        ahead.
        """
        if self.road is None:
            return float("nan")
        return float(least_headway(self.states[: self.crash_frame]))

    def mean_jerk(self) -> float:
        """Mean magnitude of the jerk along the path, up to a crash [m/s^3]; NaN with less than three frames."""
        sizes = self.jerks()
        return float(sizes.mean()) if sizes.size else np.nan

    def jerks(self) -> FloatArray:
        """Magnitude of the jerk along the path, frame by frame up to a crash [m/s^3], (frames - 2,)."""
        return jerk(self._driven()[:, Track.SPEED], self.dt)

    def mean_lateral_acceleration(self) -> float:
        """Mean magnitude of speed times yaw rate, up to a crash [m/s^2]; NaN with less than two frames."""
        driven = self._driven()
        rate = wrap_to_pi(np.diff(driven[:, Track.HEADING])) / self.dt
        return float(np.abs(driven[:-1, Track.SPEED] * rate).mean()) if rate.size else np.nan

    @property
    def moved(self) -> FloatArray:
        """The ego in the world frame (see `world`), (frames, 8)."""
        return self._world()[:, 0]

    def _driven(self) -> FloatArray:
        """The ego in the world frame, before a crash (which changes its speed within a frame)."""
        return self._world()[: self.crash_frame, 0]

    def _world(self) -> FloatArray:
        """States in the world frame, or on a straight road in a frame that is only rotated and translated."""
        return self.states if self.world is None else self.world


class Recorder:
    """Records one episode of an environment of highway-env, with any road and actions, or of a compiled one.

    Parameters
    ----------
    env : the environment, wrapped or not, after `reset`; each episode needs a new recorder.
    """

    def __init__(self, env: Any) -> None:
        base = env.unwrapped
        self._map = read_road(base.road.network)
        self._dt = 1.0 / base.config["simulation_frequency"]
        self._base = base
        if isinstance(base, CompiledHighwayEnv):
            # The compiled environment records its frames itself.
            self._rows: list[Any] = base.frames
            self._off_road: list[bool] = base.off_road
            self._column: dict[Any, int] = {}
            return
        road = base.road
        self._column = {base.vehicle: 0}
        self._rows, self._off_road = [], []
        self._sample()
        compiled = _compiled_frames(env)
        if compiled is not None:
            compiled.watchers.append(self._take)
            return
        inner = road.step

        def step(dt: float) -> None:
            inner(dt)
            self._sample()

        road.step = step

    def _take(self, bodies: list[Any], rows: FloatArray, on_road: BoolArray) -> None:
        """Add the compiled frames of a decision."""
        for frame, on in zip(rows.tolist(), on_road.tolist(), strict=True):
            self._add(bodies, frame, not on)

    def _sample(self) -> None:
        road = self._base.road
        # Landmarks, such as a goal, are no obstacles.
        bodies = [*road.vehicles, *(thing for thing in road.objects if thing.solid)]
        frame = [(v.position[0], v.position[1], v.heading, v.speed, v.LENGTH, v.WIDTH, v.crashed) for v in bodies]
        self._add(bodies, frame, is_off_road(self._base))

    def _add(self, bodies: list[Any], frame: list[Any], off_road: bool) -> None:
        """Add a frame; new vehicles get a column, and absent ones are far away."""
        for body in bodies:
            self._column.setdefault(body, len(self._column))
        row = [_AWAY] * len(self._column)
        for body, state in zip(bodies, frame, strict=True):
            row[self._column[body]] = state
        self._rows.append(row)
        self._off_road.append(off_road)

    @property
    def columns(self) -> dict[Any, int]:
        """Column of each recorded body, by the simulator's object; empty for a compiled environment."""
        return dict(self._column)

    def world(self) -> FloatArray:
        """The states of all frames so far in the world frame, (frames, bodies, 8), columns `Track`."""
        most = len(self._rows[-1])
        # Vehicles that entered later are absent in earlier frames.
        late = [most - len(row) for row in self._rows]
        rows = np.array([[*r, *[_AWAY] * n] if n else r for r, n in zip(self._rows, late, strict=True)], float)
        world = np.concatenate([rows, np.zeros((*rows.shape[:2], 1))], axis=-1)
        world[:, 0, Track.OFF_ROAD] = self._off_road
        return world

    def history(self) -> History:
        """All frames so far; the first is the scene after the reset."""
        world = self.world()
        if self._map is None:
            return History(world, None, self._dt, world=world)
        states = world.copy()
        if isinstance(self._map, StraightRoad):
            states[..., :4] = self._map.to_road(world[..., :4])
            return History(states, self._map, self._dt)
        ego = self._map.to_road(world[:, 0, :4])
        if self._map.closed:
            ego[:, Track.S] = np.unwrap(ego[:, Track.S], period=self._map.length)
        states[:, 0, :4] = ego
        states[:, 1:, :4] = self._map.to_road(world[:, 1:, :4], near=ego[:, None, Track.S])
        return History(states, self._map, self._dt, world=world)


def _compiled_frames(env: Any) -> CompiledFrames | None:
    """The wrapper that computes the frames, if there is one."""
    while not isinstance(env, CompiledFrames):
        if not isinstance(env, gym.Wrapper):
            return None
        env = env.env
    return env


def is_off_road(base: Any) -> bool:
    """Whether the ego of an environment of highway-env is off the road (see `Track`).

    Parameters
    ----------
    base : the unwrapped environment.
    """
    return not isinstance(base, ParkingEnv) and not bool(base.vehicle.on_road)


def read_road(network: Any) -> StraightRoad | PathRoad | None:
    """The road of a network; None if it is no single road of parallel lanes."""
    readers: tuple[Callable[[Any], StraightRoad | PathRoad], ...] = (StraightRoad.from_network, read_network)
    for read in readers:
        try:
            return read(network)
        except SceneError:
            continue
    return None
