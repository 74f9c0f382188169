"""Watches whether the traffic keeps to the assumptions, and counts each violation."""

from __future__ import annotations

import numpy as np

from dynamics.scenes.scene import Scene
from dynamics.state import FloatArray, RoadState, Vehicle
from dynamics.traffic.occupancy import Surroundings
from shield.certificate.kernels import may_break
from shield.config import ShieldConfig

__all__ = ["AssumptionMonitor"]

_TOLERANCE = 0.1
"""Slack on accelerations [m/s^2]."""


class AssumptionMonitor:
    """Compares each scene with the one before it.

    A vehicle counts as violating when it brakes or accelerates harder than assumed, crashes, or moves into the
    ego's way from another lane without leaving the gap from which the ego's fail-safe can still stop.

    Attributes
    ----------
    count : violations so far.
    violated : whether the last update saw one within the ego's stopping distance.
    """

    def __init__(self, config: ShieldConfig) -> None:
        self._config = config
        self._last: tuple[FloatArray, FloatArray] | None = None
        self.count = 0
        self.violated = False

    def update(self, scene: Scene, elapsed: float | None = None, around: Surroundings | None = None) -> None:
        """Take in the next scene, `elapsed` seconds after the last (one frame by default).

        Vehicles are matched by their order. `around` saves building the scene's surroundings once more.
        """
        self.violated = False
        rows, states = scene.others, scene.others_road
        last, self._last = self._last, None
        if rows.shape[0] == 0:
            return
        a = self._config.assumptions
        if around is None:
            around = Surroundings(rows, states, scene.road, a)
        self._last = (rows, around.hull)
        if last is None or last[0].shape != rows.shape:
            return
        before, hull = last
        ego, body = scene.ego_road, 0.5 * scene.ego[Vehicle.WIDTH]
        across = np.array([ego[RoadState.R] - body, ego[RoadState.R] + body])
        least, most, period = -a.braking - _TOLERANCE, a.acceleration + _TOLERANCE, elapsed or scene.dt
        if not may_break(rows, before, around.hull, hull, least, most, across, period):
            return
        speed = rows[:, Vehicle.SPEED]
        rate = (speed - before[:, Vehicle.SPEED]) / period
        found = ((rate < least) | (rate > most) | (rows[:, Vehicle.CRASHED] > 0)) & (before[:, Vehicle.CRASHED] == 0)
        (low, high), (low0, high0), (left, right) = around.hull, hull, across
        came = (low < right) & (high > left) & ~((low0 < right) & (high0 > left))
        if not (found | came).any():
            return
        ds = states[:, RoadState.S] - ego[RoadState.S]
        bumper = ds - 0.5 * (rows[:, Vehicle.LENGTH] + scene.ego[Vehicle.LENGTH])
        stop = max(float(ego[RoadState.SPEED]), 0.0) ** 2 / (2 * self._config.braking)
        room = bumper + np.maximum(speed, 0.0) ** 2 / (2 * a.braking) - stop
        found |= came & (ds > -0.5 * scene.ego[Vehicle.LENGTH]) & (room < self._config.buffer.longitudinal)
        self.count += int(found.sum())
        near = np.abs(ds) < stop + 50.0
        self.violated = bool((found & near).any())
