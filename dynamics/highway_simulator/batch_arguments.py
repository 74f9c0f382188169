"""Checks of the arguments of a batch of compiled environments: which to reset, with which seeds, and actions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynamics.errors import ActionError, ConfigError
from dynamics.state import FloatArray, IntArray

__all__ = ["checked_resets", "checked_steps", "kernel_actions"]


def checked_resets(
    num_envs: int, seeds: Sequence[int] | NDArray[Any] | None, which: Sequence[int] | None
) -> tuple[IntArray, IntArray]:
    """The environments to reset, all by default, and the seed of each. A seed of -1 means that the present generator
    continues.

    Raises
    ------
    ConfigError
        If an environment does not exist, or there is not one seed from 0 to 2^63 - 1 for each.
    """
    chosen = np.arange(num_envs) if which is None else np.asarray(which, dtype=np.int64)
    if chosen.ndim != 1 or ((chosen < 0) | (chosen >= num_envs)).any():
        raise ConfigError(f"there are environments 0 to {num_envs - 1}, not {which!r}")
    if seeds is None:
        return chosen, np.full(len(chosen), -1)
    given = list(seeds)
    if len(given) != len(chosen) or not all(isinstance(s, int | np.integer) and 0 <= s < 2**63 for s in given):
        raise ConfigError(f"have a seed from 0 to 2^63 - 1 for each of {len(chosen)} environments, not {seeds!r}")
    return chosen, np.array(given, dtype=np.int64)


def checked_steps(num_envs: int, which: Sequence[int] | NDArray[Any] | None) -> IntArray | None:
    """The environments to step, in increasing order; None for all.

    Raises
    ------
    ConfigError
        If they are not in increasing order, or one does not exist.
    """
    if which is None:
        return None
    chosen = np.asarray(which, np.int64)
    inside = chosen.ndim == 1 and ((chosen >= 0) & (chosen < num_envs)).all()
    if not (inside and (np.diff(chosen) > 0).all()):
        raise ConfigError(f"have environments from 0 to {num_envs - 1} in increasing order, not {which!r}")
    return chosen


def kernel_actions(actions: Any, num_envs: int, labels: int, inputs: Any) -> FloatArray:
    """Actions in the form of the kernels, (num_envs, 2).

    Parameters
    ----------
    labels : number of meta-actions. inputs : conversion of actions to throttle and steering (`scenario.Inputs`); None
        for meta-actions.

    Raises
    ------
    ActionError
        If there is not one action for each environment, or one is not in the action space.
    """
    actions = np.asarray(actions)
    if inputs is not None:
        if actions.shape != (num_envs, inputs.size) or not np.isfinite(actions).all():
            raise ActionError(f"have finite actions of shape {(num_envs, inputs.size)}, not {actions.shape}")
        scaled: FloatArray = inputs(actions)
        return scaled
    if actions.shape != (num_envs,) or not ((actions >= 0) & (actions < labels)).all():
        raise ActionError(f"have {num_envs} meta-actions from 0 to {labels - 1}, not {actions!r}")
    given = np.zeros((num_envs, 2))
    given[:, 0] = actions
    return given
