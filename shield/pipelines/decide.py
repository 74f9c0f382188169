"""One decision: `decide(memory, scene, proposal, procedure) -> (decision, memory)`.

A decision pipeline (`Pipeline`) lists the plans to verify in order, and a fallback. The rest is the same for
meta-actions, frames, throttle and steering, and parking lots. The first plan that verifies is executed, and after any
error the pipeline's last resort. All state is in the memory, so a decision can be repeated from its arguments.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from dynamics.errors import SceneError
from dynamics.scenes.scene import Scene
from dynamics.state import FloatArray, readable
from shield.certificate.road.memory import Memory
from shield.certificate.road.monitor import RoadMonitor
from shield.certificate.road.verify import NOTHING, Binding
from shield.decision import Decision, Reason, Tier
from shield.explanation import Explanation

__all__ = [
    "DecisionCore",
    "DecisionData",
    "Explainer",
    "JudgedPlan",
    "Pipeline",
    "Plan",
    "Reader",
    "Unreadable",
    "decide",
    "read",
]

_log = logging.getLogger(__name__)

S = TypeVar("S")
"""Type of the stored fail-safe, see `Memory.stored`."""
View = TypeVar("View")
"""Type of a pipeline's view: a scene together with the memory."""


@dataclass(frozen=True, slots=True)
class Plan(Generic[S]):
    """An action, and the fail-safe that follows it.

    Attributes
    ----------
    action : the executed action.
    margin : clearance beyond the buffer of both [m]; it verifies from 0 on.
    stored : data with which the fail-safe continues, see `Memory.stored`.
    clear : number of frames that stay clear.
    path : states after frames 1..K, (K, 4), or None.
    binding : binding clause and binding vehicle of the margin.
    occupancy : see `Decision.occupancy`.
    predicted : plan of the predictive filter, the initial guess of its next one, (N, 2).
    trusted : whether the plan counts as verified without a certificate, because a rule alone accepted it.
    entered : see `Memory.entered`.
    """

    action: Any
    margin: float = float("nan")
    stored: S | None = None
    path: FloatArray | None = None
    binding: Binding = NOTHING
    clear: int = 0
    occupancy: FloatArray | None = None
    predicted: FloatArray | None = None
    trusted: bool = False
    entered: int | None = None

    @property
    def verified(self) -> bool:
        """Whether the plan may be executed."""
        return self.trusted or self.margin >= 0


@dataclass(frozen=True, slots=True)
class JudgedPlan(Generic[S]):
    """A judged plan, with its tier and the reason that is recorded if it is executed."""

    tier: Tier
    reason: Reason
    plan: Plan[S]


@dataclass(frozen=True, slots=True)
class Unreadable:
    """Placeholder for a scene that cannot be read.

    Attributes
    ----------
    reason : reason for the record. cause : text of the error.
    stopping : acceleration that stops the ego by the next scene [m/s^2]; NaN if its speed is unknown.
    """

    reason: Reason = Reason.BAD_SCENE
    stopping: float = float("nan")
    cause: str = ""


class Pipeline(Protocol[S, View]):
    """Decision pipeline for one kind of action: plans in order, and the fallback."""

    def refuses(self, scene: Any, proposal: Any) -> Reason | None:
        """Reason if the scene or the proposal is unsuitable for verification; else None."""

    def observe(self, memory: Memory[S], scene: Any) -> tuple[View, Memory[S]]:
        """Observe a scene: the view for `plans`, and the new memory."""

    def plans(self, view: View, proposal: Any) -> Iterator[JudgedPlan[S]]:
        """Plans to verify, in order: the proposal, and then its replacements."""

    def fall_back(self, view: View, proposal: Any, tried: list[JudgedPlan[S]]) -> JudgedPlan[S]:
        """Plan to execute if none of `plans` verifies."""

    def last_resort(self, memory: Memory[S], scene: Any, proposal: Any) -> tuple[Tier, Plan[S]]:
        """Plan to execute without a verification. Must not raise for any scene."""


@dataclass(frozen=True, slots=True, eq=False)
class DecisionData(Generic[S]):
    """Data of one decision for its explanation: references to the arguments, from which it can be repeated.

    A pickled copy is None.
    """

    memory: Memory[S]
    scene: Any
    proposal: Any
    procedure: Pipeline[S, Any]
    how: Explainer

    def explain(self, at: Decision, record: Decision, frame: int) -> Explanation:
        """See `shield.decision.Source`."""
        return self.how(self, at, record, frame)

    def __reduce__(self) -> Any:
        return type(None), ()


Explainer = Callable[[DecisionData[Any], Decision, Decision, int], Explanation]
"""Explains a decision from its data, see `shield.decision.Source`."""


