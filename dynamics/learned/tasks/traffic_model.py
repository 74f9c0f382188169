"""Learned motion of the traffic relative to the ego, one decision later, for meta-actions.

Notation
--------
The state of a scene is the ego's (y [m], vy, vx [m/s]) and, for each of K vehicles, (presence, dx, dy [m], dvx, dvy
[m/s]) relative to the ego: highway-env's Kinematics observation in SI units. One shared model predicts the row of every
vehicle from its pair with the ego, z = (0, 0, y, vy, vx, dx, dy, dvx, dvy), and the one-hot meta-action u,

    z+ = z + dt (A(z, u) z + B(z, u) u)

(the two zeros replace the absolute position of other models, on which no quantity depends). The ego's own next state is
that of a pair with an absent vehicle.
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

__all__ = ["EGO", "PAIR", "VEHICLE", "TrafficModel", "collect_traffic", "traffic_config"]

EGO, VEHICLE, PAIR = 3, 5, 9
"""Number of entries of the ego, of each vehicle, and of a pair."""
_NOBODY = np.array([150.0, 0.0, 0.0, 0.0])
_REACH = (-30.0, 120.0)
"""Range of dx of the vehicles in the training data [m]."""


def traffic_config(actions: int, dt: float, seed: int = 0, members: int = 3) -> ModelConfig:
    """Configuration of the model of a pair, for `actions` meta-actions that last `dt` seconds."""
    return ModelConfig(
        state_dim=PAIR,
        action_dim=actions,
        dt=dt,
        form="plain",
        hidden=(48, 48),
        members=members,
        unit_heading=False,
        layout=Layout(position=(0, 1), heading=(2, 3), vectors=()),
        seed=seed,
    )


class TrafficModel:
    """A `DynamicsModel` of a whole scene; its action is the number of a meta-action.

    Parameters
    ----------
    pair : the fitted model of a pair.
    vehicles : K, number of rows of other vehicles in a state.

    Raises
    ------
    ConfigError
        If the model has another width, or there is no vehicle.
    """

    action_dim = 1

    def __init__(self, pair: LinearStructuredModel, vehicles: int) -> None:
        if pair.state_dim != PAIR or vehicles < 1:
            raise ConfigError(
                f"a model of a pair has {PAIR} state variables and a scene 1 vehicle or more, got {pair.state_dim} "
                f"and {vehicles}"
            )
        self.pair, self.vehicles, self.state_dim = pair, vehicles, EGO + VEHICLE * vehicles

    def step(self, states: Any, actions: Any) -> Any:
        """States one decision later: (n, d) and (n, 1) to (n, d).

        Raises
        ------
        ModelError
            If a shape is wrong, or an action does not exist.
        """
        check_batch(self, states, actions)
        states, number = np.asarray(states, np.float32), np.asarray(actions)[:, 0]
        if ((number < 0) | (number >= self.pair.action_dim) | (number != np.round(number))).any():
            raise ModelError(f"actions must be whole numbers from 0 to {self.pair.action_dim - 1}")
        n, k = len(states), self.vehicles
        others = states[:, EGO:].reshape(n, k, VEHICLE)
        pairs = np.zeros((n, k + 1, PAIR), np.float32)
        pairs[..., 2:5] = states[:, None, :EGO]
        pairs[:, 0, 5:] = _NOBODY
        pairs[:, 1:, 5:] = np.where(others[..., :1] > 0, others[..., 1:], _NOBODY)
        choice = np.eye(self.pair.action_dim, dtype=np.float32)[number.astype(int)]
        after = self.pair.step(pairs.reshape(-1, PAIR), np.repeat(choice, k + 1, axis=0)).reshape(n, k + 1, PAIR)
        out = np.empty_like(states)
        out[:, :EGO] = after[:, 0, 2:5]
        moved = out[:, EGO:].reshape(n, k, VEHICLE)
        moved[..., :1] = others[..., :1]
        moved[..., 1:] = after[:, 1:, 5:]
        out[:, EGO:] = moved.reshape(n, -1)
        return out


def collect_traffic(
    env: Any, decisions: int, seed: int = 0, policy: Any = None, explore: float = 1.0, first_reset: int = 0
) -> Transitions:
    """Pairs of the ego and each vehicle near it, read from the simulator's state over a number of decisions.

    Motions into a crash are left out.

    Parameters
    ----------
    env : a highway-env environment with meta-actions, on a road along x.
    decisions : number of decisions.
    seed : of the random actions. policy : the driving policy (SB3's `predict`); None for random meta-actions.
    explore : share of the decisions in which a random action replaces the policy's.
    first_reset : seed of the first reset; each further episode adds 1.

    Raises
    ------
    DataError
        If there was no vehicle near the ego.
    """
    base, driving = env.unwrapped, Exploration(env, seed, policy, explore, first_reset)
    runs: dict[tuple[int, int], list[tuple[Any, Any, Any]]] = {}
    for _ in range(decisions):
        action, before = driving.choose(), _pairs(base)
        over = driving.carry_out(action)
        if not base.vehicle.crashed:
            after, choice = _pairs(base), np.eye(env.action_space.n)[action]
            # In the order of the road: the order of a set would differ between runs.
            for key in before:
                if key in after and _REACH[0] < before[key][5] < _REACH[1]:
                    runs.setdefault((driving.episode, key), []).append((before[key], choice, after[key]))
        if over:
            driving.begin_anew()
    parts: list[tuple[Any, Any, Any]] = []
    names: list[int] = []
    for run in runs.values():
        for i, row in enumerate(run):
            # A vehicle that was out of range in between starts another sequence.
            if i == 0 or not np.array_equal(run[i - 1][2], row[0]):
                names.append((names[-1] if names else -1) + 1)
            else:
                names.append(names[-1])
            parts.append(row)
    if not parts:
        raise DataError("there was no vehicle near the ego; collect more decisions")
    x, u, y = (np.array(column) for column in zip(*parts, strict=True))
    dt = 1.0 / float(base.config["policy_frequency"])
    return Transitions(x, u, y, np.array(names), dt, {"env": str(env.spec and env.spec.id), "seed": seed})


def _pairs(base: Any) -> dict[int, Any]:
    """z of each vehicle, by its `id`."""
    ego = base.vehicle
    y, (vx, vy) = ego.position[1], ego.velocity
    out = {}
    for other in base.road.vehicles:
        if other is not ego:
            dx, dy = other.position - ego.position
            dvx, dvy = other.velocity - ego.velocity
            out[id(other)] = np.array([0.0, 0.0, y, vy, vx, dx, dy, dvx, dvy])
    return out
