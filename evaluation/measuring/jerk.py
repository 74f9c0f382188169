"""Jerk, in two units: as physics has it, and as Dong et al. 2023 have it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dynamics.state import FloatArray

__all__ = ["jerk", "normalised_jerk"]


def jerk(speeds: ArrayLike, dt: float) -> FloatArray:
    """Size of the jerk along the way [m/s^3], shape (n - 2,).

    Parameters
    ----------
    speeds : at n times [m/s], shape (n,).
    dt : time between two of them [s].

    Examples
    --------
    >>> jerk([0.0, 1.0, 2.0, 4.0], dt=0.5).tolist()
    [0.0, 4.0]
    """
    size: FloatArray = np.abs(np.diff(np.asarray(speeds, float), 2) / dt**2)
    return size


def normalised_jerk(accelerations: ArrayLike, steerings: ArrayLike, acceleration_range: float) -> FloatArray:
    """Change of what is commanded from one decision to the next: (|da| / range + 2 |ddelta| / pi) / 2, in [0, 1] for
    steering within pi / 4 to both sides, shape (n - 1,).

    Parameters
    ----------
    accelerations : commanded at n decisions [m/s^2], shape (n,).
    steerings : steering angles of the same decisions [rad], shape (n,).
    acceleration_range : between full braking and full throttle [m/s^2].

    Examples
    --------
    >>> normalised_jerk([-5.0, 5.0], [0.0, 0.0], acceleration_range=10.0).tolist()
    [0.5]
    """
    push, turn = (np.abs(np.diff(np.asarray(values, float))) for values in (accelerations, steerings))
    size: FloatArray = 0.5 * (push / acceleration_range + 2.0 * turn / np.pi)
    return size
