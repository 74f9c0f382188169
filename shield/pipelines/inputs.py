"""The pipeline for throttle and steering: the nearest input that verifies.

An input (a, delta) is verified for as long as it is held, together with the fail-safe after it: braking to a stop in a
lane, steered by highway-env's lane controller. The path must stay clear of every place that the others can reach, the
ego's body must stay on the road, and the ego must not roll backwards.

A proposal that does not verify is replaced by the nearest input that does (`shield.alternatives.nearest_input`). If the
search finds none, the first input of the predictive filter's plan is verified (`mpc.filter.predictive_filter`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from dynamics.scenes.scene import Scene
from dynamics.state import FloatArray, RoadState, State
from dynamics.vehicle.actuators import Actuators
from dynamics.vehicle.bicycle import LENGTH
from mpc.filter.program.road_step import StageModel
from shield.alternatives.nearest_input import JudgedInputs, NearestInputSearch
from shield.alternatives.predicted_input import Predictor
from shield.certificate.road.clauses.edge import verdicts
from shield.certificate.road.memory import Memory, ObservedScene, observe
from shield.certificate.road.verify import ROUNDING, Binding, PathVerifier, least_bad_evasion
from shield.config import ShieldConfig
from shield.decision import Reason, Tier
from shield.errors import ConfigError
from shield.pipelines.decide import JudgedPlan, Plan, Unreadable
from shield.pipelines.execution import EveryDecision, EveryFrame, Execution

__all__ = ["InputPipeline"]

_EVASIONS = 9
"""Number of accelerations tried for each lane after a violation."""


class InputPipeline:
    """Decides about throttle and steering on a road.

    Parameters
    ----------
    config : settings.
    actuators : the policy's actuators.
    hold : simulation frames for which each action is held, if the shield acts through the actions only. Without it, the
        shield acts at every frame, with throttle, brake (`config.braking`) and wheel, whatever the actuators are.
    predictive : whether the predictive filter is part of the repair; ignored with `hold` unless both throttle and
        steering are actions.
    model : model of the predictive filter; the bicycle by default. Its plans are verified with the bicycle.
    norm : distance of the nearest input, one of `shield.config.NORMS`; `config.norm` by default.

    Raises
    ------
    ConfigError
        If the mode is a rule for meta-actions.
    """

    def __init__(
        self,
        config: ShieldConfig,
        actuators: Actuators | None = None,
        hold: int | None = None,
        predictive: bool = True,
        model: StageModel | None = None,
        norm: str | None = None,
    ) -> None:
        if config.mode not in ("none", "full"):
            raise ConfigError(f"mode {config.mode!r} judges meta-actions; for ContinuousAction use none or full")
        self.actuators = actuators if actuators is not None else Actuators()
        self.execution: Execution = EveryFrame(config)
        if hold is not None:
            self.execution = EveryDecision(config, self.actuators, hold)
            predictive = predictive and self.actuators.size == 2
        self.config = self.execution.config
        self.norm = self.config.norm if norm is None else norm
        self.predictor: Predictor | None = None
        if predictive:
            self.predictor = Predictor(self.config, self.actuators, self.execution.frames, model)

    def prepare(self, scene: Scene) -> None:
        """Compute the road-dependent tables before the first frame needs them."""
        if scene.finite:
            now, _ = self.observe(Memory(), scene)
            self.judge(now, np.zeros((1, 2)), self.stop_lanes(now)[:1])
            if self.predictor is not None:
                self.predictor.prepare(scene)

    def refuses(self, scene: Scene, proposal: FloatArray | None) -> Reason | None:
        """Reason if the proposal is invalid or the scene is not finite; else None."""
        if proposal is None:
            return Reason.BAD_ACTION
        return None if scene.finite else Reason.BAD_SCENE

    def observe(self, memory: Memory[int], scene: Scene) -> tuple[ObservedScene, Memory[int]]:
        """Observe a scene: monitor, and reachable places of the others."""
        now = observe(memory, scene, self.config, self.execution.frames)
        return now, now.memory

    def plans(self, now: ObservedScene, proposal: FloatArray) -> Iterator[JudgedPlan[int]]:
        """The proposal, and then its replacements."""
        first, *others = self.stop_lanes(now)
        judged = self.judge(now, proposal[None], [first])
        if not judged.margin[0] >= 0 and others:
            judged = self.judge(now, proposal[None], [first, *others])
        yield JudgedPlan(Tier.PASSED, Reason.NONE, replace(self.plan(now, judged), action=proposal))
        for plan in self.repairs(now, proposal, judged):
            yield JudgedPlan(Tier.GOVERNED, Reason.UNVERIFIED, plan)

    def repairs(self, now: ObservedScene, proposal: FloatArray, first: JudgedInputs) -> Iterator[Plan[int]]:
        """The nearest input, or the least bad one; and then that of the predictive filter.

        Parameters
        ----------
        first : the judged proposal.
        """
        lane = self._stop_lane(now)
        floor = np.array([self._floor(now.scene), -np.inf])
        lanes = list(dict.fromkeys((lane, int(first.lanes[0]))))
        least = np.minimum((-self.config.braking, self.actuators.steering[0]), proposal)
        most = np.maximum((self.actuators.acceleration[1], self.actuators.steering[1]), proposal)

        def judge(inputs: FloatArray, lanes: list[int], parts: bool) -> JudgedInputs:
            return self.judge(now, inputs, lanes, parts)

        bounds = np.maximum(least, floor), np.maximum(most, floor)
        search = NearestInputSearch(judge, proposal, self._spans(now.scene), *bounds)
        fail_safe_inputs = self.execution.fail_safe_inputs(now.scene, lane)
        yield self.plan(now, search.run(lanes, fail_safe_inputs, self.stop_lanes(now)))
        if self.predictor is not None:
            planned = self.predictor.plan(now, proposal, int(first.lanes[0]))
            if planned is not None:
                found = self.judge(now, np.maximum(planned[0], floor)[None], lanes)
                yield replace(self.plan(now, found), predicted=planned)

    def fall_back(self, now: ObservedScene, proposal: FloatArray, tried: list[JudgedPlan[int]]) -> JudgedPlan[int]:
        """Without a violation, the stored plan, also if it is not clear any more.

        After a violation, if the stored plan is clear of the compliant vehicles: the plan that stays clear of the
        violators longest among those that are, or else the stored plan. Otherwise the least bad input of the search.
        """
        violated, reason, lane = now.memory.watch.violated, Reason.NO_SAFE_PLAN, now.memory.stored
        if lane is not None:
            fail_safe_inputs = self.execution.fail_safe_inputs(now.scene, lane)[None]
            stored = self.judge(now, fail_safe_inputs, [lane], verifier=now.lawful.without_cut_ins())
            keeps = bool(stored.margin[0] >= -ROUNDING)
            if keeps and violated:
                evading = self._evade(now)
                if evading is not None:
                    return JudgedPlan(Tier.EVADED, reason, self.plan(now, evading))
            if keeps and not violated:
                reason = Reason.PRECAUTION
            if keeps or not violated:
                return JudgedPlan(Tier.STORED_PLAN, reason, replace(self.plan(now, stored), action=fail_safe_inputs[0]))
        # The first of the repairs: the least bad input of the search.
        return JudgedPlan(Tier.LARGEST_MARGIN, reason, tried[1].plan)

    def last_resort(
        self, memory: Memory[int], scene: Scene | Unreadable, proposal: FloatArray | None
    ) -> tuple[Tier, Plan[int]]:
        """Brake in the stored lane if there is one; with the wheel straight without a readable scene."""
        inputs = np.array([-self.config.braking, 0.0])
        if isinstance(scene, Unreadable):
            # NaN (unknown speed) gives full braking.
            inputs[0] = np.fmin(np.fmax(inputs[0], scene.stopping), self.config.braking)
        elif np.isfinite(scene.ego).all():
            here = scene.road.lane_at(float(scene.ego_road[RoadState.R]))
            inputs = self.execution.fail_safe_inputs(scene, here if memory.stored is None else memory.stored)
        return Tier.EMERGENCY, Plan(inputs, stored=memory.stored, entered=memory.entered)

    # -- parts -------------------------------------------------------------------------------------------

    def judge(
        self,
        now: ObservedScene,
        inputs: FloatArray,
        stops: list[int],
        parts: bool = False,
        verifier: PathVerifier | None = None,
    ) -> JudgedInputs:
        """Margins of inputs (n, 2), each followed by the fail-safe in the first lane of `stops` that verifies.

        Parameters
        ----------
        parts : whether to return the components of the margins too; requires a single lane in `stops`.
        verifier : verifier; by default against all vehicles.
        """
        scene, frames = now.scene, self.execution.frames
        inputs = self.execution.exact(inputs)
        n, f = len(inputs), len(stops)
        fails = np.array(stops * n)
        repeated = inputs[:, None] if frames == 1 else np.repeat(inputs[:, None], frames, axis=1)
        paths = self.execution.stops(scene, now.rollouts.run_inputs(scene.ego_road, repeated), fails)
        entered, edges, allowed, on_road = now.verifier.entered(paths, fails)
        verifier = verifier if verifier is not None else now.verifier
        result = verifier.clearance(paths, entered, fails)
        margin = verdicts(result.margin, edges, allowed, paths, frames)
        clear = np.minimum(result.clear, on_road)
        of = np.hstack([result.parts, edges]) if parts else None

        def bind(row: int) -> Binding:
            if not margin[row] < result.margin[row]:
                return result.binding(row)
            return Binding("edge" if np.isfinite(margin[row]) or not allowed[row] else "rollback")

        if f == 1:
            return JudgedInputs(inputs, margin, clear, fails, paths, of, bind)
        # The first lane that verifies, in order; otherwise the best one.
        each = margin.reshape(n, f)
        good = each >= 0
        pick = np.where(good.any(axis=1), good.argmax(axis=1), np.nan_to_num(each, nan=-np.inf).argmax(axis=1))
        rows = np.arange(n) * f + pick
        return JudgedInputs(
            inputs, margin[rows], clear[rows], fails[rows], paths[rows], bind=lambda i: bind(int(rows[i]))
        )

    def plan(self, now: ObservedScene, judged: JudgedInputs) -> Plan[int]:
        """The plan of the first judged input."""
        path, occupancy = np.vstack([now.scene.ego_road, judged.paths[0]]), None
        if self.config.record:
            occupancy = now.verifier.around.occupancy(len(judged.paths[0])).rectangles()
        margin, clear = float(judged.margin[0]), int(judged.clear[0])
        stop = int(judged.lanes[0])
        entered = int(now.verifier.entered(judged.paths[:1], judged.lanes[:1])[0][0])
        plan = Plan(judged.inputs[0], margin, stop, path, judged.bind(0), clear, occupancy)
        return plan if entered == stop else replace(plan, entered=entered)

    def stop_lanes(self, now: ObservedScene) -> list[int]:
        """Lanes in which the fail-safe may stop, in order of preference."""
        near = (self._stop_lane(now), now.here, now.here - 1, now.here + 1)
        return list(dict.fromkeys(i for i in near if 0 <= i < now.scene.road.centers.size))

    def _evade(self, now: ObservedScene) -> JudgedInputs | None:
        """The input that is expected to stay clear longest, among those that are clear of the compliant vehicles; None
        without any. See `shield.pipelines.frames`."""
        lanes, braking = self.stop_lanes(now), self.config.braking
        accelerations = np.linspace(-braking, self.actuators.acceleration[1], _EVASIONS)
        wheels = [float(self.execution.fail_safe_inputs(now.scene, lane)[1]) for lane in lanes]
        floored = np.maximum(accelerations, self._floor(now.scene))
        inputs = np.array([(a, wheel) for wheel in wheels for a in floored])
        lawful = self.judge(now, inputs, lanes, verifier=now.lawful)
        keeps = np.flatnonzero(lawful.margin >= 0)
        if not keeps.size:
            return None
        paths, fails = lawful.paths[keeps], lawful.lanes[keeps]
        entered = now.verifier.entered(paths, fails)[0]
        expected = now.verifier.clearance(paths, entered, fails, hold=paths.shape[1])
        i = keeps[least_bad_evasion(expected, now.verifier.clearance(paths, entered, fails))]
        return self.judge(now, inputs[i : i + 1], [int(lawful.lanes[i])])

    def _stop_lane(self, now: ObservedScene) -> int:
        """The stop lane of the previous fail-safe, however far; the ego's own lane without one."""
        return now.here if now.memory.stored is None else int(now.memory.stored)

    def _floor(self, scene: Scene) -> float:
        """Acceleration that stops the ego by the next scene [m/s^2]."""
        return -max(float(scene.ego[State.SPEED]), 0.0) / (self.execution.frames * scene.dt)

    def _spans(self, scene: Scene) -> FloatArray:
        """Changes of throttle and steering of equal weight, (2,) [m/s^2, rad]."""
        along, across = float(np.ptp(self.actuators.acceleration)), float(np.ptp(self.actuators.steering))
        if self.norm == "acceleration":
            v, along = max(float(scene.ego[State.SPEED]), 1.0), along or self.config.braking
            across = min(along * LENGTH / v**2, across or np.inf)
        return np.array([along, across])
