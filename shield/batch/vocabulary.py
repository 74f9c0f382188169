"""Reasons, tiers and clauses by number."""

from __future__ import annotations

from shield.certificate.clauses.together import NOTHING_BINDS, ROOM_BINDS, SEPARATION_BINDS, SLIP_IN_BINDS
from shield.decision import Reason, Tier

__all__ = ["CLAUSES", "REASONS", "TIERS"]

REASONS, TIERS = tuple(Reason), tuple(Tier)
CLAUSES = {NOTHING_BINDS: "", SEPARATION_BINDS: "separation", SLIP_IN_BINDS: "slip-in", ROOM_BINDS: "room"}
