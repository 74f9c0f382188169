"""Conversion of a policy's output to one discrete action."""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["action_index", "action_labels"]

_LARGEST = 2.0**53
"""Beyond it not every integer is a float, and soon none fits a kernel's integer."""


def action_index(action: Any) -> int:
    """A single action index; -1 if `action` is not one (NaN, wrong shape, not whole, or too large).

    Examples
    --------
    >>> action_index(np.array([3])), action_index(float("nan")), action_index([1, 2]), action_index(1e30)
    (3, -1, -1, -1)
    """
    try:
        array = np.asarray(action, dtype=float).reshape(-1)
    except (TypeError, ValueError, OverflowError):
        return -1
    if array.size != 1 or not np.isfinite(array[0]) or array[0] != np.rint(array[0]) or abs(array[0]) > _LARGEST:
        return -1
    return int(array[0])


def action_labels(base: Any) -> dict[int, str]:
    """Names of the meta-actions by index, of one ego or of each of several; empty for other actions.

    Parameters
    ----------
    base : the environment, unwrapped, or its prior map (`shield.Known`).
    """
    kind = getattr(base, "action_type", None)
    kind = getattr(kind, "agents_action_types", [kind])[0]
    actions = base.actions if kind is None else getattr(kind, "actions", None)
    return dict(actions if isinstance(actions, dict) else enumerate(actions or ()))
