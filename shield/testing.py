"""Conformance tests for a user's own rule or policy; call them from a test of your own.

They raise `AssertionError` with a text that states the required and the observed behaviour.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np

from dynamics.roads.straight import StraightRoad
from dynamics.scenes.scene import EgoControl, Scene, Target
from dynamics.state import FloatArray, State, Vehicle
from shield.decision import Reason
from shield.rules import Rule
from shield.wrappers.ranking import ranking_of

__all__ = ["check_policy", "check_rule", "random_scene"]

_GRID = 2.0**-10
"""Random states are multiples of this, so that a shift along the road causes no rounding [m], [m/s], [rad]."""


def random_scene(rng: np.random.Generator, vehicles: int = 8, lanes: int = 4) -> Scene:
    """A random scene on a straight road along the x axis.

    The other vehicles are within 120 m, most in a lane and some between two; they may overlap.

    Parameters
    ----------
    rng : random number generator.
    vehicles : number of other vehicles.
    lanes : number of lanes.

    Examples
    --------
    >>> random_scene(np.random.default_rng(0), vehicles=3).others.shape
    (3, 7)
    """
    road = StraightRoad.from_lanes(lanes)

    def states(n: int, reach: float) -> FloatArray:
        lane = rng.integers(lanes, size=n)
        drift = np.where(rng.random(n) < 0.3, rng.uniform(-2, 2, n), 0.0)
        heading = np.where(drift != 0, rng.uniform(-0.2, 0.2, n), 0.0)
        out = np.column_stack(
            [2000 + rng.uniform(-reach, reach, n), road.centers[lane] + drift, heading, rng.uniform(0, 40, n)]
        )
        return np.round(out / _GRID) * _GRID

    body = [5.0, 2.0, 0.0]
    ego = np.concatenate([states(1, 0.0)[0], body])
    others = np.column_stack([states(vehicles, 120.0), np.tile(body, (vehicles, 1))])
    target = Target(road.lane_at(float(ego[State.Y])), float(rng.choice([20.0, 25.0, 30.0])))
    return Scene(ego, others, road, EgoControl(target), 1 / 15, 15)


def check_rule(rule: Rule, scenes: int = 200, seed: int = 0) -> None:
    """Check that an object is a rule that the shield can use.

    - It has a `Reason`.
    - It returns a bool for every action in random scenes, and the same one twice.
    - It does not change the scene.
    - Its result does not depend on the order of the others, or on a shift along the road.
    - It refuses no action on an empty road.

    Parameters
    ----------
    rule : the rule.
    scenes : number of random scenes.
    seed : seed of the scenes.

    Raises
    ------
    AssertionError
        If one of these does not hold.

    Examples
    --------
    >>> from shield.rules import TtcRule
    >>> check_rule(TtcRule(2.0))
    """
    name = type(rule).__name__
    reason = getattr(rule, "reason", None)
    _require(isinstance(reason, Reason), f"{name}.reason must be a Reason, got {reason!r}; have {[*Reason]}")
    _require(callable(getattr(rule, "objects", None)), f"{name} must have a method objects(scene, target)")
    rng = np.random.default_rng(seed)
    for i in range(scenes):
        scene = random_scene(rng, vehicles=int(rng.integers(1, 12)))
        shift = np.zeros(len(Vehicle))
        shift[State.X] = float(rng.integers(-1500, 1500))
        shuffled = replace(scene, others=rng.permutation(scene.others))
        moved = replace(scene, ego=scene.ego + shift, others=scene.others + shift)
        empty = replace(scene, others=scene.others[:0])
        for action, label in enumerate(scene.control.actions):
            target = scene.target_of(action)
            where = f"{label} in random scene {i} (seed {seed})"
            before = _arrays(scene)
            first = _answer(rule, scene, target, where)
            same = all(np.array_equal(a, b) for a, b in zip(before, _arrays(scene), strict=True))
            _require(same, f"{name} changed the scene; it must only read it: {where}")
            again = _answer(rule, scene, target, where)
            _require(again == first, f"{name} answered {first}, then {again}, to the same question: {where}")
            for other, what in ((shuffled, "the order of the others"), (moved, "a shift along the road")):
                answer = _answer(rule, other, target, where)
                _require(answer == first, f"{name} answered {first}, but {answer} after {what} changed: {where}")
            _require(
                not _answer(rule, empty, target, where),
                f"{name} objects on an empty road, so nothing could ever pass: {where}",
            )


def check_policy(
    policy: Any,
    env: gym.Env[Any, Any],
    steps: int = 20,
    seed: int = 0,
    deterministic: bool = True,
) -> None:
    """Check that an object can be used as a policy in `Shield(policy, env=env)`.

    `predict` takes SB3's arguments, returns an action of the action space and a state, and does not change the
    observation. If the policy has scores, they are finite, one per action.

    Parameters
    ----------
    policy : the policy.
    env : an environment with meta-actions; it is reset and stepped.
    steps : number of decisions.
    seed : seed of the first episode.
    deterministic : also check that `predict(..., deterministic=True)` returns the same action twice.

    Raises
    ------
    AssertionError
        If one of these does not hold.
    """
    name, space = type(policy).__name__, env.action_space
    _require(callable(getattr(policy, "predict", None)), f"{name} has no method predict()")
    _require(
        isinstance(space, gym.spaces.Discrete), f"the shield filters discrete actions, the environment has {space}"
    )
    assert isinstance(space, gym.spaces.Discrete)
    obs, _ = env.reset(seed=seed)
    state, start = None, np.ones(1, dtype=bool)
    for i in range(steps):
        kept = np.array(obs, copy=True)
        action, after = _predict(policy, obs, state, start)
        _require(np.array_equal(kept, obs), f"{name}.predict changed the observation; it must only read it (step {i})")
        _require(np.size(action) == 1, f"{name}.predict returned {action!r} for one observation; one action is wanted")
        value = np.asarray(action).reshape(-1)[0]
        _require(
            bool(np.isreal(value)) and np.isfinite(value) and value == int(value) and space.contains(int(value)),
            f"{name}.predict returned {value!r}, which is not an action: valid are {space}",
        )
        if deterministic:
            again, _ = _predict(policy, obs, state, start)
            _require(
                int(np.asarray(again).reshape(-1)[0]) == int(value),
                f"{name}.predict with deterministic=True returned {action!r}, then {again!r}, for one observation",
            )
        scores = ranking_of(policy, obs)
        if scores is not None:
            _require(
                np.size(scores) == space.n and bool(np.isfinite(scores).all()),
                f"{name} must give {space.n} finite scores, one per action; got {scores!r}",
            )
        obs, _, terminated, truncated, _ = env.step(int(value))
        state, start = after, np.array([terminated or truncated])
        if start[0]:
            obs, _ = env.reset()


def _predict(policy: Any, obs: Any, state: Any, start: Any) -> tuple[Any, Any]:
    name = type(policy).__name__
    try:
        answer = policy.predict(obs, state=state, episode_start=start, deterministic=True)
    except TypeError as error:
        raise AssertionError(
            f"{name}.predict must take (observation, state, episode_start, deterministic): {error}"
        ) from error
    _require(
        isinstance(answer, tuple) and len(answer) == 2,
        f"{name}.predict must return the pair (action, state), got {answer!r}",
    )
    return answer[0], answer[1]


def _answer(rule: Rule, scene: Scene, target: Target, where: str) -> bool:
    answer = rule.objects(scene, target)
    # `numpy.bool` is not accepted: `answer is True` would be False with it.
    _require(
        isinstance(answer, bool),
        f"{type(rule).__name__}.objects must return a bool, got {answer!r} ({type(answer).__name__}): {where}",
    )
    return answer


def _arrays(scene: Scene) -> list[FloatArray]:
    arrays = (scene.ego, scene.others, scene.ego_road, scene.others_road, scene.road.centers)
    return [a.copy() for a in arrays]


def _require(holds: bool, text: str) -> None:
    """An assertion that is also checked under `python -O`."""
    if not holds:
        raise AssertionError(text)
