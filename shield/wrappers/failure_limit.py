"""A fallback is for an instant: what goes wrong decision after decision is an error, and is raised as one. An action
that is none of the environment's is warned of once."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from typing import Any

import numpy as np

from shield.decision import Decision, Reason
from shield.errors import PolicyError, SceneError
from shield.filters.discrete_action import action_labels

__all__ = ["ActionWarning", "Patience"]

_log = logging.getLogger("shield")
_ERRORS: dict[Reason, type[PolicyError | SceneError]] = {
    Reason.BAD_SCENE: SceneError,
    Reason.POLICY_FAILED: PolicyError,
}


class Patience:
    """Says once that decisions cannot be made, and raises where that goes on.

    Parameters
    ----------
    most : decisions in a row with the same trouble that are left to the fallback; 0 for any number.
    """

    def __init__(self, most: int) -> None:
        self._most, self._reason, self._count = most, Reason.NONE, 0

    def check(self, decision: Decision, cause: str = "") -> None:
        """Take in a decision; `cause` is what is known of the trouble.

        Raises
        ------
        SceneError, PolicyError
            If it is one more than `most` in a row of which the scene, or the policy's action, could not be read.
        """
        if decision.reason not in _ERRORS:
            self._reason, self._count = Reason.NONE, 0
            return
        if decision.reason is not self._reason:
            self._reason, self._count = decision.reason, 0
            _log.error("%s%s", decision.reason.text, f" ({cause})" if cause else "")
        self._count += 1
        if 0 < self._most < self._count:
            raise _ERRORS[decision.reason](
                f"{self._count} decisions in a row: {decision.reason.text}{f' ({cause})' if cause else ''}. "
                "ShieldConfig.patience says after how many that is raised; 0 leaves it to the fallback for ever"
            )


class ActionWarning:
    """Warns once of an action that is none of the environment's, and says which are."""

    def __init__(self) -> None:
        self._told = False

    def check(self, decisions: Iterable[Decision], base: Any) -> None:
        """Take in the decisions of one step.

        Parameters
        ----------
        decisions : about one ego or several. base : the environment, unwrapped, or what is known of it
            (`shield.Known`).
        """
        for decision in () if self._told else decisions:
            if decision.reason is Reason.BAD_ACTION:
                self._told = True
                given = decision.proposed
                shown = given.item() if isinstance(given, np.ndarray | np.generic) and given.size == 1 else given
                valid, hint = _valid(base, shown)
                _log.warning(
                    "%r is no action of this environment; have %s%s. The fallback acts instead, here %s, and the "
                    "record says %s. Told once",
                    shown,
                    valid,
                    hint,
                    _name(base, decision.executed),
                    decision.reason.value,
                )


def _valid(base: Any, proposed: Any) -> tuple[str, str]:
    """The valid actions, and what one that is a name stands for."""
    labels = action_labels(base)
    if not labels:
        return f"finite numbers of {base.action_space}", ""
    indexes = {label: index for index, label in labels.items()}
    hint = f": {proposed} is {indexes[proposed]}" if isinstance(proposed, str) and proposed in indexes else ""
    return ", ".join(f"{index} {label}" for index, label in sorted(labels.items())), hint


def _name(base: Any, executed: Any) -> str:
    labels = action_labels(base)
    return labels.get(int(executed), str(executed)) if labels else str(executed)
