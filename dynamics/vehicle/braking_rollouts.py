"""Rollouts of braking with constant inputs in each decision period: the fail-safe of an agent that acts only once a
decision.

Notation
--------
A *stop* per candidate is (r*, b, delta_max): the target lateral position [m], the deceleration [m/s^2] and the greatest
wheel angle [rad]. At the start of each period of h frames the inputs are

    a     = -min(b, max(v, 0) / (h dt))
    delta = clip(steering_control(x, r*), -delta_max, delta_max)

so that the ego brakes at b and comes to rest at the end of a period. On a curved road the steering uses the curvature
there (`dynamics.vehicle.curved_bicycle`). Source of the steering control: `ControlledVehicle.steering_control` of
highway-env 1.12, sampled once in a period.
"""

from __future__ import annotations

import numpy as np

from dynamics.roads.path import PathRoad
from dynamics.roads.straight import StraightRoad
from dynamics.state import FloatArray
from dynamics.vehicle.rollout_kernels import roll_stops, table_of

__all__ = ["BrakingRollouts"]


class BrakingRollouts:
    """Rollouts for one frame duration and decision period on one road.

    Parameters
    ----------
    dt : frame duration [s].
    hold : number of frames with the same inputs.
    road : the road; its road frame is that of the states. All straight roads have the same rollouts.
    """

    def __init__(self, dt: float, hold: int, road: StraightRoad | PathRoad | None = None) -> None:
        self.dt, self.hold = float(dt), int(hold)
        self._table = table_of(road)

    def run(self, states: FloatArray, stops: FloatArray, periods: int) -> FloatArray:
        """Brake from each state.

        Parameters
        ----------
        states : road states, (n, 4). stops : (n, 3). periods : number of decision periods.

        Returns
        -------
        Road states after each frame, (n, periods * hold, 4).
        """
        states, stops = (np.ascontiguousarray(x, float) for x in (states, stops))
        paths = np.empty((len(states), periods * self.hold, 4))
        roll_stops(states, stops, self.hold, self._table, self.dt, paths)
        return paths
