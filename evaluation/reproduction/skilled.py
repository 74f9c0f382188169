"""Skills in a batch of environments: the next primitive action of each, and the end of a skill."""

from __future__ import annotations

import numpy as np

from dynamics.state import BoolArray, IntArray
from evaluation.reproduction import script, text
from evaluation.reproduction.batch import ReportBatch
from evaluation.wrappers.skill_progress import SkillProgress

__all__ = ["SkillRun"]


class SkillRun:
    """The present skill of each environment of a batch.

    A skill ends with its last action. If the report's skills are interruptible, a skill also ends as soon as a vehicle
    is shown near. If the shield interrupts skills, a skill ends after a primitive step that was overridden.
    `evaluation.wrappers.Skills` does the same for one environment.

    Parameters
    ----------
    batch : the environments, of a variant with skills.
    """

    def __init__(self, batch: ReportBatch) -> None:
        skills = batch.preset.skills
        self._batch = batch
        self._progress = SkillProgress(list(skills.values()), len(batch.steps))
        self.slow_down = list(skills).index("SLOW_DOWN")
        self.gated: BoolArray = np.zeros(len(batch.steps), np.bool_)

    @property
    def over(self) -> BoolArray:
        """Environments without a present skill, (e,)."""
        return self._progress.over

    def begin(self, e: int) -> None:
        """Clear the skill of an environment for a new episode."""
        self._progress.over[e] = True

    def choose(self, skills: IntArray) -> None:
        """Begin these skills (e,) in environments without one; the other skills continue."""
        batch = self._batch
        chosen, self.gated = np.asarray(skills, np.intp), np.zeros(len(skills), np.bool_)
        if batch.variant.report_skills and not batch.preset.interrupted:
            chosen, gated = script.gate_skills(batch.shown, chosen, self.slow_down)
            self.gated = gated & self.over
        self._progress.choose(chosen)

    @property
    def primitive(self) -> IntArray:
        """The next primitive action of each environment, (e,)."""
        return self._progress.primitive

    def step(self) -> None:
        """Update the skills after a primitive step of the batch."""
        batch = self._batch
        self._progress.advance()
        if not batch.variant.report_skills:
            self._progress.stop(batch.overridden)
        elif batch.preset.interrupted:
            self._progress.stop(text.vehicle_near(batch.shown, batch.preset.distance, batch.preset.scale))
