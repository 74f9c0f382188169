"""Who may slip in alongside the ego in one scene: `shield.certificate.clauses.slip_in`, asked for its paths."""

from __future__ import annotations

import numpy as np

from dynamics.scenes.scene import Scene
from dynamics.state import FloatArray, RoadState, Vehicle
from dynamics.traffic.occupancy import Surroundings
from dynamics.vehicle.rollouts import NO_LIMIT, Rollouts
from shield.certificate.clauses.footprint import Footprint
from shield.certificate.clauses.slip_in import Slips, anybody, least_separations_of_slips, may_slip
from shield.config import ShieldConfig

__all__ = ["Alongside"]

_LASTS = 1.0
"""Within this time such a vehicle has reached the other lane [s]."""


class Alongside:
    """Who may slip in alongside the ego in one scene, and how near that would come.

    Parameters
    ----------
    scene, config, around : the scene, the shield's settings, and the scene's surroundings.
    """

    def __init__(self, scene: Scene, config: ShieldConfig, around: Surroundings) -> None:
        self._scene, self._config, self._around = scene, config, around
        found = np.empty((2 * len(scene.others), 4))
        a, road = config.assumptions, scene.road
        count = 0
        if a.slip_in and len(scene.others):
            count = may_slip(
                around.others,
                around.states,
                around.bodies.first != around.bodies.last,
                scene.ego_road,
                float(scene.ego[Vehicle.LENGTH]),
                road.centers,
                around.lane,
                a.visible_distance,
                a.braking,
                found,
            )
        self.rows = found[:count, 0].astype(np.intp)
        self._sweep: FloatArray | None = None
        self._bounds = np.empty((2, count, 0))
        if not count:
            return
        states = around.states[self.rows]
        self._slips = Slips(
            states[:, RoadState.S].copy(),
            states[:, RoadState.SPEED].copy(),
            road.centers[found[:count, 1].astype(np.intp)],
            np.ascontiguousarray(found[:count, 2:].T),
            around.reach[self.rows],
            a.acceleration,
            a.braking,
        )

    def __len__(self) -> int:
        return len(self.rows)

    def separations(self, paths: FloatArray, size: Footprint) -> FloatArray:
        """Least separation of each path from each of them, (n, len(self)) [m]; +inf where they stay apart.

        Parameters
        ----------
        paths : road states of the ego after frames 1..K, (n, K, 4).
        size : the ego's footprint.
        """
        rows, dt, frames = self.rows, self._scene.dt, paths.shape[1]
        out = np.full((len(paths), len(rows)), np.inf)
        centers, sight = self._scene.road.centers, self._config.assumptions.visible_distance
        if not anybody(paths, self._slips, centers, sight, dt):
            return out
        if frames > self._bounds.shape[2]:
            longer = frames + frames // 4
            front = self._around.front(longer, rows=rows)
            self._bounds = np.stack([self._around.rear(longer, rows=rows), front])
        if self._sweep is None:
            self._sweep = self._swept()
        least_separations_of_slips(
            paths,
            size,
            self._slips,
            self._bounds[0],
            self._bounds[1],
            self._sweep,
            centers,
            sight,
            dt,
            out,
        )
        return out

    def _swept(self) -> FloatArray:
        """Where each body is across the road after 1..T frames of its lane change, (m, T, 2) [m]."""
        dt, road = self._scene.dt, self._scene.road
        states, frames = self._around.states[self.rows], int(np.ceil(_LASTS / self._scene.dt))
        commands = np.empty((len(states), frames, 3))
        commands[..., 0], commands[..., 1] = self._slips.goals[:, None], states[:, RoadState.SPEED, None]
        commands[..., 2] = NO_LIMIT
        path = Rollouts(dt, road).run(states, commands)
        length, width = self._around.others[self.rows][:, [Vehicle.LENGTH, Vehicle.WIDTH]].T[..., None]
        sin, cos = np.abs(np.sin(path[..., RoadState.HEADING])), np.abs(np.cos(path[..., RoadState.HEADING]))
        half = 0.5 * (length * sin + width * cos)
        low, high = path[..., RoadState.R] - half, path[..., RoadState.R] + half
        own = self._around.hull[:, self.rows]
        return np.stack(
            [
                np.minimum.accumulate(np.minimum(low, own[0][:, None]), axis=1),
                np.maximum.accumulate(np.maximum(high, own[1][:, None]), axis=1),
            ],
            axis=-1,
        )
