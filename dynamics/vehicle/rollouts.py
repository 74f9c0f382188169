"""Closed-loop rollouts of the ego, compiled: many candidates over many frames in one call.

Notation
--------
A *command* per frame is (r*, v*, b): the lateral position of the target lane's centre [m], the target speed [m/s], and
the greatest deceleration [m/s^2]. The acceleration is

    a = max(KP (v* - v), -b, -max(v, 0) / dt)

so that with b = NO_LIMIT and v* >= 0 it is highway-env's own control, bit for bit in exact arithmetic, and with v* =
BRAKE the vehicle brakes at b to a stop and stays there. An *input* per frame is (a, delta): acceleration [m/s^2] and
front wheel angle [rad], without a controller. On a curved road (see `dynamics.vehicle.curved_bicycle`) r* is a line
along the road, and the steering uses its curvature.
"""

from __future__ import annotations

import numpy as np

from dynamics.roads.path import PathRoad
from dynamics.roads.straight import StraightRoad
from dynamics.state import FloatArray
from dynamics.vehicle.rollout_kernels import (
    NO_LIMIT,
    StopTargets,
    roll_brakes,
    roll_commands,
    roll_inputs,
    roll_targets,
    table_of,
)

__all__ = ["BRAKE", "NO_LIMIT", "Rollouts"]

BRAKE = -1e9
"""Target speed that means braking as hard as the command allows [m/s]."""


class Rollouts:
    """Rollouts for one frame duration on one road.

    Parameters
    ----------
    dt : frame duration [s].
    road : the road; its road frame is that of the states. All straight roads have the same rollouts.
    """

    def __init__(self, dt: float, road: StraightRoad | PathRoad | None = None) -> None:
        self.dt = float(dt)
        self._table = table_of(road)

    def run(self, state: FloatArray, commands: FloatArray) -> FloatArray:
        """Roll out several command sequences.

        Parameters
        ----------
        state : road state, shape (4,), or one for each sequence, (n, 4).
        commands : shape (n, frames, 3).

        Returns
        -------
        Road states after each frame, shape (n, frames, 4).
        """
        n, frames, _ = commands.shape
        paths = np.empty((n, frames, 4))
        roll_commands(self._starts(state, n), np.ascontiguousarray(commands, float), self._table, self.dt, paths)
        return paths

    def run_brakes(self, state: FloatArray, centers: FloatArray, targets: StopTargets, frames: int) -> FloatArray:
        """Track lanes and speeds for some frames, and then brake to a stop.

        Parameters
        ----------
        state : road state, shape (4,).
        centers : of the lanes [m]. targets : of the n paths.
        frames : number of frames in total.

        Returns
        -------
        Road states after each frame, shape (n, frames, 4).
        """
        paths = np.empty((len(targets.speeds), frames, 4))
        roll_targets(state, centers, targets, self._table, self.dt, paths)
        return paths

    def run_inputs(self, state: FloatArray, inputs: FloatArray) -> FloatArray:
        """Roll out several sequences of raw inputs.

        Parameters
        ----------
        state : road state, shape (4,), or one for each sequence, (n, 4).
        inputs : acceleration [m/s^2] and front wheel angle [rad] of each frame, shape (n, frames, 2). They are applied
            unchanged, except for highway-env's limits on the acceleration above `bicycle.MAX_SPEED`.

        Returns
        -------
        Road states after each frame, shape (n, frames, 4).
        """
        n, frames, _ = inputs.shape
        paths = np.empty((n, frames, 4))
        roll_inputs(self._starts(state, n), np.ascontiguousarray(inputs, float), self._table, self.dt, paths)
        return paths

    def stop(self, began: FloatArray, goals: FloatArray, braking: float, frames: int) -> FloatArray:
        """Continue paths with braking to a stop while steering to a line: commands (r*, BRAKE, braking).

        Parameters
        ----------
        began : road states after the first frames, (n, h, 4).
        goals : target lateral positions [m], (n k,): the first k continue the first path, and so on.
        braking : deceleration [m/s^2].
        frames : number of frames of braking.

        Returns
        -------
        Road states, (n k, h + frames, 4).
        """
        paths = np.empty((len(goals), began.shape[1] + frames, 4))
        roll_brakes(began, goals, float(braking), self._table, self.dt, paths)
        return paths

    @staticmethod
    def _starts(state: FloatArray, n: int) -> FloatArray:
        starts = np.empty((n, 4))
        starts[:] = state
        return starts
