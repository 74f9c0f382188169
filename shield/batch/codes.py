"""Integer codes of reasons, tiers, clauses and rules."""

from __future__ import annotations

import numpy as np

from dynamics.state import BoolArray, FloatArray, IntArray
from dynamics.traffic.rules_of_the_road import RoadRule
from shield.certificate.road.verify import CLAUSES
from shield.decision import ROUNDING, Reason, Tier

__all__ = ["CLAUSES", "FALLBACKS", "OVERRIDES", "REASONS", "TIERS", "certified", "rules_in"]

REASONS, TIERS = tuple(Reason), tuple(Tier)
FALLBACKS = np.array([tier.fallback for tier in TIERS])
OVERRIDES = np.array([tier not in (Tier.OFF, Tier.PASSED) for tier in TIERS])
"""For each tier, whether it is a fallback, and whether it replaces the proposal."""
_CERTIFIED = np.array([tier.certified for tier in TIERS])


def certified(tiers: IntArray, reasons: IntArray, margins: FloatArray) -> BoolArray:
    """Which decisions have a certificate, for arrays of one shape; see `shield.decision.Decision.guarantee`."""
    lost = (tiers == TIERS.index(Tier.STORED_PLAN)) & (reasons == REASONS.index(Reason.NO_SAFE_PLAN))
    return np.asarray(_CERTIFIED[tiers] & ~np.isnan(margins) & ~(lost & (margins < -ROUNDING)))


def rules_in(broken: IntArray) -> dict[str, int]:
    """Number of violations of each rule, by its name, from a row of `BatchRecords.broken`, (rules,)."""
    return {str(rule): int(count) for rule, count in zip(RoadRule, broken, strict=True) if count}
