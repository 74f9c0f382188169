"""Separation of a policy's output into one action per environment, and its inverse."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from shield.errors import ConfigError

__all__ = ["ActionRows", "as_numbers"]


@dataclass(frozen=True, slots=True)
class ActionRows:
    """Actions of a policy for some environments.

    Attributes
    ----------
    rows : the action for each environment, valid or not; the filters fall back on invalid ones.
    shape : of the array that is returned instead. kind : its data type.
    """

    rows: list[Any]
    shape: tuple[int, ...]
    kind: Any

    @classmethod
    def of(cls, actions: Any, count: int, size: int | None, batched: bool) -> ActionRows:
        """Separate a policy's output: an array, a number, a list or a tuple.

        Parameters
        ----------
        count : number of environments.
        size : number of inputs in an action; None where an action is a whole number.
        batched : whether the observations were a batch, of at least one environment.

        Raises
        ------
        ConfigError
            If there are several environments, and another number of actions.
        """
        array, entries = as_numbers(actions), 1 if size is None else size
        kind: Any = np.dtype(np.int64) if size is None else np.dtype(np.float32)
        if array is not None and array.size == count * entries:
            flat = array.reshape(-1)
            # An integer type cannot represent the verified inputs.
            if size is not None and array.dtype.kind == "f":
                kind = array.dtype
            return cls(list(flat if size is None else flat.reshape(count, size)), array.shape, kind)
        shape = (*((count,) if batched or count > 1 else ()), *(() if size is None else (size,)))
        if count == 1:
            return cls([actions], shape, kind)
        several = isinstance(actions, Sequence | np.ndarray) and getattr(actions, "ndim", 1) > 0
        there = len(actions) if several else 1
        if there != count:
            raise ConfigError(
                f"the policy returned {there} actions for {count} environments; a batch needs one row per environment"
            )
        return cls(list(actions), shape, kind)

    def answer(self, executed: Sequence[Any]) -> Any:
        """The executed actions in the form of the policy's output."""
        return np.stack([np.asarray(each, dtype=self.kind).reshape(-1) for each in executed]).reshape(self.shape)


def as_numbers(actions: Any) -> np.ndarray[Any, Any] | None:
    """The actions as an array of numbers; None if they are not numbers."""
    try:
        array = np.asarray(actions)
    except (TypeError, ValueError):
        return None
    return array if array.dtype.kind in "iufb" else None
