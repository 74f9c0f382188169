"""Position certainty of a track: the probability that its centre is within a distance of the mean."""

from __future__ import annotations

import numpy as np

from dynamics.state import FloatArray
from shield.perception.tracking import Tracks

__all__ = ["probability_within"]

_RINGS = 16
"""A normal distribution is approximated by this many rings of as many points, of equal probability."""


def _points() -> FloatArray:
    """Points that represent a standard normal distribution in the plane, (n, 2); the radii are quantiles of the
    Rayleigh distribution."""
    ring, turn = np.meshgrid(np.arange(_RINGS), np.arange(_RINGS), indexing="ij")
    radius = np.sqrt(-2.0 * np.log1p(-(ring + 0.5) / _RINGS))
    angle = 2.0 * np.pi * (turn + 0.5 * (ring % 2)) / _RINGS
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1).reshape(-1, 2)


_POINTS = _points()


def probability_within(tracks: Tracks, distance: float) -> FloatArray:
    """Probability of each vehicle that its centre is at most `distance` [m] from the mean of its track, (n,).

    The probability is that of the mixture of the three filters, from a fixed set of points, with an error of about
    0.03.
    """
    covariances = tracks.covariances[:, :, :2, :2] + 1e-12 * np.eye(2)
    spread = np.linalg.cholesky(covariances) @ _POINTS.T
    apart = (tracks.means - tracks.mean[:, None])[:, :, :2, None] + spread
    inside = np.square(apart).sum(axis=2) <= distance**2
    found: FloatArray = np.einsum("nj,nj->n", tracks.chances, inside.mean(axis=2))
    return found
