"""The action type that the policy decides about, and a refusal of unsupported ones."""

from __future__ import annotations

from typing import Any

from highway_env.envs.common.action import ContinuousAction

from dynamics.scenes.parking_lot import is_parking_lot
from shield.errors import ConfigError
from shield.filters.simulated.remedies import multi_agent_advice

__all__ = ["action_type_name"]

_META, _INPUTS = "DiscreteMetaAction", "ContinuousAction"


def action_type_name(bases: list[Any], wrapper: str) -> str:
    """The action type of the policy: "DiscreteMetaAction" or "ContinuousAction". `DiscreteAction` counts as the latter.

    Raises
    ------
    ConfigError
        If it is neither, or differs between the environments.
    """
    kinds = {type(getattr(base, "action_type", None)) for base in bases}
    if len(kinds) == 1:
        (kind,) = kinds
        if issubclass(kind, ContinuousAction):
            return _INPUTS
        if kind.__name__ == _META:
            return _META
    names = ", ".join(sorted(kind.__name__ for kind in kinds))
    if names == "MultiAgentAction":
        instead = multi_agent_advice(bases[0])
        raise ConfigError(
            f"{wrapper} filters one ego's actions{f'; {instead}' if instead else ', and here are several'}"
        )
    valid = _INPUTS if any(map(is_parking_lot, bases)) else _META
    raise ConfigError(
        f"{wrapper} filters {_META}, {_INPUTS} or DiscreteAction; this environment has {names}. "
        f'Pass config={{"action": {{"type": "{valid}"}}}} to gym.make'
    )
