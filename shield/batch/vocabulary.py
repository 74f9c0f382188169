"""Reasons, tiers and clauses by number."""

from __future__ import annotations

import numpy as np

from shield.certificate.clauses.together import NOTHING_BINDS, ROOM_BINDS, SEPARATION_BINDS, SLIP_IN_BINDS
from shield.decision import Reason, Tier

__all__ = ["CLAUSES", "FALLBACKS", "OVERRIDES", "REASONS", "TIERS"]

REASONS, TIERS = tuple(Reason), tuple(Tier)
FALLBACKS = np.array([tier.fallback for tier in TIERS])
OVERRIDES = np.array([tier not in (Tier.OFF, Tier.PASSED) for tier in TIERS])
"""Which tiers are fallbacks, and which stand for something else than the proposal."""
CLAUSES = {NOTHING_BINDS: "", SEPARATION_BINDS: "separation", SLIP_IN_BINDS: "slip-in", ROOM_BINDS: "room"}