def decide(
    memory: Memory[S], scene: Any, proposal: Any, procedure: Pipeline[S, Any], explain: Explainer | None = None
) -> tuple[Decision, Memory[S]]:
    """One decision, and the memory for the next one; the arguments are not changed.

    Parameters
    ----------
    memory : of the decisions so far. scene : a scene, or `Unreadable`.
    proposal : argument of the pipeline. procedure : the pipeline.
    explain : function that can explain the decision; None if no explanation is needed.
    """
    start, seen = perf_counter(), memory
    source = None if explain is None else DecisionData(memory, scene, proposal, procedure, explain)
    try:
        refused = scene.reason if isinstance(scene, Unreadable) else procedure.refuses(scene, proposal)
        if refused is None:
            view, seen = procedure.observe(memory, scene)
            tried: list[JudgedPlan[S]] = []
            for one in procedure.plans(view, proposal):
                tried.append(one)
                if one.plan.verified:
                    break
            else:
                one = procedure.fall_back(view, proposal, tried)
            return _decided(start, seen, proposal, one, source)
        if refused is Reason.BAD_SCENE:
            seen = _observe_readable(memory, scene, procedure)
    except Exception:
        # Fail closed: after an error in a stage the proposal must not pass.
        _log.exception("a stage of the shield raised; the last resort acts")
        refused = Reason.STAGE_FAILED
    tier, plan = procedure.last_resort(seen, scene, proposal)
    return _decided(start, seen, proposal, JudgedPlan(tier, refused, plan), source)


def _observe_readable(memory: Memory[S], scene: Any, procedure: Pipeline[S, Any]) -> Memory[S]:
    """Observe a scene without the vehicles in an unreadable state. Such a state counts as a violation; the other
    vehicles are judged as usual."""
    if not isinstance(scene, Scene) or scene.observed or not readable(scene.ego).all():
        return memory
    strange, before = scene.unreadable, memory.watch
    if not strange.any() or not isinstance(before, RoadMonitor):
        return memory
    ids = np.flatnonzero(strange) if scene.ids is None else scene.ids[strange]
    _, seen = procedure.observe(memory, scene.without(strange))
    if not isinstance(seen.watch, RoadMonitor) or (seen.frame is not None and seen.frame == memory.frame):
        return memory
    return replace(seen, watch=seen.watch.with_unreadable(ids, readable(scene.others[strange]), before.unreadable))


def _decided(
    start: float, memory: Memory[S], proposal: Any, one: JudgedPlan[S], source: DecisionData[S] | None
) -> tuple[Decision, Memory[S]]:
    """The decision for a plan, and the new memory."""
    tier, plan = one.tier, one.plan
    stored = None if tier is Tier.LARGEST_MARGIN else plan.stored
    watch = memory.watch.forgiven() if tier.verified else memory.watch
    predicted = memory.plan if plan.predicted is None else plan.predicted
    memory = Memory(memory.frame, stored, memory.verifier, watch, predicted, plan.entered)
    latency, (clause, vehicle) = perf_counter() - start, (plan.binding.clause, plan.binding.vehicle)
    record = plan.margin, latency, plan.path, plan.occupancy, clause, vehicle
    return Decision(proposal, plan.action, one.reason, tier, *record, source=source), memory


class Reader(Protocol):
    """A reader of scenes."""

    def read(self) -> Any:
        """The present scene; raises `SceneError` if there is none."""


class DecisionCore(Generic[S]):
    """Decision pipelines of one vehicle, and their memory.

    Attributes
    ----------
    procedure : the default pipeline. memory : of the decisions so far.
    explain : explains its decisions; None to keep no data for explanations.
    """

    def __init__(self, procedure: Pipeline[S, Any], explain: Explainer | None = None) -> None:
        self.procedure, self.explain = procedure, explain
        self.reset()

    def reset(self) -> None:
        """Clear everything about the episode."""
        self.memory: Memory[S] = Memory()
        self._observed: tuple[Any, Memory[S]] | None = None

    @property
    def violations(self) -> int:
        """Number of violations of the assumptions by the other vehicles."""
        return self.memory.watch.count

    @property
    def by_rule(self) -> dict[str, int]:
        """The same by rule."""
        return self.memory.watch.named

    def decide(self, scene: Any, proposal: Any, procedure: Pipeline[S, Any] | None = None) -> Decision:
        """The next decision; see the function `decide`."""
        observed_before, self._observed = self._observed, None
        if observed_before is not None and not _same_arrays(observed_before[0], scene):
            # The user has changed the scene since `observe`: observe it again.
            self.memory = observed_before[1]
        decision, self.memory = decide(self.memory, scene, proposal, procedure or self.procedure, self.explain)
        return decision

    def observe(self, scene: Any, procedure: Pipeline[S, Any] | None = None) -> None:
        """Observe a scene before a decision about it, such as the last scene of an episode, to count the violations on
        the way there. A later decision about the same scene does not judge them again."""
        if isinstance(scene, Unreadable):
            return
        before, procedure = self.memory if self._observed is None else self._observed[1], procedure or self.procedure
        try:
            if scene.finite:
                _, self.memory = procedure.observe(before, scene)
                self._observed = scene, before
            else:
                self.memory = _observe_readable(before, scene, procedure)
        except Exception:
            _log.exception("the last scene of an episode could not be judged")


def _same_arrays(a: Any, b: Any) -> bool:
    """Whether two scenes have the same arrays."""
    names = [name for name in ("ego", "others", "obstacles") if hasattr(a, name)]
    return type(a) is type(b) and all(np.array_equal(getattr(a, name), getattr(b, name)) for name in names)


def read(reader: Reader, stopping: float = np.nan) -> Any:
    """The present scene, or `Unreadable`."""
    try:
        return reader.read()
    except SceneError as error:
        return Unreadable(Reason.BAD_SCENE, stopping, str(error))
    except Exception:
        _log.exception("the scene could not be read; the last resort acts")
        return Unreadable(Reason.STAGE_FAILED, stopping)
