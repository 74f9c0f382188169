"""Policies by name: constant actions, random actions, the reference policies, and SB3 zip files.

All have the `predict` signature of Stable-Baselines3:

>>> from evaluation.settings import get_setting
>>> env = get_setting("highway-fast").make()
>>> policy = make_policy("faster", env)
>>> int(policy.predict(None)[0])
3
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from highway_env.envs.common.action import ContinuousAction, DiscreteAction
from numpy.typing import NDArray

from dynamics.vehicle.actuators import Actuators
from evaluation.learning.algorithms import load_model
from evaluation.learning.manifests import manifest_path
from evaluation.learning.normalised_model import statistics_beside, with_statistics
from evaluation.names import BASELINES, check_policy, policy_label
from evaluation.policies import list_references, load_reference
from evaluation.running.highway_planner import highway_policy
from evaluation.running.parking_planner import PARKING_POLICIES, parking_policy
from evaluation.running.roundabout_planner import roundabout_policy
from mpc import MPCPolicy
from mpc.filter.program.road_step import StageModel
from mpc.lookahead_policy import LookaheadPolicy
from shield.batch.lookahead import ShieldedLookaheadPolicy
from shield.errors import ConfigError, PolicyError
from shield.wrappers.policy_adapters import refuse_misfits

__all__ = [
    "BASELINES",
    "ConstantPolicy",
    "Policy",
    "RandomActions",
    "WeavingPolicy",
    "is_model",
    "make_policy",
    "policy_label",
    "start_episode",
]

_META = {"faster": "FASTER", "slower": "SLOWER", "idle": "IDLE", "left": "LANE_LEFT", "right": "LANE_RIGHT"}
_INPUTS = {"throttle", "idle"}
_SEVERAL_EGOS = (
    "several egos are driven by ShieldedEnv(env, ShieldConfig.simulated_traffic()), whose step takes a tuple of actions"
)
_WEAVING = ("LANE_LEFT", "FASTER", "LANE_RIGHT", "FASTER")


class Policy(Protocol):
    """A policy with the `predict` of Stable-Baselines3."""

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """The action for an observation, and the next hidden state."""
        ...


class ConstantPolicy:
    """The same action at every decision.

    Parameters
    ----------
    action : index of a meta-action, or a normalised continuous action.
    """

    def __init__(self, action: int | NDArray[np.float32]) -> None:
        self.action = action

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """The constant action; the observation is ignored."""
        return np.array(self.action), state

    def plan(self, seed: int, steps: int) -> NDArray[np.intp]:
        """The actions of the first `steps` decisions of an episode."""
        return np.full(steps, self.action)


class RandomActions:
    """Uniform random actions from a generator of its own, reproducible per episode.

    Parameters
    ----------
    space : the action space.
    seed : seed of the first episode.
    """

    def __init__(self, space: gym.Space[Any], seed: int = 0) -> None:
        self._space = space
        self.reset(seed)

    def reset(self, seed: int) -> None:
        """Start an episode: the actions depend on its seed alone."""
        self._generator = np.random.default_rng(seed)

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """An action drawn uniformly, for every value of `deterministic`."""
        space = self._space
        if isinstance(space, gym.spaces.Discrete):
            return np.asarray(space.start + self._generator.integers(space.n)), state
        if isinstance(space, gym.spaces.Box):
            return self._generator.uniform(space.low, space.high).astype(space.dtype), state
        several = f"; {_SEVERAL_EGOS}" if isinstance(space, gym.spaces.Tuple) else ""
        raise ConfigError(f"random actions need a Discrete or a Box action space, not {space}{several}")

    def plan(self, seed: int, steps: int) -> NDArray[np.intp]:
        """The actions of the first `steps` decisions of an episode, for a Discrete action space."""
        space = self._space
        assert isinstance(space, gym.spaces.Discrete)
        found: NDArray[np.intp] = space.start + np.random.default_rng(seed).integers(space.n, size=steps)
        return found


class WeavingPolicy:
    """Repeats LANE_LEFT, FASTER, LANE_RIGHT, FASTER: lane changes at the highest speed, without regard to the traffic.

    Parameters
    ----------
    actions : indices of these four meta-actions.
    """

    def __init__(self, actions: Sequence[int]) -> None:
        self.actions = np.asarray(actions, np.intp)
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Start an episode with the first action."""
        self._step = 0

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """The next action of the sequence."""
        self._step += 1
        return np.asarray(self.actions[(self._step - 1) % len(self.actions)]), state

    def plan(self, seed: int, steps: int) -> NDArray[np.intp]:
        """The actions of the first `steps` decisions of an episode."""
        return np.resize(self.actions, steps)


def is_model(name: str) -> bool:
    """Whether a policy is read from a file: a reference policy, or a zip file."""
    return name.endswith(".zip") or name in list_references()


