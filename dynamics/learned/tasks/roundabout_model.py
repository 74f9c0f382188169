"""Learned motion of vehicles in highway-env's roundabout: the ego under its meta-actions, other vehicles by their next
exit.

Notation
--------
Positions p = (x, y) [m] and velocities v [m/s] are in the world frame. The centre of the roundabout is 0, and traffic
turns towards smaller angles. Four arms leave it at k 90°, each with its exit at k 90° + `ALPHA` and its entry at k 90°
- `ALPHA`; a quarter turn maps the road onto itself. So a vehicle is described in the frame of its nearest arm. With R_k
the rotation by k 90° and k the nearest arm,

    z = R_k' (x, y, vx, vy),    z+ = z + dt (A(z, u) z + B(z, u) u),    (x, y, vx, vy)+ = R_k z+

For the ego, u is the one-hot meta-action, and 1 if it leaves at the next exit, else 0. For another vehicle, u is (1, 0)
if it stays on at the next exit, and (0, 1) if it leaves there. Its exit cannot be observed, so a scene contains both:
each vehicle has two rows, and a planner keeps clear of both.

The state of a scene is the ego's (x, y, vx, vy, c, s) and, for each row, (presence, x, y, vx, vy, c, s, leaves). Here
(c, s) is the direction of motion, or the last one before the vehicle stopped.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.errors import ConfigError, DataError, ModelError
from dynamics.learned.data.transitions import Transitions
from dynamics.learned.models.body_frame import Layout
from dynamics.learned.models.linear import LinearStructuredModel, ModelConfig
from dynamics.learned.models.model import check_batch
from dynamics.learned.tasks.exploration import Exploration

__all__ = ["ALPHA", "EGO", "ROW", "RoundaboutModel", "arm_of", "collect_roundabout", "next_exit", "roundabout_config"]

EGO, ROW = 6, 8
"""Number of entries of the ego, and of each row of another vehicle."""
ALPHA = float(np.deg2rad(24.0))
"""Angle between an arm and its exit, and its entry [rad]. Source: `RoundaboutEnv._make_road` in highway-env 1.12."""
_QUARTER = np.pi / 2
_MOVING = 0.5
"""Least speed at which the velocity determines the direction of a vehicle [m/s]."""
_PAIR = 6
"""Columns of z: two that are always 0, in place of the position of other models, and four."""


def roundabout_config(inputs: int, dt: float, seed: int = 0, members: int = 3) -> ModelConfig:
    """Configuration of the model of a vehicle, for `inputs` entries of u and decisions of `dt` seconds."""
    return ModelConfig(
        state_dim=_PAIR,
        action_dim=inputs,
        dt=dt,
        form="plain",
        hidden=(64, 64),
        members=members,
        unit_heading=False,
        layout=Layout(position=(0, 1), heading=(4, 5), vectors=((2, 3),)),
        seed=seed,
    )


def arm_of(x: Any, y: Any) -> Any:
    """The arm k in 0..3 nearest to a position, of the shape of x and y [m]."""
    return np.round(np.arctan2(y, x) / _QUARTER).astype(int) % 4


def next_exit(x: Any, y: Any) -> Any:
    """The arm in 0..3 of the next exit of a vehicle at a position, of the shape of x and y [m]."""
    return (np.ceil((np.arctan2(y, x) - ALPHA) / _QUARTER).astype(int) - 1) % 4


def _turned(motion: Any, arm: Any, back: bool = False) -> Any:
    """R_k' of (x, y, vx, vy), shape (..., 4), or R_k if `back`; exact, since the rotations are quarter turns."""
    c, s = np.array([1, 0, -1, 0])[arm], np.array([0, 1, 0, -1])[arm]
    s = (-s if back else s)[..., None]
    first, second = motion[..., 0::2], motion[..., 1::2]
    out = np.empty_like(motion)
    out[..., 0::2] = c[..., None] * first + s * second
    out[..., 1::2] = c[..., None] * second - s * first
    return out


def _direction(velocity: Any, before: Any) -> Any:
    """Unit vector of a velocity (..., 2); `before` where the vehicle is too slow."""
    speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
    return np.where(speed > _MOVING, velocity / np.maximum(speed, _MOVING), before)


class RoundaboutModel:
    """A `StepModel` of a whole scene; its action is the number of a meta-action.

    The motion of the other vehicles does not depend on the ego's: the model does not assume that they give way.

    Parameters
    ----------
    ego, others : the fitted models.
    rows : number of rows of other vehicles in a state.
    exit_arm : the arm in 0..3 at which the ego wants to leave.

    Raises
    ------
    ConfigError
        If the models have other widths, or a number is out of range.
    """

    action_dim = 1

    def __init__(self, ego: LinearStructuredModel, others: LinearStructuredModel, rows: int, exit_arm: int) -> None:
        if (ego.state_dim, others.state_dim, others.action_dim) != (_PAIR, _PAIR, 2) or ego.action_dim < 2:
            raise ConfigError(
                f"models of vehicles have {_PAIR} state variables, the others' 2 inputs; got {ego.state_dim}, "
                f"{others.state_dim} and {others.action_dim}"
            )
        if rows < 1 or exit_arm not in range(4):
            raise ConfigError(f"a scene has 1 row or more and an exit arm in 0..3, got {rows} and {exit_arm}")
        self.ego, self.others, self.rows, self.exit_arm = ego, others, rows, exit_arm
        self.actions, self.state_dim = ego.action_dim - 1, EGO + ROW * rows

    def step(self, states: Any, actions: Any) -> Any:
        """States one decision later: (n, d) and (n, 1) to (n, d).

        Raises
        ------
        ModelError
            If a shape is wrong, or an action does not exist.
        """
        check_batch(self, states, actions)
        states, number = np.asarray(states, np.float32), np.asarray(actions)[:, 0]
        if ((number < 0) | (number >= self.actions) | (number != np.round(number))).any():
            raise ModelError(f"actions must be whole numbers from 0 to {self.actions - 1}")
        out = np.empty_like(states)
        wanted = next_exit(states[:, 0], states[:, 1]) == self.exit_arm
        choice = np.concatenate([np.eye(self.actions)[number.astype(int)], wanted[:, None]], axis=1)
        out[:, :EGO] = _moved(self.ego, states[:, :EGO], choice)
        # The plans of a search share scenes; the model is evaluated once for each distinct scene.
        scenes, which = np.unique(states[:, EGO:], axis=0, return_inverse=True)
        rows = scenes.reshape(-1, ROW)
        after = rows.copy()
        there = rows[:, 0] > 0
        if there.any():
            leaves = rows[there, 7:]
            after[there, 1:7] = _moved(self.others, rows[there, 1:7], np.concatenate([1 - leaves, leaves], axis=1))
        out[:, EGO:] = after.reshape(scenes.shape)[which.reshape(-1)]
        return out


