"""The record of one decision: what was proposed, what was executed, and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import EnumType, StrEnum
from math import isfinite, isnan, nan
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from dynamics.deprecation import warn_of_former_name
from dynamics.state import FloatArray
from shield.errors import ConfigError

if TYPE_CHECKING:
    from shield.explanation import Explanation

__all__ = ["ROUNDING", "Decision", "Guarantee", "Intervention", "Reason", "Source", "Tier", "Verification", "weakest"]

ROUNDING = 1e-6
"""By so much a plan that was verified may seem to miss later by the order of additions alone [m]."""


class Reason(StrEnum):
    """Why the proposal was not executed as it was; `NONE` when it was."""

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
        """One sentence for people."""
        return _TEXT[self]


_TEXT = {
    Reason.NONE: "the proposal was verified and executed unchanged",
    Reason.BUFFER: "a lane change was proposed into a vehicle that is alongside, within the buffer",
    Reason.DISTANCE: "a lane change was proposed with a vehicle nearer than the fixed distance",
    Reason.RSS: "the proposal would break an RSS distance",
    Reason.TTC: "the time to collision was below the threshold",
    Reason.UNVERIFIED: "some behaviour within the assumptions would bring a vehicle into the buffer",
    Reason.RESUME: "the policy has no throttle; the shield brings the ego back to the speed that it took from it",
    Reason.PRECAUTION: "a precaution refused every plan; the stored plan, which still verifies, was played on",
    Reason.NO_SAFE_PLAN: "nothing verified; the fallback acted (stored plan, or the largest margin)",
    Reason.BAD_ACTION: "the policy's action was outside the action space or not finite",
    Reason.BAD_SCENE: "the scene could not be read or was not finite; the fallback acted",
    Reason.STAGE_FAILED: "a stage of the shield raised (the error is logged); the fallback acted",
    Reason.POLICY_FAILED: "the policy raised or returned NaN; the fallback acted",
}


class Tier(StrEnum):
    """Which stage of the shield produced what was executed.

    `PASSED`, `ALTERNATIVE` and `GOVERNED` are verified; `STORED_PLAN` was verified at an earlier frame;
    `EVADED` clears everybody who has broken no rule, and those who have for as long as can be expected;
    `LARGEST_MARGIN` and `EMERGENCY` are fallbacks without a certificate, and labelled so.
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
        """Whether what was executed carries a certificate made for the scene of this decision."""
        return self in (Tier.PASSED, Tier.GOVERNED, Tier.ALTERNATIVE)

    @property
    def certified(self) -> bool:
        """Whether what was executed was verified, at this frame or an earlier one, or evades who has broken a rule."""
        return self not in (Tier.OFF, Tier.LARGEST_MARGIN, Tier.EMERGENCY)

    @property
    def fallback(self) -> bool:
        """Whether what was executed was not verified for the present scene."""
        return self in (Tier.STORED_PLAN, Tier.EVADED, Tier.LARGEST_MARGIN, Tier.EMERGENCY)


class Intervention(StrEnum):
    """What the shield did to a proposal.

    `NONE`: the proposal was executed unchanged. `HELD_BACK`: the environment got the proposed action, and at least one
    simulation frame got other inputs than that action leads to. `OTHER_ACTION`: the environment got another action.
    """

    NONE = "none"
    HELD_BACK = "held back"
    OTHER_ACTION = "other action"


class Verification(StrEnum):
    """What actions are verified against.

    `WORST_CASE`: every behaviour of the others within the assumptions. `SIMULATED`: highway-env's own traffic,
    simulated. `STANDING`: obstacles that stand still (parking lots). `RULE`: nothing, a rule decides alone. `OFF`:
    there is no shield.
    """

    WORST_CASE = "worst_case"
    SIMULATED = "simulated_traffic"
    STANDING = "standing_obstacles"
    RULE = "rule_alone"
    OFF = "off"


class _FormerMembers(EnumType):
    def __getattr__(cls, name: str) -> Any:
        if name == "FULL":
            warn_of_former_name("Guarantee.FULL", "Guarantee.ALL_SEEN")
            return cls["ALL_SEEN"]
        raise AttributeError(name)


