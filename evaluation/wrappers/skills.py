"""Skills: named sequences of primitive actions, one of which a policy chooses at a time.

A skill is an option with a fixed sequence and a predicate that ends it early (Sutton, Precup and Singh 1999). With k
primitive steps carried out, rewards r_0 ... r_(k-1) and the discount g of a primitive step, the reward of a skill is
r_0 + g r_1 + ... + g^(k-1) r_(k-1), and what follows is discounted by g^k.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import numpy as np

from dynamics.errors import perhaps
from evaluation.wrappers.checks import check_highway_env, check_number
from shield.doors.discrete_action import action_index, action_labels
from shield.errors import ConfigError

__all__ = ["REPORT_SKILLS", "Interrupt", "Skills", "nearer_than", "overridden"]

Interrupt = Callable[[gym.Env[Any, Any], Mapping[str, Any]], bool]
"""Whether a skill ends now: asked with the environment and the info of the primitive step that has just ended."""

REPORT_SKILLS: Mapping[str, tuple[int, ...]] = MappingProxyType(
    {
        "FOLLOW": (1, 1, 1, 1),
        "OVERTAKE_LEFT": (2, 3, 3, 0),
        "OVERTAKE_RIGHT": (0, 3, 3, 2),
        "SLOW_DOWN": (4, 4, 4, 4),
        "KEEP_RIGHT": (0, 0, 1, 1),
    }
)
"""Skills as the published script of the report has them, actions of `DiscreteMetaAction`: OVERTAKE_LEFT begins with
LANE_RIGHT, OVERTAKE_RIGHT and KEEP_RIGHT with LANE_LEFT."""


@dataclass(frozen=True, slots=True)
class _Skill:
    name: str
    actions: tuple[int, ...]


class Skills(gym.Wrapper[Any, Any, Any, Any]):
    """The action is which skill to carry out, and a step is all of its primitive steps.

    `info["skill"]` has `name`, `actions` (those carried out), `planned` (how many there are in the skill), `steps` (how
    many were carried out), `interrupted` (whether the predicate ended it early), `rewards` of the primitive steps, and
    `discount`, g^steps. The rest of `info` is that of the last primitive step; where there is an `info["shield"]`,
    `info["skill"]["overridden"]` is the number of primitive steps that the shield overrode.

    Parameters
    ----------
    env : an environment of highway-env with discrete actions; `ShieldedEnv(env)` for skills inside the shield.
    skills : names and their sequences of primitive actions, as indices or, of meta-actions, as names.
    interrupt : ends a skill after a primitive step, by `nearer_than(distance)`, `overridden`, or a function of one's
        own; None for never.
    discount : g, of a primitive step, above 0 and at most 1.

    Raises
    ------
    ConfigError
        If there is no skill, one is empty or names no action of the environment, or the discount is out of range.

    Examples
    --------
    >>> import highway_env
    >>> from shield import ShieldedEnv
    >>> pairs = {"FOLLOW": ["IDLE"] * 4, "PASS": ["LANE_LEFT", "FASTER", "FASTER", "LANE_RIGHT"]}
    >>> env = Skills(ShieldedEnv(gym.make("highway-fast-v0")), pairs, interrupt=overridden)
    >>> obs, info = env.reset(seed=0)
    >>> obs, reward, terminated, truncated, info = env.step(0)
    >>> info["skill"]["name"], info["skill"]["steps"]
    ('FOLLOW', 4)
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        skills: Mapping[str, Sequence[int | str]] = REPORT_SKILLS,
        interrupt: Interrupt | None = None,
        discount: float = 1.0,
    ) -> None:
        super().__init__(env)
        check_highway_env(env, "Skills")
        if not isinstance(env.action_space, gym.spaces.Discrete):
            raise ConfigError(f"skills are sequences of discrete actions; this environment has {env.action_space}")
        check_number("discount", discount, above=0.0)
        if discount > 1.0:
            raise ConfigError(f"discount is at most 1, not {discount!r}")
        if interrupt is not None and not callable(interrupt):
            raise ConfigError(f"interrupt is a function of the environment and the info, or None, not {interrupt!r}")
        self.skills = tuple(self._skill(name, actions) for name, actions in dict(skills).items())
        if not self.skills:
            raise ConfigError("have at least one skill, such as {'FOLLOW': ['IDLE'] * 4}")
        self.interrupt, self.discount = interrupt, float(discount)
        self.action_space = gym.spaces.Discrete(len(self.skills))

    @property
    def names(self) -> list[str]:
        """Of the skills, in the order of the actions."""
        return [skill.name for skill in self.skills]

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Carry out one skill.

        Raises
        ------
        ConfigError
            If `action` is no index of a skill.
        """
        k = action_index(action)
        if not 0 <= k < len(self.skills):
            skills = ", ".join(f"{i} {name}" for i, name in enumerate(self.names))
            raise ConfigError(f"{action!r} is no skill; have {skills}")
        skill, rewards, overrides = self.skills[k], [], 0
        interrupted = False
        for primitive in skill.actions:
            obs, reward, terminated, truncated, info = self.env.step(primitive)
            rewards.append(float(reward))
            overrides += bool(info.get("shield", {}).get("overridden", False))
            if terminated or truncated:
                break
            if len(rewards) < len(skill.actions) and self.interrupt is not None and self.interrupt(self.env, info):
                interrupted = True
                break
        steps = len(rewards)
        total = float(np.dot(self.discount ** np.arange(steps), rewards))
        about = {
            "name": skill.name,
            "actions": list(skill.actions[:steps]),
            "planned": len(skill.actions),
            "steps": steps,
            "interrupted": interrupted,
            "rewards": rewards,
            "discount": self.discount**steps,
        }
        if "shield" in info:
            about["overridden"] = overrides
        return obs, total, terminated, truncated, {**info, "skill": about}

    def _skill(self, name: str, actions: Sequence[int | str]) -> _Skill:
        space = self.env.action_space
        assert isinstance(space, gym.spaces.Discrete)
        labels = {label: k for k, label in action_labels(self.env.unwrapped).items()}
        if isinstance(actions, str) or not len(actions):
            raise ConfigError(f"skill {name!r} is a sequence of actions with at least one, not {actions!r}")
        found = []
        for each in actions:
            k = labels.get(each, -1) if isinstance(each, str) else action_index(each)
            if not 0 <= k < int(space.n):
                valid = ", ".join(labels) if labels else f"0 to {int(space.n) - 1}"
                near = perhaps(each, list(labels)) if isinstance(each, str) else ""
                raise ConfigError(f"skill {name!r} has {each!r}, which is no action{near}; have {valid}")
            found.append(k)
        return _Skill(str(name), tuple(found))


def nearer_than(distance: float) -> Interrupt:
    """A predicate: whether the centre of any vehicle or object is nearer to the ego's than a distance [m]. It reads the
    simulator's state.

    Raises
    ------
    ConfigError
        If the distance is no positive number.
    """
    check_number("distance", distance, above=0.0)

    def interrupt(env: gym.Env[Any, Any], info: Mapping[str, Any]) -> bool:
        base: Any = env.unwrapped
        others = [body.position for body in (*base.road.vehicles, *base.road.objects) if body is not base.vehicle]
        if not others:
            return False
        return bool((np.linalg.norm(np.array(others) - base.vehicle.position, axis=1) < distance).any())

    return interrupt


def overridden(env: gym.Env[Any, Any], info: Mapping[str, Any]) -> bool:
    """A predicate: whether the shield has overridden the primitive step that has just ended.

    Raises
    ------
    ConfigError
        If there is no shield inside the skills.
    """
    if "shield" not in info:
        raise ConfigError("no shield reports what it overrode; have Skills(ShieldedEnv(env), interrupt=overridden)")
    return bool(info["shield"]["overridden"])
