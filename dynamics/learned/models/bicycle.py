"""The true bicycle of highway-env as a dynamics model: the reference for planners with a learned model.

Notation
--------
State (x, y [m], vx, vy [m/s], cos psi, sin psi), as in `parking-v0` without its scales; the speed is v = vx cos psi +
vy sin psi. A decision lasts F frames of dt seconds with one input (a, delta). With the slip angle beta =
atan(tan(delta) / 2) and c = sin(beta) / (L/2), highway-env's Euler frames add up to

    v_k   = v_0 + k a dt              psi_k = psi_0 + c dt (v_0 + ... + v_{k-1})
    x_k   = x_0 + dt (v_0 cos(psi_0 + beta) + ... + v_{k-1} cos(psi_{k-1} + beta)),    y_k with the sine

so that a rollout of any length is three cumulative sums. Beyond `bicycle.MAX_SPEED` the acceleration is limited and the
sums do not hold; those rollouts use the compiled frames of `dynamics.vehicle.rollouts`.
Source: `Vehicle.step` of highway-env 1.12 (see `dynamics.vehicle.bicycle`).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.errors import ModelError
from dynamics.learned.models.model import check_batch
from dynamics.state import State
from dynamics.vehicle.actuators import Actuators
from dynamics.vehicle.bicycle import LENGTH, MAX_SPEED
from dynamics.vehicle.rollouts import Rollouts

__all__ = ["BicycleModel"]


class BicycleModel:
    """highway-env's kinematic bicycle as a `DynamicsModel` with a fast `rollout_held`.

    Parameters
    ----------
    actuators : range of the normalised actions; actions beyond [-1, 1] are clipped, as by the environment.
    dt : duration of a simulation frame [s].
    frames : simulation frames in a decision.
    dtype : floating type of the computation.

    Examples
    --------
    >>> model = BicycleModel()
    >>> model.step(np.array([[0.0, 0, 2, 0, 1, 0]]), np.array([[0.5, 0.0]])).round(3)
    array([[0.433, 0.   , 2.5  , 0.   , 1.   , 0.   ]])
    """

    state_dim = 6

    def __init__(
        self, actuators: Actuators | None = None, dt: float = 1 / 15, frames: int = 3, dtype: Any = np.float64
    ) -> None:
        if not (np.isfinite(dt) and dt > 0 and frames >= 1):
            raise ModelError(f"dt must be positive [s] and frames at least 1, got {dt!r} and {frames!r}")
        self.actuators = actuators if actuators is not None else Actuators()
        self.action_dim = self.actuators.size
        self.dt, self.frames, self.dtype = float(dt), int(frames), np.dtype(dtype)
        self._rollouts: Rollouts | None = None

    @classmethod
    def of(cls, env: Any, dtype: Any = np.float64) -> BicycleModel:
        """The model of an environment with `ContinuousAction` on the kinematic bicycle.

        Raises
        ------
        ModelError
            If its actions are of another kind, or limit the speed.
        """
        base = getattr(env, "unwrapped", env)
        kind = base.action_type
        if type(kind).__name__ != "ContinuousAction" or kind.dynamical or kind.speed_range:
            raise ModelError(
                f"the bicycle model needs ContinuousAction with dynamical=False and without speed_range; this "
                f"environment has {type(kind).__name__}"
            )
        frames = int(base.config["simulation_frequency"] // base.config["policy_frequency"])
        return cls(Actuators.of(kind), 1 / base.config["simulation_frequency"], frames, dtype)

    def step(self, states: Any, actions: Any) -> Any:
        """States one decision later: (n, 6) and (n, m) to (n, 6)."""
        check_batch(self, states, actions)
        return self._roll(states, np.asarray(actions)[:, None], 1)[:, -1]

    def rollout(self, states: Any, actions: Any) -> Any:
        """States after each decision: (n, 6) and (n, H, m) to (n, H, 6)."""
        return self.rollout_held(states, actions, 1)

    def rollout_held(self, states: Any, actions: Any, hold: int) -> Any:
        """States at the end of each block: (n, 6) and (n, blocks, m), held `hold` decisions each, to (n, blocks, 6)."""
        check_batch(self, states, actions, sequences=True)
        if hold < 1:
            raise ModelError(f"hold must be 1 or more decisions, got {hold}")
        return self._roll(states, actions, hold)

    def _roll(self, states: Any, actions: Any, hold: int) -> Any:
        """States at the end of each block by cumulative sums; shapes as in `rollout_held`."""
        states, actions = np.asarray(states, self.dtype), np.asarray(actions, self.dtype)
        (n, blocks), frames = actions.shape[:2], self.frames * hold
        if n == 0 or blocks == 0:
            return np.empty((n, blocks, 6), self.dtype)
        inputs = self.actuators.physical(np.clip(actions, -1.0, 1.0)).astype(self.dtype)
        x, y, vx, vy, cos, sin = states.T
        speed, heading = vx * cos + vy * sin, np.arctan2(sin, cos)
        gain = inputs[..., 0, None] * self.dt * np.arange(1, frames + 1, dtype=self.dtype)
        v = (speed[:, None] + np.cumsum(gain[..., -1], axis=1))[..., None] + (gain - gain[..., -1:])
        if max(np.abs(speed).max(), np.abs(v).max()) > MAX_SPEED:
            return self._limited(x, y, heading, speed, inputs, frames)
        before = v - inputs[..., 0, None] * self.dt
        beta = np.arctan(0.5 * np.tan(inputs[..., 1]))[..., None]
        turn = before * (np.sin(beta) / (LENGTH / 2) * self.dt)
        psi = heading[:, None] + np.cumsum(turn.reshape(n, -1), axis=1)
        along = psi.reshape(turn.shape) - turn + beta
        out = np.empty((n, blocks, 6), self.dtype)
        way = before * self.dt
        out[..., 0] = x[:, None] + np.cumsum((way * np.cos(along)).sum(axis=-1), axis=1)
        out[..., 1] = y[:, None] + np.cumsum((way * np.sin(along)).sum(axis=-1), axis=1)
        self._write(out, psi[:, frames - 1 :: frames], v[..., -1])
        return out

    def _limited(self, x: Any, y: Any, heading: Any, speed: Any, inputs: Any, frames: int) -> Any:
        """The rollout frame by frame, with the limits beyond `MAX_SPEED`."""
        if self._rollouts is None:
            self._rollouts = Rollouts(self.dt)
        start = np.stack([x, y, heading, speed], axis=-1).astype(float)
        track = self._rollouts.run_inputs(start, np.repeat(inputs.astype(float), frames, axis=1))
        track = track[:, frames - 1 :: frames]
        out = np.empty((*track.shape[:2], 6), self.dtype)
        out[..., :2] = track[..., : State.Y + 1]
        self._write(out, track[..., State.HEADING], track[..., State.SPEED])
        return out

    @staticmethod
    def _write(out: Any, psi: Any, v: Any) -> None:
        """Fill in velocities and headings, columns 2 to 5, from headings `psi` [rad] and speeds `v` [m/s]."""
        out[..., 4], out[..., 5] = np.cos(psi), np.sin(psi)
        out[..., 2], out[..., 3] = v * out[..., 4], v * out[..., 5]