class Guarantee(StrEnum, metaclass=_FormerMembers):
    """What a certificate rests on beside the assumptions about the others' behaviour.

    `ALL_SEEN`: every vehicle was seen; nothing else is assumed about the scene. `ASSUMED`: vehicles that may be there
    unseen are assumed (`shield.Unseen`). `PROBABILISTIC`: every vehicle is also assumed within the bounds of its
    measurement. `BROKEN`: of an episode, in which other vehicles broke the assumptions. `NONE`: there is no
    certificate. None of them means that a crash is impossible. The former name of `ALL_SEEN` is `FULL`, with the value
    "full".
    """

    ALL_SEEN = "all vehicles seen"
    ASSUMED = "assumed"
    PROBABILISTIC = "probabilistic"
    BROKEN = "assumptions broken"
    NONE = "none"

    __hash__ = StrEnum.__hash__

    def __eq__(self, other: object) -> bool:
        if self is Guarantee.ALL_SEEN and type(other) is str and other == "full":
            warn_of_former_name('guarantee == "full"', f'guarantee == "{self.value}"')
            return True
        return str.__eq__(self, other) if isinstance(other, str) else NotImplemented

    @classmethod
    def _missing_(cls, value: object) -> Guarantee | None:
        if value == "full":
            warn_of_former_name('Guarantee("full")', "Guarantee.ALL_SEEN", stacklevel=5)
            return cls.ALL_SEEN
        return None


class Source(Protocol):
    """What a decision was made from, kept for whoever asks why."""

    def explain(self, at: Decision, record: Decision, frame: int) -> Explanation:
        """Why a proposal was refused.

        Parameters
        ----------
        at : the decision that was made from this. record : the step's. frame : the frame that `at` is about, 0 for the
            decision about the action.
        """


_WEAKER = list(Guarantee)
"""From the strongest to none."""


def weakest(*guarantees: Guarantee) -> Guarantee:
    """The weakest of some guarantees.

    Examples
    --------
    >>> weakest(Guarantee.ALL_SEEN, Guarantee.BROKEN, Guarantee.ASSUMED).value
    'assumptions broken'
    """
    return max(guarantees, key=_WEAKER.index)