def _moved(model: LinearStructuredModel, vehicles: Any, inputs: Any) -> Any:
    """(x, y, vx, vy, c, s) one decision later, (n, 6)."""
    # The arm of a position that is not finite is arbitrary; the result is not finite either.
    arm = arm_of(*np.nan_to_num(vehicles[:, :2]).T)
    z = np.zeros((len(vehicles), _PAIR), np.float32)
    z[:, 2:] = _turned(vehicles[:, :4], arm)
    after = _turned(model.step(z, inputs)[:, 2:], arm, back=True)
    return np.concatenate([after, _direction(after[:, 2:], vehicles[:, 4:6])], axis=1)


def collect_roundabout(
    env: Any, decisions: int, seed: int = 0, policy: Any = None, explore: float = 1.0, first_reset: int = 0
) -> tuple[Transitions, Transitions]:
    """Motions of the ego and of the other vehicles, read from the simulator's state over a number of decisions.

    On the way in and on an exit, it makes no difference whether a vehicle leaves at the next exit; there the motion is
    stored under both inputs. Velocities are clipped as in the environment's observations, which a planner reads.
    Motions into a crash are left out. Motions of other vehicles that come to a stop after a crash are kept, since they
    are obstacles. Each motion is an episode of its own, as its frame changes from one to the next.

    Parameters
    ----------
    env : roundabout-v0, or a wrapper of it.
    decisions : number of decisions.
    seed : of the random actions. policy : the driving policy (SB3's `predict`); None for random meta-actions.
    explore : share of the decisions in which a random action replaces the policy's.
    first_reset : seed of the first reset; each further episode adds 1.

    Raises
    ------
    ConfigError
        If the environment is not highway-env's roundabout.
    DataError
        If there are no motions of the ego or of others.
    """
    base = env.unwrapped
    if type(base).__name__ != "RoundaboutEnv":
        raise ConfigError(f"motions are collected in highway-env's RoundaboutEnv, got {type(base).__name__}")
    ranges = getattr(base.observation_type, "features_range", None) or {}
    reach = np.array([np.inf, np.inf, *(ranges.get(name, (0.0, np.inf))[1] for name in ("vx", "vy"))])
    ego: list[tuple[Any, Any, Any]] = []
    others: list[tuple[Any, Any, Any]] = []
    driving = Exploration(env, seed, policy, explore, first_reset)
    bound = _destinations(base)
    for _ in range(decisions):
        action = driving.choose()
        vehicles = list(base.road.vehicles)
        before = [(_motion(v, reach), v.lane_index, v.crashed) for v in vehicles]
        over = driving.carry_out(action)
        for v, (was, lane, crashed) in zip(vehicles, before, strict=True):
            if v.crashed and (v is base.vehicle or not crashed):
                continue
            leaves = bool(next_exit(*was[:2]) == bound[id(v)])
            if v is base.vehicle:
                ego.append((was, np.append(np.eye(env.action_space.n)[action], leaves), _motion(v, reach)))
            else:
                flags = (leaves,) if len(lane[0]) == len(lane[1]) == 2 else (False, True)
                others.extend((was, np.array([not flag, flag], float), _motion(v, reach)) for flag in flags)
        if over:
            driving.begin_anew()
            bound = _destinations(base)
    if not ego or not others:
        raise DataError(f"{decisions} decisions gave {len(ego)} motions of the ego and {len(others)} of the others")
    dt = 1.0 / float(base.config["policy_frequency"])
    return _transitions(ego, dt, seed), _transitions(others, dt, seed)


def _motion(vehicle: Any, reach: Any) -> Any:
    """(x, y, vx, vy) of a vehicle, clipped to `reach`."""
    return np.clip(np.concatenate([vehicle.position, vehicle.velocity]), -reach, reach)


def _destinations(base: Any) -> dict[int, int]:
    """The arm of each vehicle's exit, by its `id`."""
    return {id(v): "eswn".index(v.route[-1][1][0]) for v in base.road.vehicles}


def _transitions(rows: list[tuple[Any, Any, Any]], dt: float, seed: int) -> Transitions:
    """Motions as transitions of the model, in the frame of the nearest arm."""
    x, u, y = (np.array(column, float) for column in zip(*rows, strict=True))
    arm = arm_of(x[:, 0], x[:, 1])
    blank = np.zeros((len(x), 2))
    seen = (np.concatenate([blank, _turned(motion, arm)], axis=1) for motion in (x, y))
    before, after = seen
    return Transitions(before, u, after, np.arange(len(x)), dt, {"env": "roundabout-v0", "seed": seed})
