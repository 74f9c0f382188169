"""What a step reports of the shield."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from shield.decision import Decision

__all__ = ["report"]


def report(decision: Decision, frames: Sequence[Decision], violations: int) -> dict[str, Any]:
    """A decision and those about its frames as one: overridden where one of them is, with the reason of a fallback
    before that of any other.

    Parameters
    ----------
    violations : of the assumptions, by the traffic.
    """
    held = [d for d in frames if d.overridden]
    overridden = [decision, *held] if decision.overridden else held
    shown = next((d for d in overridden if d.tier.fallback), overridden[0] if overridden else decision)
    margins = [d.margin for d in (decision, *frames) if np.isfinite(d.margin)]
    return {
        "overridden": bool(overridden),
        "reason": shown.reason.value,
        "tier": shown.tier.value,
        "margin": min(margins, default=float("inf")),
        "frames_overridden": len(held),
        "violations": violations,
    }
