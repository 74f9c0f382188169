"""Rows of somebody who is not there."""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.state import FloatArray
from shield.perception.spec import STATE, ObservationSpec

__all__ = ["Ghosts", "in_units"]

_LANE = 4.0
"""Between the middles of two lanes [m]."""
_SPEEDS = 15.0, 30.0
"""Ghosts drive along the road, no slower and no faster than this [m/s]."""


class Ghosts:
    """Some who are not there, on a straight highway: each appears at random within the range, anywhere across the road,
    and drives on for a few frames.

    Parameters
    ----------
    rate : how many appear in a decision in the mean; as many as a Poisson distribution says.
    lasting : frames that each is shown for.
    reach : how far ahead of the ego, and behind it, one may be [m].
    lanes : of the road.
    timing : duration of a frame [s], and frames in a decision.
    rng : what they are drawn by.
    """

    def __init__(
        self,
        rate: float,
        lasting: int,
        reach: tuple[float, float],
        lanes: int,
        timing: tuple[float, int],
        rng: np.random.Generator,
    ) -> None:
        self._rate, self._lasting, self._reach, self._lanes = rate, lasting, reach, lanes
        self._timing, self._rng = timing, rng
        self._frame: int | None = None
        self._states: FloatArray = np.zeros((0, 4))
        self._until = np.zeros(0, np.intp)

    def at(self, frame: int, ego_speed: float) -> FloatArray:
        """Who appears to be there: x ahead of the ego, y in the world [m], vx, vy [m/s], (n, 4).

        Parameters
        ----------
        frame : simulation frame since the reset; the same one again is the same instant.
        ego_speed : of the ego along the road since the frame that was asked for before [m/s].
        """
        if frame == self._frame:
            return self._states
        (dt, frames), (far, back) = self._timing, self._reach
        passed = frames if self._frame is None else frame - self._frame
        self._frame = frame
        x = self._states[:, 0] + (self._states[:, 2] - ego_speed) * passed * dt
        self._states[:, 0] = x
        left = (self._until > frame) & (-back <= x) & (x <= far)
        n = self._rng.poisson(self._rate * passed / frames)
        low, high = [-back, -_LANE / 2, _SPEEDS[0], 0.0], [far, (self._lanes - 0.5) * _LANE, _SPEEDS[1], 0.0]
        self._states = np.concatenate([self._states[left], self._rng.uniform(low, high, (n, 4))])
        self._until = np.concatenate([self._until[left], np.full(n, frame + self._lasting)])
        return self._states

    def shown_in(self, spec: ObservationSpec, shown: Any, ego: FloatArray, frame: int) -> Any:
        """An observation with them in it: in rows that are empty; where there is none, in place of the last, if that is
        further away. So the rows still show who is nearest.

        Parameters
        ----------
        shown : what the sensor shows of those who are there, (rows, features). ego : x, y, vx, vy of the ego, (4,).
        """
        column = spec.features.index("x")
        for x, y, vx, vy in self.at(frame, float(ego[2])):
            empty = np.flatnonzero(~np.abs(shown).max(axis=1).astype(bool))
            last = in_units(spec, "x", float(shown[-1, column])) - (ego[0] if spec.absolute else 0.0)
            if not len(empty) and abs(last) <= abs(x):
                continue
            state = np.array([x + ego[0], y, vx, vy]) - (0.0 if spec.absolute else ego)
            values = {"presence": 1.0, "cos_h": 1.0, **dict(zip(STATE, state, strict=True))}
            row = empty[0] if len(empty) else len(shown) - 1
            shown[row] = [_shown(spec, name, values.get(name, 0.0)) for name in spec.features]
        return shown


def in_units(spec: ObservationSpec, name: str, shown: Any) -> Any:
    """What is shown of a feature in its own unit [m], [m/s]."""
    low, high = spec.ranges.get(name, (-1.0, 1.0))  # type: ignore[union-attr]
    return low + (shown + 1.0) * (high - low) / 2.0


def _shown(spec: ObservationSpec, name: str, value: float) -> float:
    """The other way round."""
    if name not in spec.ranges:  # type: ignore[operator]
        return value
    low, high = spec.ranges[name]  # type: ignore[index]
    share = 2.0 * (value - low) / (high - low) - 1.0
    return min(max(share, -1.0), 1.0) if spec.clip else share
