"""Drift of a model's open-loop predictions from the recorded motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynamics.errors import DataError
from dynamics.learned.data.transitions import Transitions
from dynamics.learned.models.model import DynamicsModel
from dynamics.state import FloatArray

__all__ = ["OpenLoop", "open_loop"]


@dataclass(frozen=True, slots=True, eq=False)
class OpenLoop:
    """Errors of open-loop predictions.

    Attributes
    ----------
    position : distance between predicted and true position [m], shape (windows, horizon).
    """

    position: FloatArray

    def quantile(self, q: float) -> FloatArray:
        """Quantile of the position error over the windows [m], shape (horizon,)."""
        return np.asarray(np.quantile(self.position, q, axis=0))

    @property
    def median(self) -> FloatArray:
        """Median position error [m] after 1, 2, … decisions, shape (horizon,)."""
        return self.quantile(0.5)


def open_loop(
    model: DynamicsModel, data: Transitions, horizon: int = 15, position: tuple[int, int] = (0, 1)
) -> OpenLoop:
    """Predict every window of `horizon` decisions from its first state and its actions only.

    Parameters
    ----------
    position : columns of x and y [m].

    Raises
    ------
    DataError
        If no episode is long enough.
    """
    states, actions, after = data.sequences(horizon)
    if not len(states):
        raise DataError(f"no episode has {horizon} transitions in a row; shorten the horizon or collect longer ones")
    error = (model.rollout(states, actions) - after)[..., list(position)]
    return OpenLoop(np.asarray(np.hypot(error[..., 0], error[..., 1]), dtype=float))
