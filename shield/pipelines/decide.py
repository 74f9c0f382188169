"""One decision: `decide(memory, scene, proposal, procedure) -> (decision, memory)`.

A procedure says which plans are worth verifying, in which order, and what to do where none verifies. The rest is the
same for meta-actions, frames, throttle and steering, and parking lots: the first plan that verifies is executed, and
whatever goes wrong on the way, the procedure's last resort acts. Nothing is kept anywhere but in the memory, so that a
decision can be made again from what it was made from.
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
from shield.certificate.road.monitor import Watch
from shield.certificate.road.verify import NOTHING, Binding
from shield.decision import Decision, Reason, Tier
from shield.explanation import Explanation

__all__ = ["Core", "Explainer", "Made", "Plan", "Procedure", "Reader", "Tried", "Unreadable", "decide", "read"]

_log = logging.getLogger(__name__)

S = TypeVar("S")
"""What has to be remembered of a fail-safe, see `Memory.stored`."""
View = TypeVar("View")
"""What a procedure looks at: a scene, with what is remembered."""


@dataclass(frozen=True, slots=True)
class Plan(Generic[S]):
    """An action, and the fail-safe that comes after it.

    Attributes
    ----------
    action : what is executed.
    margin : clearance beyond the buffer of both [m]; it verifies where that is not negative.
    stored : what plays the fail-safe on afterwards, see `Memory.stored`.
    clear : frames for which it stays clear.
    path : states after frames 1..K, (K, 4), or None.
    binding : the clause that the margin comes from, and the vehicle.
    occupancy : see `Decision.occupancy`.
    predicted : a plan of the predictive filter to start its next one from, (N, 2).
    trusted : whether it is taken without a certificate: a rule alone has let it pass.
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
        """Whether it may be executed."""
        return self.trusted or self.margin >= 0


@dataclass(frozen=True, slots=True)
class Tried(Generic[S]):
    """A plan that has been judged, the stage that it comes from, and why it takes the proposal's place."""

    tier: Tier
    reason: Reason
    plan: Plan[S]


@dataclass(frozen=True, slots=True)
class Unreadable:
    """What stands for a scene that cannot be read.

    Attributes
    ----------
    reason : why. cause : what was raised. stopping : the acceleration that just stops the ego until the next scene
        [m/s^2], NaN where its speed is not known.
    """

    reason: Reason = Reason.BAD_SCENE
    stopping: float = float("nan")
    cause: str = ""


class Procedure(Protocol[S, View]):
    """How one kind of action is decided about: manoeuvres, clauses, and repair in stages."""

    def refuses(self, scene: Any, proposal: Any) -> Reason | None:
        """Why nothing is verified at all: the scene or the proposal is no good. None where they are."""

    def observe(self, memory: Memory[S], scene: Any) -> tuple[View, Memory[S]]:
        """Take in a scene."""

    def plans(self, view: View, proposal: Any) -> Iterator[Tried[S]]:
        """What to verify, in order: the proposal, and then what may take its place."""

    def fall_back(self, view: View, proposal: Any, tried: list[Tried[S]]) -> Tried[S]:
        """What to do where none of `plans` verifies."""

    def last_resort(self, memory: Memory[S], scene: Any, proposal: Any) -> tuple[Tier, Plan[S]]:
        """What to do where nothing can be judged. It must not raise, whatever the scene."""


@dataclass(frozen=True, slots=True, eq=False)
class Made(Generic[S]):
    """What one decision was made from, for whoever asks why: references, from which it can be made again.

    A copy that is pickled has nothing of it.
    """

    memory: Memory[S]
    scene: Any
    proposal: Any
    procedure: Procedure[S, Any]
    how: Explainer

    def explain(self, at: Decision, record: Decision, frame: int) -> Explanation:
        """See `shield.decision.Source`."""
        return self.how(self, at, record, frame)

    def __reduce__(self) -> Any:
        return type(None), ()


Explainer = Callable[[Made[Any], Decision, Decision, int], Explanation]
"""Says why, see `shield.decision.Source`, of what a decision was made from."""


def decide(
    memory: Memory[S], scene: Any, proposal: Any, procedure: Procedure[S, Any], explain: Explainer | None = None
) -> tuple[Decision, Memory[S]]:
    """One decision, and the memory for the next one; neither argument is changed.

    Parameters
    ----------
    memory : of the decisions so far. scene : a scene, or `Unreadable`.
    proposal : what the procedure decides about. explain : how the decision can be explained; None if it need not be.
    """
    start, seen = perf_counter(), memory
    source = None if explain is None else Made(memory, scene, proposal, procedure, explain)
    try:
        refused = scene.reason if isinstance(scene, Unreadable) else procedure.refuses(scene, proposal)
        if refused is None:
            view, seen = procedure.observe(memory, scene)
            tried: list[Tried[S]] = []
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
        # Fail closed: a stage that breaks must not let the proposal through.
        _log.exception("a stage of the shield raised; the last resort acts")
        refused = Reason.STAGE_FAILED
    tier, plan = procedure.last_resort(seen, scene, proposal)
    return _decided(start, seen, proposal, Tried(tier, refused, plan), source)