def start_episode(policy: Policy, seed: int) -> None:
    """Start an episode of a policy with this seed; only `RandomActions` and `WeavingPolicy` have such a state."""
    if isinstance(policy, RandomActions | WeavingPolicy):
        policy.reset(seed)


def make_policy(
    name: str, env: gym.Env[Any, Any], algorithm: str | None = None, model: StageModel | None = None
) -> Policy:
    """Make a policy by name, or load it from an SB3 zip file.

    Parameters
    ----------
    name : a name in `BASELINES`, a reference policy, or the path of a zip file. If the file of its `VecNormalize` lies
        beside it, observations are normalised (see `evaluation.learning.normalised_model.statistics_beside`).
    env : the environment of the policy.
    algorithm : SB3 algorithm of a zip file; by default from the manifest beside the file, or from the file.
    model : dynamics model of `mpc` (see `evaluation.running.driving_model`); the other policies ignore it.

    Raises
    ------
    ConfigError
        On an unknown name, or a zip file of unknown algorithm; the message lists what is valid.
    PolicyError
        If a file cannot be read (see `evaluation.learning.algorithms.load_model`), or its observation or action space
        differs from the environment's.
    """
    if name in _META or name in _INPUTS:
        return ConstantPolicy(_constant(name, env))
    if name == "random":
        return RandomActions(env.action_space)
    if name == "weaving":
        return WeavingPolicy([_meta_action(label, env) for label in _WEAVING])
    if name == "lookahead":
        return LookaheadPolicy(env)
    if name == "lookahead-shielded":
        return ShieldedLookaheadPolicy(env)
    if name == "mpc":
        return MPCPolicy(env, model=model)
    if name == "cem" and type(env.unwrapped.action_type).__name__ == "DiscreteMetaAction":  # type: ignore[attr-defined]
        roundabout = type(env.unwrapped).__name__ == "RoundaboutEnv"
        return roundabout_policy(env) if roundabout else highway_policy(env)
    if name in PARKING_POLICIES:
        return parking_policy(name, env)
    if is_model(name):
        made = load_reference(name) if name in list_references() else _load_zip(Path(name), algorithm, env)
        try:
            refuse_misfits(made, env)
        except PolicyError as error:
            raise PolicyError(f"{name} does not drive this environment: {error}") from None
        return made
    check_policy(name)
    raise ConfigError(f"the policy {name!r} does not drive this environment")


def _constant(name: str, env: gym.Env[Any, Any]) -> int | NDArray[np.float32]:
    """The action of a constant policy in an environment."""
    kind = env.unwrapped.action_type  # type: ignore[attr-defined]
    label = type(kind).__name__
    if isinstance(kind, ContinuousAction):
        inputs = _inputs(name, Actuators.of(kind))
        return int(inputs) if isinstance(kind, DiscreteAction) else inputs
    if label == "MultiAgentAction":
        raise ConfigError(f"policy {name!r} drives one ego, and this environment takes {label}; {_SEVERAL_EGOS}")
    if label != "DiscreteMetaAction":
        raise ConfigError(
            f"policy {name!r} needs DiscreteMetaAction, ContinuousAction or DiscreteAction; this environment takes"
            f" {label}; have random"
        )
    if name not in _META:
        raise ConfigError(f"{name!r} needs ContinuousAction; this environment takes {label}; have {_list(_META)}")
    return _meta_action(_META[name], env)


def _meta_action(label: str, env: gym.Env[Any, Any]) -> int:
    """The index of a meta-action in an environment."""
    indexes: dict[str, int] = getattr(env.unwrapped.action_type, "actions_indexes", {})  # type: ignore[attr-defined]
    if label not in indexes:
        raise ConfigError(f"this environment has no action {label}; have {sorted(indexes)}")
    return int(indexes[label])


def _inputs(name: str, actuators: Actuators) -> Any:
    """Action of a constant policy for throttle and steering: normalised, or the index of the nearest action."""
    valid = _INPUTS if actuators.longitudinal else _INPUTS - {"throttle"}
    if name not in _INPUTS:
        raise ConfigError(f"{name!r} is a meta-action; this environment takes ContinuousAction; have {_list(valid)}")
    if name not in valid:
        raise ConfigError(f"this environment's ContinuousAction has no {name}; have {_list(valid)}")
    acceleration = actuators.acceleration[1] if name == "throttle" else 0.0
    return actuators.normalised(np.array([acceleration, 0.0]))


def _list(names: Iterable[str]) -> str:
    return ", ".join([*sorted(names), "random"])


def _load_zip(path: Path, algorithm: str | None, env: gym.Env[Any, Any]) -> Policy:
    check_policy(str(path))
    manifest = manifest_path(path)
    if algorithm is None and manifest.is_file():
        algorithm = json.loads(manifest.read_text(encoding="utf-8")).get("algorithm")
    model, statistics = load_model(path, algorithm, env), statistics_beside(path)
    return model if statistics is None else with_statistics(model, statistics)
