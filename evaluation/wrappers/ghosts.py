"""False detections: rows of vehicles that do not exist."""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.state import FloatArray
from shield.perception.spec import STATE, ObservationSpec

__all__ = ["FalseDetections", "in_units"]

_LANE = 4.0
"""Distance of the centre lines of two lanes [m]."""
_SPEEDS = 15.0, 30.0
"""Range of speeds of false detections, which move along the road [m/s]."""


class FalseDetections:
    """False detections on a straight highway.

    Each appears at a random position within the range and across the road, and moves on for a few frames.

    Parameters
    ----------
    rate : mean number of new ones in a decision, with a Poisson distribution.
    lasting : number of frames for which each is shown.
    reach : range ahead of the ego and behind it [m].
    lanes : number of lanes of the road.
    timing : duration of a frame [s], and frames in a decision.
    rng : random generator.
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
        """States of the false detections: x ahead of the ego, y in the world frame [m], vx, vy [m/s], (n, 4).

        Parameters
        ----------
        frame : simulation frame since the reset; a repeated call for the same frame has the same result.
        ego_speed : speed of the ego along the road since the frame of the last call [m/s].
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
        """Insert the false detections into an observation.

        They take empty rows; without one, they replace the last row if that is farther away. So the rows still hold the
        nearest vehicles.

        Parameters
        ----------
        spec : format of the observation.
        shown : the sensor's observation of real vehicles, (rows, features).
        ego : x, y, vx, vy of the ego, (4,).
        frame : simulation frame since the reset.
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
    """Convert shown values of a feature to its own unit [m], [m/s]."""
    low, high = spec.ranges.get(name, (-1.0, 1.0))  # type: ignore[union-attr]
    return low + (shown + 1.0) * (high - low) / 2.0


def _shown(spec: ObservationSpec, name: str, value: float) -> float:
    """Convert a value of a feature to the observation's units; the inverse of `in_units`."""
    if name not in spec.ranges:  # type: ignore[operator]
        return value
    low, high = spec.ranges[name]  # type: ignore[index]
    share = 2.0 * (value - low) / (high - low) - 1.0
    return min(max(share, -1.0), 1.0) if spec.clip else share
