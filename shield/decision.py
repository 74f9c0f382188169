"""The record of one decision: the proposed and the executed action, and the reason for a difference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import EnumType, StrEnum
from math import isfinite, isnan, nan
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from dynamics.deprecation import accept_former_fields, warn_of_former_name
from dynamics.state import FloatArray
from shield.errors import ConfigError

if TYPE_CHECKING:
    from shield.explanation import Explanation

__all__ = ["ROUNDING", "Decision", "Guarantee", "Intervention", "Reason", "Source", "Tier", "Verification", "weakest"]

ROUNDING = 1e-6
"""Amount by which the margin of a verified plan may decrease later through rounding alone [m]."""


class Reason(StrEnum):
    """Why the proposal was not executed as it was; `NONE` if it was."""

    NONE = "none"
    BUFFER = "buffer"
    DISTANCE = "distance"
    RSS = "rss"
    TTC = "ttc"
    UNVERIFIED = "unverified"
    RESUME = "resume"
    PRECAUTION = "precaution"
    NO_SAFE_PLAN = "no_safe_plan"
    BAD_ACTION = "bad_action"
    BAD_SCENE = "bad_scene"
    POLICY_FAILED = "policy_failed"
    STAGE_FAILED = "stage_failed"

    @property
    def text(self) -> str:
        """One sentence for users."""
        return _TEXT[self]


_TEXT = {
    Reason.NONE: "the proposal was verified and executed unchanged",
    Reason.BUFFER: "a lane change was proposed into a vehicle that is alongside, within the buffer",
    Reason.DISTANCE: "a lane change was proposed with a vehicle nearer than the fixed distance",
    Reason.RSS: "the proposal would break an RSS distance",
    Reason.TTC: "the time to collision was below the threshold",
    Reason.UNVERIFIED: "some behaviour within the assumptions would bring a vehicle into the buffer",
    Reason.RESUME: "the policy has no throttle; the shield brings the ego back to its speed before the shield braked",
    Reason.PRECAUTION: "a precaution refused every plan; the stored plan, which still verifies, was continued",
    Reason.NO_SAFE_PLAN: "nothing verified; the fallback acted (stored plan, or the largest margin)",
    Reason.BAD_ACTION: "the policy's action was outside the action space or not finite",
    Reason.BAD_SCENE: "the scene could not be read or was not finite; the fallback acted",
    Reason.STAGE_FAILED: "a stage of the shield raised (the error is logged); the fallback acted",
    Reason.POLICY_FAILED: "the policy raised or returned NaN; the fallback acted",
}


class Tier(StrEnum):
    """The stage that produced the executed action.

    `PASSED`, `ALTERNATIVE` and `GOVERNED` are verified. `STORED_PLAN` was verified at an earlier frame. `EVADED` is
    clear of every compliant vehicle, and of the violators for as long as can be expected. `LARGEST_MARGIN` and
    `EMERGENCY` are fallbacks without a certificate.
    """

    OFF = "off"
    PASSED = "passed"
    GOVERNED = "governed"
    ALTERNATIVE = "alternative"
    STORED_PLAN = "stored_plan"
    EVADED = "evaded"
    LARGEST_MARGIN = "largest_margin"
    EMERGENCY = "emergency"

    @property
    def verified(self) -> bool:
        """Whether the executed action has a certificate for the scene of this decision."""
        return self in (Tier.PASSED, Tier.GOVERNED, Tier.ALTERNATIVE)

    @property
    def certified(self) -> bool:
        """Whether the executed action was verified, at this frame or an earlier one, or evades a violator."""
        return self not in (Tier.OFF, Tier.LARGEST_MARGIN, Tier.EMERGENCY)

    @property
    def fallback(self) -> bool:
        """Whether the executed action was not verified for the present scene."""
        return self in (Tier.STORED_PLAN, Tier.EVADED, Tier.LARGEST_MARGIN, Tier.EMERGENCY)


class Intervention(StrEnum):
    """What the shield did to a proposal.

    `NONE`: the proposal was executed unchanged. `HELD_BACK`: the environment got the proposed action, and at least one
    simulation frame got other inputs than the action's own. `OTHER_ACTION`: the environment got another action.
    """

    NONE = "none"
    HELD_BACK = "held back"
    OTHER_ACTION = "other action"


class Verification(StrEnum):
    """What actions are verified against.

    `WORST_CASE`: every behaviour of the others within the assumptions. `SIMULATED`: highway-env's own traffic,
    simulated. `STANDING`: obstacles that stand still (parking lots). `RULE`: nothing, a rule decides alone. `OFF`: no
    shield.
    """

    WORST_CASE = "worst_case"
    SIMULATED = "simulated_traffic"
    STANDING = "standing_obstacles"
    RULE = "rule_alone"
    OFF = "off"


class _FormerMembers(EnumType):
    """Metaclass for former names of members, which warn."""

    def __getattr__(cls, name: str) -> Any:
        if name == "FULL":
            warn_of_former_name("Guarantee.FULL", "write Guarantee.ALL_SEEN")
            return cls["ALL_SEEN"]
        raise AttributeError(name)


class Guarantee(StrEnum, metaclass=_FormerMembers):
    """What a certificate rests on, besides the assumptions about the others' behaviour.

    `ALL_SEEN`: every vehicle was seen; no other assumption about the scene. `ASSUMED`: assumptions about unseen
    vehicles (`shield.Unseen`). `PROBABILISTIC`: also the assumption that every vehicle is within the bounds of its
    measurement. `BROKEN`: for an episode in which other vehicles violated the assumptions. `NONE`: no certificate. None
    of them means that a crash is impossible. The former name of `ALL_SEEN` is `FULL`, with the value "full".
    """

    ALL_SEEN = "all vehicles seen"
    ASSUMED = "assumed"
    PROBABILISTIC = "probabilistic"
    BROKEN = "assumptions broken"
    NONE = "none"

    __hash__ = StrEnum.__hash__

    def __eq__(self, other: object) -> bool:
        if self is Guarantee.ALL_SEEN and type(other) is str and other == "full":
            warn_of_former_name('guarantee == "full"', f'write guarantee == "{self.value}"')
            return True
        return str.__eq__(self, other) if isinstance(other, str) else NotImplemented

    @classmethod
    def _missing_(cls, value: object) -> Guarantee | None:
        if value == "full":
            warn_of_former_name('Guarantee("full")', "write Guarantee.ALL_SEEN", stacklevel=5)
            return cls.ALL_SEEN
        return None


class Source(Protocol):
    """Data of a decision, kept for its explanation."""

    def explain(self, at: Decision, record: Decision, frame: int) -> Explanation:
        """Why a proposal was refused.

        Parameters
        ----------
        at : the decision made from this data. record : the record of the step.
        frame : the frame that `at` is about, 0 for the decision about the action.
        """


_WEAKER = list(Guarantee)
"""Guarantees from the strongest to none."""


def weakest(*guarantees: Guarantee) -> Guarantee:
    """The weakest of some guarantees.

    Examples
    --------
    >>> weakest(Guarantee.ALL_SEEN, Guarantee.BROKEN, Guarantee.ASSUMED).value
    'assumptions broken'
    """
    return max(guarantees, key=_WEAKER.index)


@accept_former_fields(
    {
        "sight": "scene_guarantee",
        "weakest": "weakest_guarantee",
        "done": "step_intervention",
        "held": "first_overridden",
    }
)
@dataclass(frozen=True, slots=True)
class Decision:
    """One decision of the shield, about an action or about one simulation frame; or the record of a whole step.

    `last_decision` and `last_decisions` of both wrappers are records of steps (`with_frames`), from which
    `info["shield"]` and `report()` are read. `frame_decisions` has the parts.

    Attributes
    ----------
    proposed : the policy's action, unchanged.
    executed : the action that the environment gets.
    reason : why the two differ, or `Reason.NONE`.
    tier : the stage that produced `executed`.
    margin : clearance beyond the buffer of the executed plan, over its verified horizon [m]. NaN if it is unknown, or
        if every plan found ends in a crash.
    latency : time of the decision [s].
    plan : road states of the executed action and its fail-safe, (frames + 1, 4), or None. On a road network they are
        world states, from the present frame on, and filled only with `ShieldConfig.record`.
    occupancy : rectangles that the others can reach, (frames, vehicles, 4) as s_min, s_max, r_min, r_max in the road
        frame [m], or None; filled only with `ShieldConfig.record`. In simulated traffic, plan and occupancy are the
        prediction in the world frame (x, y, heading, speed; bounding boxes of the others).
    clause : the binding clause of the margin: "separation", "cut-in", "room", "edge", "gap of the map", "rollback"; ""
        without one.
    vehicle : row of the binding vehicle among the scene's others, -1 without one.
    scene_guarantee : what a certificate for this scene rests on.
    level : probability with which each side of each body is within its bounds, 1 if the states are exact.
    alarm : whether the sensor did not behave as assumed (`shield.perception.sensor_monitor`). Then the bounds are the
        widest, and there is no guarantee.
    frames_overridden : in the record of a step, the number of its frames that got other inputs.
    weakest_guarantee : in the record of a step, the weakest guarantee of the decision and its frames; None elsewhere.
    step_intervention : in the record of a step, the intervention; None elsewhere.
    frames : in the record of a step, the number of its frames so far.
    first_overridden : the first of these frames that was overridden; None if none was.
    source : data for `explain`; None without any.
    refusal : the decision that `explain` is about, and its frame. In the record of a step, the one that its reason and
        tier come from.
    """

    proposed: Any
    executed: Any
    reason: Reason
    tier: Tier
    margin: float
    latency: float
    plan: FloatArray | None = field(default=None, repr=False, compare=False)
    occupancy: FloatArray | None = field(default=None, repr=False, compare=False)
    clause: str = ""
    vehicle: int = -1
    scene_guarantee: Guarantee = Guarantee.ALL_SEEN
    level: float = 1.0
    alarm: bool = False
    frames_overridden: int = 0
    weakest_guarantee: Guarantee | None = None
    step_intervention: Intervention | None = None
    frames: int = 0
    first_overridden: Decision | None = field(default=None, repr=False, compare=False)
    source: Source | None = field(default=None, repr=False, compare=False)
    refusal: tuple[Decision, int] | None = field(default=None, repr=False, compare=False)

    @property
    def guarantee(self) -> Guarantee:
        """Guarantee of the executed plan. It is none if no plan was verified, at this frame or an earlier one, or if
        the stored plan that is continued does not verify any more."""
        if self.weakest_guarantee is not None:
            return self.weakest_guarantee
        lost = self.tier is Tier.STORED_PLAN and self.reason is Reason.NO_SAFE_PLAN and self.margin < -ROUNDING
        return self.scene_guarantee if self.tier.certified and not isnan(self.margin) and not lost else Guarantee.NONE

    @property
    def overridden(self) -> bool:
        """Whether something other than the proposal was executed."""
        if self.step_intervention is None:
            return self.tier not in (Tier.OFF, Tier.PASSED)
        return self.step_intervention is not Intervention.NONE

    @property
    def intervention(self) -> Intervention:
        """What was done to the proposal."""
        return self.step_intervention if self.step_intervention is not None else self.with_frames(()).intervention

    def with_frames(self, frames: Sequence[Decision]) -> Decision:
        """The record of a step: this decision, and those about its frames so far.

        The step is overridden if another action was executed, or a frame was overridden. Its reason and tier are those
        of the first fallback, or else of the first override. Its margin is the least finite one, with its clause and
        vehicle; NaN without one. Its guarantee is the weakest. Two cases are not overrides, since the proposal was
        executed unchanged: an acceleration cap without an overridden frame, and a fallback that equals the proposal.
        """
        overridden_frames, parts = [frame for frame in frames if frame.overridden], (self, *frames)
        same, holds = _same(self.proposed, self.executed), self.tier is Tier.GOVERNED
        unchanged, done = bool(frames) and not overridden_frames and holds and same, Intervention.NONE
        if self.overridden and not same:
            done = Intervention.OTHER_ACTION
        elif overridden_frames or (self.overridden and holds and not unchanged):
            done = Intervention.HELD_BACK
        overridden = [self, *overridden_frames] if self.overridden and not unchanged else overridden_frames
        shown = next((d for d in overridden if d.tier.fallback), overridden[0] if overridden else None)
        number = next((k for k, frame in enumerate(frames) if frame is shown), 0)
        least = min((d for d in parts if isfinite(d.margin)), key=lambda d: d.margin, default=None)
        tier = Tier.PASSED if unchanged else self.tier
        return replace(
            self,
            reason=Reason.NONE if shown is None else shown.reason,
            tier=tier if shown is None else shown.tier,
            margin=nan if least is None else least.margin,
            latency=sum(d.latency for d in parts),
            clause="" if least is None else least.clause,
            vehicle=-1 if least is None else least.vehicle,
            level=min(d.level for d in parts),
            alarm=any(d.alarm for d in parts),
            frames_overridden=len(overridden_frames),
            weakest_guarantee=weakest(*(d.guarantee for d in parts)),
            step_intervention=done,
            frames=len(frames),
            first_overridden=overridden_frames[0] if overridden_frames else None,
            refusal=None if shown is None else (shown if shown.refusal is None else shown.refusal[0], number),
        )

    def explain(self) -> Explanation:
        """Explanation of a refusal: the clause or rule, the vehicle, the time and the shortfall; what was executed
        instead, and its justification. `str()` of it is a sentence.

        It is computed on request, from the scene and the memory of the decision.

        Raises
        ------
        ConfigError
            If these were not kept: in a pickled copy, or in a decision that was not made by a shield.
        """
        from shield.explanation import as_proposed

        record = self if self.step_intervention is not None else self.with_frames(())
        if record.refusal is None:
            return as_proposed(record)
        at, frame = record.refusal
        if at.source is None:
            raise ConfigError(
                "the data of this decision was not kept: call last_decision.explain() of the shield that made it, in "
                "its process, before the decision is copied or pickled"
            )
        return at.source.explain(at, record, frame)


def _same(a: Any, b: Any) -> bool:
    """Whether two actions are equal; NaN and an invalid action equal none."""
    try:
        return bool(np.array_equal(np.ravel(np.asarray(a, float)), np.ravel(np.asarray(b, float))))
    except (TypeError, ValueError, OverflowError):
        return False
