"""Episodes of a variant in a batch, one row each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dynamics.state import BoolArray, FloatArray, IntArray
from evaluation.measuring.tally import begin_tally, empty_tallies, tally
from evaluation.reproduction.batch import ReportBatch
from evaluation.reproduction.presets import Preset
from evaluation.reproduction.script import counts_as_lane_change
from evaluation.reproduction.skilled import SkillRun
from evaluation.reproduction.variants import ReportVariant
from evaluation.threads import one_thread

__all__ = ["COLUMNS", "drive_many"]

_ENVS = 200
_SLOWER = 4
COLUMNS = (
    *("seed", "crashed", "off_road", "return", "steps", "mean_speed", "min_gap", "decisions", "slow", "replaced"),
    *("overridden", "frames", "frames_overridden", "fallbacks", "violations", "confidence", "script_lane_changes"),
    "simulator",
)
"""Columns of the rows. `steps`: primitive steps. `decisions`: decisions of the policy (skills). `slow`: proposals
SLOWER or SLOW_DOWN among these. `replaced`: steps or skills that the report's rule replaced. `overridden`: steps that
the shield overrode. `confidence`: mean of the last column of the ego's row, NaN without added columns.
`script_lane_changes`: lane changes by the script's count. Values that are unknown for episodes driven one at a time are
NaN."""


class _Policy(Protocol):
    def predict(self, observation: Any, *, deterministic: bool) -> tuple[Any, Any]:
        """Actions."""
        ...


class _Sums:
    """Sums over the episode of each environment beside `Tallies`, (e,)."""

    def __init__(self, envs: int) -> None:
        names = ("decisions", "slow", "replaced", "script_lane_changes")
        self.counts: dict[str, IntArray] = {name: np.zeros(envs, np.int64) for name in names}
        self.confidence: FloatArray = np.zeros(envs)

    def begin(self, e: int) -> None:
        """Reset the sums for a new episode."""
        for counts in self.counts.values():
            counts[e] = 0
        self.confidence[e] = 0.0

    def add(self, name: str, happened: BoolArray) -> None:
        """Count the environments in which an event happened."""
        self.counts[name] += happened


class _Driver:
    """The policy of a variant in a batch.

    Parameters
    ----------
    batch : the environments.
    model : the model that proposes; None for the variant's only action.
    """

    def __init__(self, batch: ReportBatch, model: _Policy | None) -> None:
        self._batch, self._model, self._variant = batch, model, batch.variant
        self.skills = SkillRun(batch) if batch.variant.skills else None

    def step(self, sums: _Sums) -> None:
        """Execute one primitive step in all environments."""
        batch, skills = self._batch, self.skills
        before = batch.shown[..., 0, :].copy()
        if skills is None:
            actions, asks = self._proposed(), np.ones(len(batch.steps), np.bool_)
            slow = actions == _SLOWER
            batch.step(actions)
            sums.add("replaced", batch.replaced)
        else:
            asks = skills.over.copy()
            chosen = self._proposed() if asks.any() else np.zeros(len(asks), np.intp)
            slow = asks & (chosen == skills.slow_down)
            skills.choose(chosen)
            sums.add("replaced", skills.gated)
            batch.step(skills.primitive)
            skills.step()
        sums.add("decisions", asks)
        sums.add("slow", slow)
        sums.add("script_lane_changes", counts_as_lane_change(batch.shown))
        sums.confidence += before[:, -1]

    def _proposed(self) -> IntArray:
        batch = self._batch
        if self._model is None:
            return np.full(len(batch.steps), self._variant.action, np.intp)
        masks = {"action_masks": batch.highways.masks()} if self._variant.masks else {}
        return np.asarray(self._model.predict(batch.shown, deterministic=True, **masks)[0], np.intp)


def drive_many(
    preset: Preset, variant: ReportVariant, model: _Policy | None, seeds: Sequence[int], envs: int = _ENVS
) -> pd.DataFrame:
    """Drive an episode for each seed; the result does not depend on the size of the batch.

    Parameters
    ----------
    preset, variant : the variant.
    model : an SB3 model; None for a baseline.
    seeds : seeds of the episodes.
    envs : size of the batch.

    Returns
    -------
    A row for each seed, in order, with the columns `COLUMNS`.
    """
    n = min(envs, len(seeds))
    batch = ReportBatch(preset, variant, n)
    driver, sums, tallies = _Driver(batch, model), _Sums(n), empty_tallies(n)
    highways, seen = batch.highways, batch.highways.simulator.seen
    scene = np.empty((highways.rows.shape[2], highways.rows.shape[3]))
    place, going, rows = np.full(n, -1), np.zeros(n, np.bool_), [dict[str, Any]()] * len(seeds)
    left = iter(range(len(seeds)))

    def follow(which: NDArray[np.intp]) -> None:
        """Begin the next episodes in these environments; without further seeds, an episode that is not counted."""
        taken = [next(left, -1) for _ in which]
        place[which], going[which] = taken, np.array(taken) >= 0
        batch.begin([seeds[k] if k >= 0 else 0 for k in taken], which.tolist())
        for e in which.tolist():
            sums.begin(e)
            if driver.skills is not None:
                driver.skills.begin(e)
            begin_tally(tallies, e, scene, not highways.write_rows(e, scene), False)

    with one_thread():
        follow(np.arange(n))
        while going.any():
            driver.step(sums)
            tally(tallies, highways.records, highways.rows, highways.off_road, seen.reward, going, False)
            over = np.flatnonzero(seen.terminated | seen.truncated)
            for e in over[going[over]].tolist():
                rows[place[e]] = {"seed": int(seeds[place[e]]), **_row(tallies, sums, e, batch.shown.shape[2] > 5)}
            if over.size:
                follow(over)
    return pd.DataFrame(rows)[list(COLUMNS)]


def _row(tallies: Any, sums: _Sums, e: int, columns: bool) -> dict[str, Any]:
    steps = int(tallies.steps[e])
    return {
        "crashed": bool(tallies.crashed[e]),
        "off_road": bool(tallies.off_road[e]),
        "return": float(tallies.total[e]),
        "steps": steps,
        "mean_speed": float(tallies.speeds[e] / tallies.counted[e]),
        "min_gap": float(tallies.min_gap[e]),
        "overridden": int(tallies.overridden[e]),
        "frames": int(tallies.frames[e]),
        "frames_overridden": int(tallies.frames_overridden[e]),
        "fallbacks": int(tallies.fallbacks[e]),
        "violations": int(tallies.violations[e]),
        "confidence": float(sums.confidence[e] / steps) if columns else float("nan"),
        **{name: int(counts[e]) for name, counts in sums.counts.items()},
        "simulator": "compiled",
    }
