"""Adapters of models, networks and functions to SB3's `predict`."""

from __future__ import annotations

import inspect
from typing import Any

import gymnasium as gym
import numpy as np

from shield.errors import PolicyError

__all__ = ["as_policy", "refuse_misfits"]

_ARGUMENTS = ("state", "episode_start", "deterministic")


def as_policy(policy: Any, env: Any) -> Any:
    """An object with `predict(observation, state, episode_start, deterministic)`.

    Parameters
    ----------
    policy : an object with such a method: an SB3 or sb3-contrib model, a bare `BasePolicy`, or any other. Or a
        `torch.nn.Module`, which maps a batch of observations, (n, ...), to scores of the actions or to continuous
        actions. Or a function that maps one observation, or a batch, to the action or actions.
    env : the environment, or the VecEnv, that it is for.

    Raises
    ------
    PolicyError
        If it is none of these, is shielded already, or its `predict` does not accept those arguments.
    """
    if type(policy).__name__ == "Shield":
        raise PolicyError("this policy is a Shield already: another around it would filter what was filtered")
    if callable(getattr(policy, "predict", None)):
        _check_signature(policy)
        return policy
    if isinstance(policy, type):
        raise PolicyError(f"{policy.__name__} is a class; pass a model, such as {policy.__name__}.load(path)")
    if hasattr(policy, "parameters") and callable(getattr(policy, "forward", None)):
        if getattr(_single(env, "observation_space"), "shape", None) is None:
            raise PolicyError(
                f"{type(policy).__name__} is a network, which takes arrays; the environment's observations are "
                f"{_single(env, 'observation_space')}. Pass a function of the observation instead"
            )
        return _Network(policy, env)
    if callable(policy):
        return _Function(policy)
    raise PolicyError(
        f"{type(policy).__name__} has no predict(); pass an SB3 model, a BasePolicy, a torch.nn.Module, a function of "
        "the observation, or an object with predict(obs, state, episode_start, deterministic)"
    )


def refuse_misfits(policy: Any, env: Any) -> None:
    """Check that the spaces of a model fit those of the environment.

    Raises
    ------
    PolicyError
        If they have other shapes.
    """
    for name in ("observation_space", "action_space"):
        mine, theirs = getattr(policy, name, None), _single(env, name)
        if mine is None or theirs is None:
            continue
        if not _alike(mine, theirs):
            raise PolicyError(
                f"the policy was made for another {name}: it has {mine}, the environment {theirs}. Pass one with the "
                "configuration, and the wrappers, that the policy was trained with"
            )


def _single(env: Any, name: str) -> Any:
    """Space of a single environment; None if `env` has no such space."""
    return getattr(env, f"single_{name}", None) or getattr(env, name, None)


def _alike(mine: Any, theirs: Any) -> bool:
    """Whether two spaces, and their subspaces, have the same kind, shape and number of values."""
    if type(mine) is not type(theirs) or mine.shape != theirs.shape:
        return False
    if isinstance(mine, gym.spaces.Dict):
        return mine.keys() == theirs.keys() and all(_alike(mine[key], theirs[key]) for key in mine)
    if isinstance(mine, gym.spaces.Tuple):
        return len(mine) == len(theirs) and all(map(_alike, mine, theirs))
    counts: list[Any] = [[getattr(space, name, None) for name in ("n", "nvec")] for space in (mine, theirs)]
    return all(map(np.array_equal, *counts))


def _check_signature(policy: Any) -> None:
    """Raise `PolicyError` unless `predict` accepts SB3's arguments."""
    try:
        signature = inspect.signature(policy.predict)
    except (TypeError, ValueError):
        return
    try:
        signature.bind(None, **dict.fromkeys(_ARGUMENTS))
    except TypeError as error:
        raise PolicyError(
            f"{type(policy).__name__}.predict{signature} cannot be called as SB3's predict(observation, state=, "
            f"episode_start=, deterministic=): {error}. Add these arguments, or pass the function itself"
        ) from None


class _Function:
    """Adapter of a function of the observation."""

    def __init__(self, function: Any) -> None:
        self.function = function

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        actions = self.function(observation)
        try:
            return np.asarray(actions), state
        except ValueError:
            # Rows of different lengths: an invalid action, or one action for each of several environments.
            return actions, state


class _Network:
    """Adapter of a `torch.nn.Module`: the action with the best score, or continuous actions, clipped."""

    def __init__(self, network: Any, env: Any) -> None:
        self.network = network
        self.action_space, self.observation_space = _single(env, "action_space"), _single(env, "observation_space")

    def action_scores(self, observation: Any) -> Any:
        """Scores of discrete actions, (n, actions); None for continuous ones."""
        return self._outputs(observation)[0] if hasattr(self.action_space, "n") else None

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        outputs, alone = self._outputs(observation)
        if hasattr(self.action_space, "n"):
            actions = outputs.argmax(axis=-1)
        else:
            actions = np.clip(outputs, self.action_space.low, self.action_space.high)
        return (actions[0] if alone else actions), state

    def _outputs(self, observation: Any) -> tuple[np.ndarray[Any, Any], bool]:
        """Outputs of the network for a batch, (n, outputs), and whether the input was a single observation."""
        import torch

        batch = np.asarray(observation, np.float32)
        alone = batch.ndim == len(self.observation_space.shape)
        # Use the device and precision of the network; without parameters, float32 on the CPU.
        like = next((part for part in self.network.parameters() if part.is_floating_point()), torch.empty(0))
        with torch.no_grad():
            outputs = self.network(torch.as_tensor(batch[None] if alone else batch, device=like.device).to(like.dtype))
        return outputs.float().cpu().numpy(), alone
