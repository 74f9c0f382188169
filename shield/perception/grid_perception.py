"""`GridPerception`: scenes from occupancy grids.

A cell is a bound, not a measurement with noise. A vehicle may be anywhere in its cell, and its offset persists from one
grid to the next, so nothing is smoothed. Each body is extended over all its possible positions.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from dynamics.scenes.scene import EgoControl, Scene
from dynamics.state import BoolArray, FloatArray, IntArray, RoadState, State, Vehicle
from shield.decision import Guarantee
from shield.errors import ConfigError, SceneError
from shield.perception.bodies import unseen_bodies
from shield.perception.grid_sighting import DecodedGrid, covered_distance, decode_grid
from shield.perception.grid_spec import GridSpec
from shield.perception.perceiving import PerceptionConfig
from shield.perception.unseen import UnseenBehind, unseen_ahead

__all__ = ["GridPerception"]

_X, _Y, _HEADING, _SPEED = int(State.X), int(State.Y), int(State.HEADING), int(State.SPEED)
_ACCELERATION, _SIDEWAYS = 6.0, 4.0
"""Deviation of a vehicle from constant velocity: greatest acceleration along the road [m/s^2] and greatest lateral
speed [m/s]. A vehicle further away is another one."""
_SURE = 0.5
"""Additional tolerance of that deviation [m]."""
_EXACT = 1e-3
"""Numbers known within this count as exact [m], [m/s]."""
_BESIDE = 0.5
"""Distance from a cell to a lane centre [m], up to which the lane may be that of a vehicle in the cell."""


class GridPerception:
    """Makes scenes from OccupancyGrid observations, the only source for the traffic.

    The ego's row is an argument, because a grid does not show it. An unseen vehicle is assumed beyond the grid, and
    wherever a cell may hide a second vehicle (`shield.perception.unseen`).

    Parameters
    ----------
    spec : meaning of the observations.
    road : the static road map, a `dynamics.roads.straight.StraightRoad`.
    timing : duration of a simulation frame [s], and simulation frames in a decision.
    config : settings; only `PerceptionConfig.unseen` applies here.

    Raises
    ------
    ConfigError
        If the grid does not reach across the road, or the sensor has noise or a delay.

    Attributes
    ----------
    behind : vehicles that may be unseen behind.
    edges : distance ahead and behind within which every vehicle is seen [m].
    """

    def __init__(
        self, spec: GridSpec, road: Any, timing: tuple[float, int], config: PerceptionConfig | None = None
    ) -> None:
        self.spec, self._road, self._timing = spec, road, timing
        self.config = PerceptionConfig() if config is None else config
        if self.config.noise is not None or self.config.delay:
            raise ConfigError("noise and delay are of Kinematics observations; a grid has neither")
        breadth = float(road.centers[-1] - road.centers[0])
        if min(covered_distance(spec, -breadth, breadth, 0.0)) <= 0:
            raise ConfigError(
                f"the grid does not reach across the road: set config['observation']['grid_size'] to at least "
                f"{-breadth:g} to {breadth:g} across, it is {spec.size[1]}"
            )
        self.reset()

    def reset(self) -> None:
        """Clear everything about the episode."""
        self.behind = UnseenBehind()
        self.edges = self.spec.distance, self.spec.distance
        self._frame: int | None = None
        self._ids: IntArray = np.zeros(0, np.intp)
        self._low = self._high = np.zeros((0, 4))
        self._next = 1

    @property
    def rating(self) -> tuple[Guarantee, float]:
        """Guarantee and probability level of a certificate for the scene seen last (see `Decision`)."""
        everybody = min(self.edges) >= self.spec.distance and not self.spec.hides
        return (Guarantee.ALL_SEEN if everybody else Guarantee.ASSUMED), 1.0

    @property
    def alarmed(self) -> bool:
        """Always False: a sensor without noise has no monitor."""
        return False

    def see(self, observation: Any, frame: int, control: EgoControl, ego: FloatArray | None = None) -> Scene:
        """Scene that an observation shows.

        Parameters
        ----------
        observation : of shape `spec.shape`, or flattened.
        frame : index of the simulation frame since the episode began. A second call with the same frame updates no
            state.
        control : the ego's target command, and the commands available to it.
        ego : its vehicle row, (7,).

        Raises
        ------
        SceneError
            If the observation cannot be read, or `ego` is None.
        """
        if ego is None:
            raise SceneError("a grid does not show the ego's own state: pass its vehicle row")
        place = self._road.to_road(ego)
        heading, r = float(place[RoadState.HEADING]), float(place[RoadState.R])
        sighting = decode_grid(self.spec, observation, heading)
        velocity = _velocity(ego)
        low, high = sighting.low.copy(), sighting.high.copy()
        for bound in (low, high):
            bound[:, :2] += ego[[_X, _Y]]
            bound[:, 2:] += velocity
        if frame != self._frame:
            self._take_in(low, high, ego, 0.0 if self._frame is None else (frame - self._frame) * self._timing[0])
            self._frame = frame
            self._mark_sensed_area(sighting, r, heading)
        rows = self._bodies(low, high, float(ego[_X]))
        unseen, to_road = self.config.unseen, self._road.to_road
        ghosts = np.concatenate(
            [
                unseen_ahead(self.spec, self.edges[0], unseen, self._road, place, to_road(rows)),  # type: ignore[arg-type]
                self.behind.states(unseen, self._road, place, self.spec.distance),
            ]
        )
        beyond = unseen_bodies(self._road.to_world(ghosts), self.spec.body)
        hidden = self._hidden(sighting, ego, r)
        nobody = np.full(len(beyond) + len(hidden), -1)
        return Scene(
            ego=ego,
            others=np.concatenate([rows, beyond, hidden]),
            road=self._road,
            control=control,
            dt=self._timing[0],
            frames_per_decision=self._timing[1],
            frame=frame,
            ids=np.concatenate([self._ids, nobody]),
            blurred=bool(((high - low) > _EXACT).any()),
            observed=True,
        )

    def _take_in(self, low: FloatArray, high: FloatArray, ego: FloatArray, passed: float) -> None:
        """Identify the observed vehicles with earlier ones, and list the lost and the new ones.

        Parameters
        ----------
        low, high : bounds of x, y [m], vx, vy [m/s] of the observed vehicles in the world frame, (n, 4).
        ego : the ego's row, (7,). passed : time since the previous observation [s].
        """
        ids, before = np.full(len(low), -1), (self._low + self._high) / 2
        expected = before.copy()
        expected[:, :2] += passed * before[:, 2:]
        now, wide = (low + high) / 2, (self._high - self._low)[:, None] / 2 + (high - low) / 2
        apart = np.abs(expected[:, None] - now)
        reach = (
            wide[..., :2]
            + _SURE
            + passed * wide[..., 2:]
            + passed * np.array([0.5 * _ACCELERATION * passed, _SIDEWAYS])
        )
        near: BoolArray = np.asarray((apart[..., :2] <= reach).all(axis=2))
        if not (wide > _EXACT).any():
            cost = np.where(near, apart[..., :2].sum(axis=2), 1e6)
            rows, columns = linear_sum_assignment(cost)
            kept = near[rows, columns]
            rows, columns = rows[kept], columns[kept]
        else:
            # An ambiguous match is left out, since an identity narrows the bounds by earlier knowledge.
            rows, columns = np.nonzero(near & (near.sum(axis=0) == 1) & (near.sum(axis=1) == 1)[:, None])
        ids[columns] = self._ids[rows]
        new = ids < 0
        ids[new] = self._next + np.arange(int(new.sum()))
        gone = np.ones(len(expected), dtype=bool)
        gone[rows] = False
        self._next += int(new.sum())
        self._lost = np.column_stack([expected[gone][:, 0] - ego[_X], expected[gone][:, 1], expected[gone][:, 2]])
        self._new = np.column_stack([now[new][:, 0] - ego[_X], now[new][:, 1], now[new][:, 2]])
        self._passed, self._ego_speed = passed, float(_velocity(ego)[0])
        self._ids, self._low, self._high = ids, low, high

    def _mark_sensed_area(self, sighting: DecodedGrid, r: float, heading: float) -> None:
        """Update the edges of sight, and the vehicles that may be beyond the edge behind.

        Parameters
        ----------
        r : lateral position of the ego on the road [m]. heading : of the ego, relative to the road [rad].
        """
        centers = self._road.centers
        far, back = covered_distance(self.spec, float(centers[0]) - r, float(centers[-1]) - r, heading)
        if sighting.cut:
            far, back = min(far, self.spec.body[0]), min(back, self.spec.body[0])
        self.edges = far, back
        self.behind.go_on(self.config.unseen, back, self._ego_speed, self._passed, self._lost, self._new)

    def _bodies(self, low: FloatArray, high: FloatArray, x: float) -> FloatArray:
        """Vehicle rows (n, 7) that cover all possible positions of the observed vehicles; x is the ego's [m]."""
        middle = (low + high) / 2
        # The conservative speed is the greatest behind the ego, and the least ahead of it.
        vx, vy = np.where(middle[:, 0] < x, high[:, 2], low[:, 2]), middle[:, 3]
        sign = np.where(vx < 0, -1.0, 1.0)
        rows = np.zeros((len(low), len(Vehicle)))
        rows[:, [_X, _Y]] = middle[:, :2]
        rows[:, _HEADING], rows[:, _SPEED] = np.arctan2(sign * vy, sign * vx), sign * np.hypot(vx, vy)
        rows[:, [Vehicle.LENGTH, Vehicle.WIDTH]] = self.spec.body + (high - low)[:, :2]
        return rows

    def _hidden(self, sighting: DecodedGrid, ego: FloatArray, r: float) -> FloatArray:
        """Vehicle rows of vehicles that a cell may hide beside the visible one, (n, 7).

        A cell holds two bodies only if there is room for both: in another lane, or in the same lane if the cell is
        longer than a body.
        """
        spec, unseen, rows = self.spec, self.config.unseen, []
        if not spec.hides:
            return np.zeros((0, len(Vehicle)))
        own = np.array([[0.0, 0.0]])
        shown = np.concatenate([own, np.stack([sighting.low[:, 1], sighting.high[:, 1]], axis=1)])
        length, width = spec.body
        for k, (x0, x1, y0, y1) in enumerate(sighting.cells):
            lanes = self._road.centers - r
            beside = _BESIDE if k else 0.0
            inside = lanes[(lanes >= y0 - beside) & (lanes <= y1 + beside)]
            for lane in inside:
                apart = np.abs(shown[k] - lane).max()
                if x1 - x0 <= length and (apart < width or (len(inside) < 2 and k)):
                    continue
                speed = unseen.slowest if x0 + x1 > 0 else unseen.fastest
                center = ego[_X] + (x0 + x1) / 2, ego[_Y] + lane
                rows.append((*center, 0.0, speed, length + x1 - x0, width, 0.0))
        return np.array(rows, float).reshape(-1, len(Vehicle))


def _velocity(row: FloatArray) -> FloatArray:
    """vx, vy of a vehicle row, (2,) [m/s]."""
    velocity: FloatArray = row[_SPEED] * np.array([np.cos(row[_HEADING]), np.sin(row[_HEADING])])
    return velocity
