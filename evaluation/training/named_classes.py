"""Conversion of dotted names to classes in hyperparameters from TOML or the command line."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from importlib import import_module
from typing import Any

from shield.errors import ConfigError

__all__ = ["with_classes"]

_CLASSES = ("activation_fn", "features_extractor_class", "optimizer_class")
"""Entries of `policy_kwargs` that are classes."""


def with_classes(hyperparameters: Mapping[str, Any]) -> dict[str, Any]:
    """Hyperparameters with classes in `policy_kwargs` in place of their names.

    Parameters
    ----------
    hyperparameters : keyword arguments of an algorithm; `policy_kwargs` may name classes, such as
        "torch.nn.ReLU".

    Raises
    ------
    ConfigError
        If there is no such class.

    Examples
    --------
    >>> with_classes({"policy_kwargs": {"activation_fn": "torch.nn.ReLU"}})
    {'policy_kwargs': {'activation_fn': <class 'torch.nn.modules.activation.ReLU'>}}
    """
    found: dict[str, Any] = deepcopy(dict(hyperparameters))
    policy: dict[str, Any] = found.get("policy_kwargs") or {}
    for key in _CLASSES:
        if isinstance(policy.get(key), str):
            policy[key] = _class_named(key, policy[key])
    return found


def _class_named(key: str, name: str) -> Any:
    module, _, kind = name.rpartition(".")
    try:
        return getattr(import_module(module), kind)
    except (ImportError, AttributeError, ValueError):
        raise ConfigError(
            f"policy_kwargs.{key} is the dotted name of a class, such as torch.nn.ReLU; there is no {name!r}"
        ) from None
