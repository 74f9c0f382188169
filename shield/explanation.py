"""Why a proposal was refused: as text, and as data."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from math import isfinite, nan
from typing import Any

from shield.decision import Decision, Reason, Tier

__all__ = ["Explanation", "LostGuarantee", "Obstruction", "as_proposed", "number"]


class LostGuarantee(StrEnum):
    """What a fallback has lost.

    `NOTHING`: the executed plan verifies for this scene, now or at the frame before. `PRECAUTION`: it verifies without
    the vehicles that may cut in, which plans avoid as a precaution. `GUARANTEE`: the executed plan does not verify.
    """

    NOTHING = "nothing"
    PRECAUTION = "precaution"
    GUARANTEE = "guarantee"


@dataclass(frozen=True, slots=True)
class Obstruction:
    """The binding vehicle or obstacle of a refusal, at that time.

    Attributes
    ----------
    vehicle : the simulator's object. The number of the track if scenes come from observations; the row if the simulator
        has no objects.
    kind : name of its class, "track" or "vehicle". where : "ahead", "behind", "to the left" or "to the right", from the
        ego.
    distance : gap between the bodies along the ego's heading; across it if they are beside each other [m].
    lane : of the vehicle, "" without lanes. speed : of the vehicle [m/s].
    """

    vehicle: Any
    kind: str
    where: str
    distance: float
    lane: str
    speed: float

    @property
    def text(self) -> str:
        """Text such as "IDMVehicle 14.2 m ahead in lane 1 at 21.3 m/s"."""
        lane = f" in {self.lane}" if self.lane else ""
        return f"{self.kind} {self.distance:.1f} m {self.where}{lane} at {number(self.speed)} m/s"


@dataclass(frozen=True, slots=True)
class Explanation:
    """Why a proposal was refused, and what was executed instead.

    Attributes
    ----------
    refused : the proposal, such as "FASTER" or "+5.0 m/s², +0.0°"; "" if it was executed unchanged.
    reason : of the record.
    clause : a clause of the certificate ("separation", "cut-in", "room", "edge", "gap of the map", "rollback"), a rule
        ("rule: rss"), "simulated", "crash", or "road". "" if nothing was judged.
    cause : the vehicle; None without one.
    short : greatest shortfall of the buffer, or of the room [m]; NaN if it is not a length.
    after : time of the shortfall, from the frame of the refusal on [s]; NaN if it is unknown.
    frame : the frame of the step at which the proposal was refused, 0 for the decision itself.
    why : text of the predicted effect. done : text of the executed command. proof : text of its justification.
    margin : clearance beyond the buffer of the executed plan [m]; NaN if it is unknown.
    lost : what a fallback has lost.
    """

    refused: str
    reason: Reason
    clause: str
    cause: Obstruction | None
    short: float
    after: float
    why: str
    done: str
    proof: str
    margin: float = nan
    frame: int = 0
    lost: LostGuarantee = LostGuarantee.NOTHING

    @property
    def text(self) -> str:
        """One sentence for users."""
        if not self.refused:
            return f"{self.done}: {self.proof}"
        at = f" in frame {self.frame + 1}" if self.frame else ""
        return f"{self.refused} refused{at}: {self.why}; {self.done}, {self.proof}"

    def __str__(self) -> str:
        return self.text


def number(value: float, digits: int = 1) -> str:
    """Text of a number with a proper minus; "–" if it is not finite."""
    return f"{value:.{digits}f}".replace("-", "−") if isfinite(value) else "–"


def as_proposed(record: Decision) -> Explanation:
    """Explanation of a step in which the proposal was executed unchanged."""
    margin, by = record.margin, f" ({record.clause})" if record.clause else ""
    if record.tier is Tier.OFF:
        why = "no shield is at work"
    else:
        why = f"verified, {number(margin)} m beyond the buffer{by}" if isfinite(margin) else "verified"
    return Explanation("", record.reason, "", None, nan, nan, "", "executed as proposed", why, margin)