def _observe_readable(memory: Memory[S], scene: Any, procedure: Procedure[S, Any]) -> Memory[S]:
    """Take in a scene some of whose others are not readable: they break a rule by it, the rest are judged as ever."""
    if not isinstance(scene, Scene) or scene.observed or not readable(scene.ego).all():
        return memory
    strange, before = scene.unreadable, memory.watch
    if not strange.any() or not isinstance(before, Watch):
        return memory
    ids = np.flatnonzero(strange) if scene.ids is None else scene.ids[strange]
    _, seen = procedure.observe(memory, scene.without(strange))
    if not isinstance(seen.watch, Watch) or (seen.frame is not None and seen.frame == memory.frame):
        return memory
    return replace(seen, watch=seen.watch.with_unreadable(ids, readable(scene.others[strange]), before.unreadable))


def _decided(
    start: float, memory: Memory[S], proposal: Any, one: Tried[S], source: Made[S] | None
) -> tuple[Decision, Memory[S]]:
    tier, plan = one.tier, one.plan
    stored = None if tier is Tier.LARGEST_MARGIN else plan.stored
    watch = memory.watch.forgiven() if tier.verified else memory.watch
    predicted = memory.plan if plan.predicted is None else plan.predicted
    memory = Memory(memory.frame, stored, memory.survey, watch, predicted, plan.entered)
    latency, (clause, vehicle) = perf_counter() - start, (plan.binding.clause, plan.binding.vehicle)
    record = plan.margin, latency, plan.path, plan.occupancy, clause, vehicle
    return Decision(proposal, plan.action, one.reason, tier, *record, source=source), memory


class Reader(Protocol):
    """What reads scenes."""

    def read(self) -> Any:
        """The scene now; raises SceneError where there is none."""


class Core(Generic[S]):
    """Procedures of one vehicle, and their memory.

    Attributes
    ----------
    procedure : the one that decides unless another is named. memory : of the decisions so far.
    explain : how its decisions can be explained; None where nothing is kept for that.
    """

    def __init__(self, procedure: Procedure[S, Any], explain: Explainer | None = None) -> None:
        self.procedure, self.explain = procedure, explain
        self.reset()

    def reset(self) -> None:
        """Forget everything about the episode."""
        self.memory: Memory[S] = Memory()
        self._looked: tuple[Any, Memory[S]] | None = None

    @property
    def violations(self) -> int:
        """How often the others have broken the assumptions."""
        return self.memory.watch.count

    @property
    def by_rule(self) -> dict[str, int]:
        """The same by the rule that was broken."""
        return self.memory.watch.named

    def decide(self, scene: Any, proposal: Any, procedure: Procedure[S, Any] | None = None) -> Decision:
        """The next decision; see `decide`."""
        looked, self._looked = self._looked, None
        if looked is not None and not _alike(looked[0], scene):
            # The world has been changed since, by hand: it is taken in anew.
            self.memory = looked[1]
        decision, self.memory = decide(self.memory, scene, proposal, procedure or self.procedure, self.explain)
        return decision

    def look(self, scene: Any, procedure: Procedure[S, Any] | None = None) -> None:
        """Take in a scene before anything is decided about it, such as the last of an episode: the others may have
        broken a rule on the way there. A decision about the same scene does not judge them again."""
        if isinstance(scene, Unreadable):
            return
        before, procedure = self.memory if self._looked is None else self._looked[1], procedure or self.procedure
        try:
            if scene.finite:
                _, self.memory = procedure.observe(before, scene)
                self._looked = scene, before
            else:
                self.memory = _observe_readable(before, scene, procedure)
        except Exception:
            _log.exception("the last scene of an episode could not be judged")


def _alike(a: Any, b: Any) -> bool:
    """Whether two scenes show the same."""
    names = [name for name in ("ego", "others", "obstacles") if hasattr(a, name)]
    return type(a) is type(b) and all(np.array_equal(getattr(a, name), getattr(b, name)) for name in names)


def read(reader: Reader, stopping: float = np.nan) -> Any:
    """The scene now, or `Unreadable`."""
    try:
        return reader.read()
    except SceneError as error:
        return Unreadable(Reason.BAD_SCENE, stopping, str(error))
    except Exception:
        _log.exception("the scene could not be read; the last resort acts")
        return Unreadable(Reason.STAGE_FAILED, stopping)
