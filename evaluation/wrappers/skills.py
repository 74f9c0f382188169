"""Skills: named sequences of primitive actions, which a policy chooses in place of actions.

A skill is an option with a fixed sequence and a predicate that ends it early (Sutton, Precup and Singh 1999). With k
executed primitive steps, rewards r_0 ... r_(k-1) and the discount g of a primitive step, the reward of a skill is
r_0 + g r_1 + ... + g^(k-1) r_(k-1), and later rewards are discounted by g^k.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import numpy as np

from dynamics.errors import nearest_name_hint
from dynamics.highway_simulator.env import CompiledHighwayEnv
from dynamics.state import BoolArray, FloatArray
from evaluation.wrappers.checks import check_highway_env, check_number
from shield.errors import ConfigError
from shield.filters.discrete_action import action_index, action_labels

__all__ = [
    "REPORT_SKILLS",
    "Interrupt",
    "NearerThan",
    "Skill",
    "Skills",
    "checked_discount",
    "chosen_skill",
    "masks_of_skills",
    "nearer_than",
    "overridden",
    "parse_skills",
    "skill_summary",
]

Interrupt = Callable[[gym.Env[Any, Any], Mapping[str, Any]], bool]
"""Predicate that ends a skill, a function of the environment and the info of the last primitive step."""

REPORT_SKILLS: Mapping[str, tuple[int, ...]] = MappingProxyType(
    {
        "FOLLOW": (1, 1, 1, 1),
        "OVERTAKE_LEFT": (2, 3, 3, 0),
        "OVERTAKE_RIGHT": (0, 3, 3, 2),
        "SLOW_DOWN": (4, 4, 4, 4),
        "KEEP_RIGHT": (0, 0, 1, 1),
    }
)
"""Skills of the report's published script, with actions of `DiscreteMetaAction`: OVERTAKE_LEFT begins with LANE_RIGHT,
OVERTAKE_RIGHT and KEEP_RIGHT with LANE_LEFT."""


@dataclass(frozen=True, slots=True)
class Skill:
    """A named sequence of primitive actions, as indices."""

    name: str
    actions: tuple[int, ...]


class Skills(gym.Wrapper[Any, Any, Any, Any]):
    """The action is the index of a skill, and a step executes all of its primitive steps.

    `info["skill"]` contains `name`, `actions` (the executed ones), `planned` (number of actions in the skill), `steps`
    (number of executed ones), `interrupted` (whether the predicate ended it early), `rewards` of the primitive steps,
    and `discount`, g^steps. The rest of `info` is that of the last primitive step. If it contains `info["shield"]`,
    `info["skill"]["overridden"]` is the number of primitive steps that the shield overrode.

    Parameters
    ----------
    env : an environment of highway-env with discrete actions; `ShieldedEnv(env)` for skills inside the shield.
    skills : names and their sequences of primitive actions, as indices, or as names of meta-actions.
    interrupt : predicate that ends a skill after a primitive step: `nearer_than(distance)`, `overridden`, or a function
        of the user; None for never.
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
        self.interrupt, self.discount = interrupt, checked_discount(discount)
        if interrupt is not None and not callable(interrupt):
            raise ConfigError(f"interrupt is a function of the environment and the info, or None, not {interrupt!r}")
        self.skills = parse_skills(skills, int(env.action_space.n), action_labels(env.unwrapped))
        self.action_space = gym.spaces.Discrete(len(self.skills))

    @property
    def names(self) -> list[str]:
        """Names of the skills, in the order of the actions."""
        return [skill.name for skill in self.skills]

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Execute one skill.

        Raises
        ------
        ConfigError
            If `action` is no index of a skill.
        """
        skill, rewards, overrides = chosen_skill(self.skills, action), list[float](), 0
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
        reported_overrides = overrides if "shield" in info else None
        total, about = skill_summary(skill, rewards, self.discount, interrupted, reported_overrides)
        return obs, total, terminated, truncated, {**info, "skill": about}

    def action_masks(self) -> BoolArray:
        """Mask of skills whose first action verifies, for sb3-contrib's MaskablePPO, (skills,); all True without any.

        Raises
        ------
        ConfigError
            If no wrapper inside has `action_masks`.
        """
        try:
            of_actions = self.env.get_wrapper_attr("action_masks")
        except AttributeError:
            raise ConfigError("no shield inside says which actions verify; have Skills(ShieldedEnv(env))") from None
        found: BoolArray = masks_of_skills(self.skills, np.asarray(of_actions())[None])[0]
        return found


def checked_discount(discount: float) -> float:
    """Check the discount of a primitive step, and return it.

    Raises
    ------
    ConfigError
        If it is not above 0 and at most 1.
    """
    check_number("discount", discount, above=0.0)
    if discount > 1.0:
        raise ConfigError(f"discount is at most 1, not {discount!r}")
    return float(discount)


def parse_skills(skills: Mapping[str, Sequence[int | str]], count: int, labels: Mapping[int, str]) -> tuple[Skill, ...]:
    """Skills with their actions as indices.

    Parameters
    ----------
    skills : as in `Skills`.
    count : number of primitive actions.
    labels : names of the actions that have one, by index.

    Raises
    ------
    ConfigError
        If there is no skill, or one is empty or names no action.
    """
    indices = {label: k for k, label in labels.items()}
    parsed = []
    for name, actions in dict(skills).items():
        if isinstance(actions, str) or not len(actions):
            raise ConfigError(f"skill {name!r} is a sequence of actions with at least one, not {actions!r}")
        found = []
        for each in actions:
            k = indices.get(each, -1) if isinstance(each, str) else action_index(each)
            if not 0 <= k < count:
                valid = ", ".join(indices) if indices else f"0 to {count - 1}"
                near = nearest_name_hint(each, list(indices)) if isinstance(each, str) else ""
                raise ConfigError(f"skill {name!r} has {each!r}, which is no action{near}; have {valid}")
            found.append(k)
        parsed.append(Skill(str(name), tuple(found)))
    if not parsed:
        raise ConfigError("have at least one skill, such as {'FOLLOW': ['IDLE'] * 4}")
    return tuple(parsed)


def chosen_skill(skills: Sequence[Skill], action: Any) -> Skill:
    """The skill with that index.

    Raises
    ------
    ConfigError
        If there is no such skill.
    """
    k = action_index(action)
    if not 0 <= k < len(skills):
        valid = ", ".join(f"{i} {skill.name}" for i, skill in enumerate(skills))
        raise ConfigError(f"{action!r} is no skill; have {valid}")
    return skills[k]


def skill_summary(
    skill: Skill, rewards: list[float], discount: float, interrupted: bool, overridden: int | None
) -> tuple[float, dict[str, Any]]:
    """The semi-Markov reward of a skill, and `info["skill"]`.

    Parameters
    ----------
    skill : the skill.
    rewards : rewards of the executed primitive steps.
    discount : discount of a primitive step.
    interrupted : whether the predicate ended the skill.
    overridden : number of steps that a shield overrode; None without a shield.
    """
    steps = len(rewards)
    total = float(np.dot(discount ** np.arange(steps), rewards))
    about: dict[str, Any] = {
        "name": skill.name,
        "actions": list(skill.actions[:steps]),
        "planned": len(skill.actions),
        "steps": steps,
        "interrupted": interrupted,
        "rewards": rewards,
        "discount": discount**steps,
    }
    if overridden is not None:
        about["overridden"] = overridden
    return total, about


def masks_of_skills(skills: Sequence[Skill], masks: BoolArray) -> BoolArray:
    """Mask of skills whose first action verifies, (e, skills), from masks of actions, (e, actions).

    A row without any such skill is all True.
    """
    first = masks[:, [skill.actions[0] for skill in skills]]
    first[~first.any(axis=1)] = True
    return first


@dataclass(frozen=True, slots=True)
class NearerThan:
    """Predicate of distance that reads the simulator's state; see `nearer_than`."""

    distance: float

    def __call__(self, env: gym.Env[Any, Any], info: Mapping[str, Any]) -> bool:
        """Whether a vehicle or object is nearer in the present state."""
        base: Any = env.unwrapped
        if isinstance(base, CompiledHighwayEnv):
            centres = base.frames[-1][:, :2]
            return self.of(centres[1:], centres[0])
        others = [body.position for body in (*base.road.vehicles, *base.road.objects) if body is not base.vehicle]
        return self.of(np.array(others), base.vehicle.position) if others else False

    def of(self, others: FloatArray, ego: FloatArray) -> bool:
        """Whether one of the centres (n, 2) [m] is nearer to the ego's centre (2,)."""
        return bool((np.linalg.norm(others - ego, axis=1) < self.distance).any())


def nearer_than(distance: float) -> NearerThan:
    """Predicate: the centre of a vehicle or object is nearer to the ego's than a distance [m], by the simulator's
    state.

    Raises
    ------
    ConfigError
        If the distance is no positive number.
    """
    check_number("distance", distance, above=0.0)
    return NearerThan(float(distance))


def overridden(env: gym.Env[Any, Any], info: Mapping[str, Any]) -> bool:
    """Predicate: the shield has overridden the last primitive step.

    Raises
    ------
    ConfigError
        If there is no shield inside the skills.
    """
    if "shield" not in info:
        raise ConfigError("no shield reports what it overrode; have Skills(ShieldedEnv(env), interrupt=overridden)")
    return bool(info["shield"]["overridden"])
