"""Common text of all explanations: the executed command, and its justification."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Any

import numpy as np

from shield.decision import Decision, Intervention, Reason, Tier
from shield.explanation import Explanation, LostGuarantee, number

__all__ = ["action_name", "executed_text", "inputs_name", "justification_text", "nothing_judged"]

_PROOFS = {
    Tier.STORED_PLAN: "the fail-safe that was verified before",
    Tier.EVADED: "which stays clear of all compliant vehicles, and of the violators for as long as can be expected",
    Tier.LARGEST_MARGIN: "the plan that stays clear longest, as none verifies",
    Tier.EMERGENCY: "the last resort, which is not verified",
}
_LOST = {
    LostGuarantee.NOTHING: "nothing is lost: it still verifies",
    LostGuarantee.PRECAUTION: (
        "a precaution is lost and the guarantee is not: without vehicles that may cut in it verifies"
    ),
    LostGuarantee.GUARANTEE: "the guarantee is lost",
}


def action_name(labels: Sequence[str], action: Any) -> str:
    """Name of a meta-action; the text of any other action."""
    try:
        index = int(action)
    except (TypeError, ValueError, OverflowError):
        return str(action)
    return labels[index] if 0 <= index < len(labels) else str(action)


def inputs_name(inputs: Any) -> str:
    """Acceleration [m/s^2] and front wheel angle [rad], (2,), as text such as "+5.0 m/s², −1.2°"."""
    acceleration, wheel = (float(x) for x in np.ravel(inputs))
    return f"{acceleration:+.1f} m/s², {np.degrees(wheel):+.1f}°".replace("-", "−")


def executed_text(at: Decision, record: Decision, name: Any, speed: float) -> str:
    """Text of what was executed instead of a proposal.

    Parameters
    ----------
    at : decision that refused the proposal. record : decision of the whole step. name : returns the name of an action.
    speed : of the ego at `at` [m/s].
    """
    if isinstance(at.executed, np.ndarray) and at.executed.shape == (2,) and at.executed is not record.executed:
        return f"{inputs_name(at.executed)} instead"
    command = at.executed
    if _acceleration(command) is None:
        if record.intervention is Intervention.OTHER_ACTION:
            return f"{name(record.executed)} instead"
        command = None if record.first_overridden is None else record.first_overridden.executed
    acceleration = _acceleration(command)
    frames = f" in {record.frames_overridden} of {record.frames} frames" if record.frames else ""
    if acceleration is not None:
        how = f"{acceleration:+.1f} m/s² from {speed:.1f} m/s" if isfinite(speed) else f"{acceleration:+.1f} m/s²"
        return f"held at {how}{frames} instead".replace("-", "−")
    if record.intervention is Intervention.NONE:
        return f"{name(record.executed)} all the same"
    return f"held back{frames} instead"


def _acceleration(command: Any) -> float | None:
    """Acceleration of a command for one frame [m/s^2]; None for an action."""
    given = command.get("acceleration") if isinstance(command, dict) else getattr(command, "acceleration", None)
    return None if given is None else float(given)


def justification_text(at: Decision, lost: LostGuarantee) -> str:
    """Text of the justification of what was executed."""
    if at.tier in _PROOFS:
        return f"{_PROOFS[at.tier]} ({_LOST[lost]})"
    if at.reason is Reason.RESUME:
        return "to recover the speed before the shield braked"
    return f"verified, {number(at.margin)} m beyond the buffer" if isfinite(at.margin) else "verified"


def nothing_judged(at: Decision, record: Decision, name: Any, speed: float, proposal: str, frame: int) -> Explanation:
    """Explanation of a step without a verification: the action was invalid, or the scene or the policy failed."""
    nothing, lost = (
        float("nan"),
        LostGuarantee.NOTHING if at.tier in (Tier.STORED_PLAN, Tier.ALTERNATIVE) else LostGuarantee.GUARANTEE,
    )
    tail = executed_text(at, record, name, speed), justification_text(at, lost)
    return Explanation(proposal, at.reason, "", None, nothing, nothing, at.reason.text, *tail, at.margin, frame, lost)
