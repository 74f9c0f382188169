"""Jerk in two definitions: the physical one, and the normalised one of Dong et al. 2023."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dynamics.state import FloatArray

__all__ = ["jerk", "normalised_jerk"]


def jerk(speeds: ArrayLike, dt: float) -> FloatArray:
    """Magnitude of the jerk along the path [m/s^3], (n - 2,).

    Parameters
    ----------
    speeds : speeds at n times [m/s], (n,).
    dt : time step [s].

    Examples
    --------
    >>> jerk([0.0, 1.0, 2.0, 4.0], dt=0.5).tolist()
    [0.0, 4.0]
    """
    size: FloatArray = np.abs(np.diff(np.asarray(speeds, float), 2) / dt**2)
    return size


def normalised_jerk(accelerations: ArrayLike, steerings: ArrayLike, acceleration_range: float) -> FloatArray:
    """Normalised change of the command from one decision to the next, (n - 1,).

    It is (|da| / range + 2 |ddelta| / pi) / 2, in [0, 1] for steering within pi / 4 to both sides.

    Parameters
    ----------
    accelerations : commanded accelerations of n decisions [m/s^2], (n,).
    steerings : steering angles of the same decisions [rad], (n,).
    acceleration_range : difference of full throttle and full braking [m/s^2].

    Examples
    --------
    >>> normalised_jerk([-5.0, 5.0], [0.0, 0.0], acceleration_range=10.0).tolist()
    [0.5]
    """
    push, turn = (np.abs(np.diff(np.asarray(values, float))) for values in (accelerations, steerings))
    size: FloatArray = 0.5 * (push / acceleration_range + 2.0 * turn / np.pi)
    return size
