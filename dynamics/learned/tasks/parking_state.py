"""The state of a vehicle that is to be parked, and its observation in `parking-v0`.

The state has the six columns of highway-env's `KinematicsGoal` observation, in SI units: position [m], velocity [m/s]
and heading as (cos, sin), all in the world frame. The observation is the state divided by `SCALES`. Only this module
uses the scales.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any

import numpy as np

from dynamics.errors import DataError
from dynamics.state import FloatArray

__all__ = ["ACTION_DIM", "DT", "SCALES", "STATE_DIM", "Parking", "goal", "observation", "state"]

SCALES = np.array([100.0, 100.0, 5.0, 5.0, 1.0, 1.0])
"""Divisors of the observation (`ParkingEnv.default_config` of highway-env 1.12) [m, m, m/s, m/s, 1, 1]."""
STATE_DIM, ACTION_DIM = 6, 2
DT = 0.2
"""Duration of a decision [s] (`policy_frequency` 5 Hz)."""


class Parking(IntEnum):
    """Columns of a parking state: [m], [m], [m/s], [m/s], cosine and sine of the heading; world frame."""

    X = 0
    Y = 1
    VX = 2
    VY = 3
    COS = 4
    SIN = 5


def state(observation: Any) -> FloatArray:
    """The ego's state in SI units, (..., 6), from a `parking-v0` observation (a dict with the key "observation").

    Raises
    ------
    DataError
        If it is no such observation.

    Examples
    --------
    >>> state({"observation": np.array([0.1, -0.2, 1.0, 0.0, 1.0, 0.0])}).tolist()
    [10.0, -20.0, 5.0, 0.0, 1.0, 0.0]
    """
    return _read(observation, "observation")


def goal(observation: Any) -> FloatArray:
    """The goal state, (..., 6), SI units; its speed is 0.

    Raises
    ------
    DataError
        If it is no `parking-v0` observation.
    """
    return _read(observation, "desired_goal")


def observation(states: Any) -> FloatArray:
    """States in SI units (..., 6) as they appear in the observation."""
    found: FloatArray = np.asarray(states, dtype=float) / SCALES
    return found


def _read(observation: Any, key: str) -> FloatArray:
    """One entry of a `parking-v0` observation in SI units, (..., 6)."""
    try:
        array = np.asarray(observation[key], dtype=float)
    except (KeyError, IndexError, TypeError, ValueError):
        have = sorted(observation) if isinstance(observation, dict) else type(observation).__name__
        raise DataError(
            f"a KinematicsGoal observation has the key {key!r} with {STATE_DIM} numbers; got {have}"
        ) from None
    if array.shape[-1:] != (STATE_DIM,):
        raise DataError(f"{key!r} must have {STATE_DIM} numbers (x, y, vx, vy, cos_h, sin_h), got shape {array.shape}")
    found: FloatArray = array * SCALES
    return found
