"""Recovers what an environment observed from what reaches its policy: undoes observation wrappers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from shield.errors import ConfigError, SceneError

__all__ = ["TRANSPARENT_WRAPPERS", "check_wrappers", "latest", "stacked_in", "undo_vec_wrappers", "wrappers_of"]

TRANSPARENT_WRAPPERS = ("FlattenObservation", "FrameStackObservation", "ReshapeObservation", "DtypeObservation")
"""Gymnasium wrappers that keep the numbers of the latest observation, in the same order."""
_SENSOR = "sensor_noise"
"""Attribute of a sensor wrapper that states its noise. Its output counts as the observation."""


def undo_vec_wrappers(env: Any, observation: Any) -> Any:
    """Undo the wrappers of a VecEnv, the outermost first, for an observation or a batch.

    `VecNormalize` is inverted; a value that it clipped is unknown and becomes NaN. Of `VecFrameStack` the latest frame
    is left, on either stacking axis. `VecTransposeImage` is transposed back.

    Parameters
    ----------
    env : source of the policy's observations: a Gymnasium environment, a VecEnv, or None if nothing is to be undone.
    observation : a batch with one row per environment, or one observation.

    Raises
    ------
    ConfigError
        If a wrapper changes observations in another way (see `check_wrappers`).
    SceneError
        If the observation does not fit the wrappers.
    """
    from stable_baselines3.common.vec_env import VecFrameStack, VecNormalize, VecTransposeImage

    for wrapper in _vec_wrappers(env):
        if isinstance(wrapper, VecNormalize):
            if wrapper.norm_obs:
                shown = np.asarray(observation)
                cut = np.abs(shown) >= wrapper.clip_obs
                try:
                    undone = np.array(wrapper.unnormalize_obs(shown))
                except ValueError:
                    raise SceneError(_misfit(shown, wrapper)) from None
                undone[cut] = np.nan
                observation = undone
        elif isinstance(wrapper, VecFrameStack):
            observation = _last_of(np.asarray(observation), wrapper)
        elif isinstance(wrapper, VecTransposeImage):
            if not wrapper.skip:
                observation = np.moveaxis(np.asarray(observation), -3, -1)
        elif wrapper.observation_space != wrapper.venv.observation_space:
            raise ConfigError(
                f"{type(wrapper).__name__} changes observations, and cannot be undone; have VecNormalize, "
                "VecFrameStack, VecTransposeImage, and wrappers that leave observations as they are"
            )
    return observation


def check_wrappers(env: Any, names: tuple[str, ...] | None = None) -> None:
    """Check that each wrapper between highway-env and the policy either keeps observations or can be undone.

    Parameters
    ----------
    env : a Gymnasium environment, or a VecEnv, of which only the layers in this process are checked.
    names : names of the observation wrappers inside, if they are in another process.

    Raises
    ------
    ConfigError
        If a wrapper is unsuitable; the message lists the permitted ones.
    """
    from stable_baselines3.common.vec_env import VecFrameStack, VecNormalize, VecTransposeImage

    undone = VecNormalize, VecFrameStack, VecTransposeImage
    for wrapper in _vec_wrappers(env):
        if not isinstance(wrapper, undone) and wrapper.observation_space != wrapper.venv.observation_space:
            undo_vec_wrappers(wrapper, None)
    for name in wrappers_of(env) if names is None else names:
        if name not in TRANSPARENT_WRAPPERS:
            raise ConfigError(
                f"{name} changes observations, and cannot be undone: have {', '.join(TRANSPARENT_WRAPPERS)}, and "
                f"sensors that state their noise ({_SENSOR})"
            )


def wrappers_of(env: Any) -> tuple[str, ...]:
    """Names of the observation wrappers of a Gymnasium environment in this process, outermost first.

    Sensors that state their noise are left out. So are wrappers with the attribute `added_features`; their columns are
    cut off.
    """
    import gymnasium as gym
    from gymnasium.wrappers import FrameStackObservation

    found = []
    while isinstance(env, gym.Wrapper):
        known = hasattr(env, _SENSOR) or hasattr(type(env), "added_features")
        if isinstance(env, gym.ObservationWrapper | FrameStackObservation) and not known:
            found.append(type(env).__name__)
        env = env.env
    return tuple(found)


def stacked_in(env: Any) -> int:
    """Number of observations that `FrameStackObservation` stacks; 1 without it."""
    import gymnasium as gym
    from gymnasium.wrappers import FrameStackObservation

    many = 1
    while isinstance(env, gym.Wrapper):
        if isinstance(env, FrameStackObservation):
            many *= int(env.stack_size)
        env = env.env
    return many


def latest(observation: Any, shape: tuple[int, ...], stacked: int = 1) -> Any:
    """Latest of the observations that Gymnasium's wrappers have stacked and flattened, in any order.

    Parameters
    ----------
    observation : one observation, or a batch of one. shape : of an observation of the environment.
    stacked : number of stacked observations.

    Returns
    -------
    An array of that shape. An input of another shape is returned unchanged; its decoder raises the error.
    """
    size = math.prod(shape)
    each = (shape, (size,)) if stacked == 1 else ((stacked, *shape), (stacked, size), (stacked * size,))
    try:
        shown = np.asarray(observation)
    except ValueError:
        return observation
    if shown.shape not in (*each, *((1, *one) for one in each)):
        return observation
    return shown.reshape(-1)[-size:].reshape(shape)


def _vec_wrappers(env: Any) -> Iterator[Any]:
    """Wrappers of a VecEnv, outermost first."""
    from stable_baselines3.common.vec_env import VecEnvWrapper

    while isinstance(env, VecEnvWrapper):
        yield env
        env = env.venv


def _last_of(shown: Any, wrapper: Any) -> Any:
    """Latest frame of a `VecFrameStack` observation."""
    whole, one = wrapper.observation_space.shape, wrapper.venv.observation_space.shape
    if shown.shape not in (whole, (wrapper.num_envs, *whole)):
        raise SceneError(_misfit(shown, wrapper))
    axis = shown.ndim - len(whole) if wrapper.stacked_obs.channels_first else shown.ndim - 1
    many = one[0 if wrapper.stacked_obs.channels_first else -1]
    return shown[(*(slice(None),) * axis, slice(-many, None))]


def _misfit(shown: Any, wrapper: Any) -> str:
    """Message for an observation that does not have a wrapper's shape."""
    whole = wrapper.observation_space.shape
    return (
        f"{type(wrapper).__name__} shows observations of shape {whole}, or {(wrapper.num_envs, *whole)}, "
        f"not {shown.shape}"
    )
