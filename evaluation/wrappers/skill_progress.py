"""Progress of the skills of a batch of environments: the next primitive action of each, and the end of a skill."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynamics.state import BoolArray, IntArray

__all__ = ["SkillProgress"]


class SkillProgress:
    """The skill of each of e environments, and the number of its executed actions.

    Parameters
    ----------
    skills : primitive actions of each skill.
    envs : number of environments.

    Attributes
    ----------
    chosen : the skill of each environment, (e,).
    over : environments without a present skill, (e,); all of them at first.

    Examples
    --------
    >>> progress = SkillProgress([(1, 1), (2, 3, 3)], 2)
    >>> progress.choose(np.array([0, 1]))
    >>> for _ in range(2):
    ...     progress.advance()
    >>> progress.over, progress.primitive[1]
    (array([ True, False]), np.int64(3))
    """

    def __init__(self, skills: Sequence[Sequence[int]], envs: int) -> None:
        self._lengths = np.array([len(each) for each in skills], np.intp)
        self._actions = np.zeros((len(skills), self._lengths.max()), np.intp)
        for k, each in enumerate(skills):
            self._actions[k, : len(each)] = each
        self.chosen: IntArray = np.zeros(envs, np.intp)
        self._place: IntArray = np.zeros(envs, np.intp)
        self.over: BoolArray = np.ones(envs, np.bool_)

    def choose(self, skills: IntArray) -> None:
        """Begin these skills (e,) in environments without one; the other skills continue."""
        self.chosen = np.where(self.over, skills, self.chosen)
        self._place[self.over] = 0
        self.over = np.zeros(len(self.over), np.bool_)

    @property
    def primitive(self) -> IntArray:
        """The next action of each environment, (e,); the last one of a skill that has ended."""
        actions: IntArray = self._actions[self.chosen, np.minimum(self._place, self._lengths[self.chosen] - 1)]
        return actions

    def advance(self) -> None:
        """Count a primitive step of each present skill, and end skills after their last action."""
        self._place += ~self.over
        self.over = self.over | (self._place >= self._lengths[self.chosen])

    def stop(self, where: BoolArray) -> None:
        """End the skills of some environments, (e,)."""
        self.over = self.over | where
