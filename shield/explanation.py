"""Why a proposal was refused: in words, and as data."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from math import isfinite, nan
from typing import Any

from shield.decision import Decision, Reason, Tier

__all__ = ["Explanation", "Lost", "Obstruction", "as_proposed", "number"]


class Lost(StrEnum):
    """What a fallback has lost.

    `NOTHING`: what is executed verifies, now or at the frame before, for this scene. `PRECAUTION`: it verifies but for
    the vehicles that may cut in, whom a plan keeps clear of as a precaution. `GUARANTEE`: nothing that verifies is
    executed.
    """

    NOTHING = "nothing"
    PRECAUTION = "precaution"
    GUARANTEE = "guarantee"


@dataclass(frozen=True, slots=True)
class Obstruction:
    """The vehicle, or obstacle, that a proposal was refused for, as it was then.

    Attributes
    ----------
    vehicle : the simulator's object; the number of a track where scenes are made of observations; the row where the
        simulator has no objects.
    kind : name of its class, "track" or "vehicle". where : "ahead", "behind", "to the left" or "to the
        right", seen from the ego.
    distance : between the bodies along the ego's way, across it where they are beside each other [m].
    lane : of the vehicle, "" where there are none. speed : of the vehicle [m/s].
    """

    vehicle: Any
    kind: str
    where: str
    distance: float
    lane: str
    speed: float

    @property
    def text(self) -> str:
        """Such as "IDMVehicle 14.2 m ahead in lane 1 at 21.3 m/s"."""
        lane = f" in {self.lane}" if self.lane else ""
        return f"{self.kind} {self.distance:.1f} m {self.where}{lane} at {number(self.speed)} m/s"


@dataclass(frozen=True, slots=True)
class Explanation:
    """Why a proposal was refused, and what was done instead.

    Attributes
    ----------
    refused : the proposal, such as "FASTER" or "+5.0 m/s², +0.0°"; "" where it was executed as it was.
    reason : of the record. clause : what refused it: a clause of the certificate ("separation", "slip-in", "room",
        "edge", "gap of the map", "rollback"), a rule ("rule: rss"), "simulated", "crash", "road", or "" where nothing
        was judged.
    cause : the vehicle; None where none is the cause.
    short : by how much the buffer, or the room, would be short at worst [m]; NaN where it is no length.
    after : when it would be, from the frame on at which the proposal was refused [s]; NaN where it is not known.
    frame : the frame of the step at which it was refused, 0 for the decision itself.
    why : what would happen, in words. done : what was done instead. proof : why that is right.
    margin : clearance beyond the buffer of what was done [m]; NaN where none is known.
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
    lost: Lost = Lost.NOTHING

    @property
    def text(self) -> str:
        """One sentence for people."""
        if not self.refused:
            return f"{self.done}: {self.proof}"
        at = f" in frame {self.frame + 1}" if self.frame else ""
        return f"{self.refused} refused{at}: {self.why}; {self.done}, {self.proof}"

    def __str__(self) -> str:
        return self.text


def number(value: float, digits: int = 1) -> str:
    """A number with a proper minus, "–" where there is none."""
    return f"{value:.{digits}f}".replace("-", "−") if isfinite(value) else "–"


def as_proposed(record: Decision) -> Explanation:
    """A step in which the proposal was executed as it was."""
    margin, by = record.margin, f" ({record.clause})" if record.clause else ""
    if record.tier is Tier.OFF:
        why = "no shield is at work"
    else:
        why = f"verified, {number(margin)} m beyond the buffer{by}" if isfinite(margin) else "verified"
    return Explanation("", record.reason, "", None, nan, nan, "", "executed as proposed", why, margin)