@dataclass(frozen=True, slots=True)
class Decision:
    """One decision of the shield, about an action or about one simulation frame; or the record of a whole step.

    `last_decision` and `last_decisions` of both doors are records of steps (`with_frames`): what `info["shield"]` and
    `report()` say is read from them. `frame_decisions` has the parts.

    Attributes
    ----------
    proposed : the policy's action as it came in.
    executed : the action that goes to the environment.
    reason : why the two differ, or `Reason.NONE`.
    tier : the stage that produced `executed`.
    margin : clearance beyond the buffer of what is executed, over its verified horizon [m]; NaN where none is known,
        and where whatever was found ends in a crash.
    latency : time spent deciding [s].
    plan : road states of the executed action and its fail-safe, shape (frames + 1, 4), or None. On a network of roads
        they are states in the world, of the present frame on, and filled only with `ShieldConfig.record`.
    occupancy : rectangles where the others can be, shape (frames, vehicles, 4) as s_min, s_max, r_min, r_max
        in the road frame [m], or None; filled only with `ShieldConfig.record`. Where the traffic is simulated, plan and
        occupancy are what is foretold, in the world's frame (x, y, heading, speed; boxes around the others).
    clause : which clause of the certificate the margin comes from: "separation", "slip-in", "room", "edge", "gap of the
        map", "rollback"; "" where none binds, or none was asked.
    vehicle : row of the vehicle that binds among the scene's others, -1 without one.
    sight : what a certificate made for this scene rests on. level : probability with which each side of each body is
        within its bounds there, 1 where the states are exact.
    alarm : whether the sensor did not behave as it is thought to, so that the widest bounds were taken and nothing is
        guaranteed (`shield.perception.sensor_monitor`).
    frames_overridden : in the record of a step, how many of its frames got other inputs.
    weakest : in the record of a step, the weakest guarantee of the decision and its frames; None elsewhere.
    done : in the record of a step, what was done to the proposal; None elsewhere.
    frames : in the record of a step, how many frames it has lasted for so far. held : the first that was overridden.
    source : what it was made from, for `explain`; None where nothing was kept.
    refusal : the decision that `explain` is about, and its frame: in the record of a step that which its reason and
        tier are from.
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
    sight: Guarantee = Guarantee.ALL_SEEN
    level: float = 1.0
    alarm: bool = False
    frames_overridden: int = 0
    weakest: Guarantee | None = None
    done: Intervention | None = None
    frames: int = 0
    held: Decision | None = field(default=None, repr=False, compare=False)
    source: Source | None = field(default=None, repr=False, compare=False)
    refusal: tuple[Decision, int] | None = field(default=None, repr=False, compare=False)

    @property
    def guarantee(self) -> Guarantee:
        """Which guarantee what is executed has: none, where nothing was verified, at this frame or an earlier one, and
        where the stored plan is played on that does not verify any more."""
        if self.weakest is not None:
            return self.weakest
        lost = self.tier is Tier.STORED_PLAN and self.reason is Reason.NO_SAFE_PLAN and self.margin < -ROUNDING
        return self.sight if self.tier.certified and not isnan(self.margin) and not lost else Guarantee.NONE

    @property
    def overridden(self) -> bool:
        """Whether something else than the proposal was executed."""
        return self.tier not in (Tier.OFF, Tier.PASSED) if self.done is None else self.done is not Intervention.NONE

    @property
    def intervention(self) -> Intervention:
        """What was done to the proposal."""
        return self.done if self.done is not None else self.with_frames(()).intervention

    def with_frames(self, frames: Sequence[Decision]) -> Decision:
        """The record of a step: this decision, and those about the frames that it has lasted for so far.

        It is overridden where another action was executed or a frame was. Its reason and tier are those of the first
        fallback, else those of the first override. Its margin is the least finite one, NaN without one, with the clause
        and the vehicle of that; its guarantee is the weakest. A decision to hold the proposed action back whose frames
        all passed is no override, and neither is a fallback that is what was proposed: that was executed unchanged.
        """
        held, parts = [frame for frame in frames if frame.overridden], (self, *frames)
        same, holds = _same(self.proposed, self.executed), self.tier is Tier.GOVERNED
        unchanged, done = bool(frames) and not held and holds and same, Intervention.NONE
        if self.overridden and not same:
            done = Intervention.OTHER_ACTION
        elif held or (self.overridden and holds and not unchanged):
            done = Intervention.HELD_BACK
        overridden = [self, *held] if self.overridden and not unchanged else held
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
            frames_overridden=len(held),
            weakest=weakest(*(d.guarantee for d in parts)),
            done=done,
            frames=len(frames),
            held=held[0] if held else None,
            refusal=None if shown is None else (shown if shown.refusal is None else shown.refusal[0], number),
        )

    def explain(self) -> Explanation:
        """Why the proposal was refused: which clause or rule, whose fault, when and by how much; what was done instead,
        and why that is right. `str()` of it is a sentence.

        It is found out when it is asked for, from the scene and the memory that the decision was made from.

        Raises
        ------
        ConfigError
            If nothing was kept of these: in a copy that was pickled, or of a decision that no shield has made.
        """
        from shield.explanation import as_proposed

        record = self if self.done is not None else self.with_frames(())
        if record.refusal is None:
            return as_proposed(record)
        at, frame = record.refusal
        if at.source is None:
            raise ConfigError(
                "nothing was kept that this decision was made from: ask last_decision.explain() of the shield that "
                "made it, in its process, before the decision is copied or pickled"
            )
        return at.source.explain(at, record, frame)


def _same(a: Any, b: Any) -> bool:
    """Whether two actions are the same; NaN and what is no action are the same as nothing."""
    try:
        return bool(np.array_equal(np.ravel(np.asarray(a, float)), np.ravel(np.asarray(b, float))))
    except (TypeError, ValueError, OverflowError):
        return False
