"""Training environment of a variant of the report."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np

from dynamics.state import BoolArray
from evaluation.names import FIRST_EVALUATION_SEED
from evaluation.reproduction.batch import ReportBatch
from evaluation.reproduction.presets import Preset
from evaluation.reproduction.skilled import SkillRun
from evaluation.reproduction.variants import ReportVariant
from evaluation.wrappers.override_penalty import less_overrides

__all__ = ["ReportEnv"]


class ReportEnv(gym.Env[Any, Any]):
    """Training environment of a variant.

    Episodes have seeds below `FIRST_EVALUATION_SEED`, drawn with the seed of the first reset.

    The reward of a skill of the report is the sum of the rewards of its primitive steps. The reward of a skill that the
    shield may interrupt is semi-Markov. With K planned primitive steps, k executed ones, the learner's discount G and
    g = G^(1/K), it is (r_0 + g r_1 + ... + g^(k-1) r_(k-1)) (1 - G) / (1 - g^k). A learner that discounts every step by
    G then gives the same value to a steady reward for every frequency of interruptions. With the sum it would avoid
    interrupted skills.

    `info["shield"]["overridden"]` is whether the shield overrode a primitive step, and `info["steps"]` is their
    number.

    Parameters
    ----------
    preset, variant : the variant.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    def __init__(self, preset: Preset, variant: ReportVariant) -> None:
        self._batch, self._penalty = ReportBatch(preset, variant, 1), variant.penalty
        self._semi_markov = variant.skills and not variant.report_skills
        self._gamma, self._planned = preset.gamma, max(map(len, preset.skills.values()))
        self._skills = SkillRun(self._batch) if variant.skills else None
        self.observation_space = self._batch.observation_space
        self.action_space = gym.spaces.Discrete(len(preset.skills) if variant.skills else self._batch.highways.actions)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode."""
        super().reset(seed=seed)
        self._batch.begin([int(self.np_random.integers(FIRST_EVALUATION_SEED))], [0])
        if self._skills is not None:
            self._skills.begin(0)
        return self._batch.shown[0].copy(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Execute one decision, or one skill."""
        batch, skills, seen = self._batch, self._skills, self._batch.highways.simulator.seen
        chosen = np.array([int(action)], np.intp)
        if skills is not None:
            skills.choose(chosen)
        rewards, overridden = list[float](), False
        while True:
            batch.step(chosen if skills is None else skills.primitive)
            rewards.append(less_overrides(float(seen.reward[0]), bool(batch.overridden[0]), self._penalty))
            overridden = overridden or bool(batch.overridden[0])
            terminated, truncated = bool(seen.terminated[0]), bool(seen.truncated[0])
            if skills is not None:
                skills.step()
            if skills is None or skills.over[0] or terminated or truncated:
                break
        info = {"crashed": terminated, "steps": len(rewards), "shield": {"overridden": overridden}}
        return batch.shown[0].copy(), self._paid(rewards), terminated, truncated, info

    def _paid(self, rewards: list[float]) -> float:
        if not self._semi_markov:
            return sum(rewards)
        g, k = self._gamma ** (1.0 / self._planned), len(rewards)
        return float(np.dot(g ** np.arange(k), rewards) * (1.0 - self._gamma) / (1.0 - g**k))

    def action_masks(self) -> BoolArray:
        """Mask of meta-actions that verify, as in `ShieldedVecEnv.action_masks`."""
        masks: BoolArray = self._batch.highways.masks()[0]
        return masks
