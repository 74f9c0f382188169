"""What everybody did in an episode, frame by frame, read from the simulator's state.

The recorder wraps `road.step` on the instance: it reads after each simulation frame and changes
nothing, so an episode with it and one without are the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np

from dynamics.road import StraightRoad
from dynamics.state import FloatArray

__all__ = ["History", "Recorder", "Track"]


class Track(IntEnum):
    """Columns of a history, in the road frame: [m], [m], [rad], [m/s], [m], [m], 0 or 1."""

    S = 0
    R = 1
    HEADING = 2
    SPEED = 3
    LENGTH = 4
    WIDTH = 5
    CRASHED = 6


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """Recorded states of an episode, or of its end.

    Attributes
    ----------
    states : shape (frames, vehicles, 7), columns `Track`; vehicle 0 is the ego.
    road : the road that S and R refer to.
    dt : time between two frames [s].
    from_reset : whether the first frame is the scene that the episode was reset to.
    """

    states: FloatArray
    road: StraightRoad
    dt: float
    from_reset: bool = True

    @property
    def ego(self) -> FloatArray:
        """The ego's states, shape (frames, 7)."""
        return self.states[:, 0]

    @property
    def crash_frame(self) -> int | None:
        """First frame in which the ego counts as crashed, or None."""
        crashed = np.flatnonzero(self.ego[:, Track.CRASHED])
        return int(crashed[0]) if crashed.size else None

    def gaps(self, frame: int) -> FloatArray:
        """Clearance between the ego and each other vehicle in a frame [m], shape (vehicles - 1,).

        Footprints are the smallest boxes along the road that hold the rotated rectangles.
        """
        return clearance(self.states[frame, 0], self.states[frame, 1:])

    def min_gap(self) -> float:
        """Smallest clearance between the ego and anybody, up to a crash [m]; inf when alone."""
        if self.states.shape[1] < 2:
            return float("inf")
        end = self.crash_frame
        if end is not None:
            return 0.0
        return float(clearance(self.states[:, :1], self.states[:, 1:]).min())


def clearance(first: FloatArray, second: FloatArray) -> FloatArray:
    """Distance between the road-aligned boxes of vehicles [m]; 0 when they overlap."""
    half_1, half_2 = _half_extents(first), _half_extents(second)
    along = np.abs(second[..., Track.S] - first[..., Track.S]) - half_1[0] - half_2[0]
    across = np.abs(second[..., Track.R] - first[..., Track.R]) - half_1[1] - half_2[1]
    distance: FloatArray = np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0))
    return distance


def _half_extents(states: FloatArray) -> tuple[FloatArray, FloatArray]:
    cos, sin = (
        np.abs(np.cos(states[..., Track.HEADING])),
        np.abs(np.sin(states[..., Track.HEADING])),
    )
    length, width = states[..., Track.LENGTH], states[..., Track.WIDTH]
    return (length * cos + width * sin) / 2, (length * sin + width * cos) / 2


class Recorder:
    """Records one episode of a highway-env environment.

    Parameters
    ----------
    env : the environment, wrapped or not, after `reset`; make a recorder for each episode.

    Raises
    ------
    SceneError
        If the road is not one that `StraightRoad` can describe.
    """

    def __init__(self, env: Any) -> None:
        base = env.unwrapped
        road = base.road
        self._map = StraightRoad.from_network(road.network)
        self._dt = 1.0 / base.config["simulation_frequency"]
        others = [vehicle for vehicle in road.vehicles if vehicle is not base.vehicle]
        self._vehicles = [base.vehicle, *others, *road.objects]
        self._rows: list[list[tuple[float, ...]]] = []
        inner = road.step

        def step(dt: float) -> None:
            inner(dt)
            self._sample()

        road.step = step
        self._sample()

    def _sample(self) -> None:
        self._rows.append(
            [(v.position[0], v.position[1], v.heading, v.speed, v.LENGTH, v.WIDTH, v.crashed) for v in self._vehicles]
        )

    def history(self) -> History:
        """All frames so far; the first is the scene after reset."""
        states = np.array(self._rows, dtype=float)
        states[..., :4] = self._map.to_road(states[..., :4])
        return History(states, self._map, self._dt)
