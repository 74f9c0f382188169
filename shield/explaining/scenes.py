"""Explanation of a refusal in the worst case that the assumptions permit, or by a rule alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite, nan
from typing import Any

import numpy as np

from dynamics.scenes.scene import Scene, Target
from dynamics.state import FloatArray, State, Vehicle
from shield.certificate.road.manoeuvres import brake_candidates
from shield.certificate.road.memory import ObservedScene
from shield.certificate.road.monitor import RoadMonitor
from shield.certificate.road.verify import ROUNDING
from shield.decision import Decision, Reason, Tier
from shield.explaining.words import action_name, executed_text, inputs_name, justification_text, nothing_judged
from shield.explaining.worlds import VehicleIdentity, describe, place
from shield.explanation import Explanation, LostGuarantee, Obstruction, number
from shield.pipelines.decide import DecisionData, Unreadable
from shield.pipelines.frames import FramePipeline, fail_lanes
from shield.pipelines.inputs import InputPipeline
from shield.pipelines.meta_actions import MetaActionPipeline
from shield.pipelines.parking_lot import ParkingLotPipeline
from shield.pipelines.screen import RulePipeline
from shield.rules import Rule

__all__ = ["describe_binding_vehicle", "explain_scene"]

_NO_VEHICLE = -1
_FAR, _HALVINGS = 500.0, 12
"""Greatest shift of a vehicle in the search for the distance that a rule accepts [m], and number of halvings."""


@dataclass(frozen=True, slots=True)
class _Refusal:
    """Why a proposal was refused.

    Attributes
    ----------
    clause : the binding clause. vehicle : row of the binding vehicle. margin : least margin [m].
    after : time until the margin becomes negative [s].
    expected : whether the margin is a forecast, and not a bound.
    """

    clause: str
    vehicle: int
    margin: float
    after: float
    expected: bool = False


def explain_scene(made: DecisionData[Any], at: Decision, record: Decision, frame: int) -> Explanation:
    """See `shield.decision.Source`."""
    scene, procedure = made.scene, made.procedure
    labels = scene.control.actions if isinstance(scene, Scene) else getattr(made.proposal, "labels", ())
    speed = nan if isinstance(scene, Unreadable) else float(scene.ego[State.SPEED])

    def name(action: Any) -> str:
        actuators = getattr(procedure, "actuators", None)
        if actuators is None:
            return action_name(labels, action)
        read = actuators.read(action)
        return str(action) if read is None else inputs_name(actuators.physical(read))

    proposal = _proposal(made, record, frame, name)
    if isinstance(scene, Unreadable) or procedure.refuses(scene, made.proposal) is not None:
        return nothing_judged(at, record, name, speed, proposal, frame)
    if at.reason is Reason.STAGE_FAILED:
        return nothing_judged(at, record, name, speed, proposal, frame)
    if at.reason is Reason.RESUME:
        tail = executed_text(at, record, name, speed), justification_text(at, LostGuarantee.NOTHING)
        return Explanation(proposal, at.reason, "", None, nan, nan, at.reason.text, *tail, at.margin, frame)
    found, view = _refusal(made, at)
    lost = LostGuarantee.NOTHING if not at.tier.fallback else _lost(made, view, at)
    cause = None if found.vehicle == _NO_VEHICLE else describe_binding_vehicle(view_scene(view, scene), found.vehicle)
    short = -found.margin if isfinite(found.margin) and found.margin < 0 else nan
    why = _why(found, cause, short) + _violator_text(view)
    right = "a rule alone decides" if isinstance(procedure, RulePipeline) else justification_text(at, lost)
    tail = executed_text(at, record, name, speed), right
    return Explanation(proposal, at.reason, found.clause, cause, short, found.after, why, *tail, at.margin, frame, lost)


def view_scene(view: Any, scene: Any) -> Any:
    """The scene that was judged. Bounds of observed vehicles are intersected with those of the previous scene."""
    return view.scene if isinstance(view, ObservedScene) else scene


def describe_binding_vehicle(scene: Any, row: int) -> Obstruction:
    """Description of another vehicle in a scene, or of an obstacle in a parking lot.

    Parameters
    ----------
    row : index of its vehicle row.
    """
    if not isinstance(scene, Scene):
        return describe(
            scene.ego, scene.obstacles[row], VehicleIdentity(row if scene.bodies is None else scene.bodies[row])
        )
    mine, other, ego, body = scene.ego_road, scene.others_road[row], scene.ego, scene.others[row]
    length, width = (0.5 * float(ego[k] + body[k]) for k in (Vehicle.LENGTH, Vehicle.WIDTH))
    where, distance = place(float(other[0] - mine[0]), float(other[1] - mine[1]), length, width)
    seen = where, distance, f"lane {scene.road.lane_at(float(other[1]))}", float(body[Vehicle.SPEED])
    if scene.bodies is not None:
        return Obstruction(scene.bodies[row], type(scene.bodies[row]).__name__, *seen)
    known = row if scene.ids is None else int(scene.ids[row])
    return Obstruction(known, f"{'vehicle' if scene.ids is None else 'track'} {known}", *seen)


def _proposal(made: DecisionData[Any], record: Decision, frame: int, name: Any) -> str:
    """Name of the refused proposal; in a frame, of the command that the action leads to."""
    if isinstance(made.proposal, Target):
        return str(name(record.executed))
    if isinstance(made.proposal, np.ndarray):
        return inputs_name(made.proposal)
    return str(name(record.proposed))


# -- cause of the refusal --------------------------------------------------------------------------------------


def _refusal(made: DecisionData[Any], at: Decision) -> tuple[_Refusal, Any]:
    """The cause of the refusal, and the view in which the proposal was judged."""
    scene, procedure, proposal = made.scene, made.procedure, made.proposal
    view, _ = procedure.observe(made.memory, scene)
    if isinstance(procedure, RulePipeline):
        return _by_rule(procedure.rule, scene, scene.target_of(proposal.action)), view
    if isinstance(procedure, ParkingLotPipeline):
        return _in_lot(procedure, view, proposal, scene), view
    if at.reason is Reason.BUFFER:
        screen: Any = procedure
        return _by_rule(screen.screen.buffer, scene, scene.target_of(proposal.action)), view
    if isinstance(procedure, MetaActionPipeline):
        return _of_target(view, scene.target_of(proposal.action), procedure.lasts(view, proposal.action)), view
    if isinstance(procedure, FramePipeline):
        return _of_target(view, proposal, False), view
    plan = next(iter(procedure.plans(view, proposal))).plan
    frames = plan.clear + 1
    return _Refusal(plan.binding.clause, plan.binding.vehicle, plan.margin, frames * scene.dt), view


def _of_target(now: ObservedScene, target: Target, lasting: bool) -> _Refusal:
    """Cause for a target command: the bound for one frame of it, or the forecast for the whole decision."""
    scene, braking = now.scene, now.config.braking
    fails = fail_lanes(now, target.lane)
    lanes, speeds = [target.lane] * len(fails), [target.speed] * len(fails)
    found: _Refusal | None = None
    for commit, hold in ((1, 0), (scene.frames_per_decision, scene.frames_per_decision)):
        if commit > 1 and not lasting:
            break
        _, result = now.judge(brake_candidates(scene, lanes, speeds, fails, commit, braking), hold)
        margins = np.nan_to_num(result.margin, nan=-np.inf)
        i, binding = int(margins.argmax()), result.binding(int(margins.argmax()))
        after = (int(result.clear[i]) + 1) * scene.dt
        this = _Refusal(binding.clause, binding.vehicle, float(margins[i]), after, hold > 0)
        if not this.margin >= 0:
            return this
        found = this
    assert found is not None
    return found


def _in_lot(procedure: ParkingLotPipeline, view: Any, proposal: FloatArray, lot: Any) -> _Refusal:
    """Cause for inputs, (2,), in a parking lot."""
    moving = np.flatnonzero(lot.moving)
    if view.memory.watch.violated and moving.size:
        return _Refusal("moving", int(moving[0]), nan, 0.0)
    judged = procedure.judge(lot, proposal[None])
    parts, margin, after = judged.parts, float(judged.margin[0]), (int(judged.clear[0]) + 1) * lot.dt
    if margin == -np.inf or parts is None or not parts.size:
        return _Refusal("speed", _NO_VEHICLE, margin, nan)
    return _Refusal("clearance", int(parts[0].argmin()), margin, after)


def _by_rule(rule: Rule, scene: Scene, target: Target) -> _Refusal:
    """Cause for a rule: the nearest vehicle that the rule objects to on its own, and the additional distance that it
    requires."""

    def objects(row: int, further: float) -> bool:
        """Whether the rule objects to one vehicle on its own, moved away by a distance [m]."""
        body = scene.others[row : row + 1].copy()
        away = further * np.sign(scene.others_road[row, 0] - scene.ego_road[0])
        body[0, :2] += away * np.array([np.cos(body[0, 2]), np.sin(body[0, 2])])
        return rule.objects(replace(scene, others=body, ids=None, likely=None, bodies=None), target)

    delta = scene.others_road[:, :2] - scene.ego_road[:2]
    for row in np.argsort(np.hypot(delta[:, 0], delta[:, 1])).tolist():
        if not objects(row, 0.0):
            continue
        least, most = 0.0, _FAR
        for _ in range(_HALVINGS):
            middle = 0.5 * (least + most)
            least, most = (middle, most) if objects(row, middle) else (least, middle)
        return _Refusal(f"rule: {rule.reason.value}", row, -most if most < _FAR else nan, nan)
    return _Refusal(f"rule: {rule.reason.value}", _NO_VEHICLE, nan, nan)


# -- text ------------------------------------------------------------------------------------------------------


def _why(found: _Refusal, cause: Obstruction | None, short: float) -> str:
    """Text of the cause."""
    by, when = number(short), f"{number(found.after)} s"
    if found.clause.startswith("rule: "):
        name = found.clause.removeprefix("rule: ")
        if cause is None:
            return f"the rule {name!r} objects"
        lacking = f", {by} m less than it requires" if isfinite(short) else ""
        return f"the rule {name!r} objects to {cause.text}{lacking}"
    if found.clause == "speed":
        return "the ego would become faster than its frames can be verified"
    if found.clause == "clearance" and cause is not None:
        return f"{cause.text} stands in the way; the clearance would be short after {when}, by up to {by} m"
    if found.clause == "moving":
        return f"{cause.text if cause else 'something'} moves, but obstacles are assumed to stand still"
    if found.clause == "room":
        return f"the plan would come to rest {by} m outside its lane after {when}"
    if found.clause == "edge":
        return (
            f"the body would come {by} m beyond the road's edge after {when}"
            if isfinite(short)
            else (f"the body would enter lanes on both sides, or leave the road, after {when}")
        )
    if found.clause == "rollback":
        return "the ego would roll backwards"
    if found.clause == "gap of the map":
        return f"the path leaves the lanes of the map after {when}"
    lacks = f"the buffer would be short after {when}, by up to {by} m"
    if cause is None:
        return f"{lacks}, whatever is done then"
    if found.expected:
        return f"{cause.text} is expected to be in the way before the decision is over; {lacks}"
    if found.clause == "cut-in":
        return f"{cause.text} could cut in; {lacks}"
    verb = {"ahead": "could brake", "behind": "could come up"}.get(cause.where, "could be in the way")
    return f"{cause.text} {verb}; {lacks}"


def _violator_text(view: Any) -> str:
    """Text on the violators, if a violation is the reason that no plan verifies."""
    watch = view.memory.watch if hasattr(view, "memory") else None
    if not isinstance(watch, RoadMonitor) or not watch.violated or not isinstance(view, ObservedScene):
        return ""
    named = [describe_binding_vehicle(view.scene, int(row)).text for row in np.flatnonzero(watch.offenders)[:2]]
    return "".join(f"; {each} has broken a rule" for each in named)


def _lost(made: DecisionData[Any], view: Any, at: Decision) -> LostGuarantee:
    """What a fallback has lost; see `LostGuarantee`."""
    if at.reason is Reason.PRECAUTION:
        return LostGuarantee.PRECAUTION
    if not isinstance(view, ObservedScene) or view.memory.watch.violated:
        kept = at.tier is Tier.STORED_PLAN and not view.memory.watch.violated
        return LostGuarantee.NOTHING if kept and at.margin >= -1e-4 else LostGuarantee.GUARANTEE
    if at.tier is Tier.STORED_PLAN and not isinstance(view.memory.stored, int | None):
        return LostGuarantee.NOTHING  # a sequence of actions, verified for its horizon
    if _fail_safe_margin(made, view) >= -ROUNDING and at.tier in (Tier.STORED_PLAN, Tier.EVADED):
        return LostGuarantee.NOTHING
    without = replace(view, verifier=view.verifier.without_cut_ins())
    if any(each.plan.verified for each in made.procedure.plans(without, made.proposal)):
        return LostGuarantee.PRECAUTION
    if at.tier is Tier.STORED_PLAN and _fail_safe_margin(made, without) >= -ROUNDING:
        return LostGuarantee.PRECAUTION
    return LostGuarantee.GUARANTEE


def _fail_safe_margin(made: DecisionData[Any], now: ObservedScene) -> float:
    """Present margin of the stored fail-safe in a lane [m]; -inf without one."""
    if not isinstance(now.memory.stored, int):
        return -np.inf
    if isinstance(made.procedure, InputPipeline):
        fail_safe_inputs = made.procedure.execution.fail_safe_inputs(now.scene, now.memory.stored)[None]
        return float(made.procedure.judge(now, fail_safe_inputs, [now.memory.stored]).margin[0])
    return now.fail_safe().margin
