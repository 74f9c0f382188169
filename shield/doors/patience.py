"""A fallback is for an instant: what goes wrong decision after decision is an error, and is raised as one."""

from __future__ import annotations

import logging

from shield.decision import Decision, Reason
from shield.errors import PolicyError, SceneError

__all__ = ["Patience"]

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
