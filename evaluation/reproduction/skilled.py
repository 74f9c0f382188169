"""Skills of many environments at once: which primitive action comes next in each, and when a skill is over."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynamics.state import BoolArray, IntArray
from evaluation.reproduction import script, text
from evaluation.reproduction.batch import ReportBatch

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
        skills, envs = batch.preset.skills, len(batch.steps)
        self._batch = batch
        self._lengths = np.array([len(each) for each in skills.values()], np.intp)
        self._actions = np.zeros((len(skills), self._lengths.max()), np.intp)
        for k, each in enumerate(skills.values()):
            self._actions[k, : len(each)] = each
        self.slow_down = list(skills).index("SLOW_DOWN")
        self._skill: IntArray = np.zeros(envs, np.intp)
        self._place: IntArray = np.zeros(envs, np.intp)
        self.over: BoolArray = np.ones(envs, np.bool_)
        self.gated: BoolArray = np.zeros(envs, np.bool_)

    def begin(self, e: int) -> None:
        """An episode begins: no skill is going on."""
        self.over[e] = True

    def choose(self, skills: IntArray) -> None:
        """Begin these (e,) wherever the one before is over; the others go on."""
        batch = self._batch
        chosen, self.gated = np.asarray(skills, np.intp), np.zeros(len(skills), np.bool_)
        if batch.variant.report_skills and not batch.preset.interrupted:
            chosen, gated = script.gate_skills(batch.shown, chosen, self.slow_down)
            self.gated = gated & self.over
        self._skill = np.where(self.over, chosen, self._skill)
        self._place[self.over] = 0
        self.over[:] = False

    @property
    def primitive(self) -> NDArray[np.intp]:
        """The next action of each, (e,)."""
        actions: NDArray[np.intp] = self._actions[self._skill, self._place]
        return actions

    def step(self) -> None:
        """After a primitive step of the batch: see which skills are over."""
        batch = self._batch
        self._place += 1
        self.over = self._place >= self._lengths[self._skill]
        if not batch.variant.report_skills:
            self.over |= batch.overridden
        elif batch.preset.interrupted:
            self.over |= text.somebody_near(batch.shown, batch.preset.distance, batch.preset.scale)
