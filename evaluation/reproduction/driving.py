"""Episodes of a variant, many at once: a row each."""

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
from evaluation.reproduction.variants import Variant
from evaluation.threads import one_thread

__all__ = ["COLUMNS", "drive_many"]

_ENVS = 200
_SLOWER = 4
COLUMNS = (
    *("seed", "crashed", "off_road", "return", "steps", "mean_speed", "min_gap", "decisions", "slow", "replaced"),
    *("overridden", "frames", "frames_overridden", "fallbacks", "violations", "confidence", "script_lane_changes"),
    "simulator",
)
"""Of the rows: `steps` primitive steps; `decisions` of the policy (skills), `slow` how many of these were SLOWER or
SLOW_DOWN as the policy asked for them; `replaced` steps or skills that the report's rule replaced, `overridden` steps
that the shield did; `confidence` the mean of the last column of the ego's row, NaN where none is added;
`script_lane_changes` what the script counts as such. What is not known of episodes driven one at a time is NaN."""


class _Policy(Protocol):
    def predict(self, observation: Any, *, deterministic: bool) -> tuple[Any, Any]:
        """Actions."""
        ...


class _Sums:
    """What is added up beside `Tallies`, of the episode of each environment, (e,)."""

    def __init__(self, envs: int) -> None:
        names = ("decisions", "slow", "replaced", "script_lane_changes")
        self.counts: dict[str, IntArray] = {name: np.zeros(envs, np.int64) for name in names}
        self.confidence: FloatArray = np.zeros(envs)

    def begin(self, e: int) -> None:
        """An episode begins."""
        for counts in self.counts.values():
            counts[e] = 0
        self.confidence[e] = 0.0

    def add(self, name: str, happened: BoolArray) -> None:
        """Count where something happened."""
        self.counts[name] += happened


class _Driver:
    """The policy of a variant in a batch.

    Parameters
    ----------
    batch : the environments. model : what proposes; None for the variant's only action.
    """

    def __init__(self, batch: ReportBatch, model: _Policy | None) -> None:
        self._batch, self._model, self._variant = batch, model, batch.variant
        self.skills = SkillRun(batch) if batch.variant.skills else None

    def step(self, sums: _Sums) -> None:
        """One primitive step of all."""
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
    preset: Preset, variant: Variant, model: _Policy | None, seeds: Sequence[int], envs: int = _ENVS
) -> pd.DataFrame:
    """A row for each seed, in order (see `COLUMNS`); the rows do not depend on how many are driven at once.

    Parameters
    ----------
    preset, variant : what is driven. model : an SB3 model; None for a baseline.
    seeds : of the episodes. envs : at once.
    """
    n = min(envs, len(seeds))
    batch = ReportBatch(preset, variant, n)
    driver, sums, tallies = _Driver(batch, model), _Sums(n), empty_tallies(n)
    highways, seen = batch.highways, batch.highways.simulator.seen
    scene = np.empty((highways.rows.shape[2], highways.rows.shape[3]))
    place, going, rows = np.full(n, -1), np.zeros(n, np.bool_), [dict[str, Any]()] * len(seeds)
    left = iter(range(len(seeds)))

    def follow(which: NDArray[np.intp]) -> None:
        """Begin the next episodes in these environments; where none is left, one that is not counted."""
        taken = [next(left, -1) for _ in which]
        place[which], going[which] = taken, np.array(taken) >= 0
        batch.begin([seeds[k] if k >= 0 else 0 for k in taken], which.tolist())
        for e in which.tolist():
            sums.begin(e)
            if driver.skills is not None:
                driver.skills.begin(e)
            begin_tally(tallies, e, scene, not highways.look(e, scene), False)

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
