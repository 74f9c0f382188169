"""How well it is known where somebody is: the probability that a track's centre is within a distance."""

from __future__ import annotations

import numpy as np

from dynamics.state import FloatArray
from shield.perception.tracking import Tracks

__all__ = ["within"]

_RINGS = 16
"""A normal distribution is taken to be that many rings of that many points, all as likely."""


def _points() -> FloatArray:
    """Points of a standard normal distribution in the plane, (n, 2): radii are quantiles of Rayleigh's distribution."""
    ring, turn = np.meshgrid(np.arange(_RINGS), np.arange(_RINGS), indexing="ij")
    radius = np.sqrt(-2.0 * np.log1p(-(ring + 0.5) / _RINGS))
    angle = 2.0 * np.pi * (turn + 0.5 * (ring % 2)) / _RINGS
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1).reshape(-1, 2)


_POINTS = _points()


def within(tracks: Tracks, distance: float) -> FloatArray:
    """Probability of each that its centre is no further than `distance` [m] from the mean of its track, (n,).

    Of the mixture of the three filters, by points that are drawn once and for all, to about 0.03.
    """
    covariances = tracks.covariances[:, :, :2, :2] + 1e-12 * np.eye(2)
    spread = np.linalg.cholesky(covariances) @ _POINTS.T
    apart = (tracks.means - tracks.mean[:, None])[:, :, :2, None] + spread
    inside = np.square(apart).sum(axis=2) <= distance**2
    found: FloatArray = np.einsum("nj,nj->n", tracks.chances, inside.mean(axis=2))
    return found
