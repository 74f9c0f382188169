"""Vehicles that were well within sight and are not shown any more. A sensor in order does not lose them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from dynamics.state import FloatArray

__all__ = ["VanishedVehicles"]

_CHANGE = 6.0
"""Assumed greatest acceleration and braking of a vehicle since then [m/s^2]."""
_MARGIN = 6.0
"""A vehicle predicted within this distance of an edge of sight may have left it [m]."""
_SAME = 6.0, 4.5
"""A vehicle shown within this distance of the possible positions of a vanished one counts as that one: along and across
the road [m]."""


@dataclass(slots=True)
class VanishedVehicles:
    """Vehicles that vanished within sight, and their possible positions.

    Attributes
    ----------
    ends : least and greatest x of each [m], (n, 2). speeds : least and greatest vx [m/s], (n, 2).
    across : y of each [m], (n,).
    """

    ends: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    speeds: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    across: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __len__(self) -> int:
        return len(self.across)

    def go_on(self, lost: FloatArray, shown: FloatArray, x: float, edges: tuple[float, float], passed: float) -> None:
        """Update with another observation.

        Parameters
        ----------
        lost : predicted x, y [m] and vx [m/s] of the vehicles of the last observation that are not shown, (k, 3).
        shown : x and y of the shown vehicles, (m, 2) [m]. x : of the ego [m].
        edges : distance ahead and behind within which every vehicle is seen [m].
        passed : time since the last observation [s].
        """
        change = _CHANGE * passed
        slower = np.maximum(self.speeds[:, :1] - change, np.minimum(self.speeds[:, :1], 0.0))
        speeds = np.concatenate([slower, self.speeds[:, 1:] + change], axis=1)
        ends = self.ends + 0.5 * passed * (self.speeds + speeds)
        stray = 0.5 * change * passed * np.array([-1.0, 1.0])
        ends = np.concatenate([ends, lost[:, :1] + stray])
        speeds = np.concatenate([speeds, lost[:, 2:] + change * np.array([-1.0, 1.0])])
        across = np.concatenate([self.across, lost[:, 1]])
        ahead, behind = x + edges[0] - _MARGIN, x - edges[1] + _MARGIN
        within = (ends[:, 0] < ahead) & (ends[:, 1] > behind)
        along = (shown[None, :, 0] > ends[:, :1] - _SAME[0]) & (shown[None, :, 0] < ends[:, 1:] + _SAME[0])
        found = along & (np.abs(shown[None, :, 1] - across[:, None]) < _SAME[1])
        kept = within & ~found.any(axis=1)
        self.ends, self.speeds, self.across = ends[kept], speeds[kept], across[kept]

    def states(self, x: float) -> FloatArray:
        """Assumed states x, y [m], vx and vy [m/s], (n, 4), for an ego at x: the nearest and slowest possible ahead,
        the nearest and fastest possible behind."""
        found = np.zeros((len(self), 4))
        ahead = self.ends.mean(axis=1) >= x
        found[:, 0] = np.where(ahead, self.ends[:, 0], self.ends[:, 1])
        found[:, 1] = self.across
        found[:, 2] = np.where(ahead, self.speeds[:, 0], self.speeds[:, 1])
        return found
