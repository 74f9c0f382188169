"""Warm start of OSQP: the last solution's slack and multipliers, shifted in time with the plan.

The deviations start at zero, which is the rollout of the guess; the guess is the last plan shifted.
"""

from __future__ import annotations

import numpy as np

from dynamics.state import FloatArray
from mpc.filter.problem import FilterSettings
from mpc.filter.program.linearised import ENDS
from mpc.filter.program.rows import SOFT, TURNS
from mpc.filter.solvers.guess import in_force

__all__ = ["WarmStart"]


class WarmStart:
    """Slack [m] and multipliers, each in its row's own unit; owned by one solver and cleared by its `reset`.

    Rows and unknowns are those of `mpc.filter.program.sparse`.

    Parameters
    ----------
    settings : stages, moves, and cost of slack.
    """

    def __init__(self, settings: FilterSettings) -> None:
        self._settings = settings
        moves, n = len(settings.moves), settings.stages
        self._inputs, self._states = 2 * moves, 4 * n
        stages: list[list[int]] = []
        ends: list[list[int]] = []
        row, k = 4 * n + 3 * moves, 0
        for j, length in enumerate(settings.moves):
            for _ in range(length):
                stages.append([*range(4 * k, 4 * k + 4), *range(row, row + SOFT)])
                row, k = row + SOFT, k + 1
            ends.append([4 * n + 2 * j, 4 * n + 2 * j + 1, 4 * n + 2 * moves + j, *range(row, row + TURNS)])
            row += TURNS
        self._of_stage, self._of_move = np.array(stages), np.array(ends)
        self._last = np.cumsum(settings.moves) - 1
        self._move = np.repeat(np.arange(moves), settings.moves)
        self._size = row + ENDS
        self.forget()

    def forget(self) -> None:
        """Reset to a start without active constraints except the slack at zero."""
        moves = len(self._settings.moves)
        self._slack, self._multipliers = np.zeros(moves), np.zeros(self._size)
        self._multipliers[self._of_move[:, 2]] = -self._settings.penalty

    def shift(self, frames: int) -> None:
        """Shift by `frames` frames: each stage takes the values in force at its start."""
        stage = in_force(frames, self._settings)
        move = self._move[stage[self._last]]
        kept = self._multipliers.copy()
        kept[self._of_stage] = self._multipliers[self._of_stage[stage]]
        kept[self._of_move] = self._multipliers[self._of_move[move]]
        self._multipliers, self._slack = kept, self._slack[move]

    def keep(self, x: FloatArray, y: FloatArray) -> None:
        """Store the slack of the unknowns x, and multipliers y in the rows' own units."""
        self._slack, self._multipliers = x[self._inputs + self._states :].copy(), y

    def start(self, hold: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Initial unknowns and multipliers for a program with rows multiplied by `hold`."""
        x = np.zeros(self._inputs + self._states + self._slack.size)
        x[self._inputs + self._states :] = self._slack
        return x, self._multipliers / hold
