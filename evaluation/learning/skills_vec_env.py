"""`SkillsVecEnv`: skills in compiled environments, for Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3.common.vec_env import VecEnvWrapper

from dynamics.highway_simulator.layout import X, Y
from dynamics.highway_simulator.simulator import Simulator
from dynamics.road_networks.simulation.frame_kernels import ego_of
from dynamics.state import BoolArray, FloatArray, IntArray
from dynamics.traffic.crossing import make
from evaluation.learning.fast_vec_env import FastHighwayVecEnv
from evaluation.wrappers.skill_progress import SkillProgress
from evaluation.wrappers.skills import (
    REPORT_SKILLS,
    NearerThan,
    Skill,
    checked_discount,
    chosen_skill,
    masks_of_skills,
    overridden,
    parse_skills,
    skill_summary,
)
from shield.errors import ConfigError
from shield.filters.discrete_action import action_labels

__all__ = ["InterruptMany", "SkillsVecEnv"]

InterruptMany = Callable[[FastHighwayVecEnv, IntArray, Sequence[Mapping[str, Any]]], Any]
"""Predicate that ends skills, (k,) booleans: a function of the compiled environments, the indices (k,) of environments
within a skill, and the infos of their last primitive steps."""


class SkillsVecEnv(VecEnvWrapper):
    """Batch of compiled environments with skills as actions, equal to `Skills` around each of them to the last bit.

    A step lasts until the skill of each environment has ended. An environment whose skill ends earlier waits for the
    others, with its traffic. `infos[i]["skill"]` is as in `Skills`. `infos[i]["episode"]` counts primitive steps, as
    with `Skills(Monitor(env))`.

    Parameters
    ----------
    venv : a `FastHighwayVecEnv`, `FastRoadVecEnv` or, for skills inside the shield, `ShieldedVecEnv`.
    skills, discount : as in `Skills`.
    interrupt : predicate that ends skills after a primitive step: `nearer_than(distance)`, `overridden`, or an
        `InterruptMany` of the user; None for never.

    Raises
    ------
    ConfigError
        If `venv` is not compiled, its actions are not discrete, or for a reason of `Skills`.

    Examples
    --------
    >>> from evaluation.learning.shielded_vec_env import ShieldedVecEnv
    >>> world = SkillsVecEnv(ShieldedVecEnv(2, "highway-fast-v0"), {"RUSH": ["FASTER"] * 3}, overridden)
    >>> _ = world.seed(0)
    >>> observations = world.reset()
    >>> observations, rewards, dones, infos = world.step([0, 0])
    >>> infos[0]["skill"]["name"]
    'RUSH'
    """

    venv: FastHighwayVecEnv

    def __init__(
        self,
        venv: FastHighwayVecEnv,
        skills: Mapping[str, Sequence[int | str]] = REPORT_SKILLS,
        interrupt: NearerThan | InterruptMany | None = None,
        discount: float = 1.0,
    ) -> None:
        if not isinstance(venv, FastHighwayVecEnv):
            raise ConfigError(
                "SkillsVecEnv goes directly around FastHighwayVecEnv, FastRoadVecEnv or ShieldedVecEnv; in another "
                "VecEnv, have Skills around each of its environments"
            )
        if not isinstance(venv.action_space, gym.spaces.Discrete):
            raise ConfigError(f"skills are sequences of discrete actions; these environments have {venv.action_space}")
        if interrupt is not None and not callable(interrupt):
            raise ConfigError(
                f"interrupt is a function of the environments, indices and infos, or None, not {interrupt!r}"
            )
        self.discount, self._interrupt = checked_discount(discount), _of_many(interrupt)
        labels = action_labels(make(venv.env_id, venv.config).unwrapped)
        self.skills: tuple[Skill, ...] = parse_skills(skills, int(venv.action_space.n), labels)
        self._progress = SkillProgress([skill.actions for skill in self.skills], venv.num_envs)
        self._requested: IntArray = np.zeros(venv.num_envs, np.intp)
        super().__init__(venv, action_space=gym.spaces.Discrete(len(self.skills)))

    @property
    def names(self) -> list[str]:
        """Names of the skills, in the order of the actions."""
        return [skill.name for skill in self.skills]

    def reset(self) -> Any:
        """Start all episodes."""
        return self.venv.reset()

    def step_async(self, actions: Any) -> None:
        """Set the skills of the next step.

        Raises
        ------
        ConfigError
            If there is not one skill for each environment, or one is no index of a skill.
        """
        given = np.asarray(actions)
        if given.shape != (self.num_envs,):
            raise ConfigError(f"have a skill for each of {self.num_envs} environments, not {actions!r}")
        for each in given:
            chosen_skill(self.skills, each)
        self._requested = given.astype(np.intp)

    def step_wait(self) -> Any:
        """Execute one skill in each environment."""
        n, progress = self.num_envs, self._progress
        # An exception in the predicate may have left unfinished skills.
        progress.stop(np.ones(n, np.bool_))
        progress.choose(self._requested)
        dones, interrupted = np.zeros(n, np.bool_), np.zeros(n, np.bool_)
        rewards, overrides, infos = [list[float]() for _ in range(n)], np.zeros(n, np.intp), [dict[str, Any]()] * n
        while not progress.over.all():
            which = np.flatnonzero(~progress.over)
            observations, _, done, step_infos = self.venv.step_some(progress.primitive, which)
            paid = self.venv.simulator.seen.reward
            for e in which.tolist():
                rewards[e].append(float(paid[e]))
                infos[e] = step_infos[e]
                overrides[e] += bool(step_infos[e].get("shield", {}).get("overridden", False))
            dones |= done
            progress.advance()
            progress.stop(done)
            running = np.flatnonzero(~progress.over)
            if self._interrupt is not None and len(running):
                ended = np.asarray(self._interrupt(self.venv, running, [infos[e] for e in running.tolist()]), np.bool_)
                interrupted[running] = ended
                progress.stop(interrupted)
        totals = np.zeros(n, np.float32)
        for e, info in enumerate(infos):
            reported_overrides = int(overrides[e]) if "shield" in info else None
            summary = skill_summary(
                self.skills[progress.chosen[e]], rewards[e], self.discount, bool(interrupted[e]), reported_overrides
            )
            totals[e], info["skill"] = summary
        return observations, totals, dones, infos

    def action_masks(self) -> BoolArray:
        """Mask of skills whose first action verifies, (num_envs, skills), for sb3-contrib's MaskablePPO.

        A row without any such skill is all True.

        Raises
        ------
        MissingAttributeError
            If there is no shield inside.
        """
        return masks_of_skills(self.skills, np.stack(self.venv.env_method("action_masks")))

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """As in the environments inside, except `action_space` and `action_masks`."""
        chosen = list(self._get_indices(indices))
        if attr_name == "action_space":
            return [self.action_space for _ in chosen]
        found = self.venv.get_attr(attr_name, indices)
        return [partial(self._mask_of, i) for i in chosen] if attr_name == "action_masks" else found

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """`action_masks` of each environment; other methods are those of the environments inside."""
        if method_name != "action_masks":
            return self.venv.env_method(method_name, *args, indices=indices, **kwargs)
        masks = self.action_masks()
        return [masks[i] for i in self._get_indices(indices)]

    def _mask_of(self, i: int) -> BoolArray:
        masks: BoolArray = self.action_masks()[i]
        return masks


def _of_many(interrupt: Any) -> InterruptMany | None:
    """The predicate for a batch of environments."""
    if interrupt is overridden:
        return lambda world, which, infos: [overridden(None, info) for info in infos]  # type: ignore[arg-type]
    if isinstance(interrupt, NearerThan):
        return partial(_near, interrupt)
    given: InterruptMany | None = interrupt
    return given


def _near(predicate: NearerThan, world: FastHighwayVecEnv, which: IntArray, infos: Any) -> list[bool]:
    """Whether another body is too near, in each of some environments."""
    return [predicate.of(*_positions(world.simulator, e)) for e in which.tolist()]


def _positions(simulator: Any, e: int) -> tuple[FloatArray, FloatArray]:
    """Centres of the other bodies, (n, 2), and of the ego, (2,), in one environment [m]."""
    if isinstance(simulator, Simulator):
        worlds, ego = simulator.worlds, 0
        bodies = worlds.f.shape[2]
    else:
        worlds = simulator.episodes.worlds
        ego, bodies = ego_of(worlds.g[e]), int(worlds.counts[e, 1])
    centres = worlds.f[e, (X, Y), :bodies].T
    return np.delete(centres, ego, axis=0), centres[ego]
