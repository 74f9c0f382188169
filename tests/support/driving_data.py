"""Random driving of the true bicycle, without an environment, and rigid motions of it."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from dynamics.learned.data.transitions import Transitions
from dynamics.learned.models.bicycle import BicycleModel


def driving(episodes: int = 12, steps: int = 30, seed: int = 0) -> Transitions:
    """Uniform random actions, each episode from another place and heading, at rest at first."""
    rng = np.random.default_rng(seed)
    heading = rng.uniform(-np.pi, np.pi, episodes)
    start = np.zeros((episodes, 6))
    start[:, :2] = rng.uniform(-20, 20, (episodes, 2))
    start[:, 4], start[:, 5] = np.cos(heading), np.sin(heading)
    actions = rng.uniform(-1, 1, (episodes, steps, 2))
    after = BicycleModel().rollout(start, actions)
    states = np.concatenate([start[:, None], after[:, :-1]], axis=1)
    numbers = np.repeat(np.arange(episodes), steps)
    return Transitions(states.reshape(-1, 6), actions.reshape(-1, 2), after.reshape(-1, 6), numbers, 0.2)


def moved(states: np.ndarray, x: float, y: float, angle: float) -> np.ndarray:
    """Parking states (..., 6) after a rotation about the origin and a translation."""
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s], [s, c]])
    pairs = states.reshape(*states.shape[:-1], 3, 2) @ turn.T
    pairs[..., 0, :] += (x, y)
    return pairs.reshape(states.shape)


angles = st.floats(-np.pi, np.pi)
coordinates = st.floats(-30, 30)
inputs = st.tuples(st.floats(-1, 1), st.floats(-1, 1)).map(np.array)


def _state(x: float, y: float, speed: float, heading: float) -> np.ndarray:
    c, s = np.cos(heading), np.sin(heading)
    return np.array([x, y, speed * c, speed * s, c, s])


states = st.builds(_state, coordinates, coordinates, st.floats(-10, 10), angles)
