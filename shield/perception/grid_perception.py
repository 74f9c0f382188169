"""`GridPerception`: the scene as an occupancy grid shows it.

A cell is a bound and not a measurement with noise: what is in it is anywhere in it, from one grid to the next the same
way off, so that nothing is smoothed. Each body reaches as far as it may be.
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
from shield.perception.grid_sighting import GridSighting, decode_grid, reach_of
from shield.perception.grid_spec import GridSpec
from shield.perception.perceiving import PerceptionConfig
from shield.perception.unseen import Behind, ahead

__all__ = ["GridPerception"]

_X, _Y, _HEADING, _SPEED = int(State.X), int(State.Y), int(State.HEADING), int(State.SPEED)
_ACCELERATION, _SIDEWAYS = 6.0, 4.0
"""Nobody is further from where its velocity has brought it than this acceleration explains [m/s^2], or further across
than this velocity [m/s]; else it is somebody else."""
_SURE = 0.5
"""And this [m]."""
_EXACT = 1e-3
"""Numbers that are known as well as this are taken to be exact [m], [m/s]."""
_BESIDE = 0.5
"""A lane whose middle is no further than this from a cell may hold somebody who is in the cell [m]."""


class GridPerception:
    """Makes scenes of OccupancyGrid observations: nothing of the traffic is read but these.

    What a grid does not show of the ego, it is told: where across the road it is, its heading and its speed. Beyond
    the grid, and where a cell may hide a second vehicle, somebody unseen is assumed (`shield.perception.unseen`).

    Parameters
    ----------
    spec : what the observations mean.
    road : the static road map, a `dynamics.roads.straight.StraightRoad`.
    timing : duration of a simulation frame [s], and simulation frames in a decision.
    config : settings; only what is assumed of the unseen has a meaning here.

    Raises
    ------
    ConfigError
        If the grid does not reach across the road, or the sensor is noisy or late.

    Attributes
    ----------
    behind : who may be there unseen. edges : how far ahead and behind everybody is seen [m].
    """

    def __init__(
        self, spec: GridSpec, road: Any, timing: tuple[float, int], config: PerceptionConfig | None = None
    ) -> None:
        self.spec, self._road, self._timing = spec, road, timing
        self.config = PerceptionConfig() if config is None else config
        if self.config.noise is not None or self.config.delay:
            raise ConfigError("noise and delay are of Kinematics observations; a grid has neither")
        breadth = float(road.centers[-1] - road.centers[0])
        if min(reach_of(spec, -breadth, breadth, 0.0)) <= 0:
            raise ConfigError(
                f"the grid does not reach across the road: set config['observation']['grid_size'] to at least "
                f"{-breadth:g} to {breadth:g} across, it is {spec.size[1]}"
            )
        self.reset()

    def reset(self) -> None:
        """Forget everything about the episode."""
        self.behind = Behind()
        self.edges = self.spec.distance, self.spec.distance
        self._frame: int | None = None
        self._ids: IntArray = np.zeros(0, np.intp)
        self._low = self._high = np.zeros((0, 4))
        self._next = 1

    @property
    def rating(self) -> tuple[Guarantee, float]:
        """What a certificate for the scene seen last rests on, and the level of its bounds (see `Decision`)."""
        everybody = min(self.edges) >= self.spec.distance and not self.spec.hides
        return (Guarantee.ALL_SEEN if everybody else Guarantee.ASSUMED), 1.0

    @property
    def alarmed(self) -> bool:
        """Nobody watches a sensor without noise."""
        return False

    def see(self, observation: Any, frame: int, control: EgoControl, ego: FloatArray | None = None) -> Scene:
        """The scene that an observation shows.

        Parameters
        ----------
        observation : of shape `spec.shape`, or flattened.
        frame : index of the simulation frame since the episode began; one that has been seen already is the same
            instant.
        control : what the ego has been told, and what it can be told.
        ego : its vehicle row, (7,).

        Raises
        ------
        SceneError
            If the observation cannot be read, or nobody says where the ego is.
        """
        if ego is None:
            raise SceneError("a grid does not show the ego's own state, which has to be told")
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
            self._look_around(sighting, r, heading)
        rows = self._bodies(low, high, float(ego[_X]))
        unseen, to_road = self.config.unseen, self._road.to_road
        ghosts = np.concatenate(
            [
                ahead(self.spec, self.edges[0], unseen, self._road, place, to_road(rows)),  # type: ignore[arg-type]
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
        """Find out who is who, and who has got out of sight."""
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
            # Of two who may be the same, neither is taken for it: bounds are narrowed by what was known before.
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

    def _look_around(self, sighting: GridSighting, r: float, heading: float) -> None:
        """Find out how far everybody is seen, and who may be behind that."""
        centers = self._road.centers
        far, back = reach_of(self.spec, float(centers[0]) - r, float(centers[-1]) - r, heading)
        if sighting.cut:
            far, back = min(far, self.spec.body[0]), min(back, self.spec.body[0])
        self.edges = far, back
        self.behind.go_on(self.config.unseen, back, self._ego_speed, self._passed, self._lost, self._new)

    def _bodies(self, low: FloatArray, high: FloatArray, x: float) -> FloatArray:
        """Vehicle rows (n, 7) that reach as far as those seen may, with an ego at x [m]."""
        middle = (low + high) / 2
        # Who is faster behind, and slower ahead, is more in the way.
        vx, vy = np.where(middle[:, 0] < x, high[:, 2], low[:, 2]), middle[:, 3]
        sign = np.where(vx < 0, -1.0, 1.0)
        rows = np.zeros((len(low), len(Vehicle)))
        rows[:, [_X, _Y]] = middle[:, :2]
        rows[:, _HEADING], rows[:, _SPEED] = np.arctan2(sign * vy, sign * vx), sign * np.hypot(vx, vy)
        rows[:, [Vehicle.LENGTH, Vehicle.WIDTH]] = self.spec.body + (high - low)[:, :2]
        return rows

    def _hidden(self, sighting: GridSighting, ego: FloatArray, r: float) -> FloatArray:
        """Vehicle rows of those who may be in a cell beside the one that is shown there, (n, 7).

        Two bodies are in one cell only where there is room for both: in another lane, or in the same where a cell is
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
