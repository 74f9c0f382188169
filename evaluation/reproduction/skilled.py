"""Skills of many environments at once: which primitive action comes next in each, and when a skill is over."""

from __future__ import annotations

import numpy as np

from dynamics.state import BoolArray, IntArray
from evaluation.reproduction import script, text
from evaluation.reproduction.batch import ReportBatch
from evaluation.wrappers.skill_progress import SkillProgress

__all__ = ["SkillRun"]


class SkillRun:
    """The skill that each environment of a batch carries out.

    A skill ends with its last action; where the report's are interrupted, as soon as somebody is shown near; and where
    the shield interrupts them, after the primitive step that it overrode. `evaluation.wrappers.Skills` does the same
    for one environment.

    Parameters
    ----------
    batch : the environments, whose variant has skills.
    """

    def __init__(self, batch: ReportBatch) -> None:
        skills = batch.preset.skills
        self._batch = batch
        self._progress = SkillProgress(list(skills.values()), len(batch.steps))
        self.slow_down = list(skills).index("SLOW_DOWN")
        self.gated: BoolArray = np.zeros(len(batch.steps), np.bool_)

    @property
    def over(self) -> BoolArray:
        """Where no skill is going on, (e,)."""
        return self._progress.over

    def begin(self, e: int) -> None:
        """An episode begins: no skill is going on."""
        self._progress.over[e] = True

    def choose(self, skills: IntArray) -> None:
        """Begin these (e,) wherever the one before is over; the others go on."""
        batch = self._batch
        chosen, self.gated = np.asarray(skills, np.intp), np.zeros(len(skills), np.bool_)
        if batch.variant.report_skills and not batch.preset.interrupted:
            chosen, gated = script.gate_skills(batch.shown, chosen, self.slow_down)
            self.gated = gated & self.over
        self._progress.choose(chosen)

    @property
    def primitive(self) -> IntArray:
        """The next action of each, (e,)."""
        return self._progress.primitive

    def step(self) -> None:
        """After a primitive step of the batch: see which skills are over."""
        batch = self._batch
        self._progress.advance()
        if not batch.variant.report_skills:
            self._progress.stop(batch.overridden)
        elif batch.preset.interrupted:
            self._progress.stop(text.somebody_near(batch.shown, batch.preset.distance, batch.preset.scale))
