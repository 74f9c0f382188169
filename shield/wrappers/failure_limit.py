"""Limit on repeated failures: a failure in many consecutive decisions is raised as an error. An invalid action gives
one warning."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from typing import Any

import numpy as np

from shield.decision import Decision, Reason
from shield.errors import PolicyError, SceneError
from shield.filters.discrete_action import action_labels

__all__ = ["ActionWarning", "FailureLimit"]

_log = logging.getLogger("shield")
_ERRORS: dict[Reason, type[PolicyError | SceneError]] = {
    Reason.BAD_SCENE: SceneError,
    Reason.POLICY_FAILED: PolicyError,
}


class FailureLimit:
    """Logs the first decision that cannot be made, and raises after too many.

    Parameters
    ----------
    most : consecutive decisions with the same failure that are left to the fallback; 0 for any number.
    """

    def __init__(self, most: int) -> None:
        self._most, self._reason, self._count = most, Reason.NONE, 0

    def check(self, decision: Decision, cause: str = "") -> None:
        """Count a decision; `cause` describes its failure.

        Raises
        ------
        SceneError, PolicyError
            If the scene, or the policy's action, could not be read in more than `most` consecutive decisions.
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
                "ShieldConfig.failure_limit is how many are left to the fallback before this is raised; 0: never"
            )


class ActionWarning:
    """Warns once of an invalid action, and lists the valid ones."""

    def __init__(self) -> None:
        self._warned = False

    def check(self, decisions: Iterable[Decision], base: Any) -> None:
        """Check the decisions of one step.

        Parameters
        ----------
        decisions : about one ego or several. base : the environment, unwrapped, or its prior map (`shield.Known`).
        """
        for decision in () if self._warned else decisions:
            if decision.reason is Reason.BAD_ACTION:
                self._warned = True
                given = decision.proposed
                shown = given.item() if isinstance(given, np.ndarray | np.generic) and given.size == 1 else given
                valid, hint = _valid(base, shown)
                _log.warning(
                    "%r is no action of this environment; have %s%s. The fallback acts instead, here %s, and the "
                    "record says %s. Logged once",
                    shown,
                    valid,
                    hint,
                    _name(base, decision.executed),
                    decision.reason.value,
                )


def _valid(base: Any, proposed: Any) -> tuple[str, str]:
    """Text on the valid actions, and a hint if the proposal is the name of one."""
    labels = action_labels(base)
    if not labels:
        return f"finite numbers of {base.action_space}", ""
    indexes = {label: index for index, label in labels.items()}
    hint = f": {proposed} is {indexes[proposed]}" if isinstance(proposed, str) and proposed in indexes else ""
    return ", ".join(f"{index} {label}" for index, label in sorted(labels.items())), hint


def _name(base: Any, executed: Any) -> str:
    """Name of an executed action; its text if the action has no name."""
    labels = action_labels(base)
    return labels.get(int(executed), str(executed)) if labels else str(executed)
