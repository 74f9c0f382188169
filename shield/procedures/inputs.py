"""The procedure for throttle and steering: the nearest input that verifies.

An input (a, delta) is verified for one frame: after it, the fail-safe (brake to a stop in a lane, steered by
highway-env's own lane controller) must stay clear of every place where the others can be, the ego's body must stay
on the road, and the ego must not roll backwards. A proposal that does not verify is replaced by the nearest input that
does (`shield.repair.nearest_input`); where the search finds none, by the first input of the predictive filter's plan
(`mpc.filter.predictive_filter`), which is verified like any other.
"""

from __future__ import annotations

from time import perf_counter
from typing import Any

import numpy as np

from dynamics.scenes.scene import Scene
from dynamics.state import FloatArray, RoadState, State, Vehicle
from dynamics.vehicle.actuators import Actuators
from dynamics.vehicle.bicycle import LENGTH
from dynamics.vehicle.curved_bicycle import steer
from mpc.filter.from_scene import curvature_ahead, edges_of, rectangles
from mpc.filter.predictive_filter import PredictiveFilter
from mpc.filter.problem import FilterProblem, FilterSettings
from mpc.filter.road_step import StageModel
from shield.certificate.kernels import lanes_touched, verdicts
from shield.certificate.manoeuvres import Candidates
from shield.certificate.memory import Memory
from shield.certificate.verify import ROUNDING, Binding, Clearance, Surveyor, least_bad
from shield.config import ShieldConfig
from shield.decision import Decision, Reason, Tier
from shield.errors import ConfigError
from shield.repair.nearest_input import Judged, Search

__all__ = ["ContinuousCore"]

_STAGE, _STAGES = 0.2, 20
"""Stage of the predictive filter [s], and how many."""
_EVASIONS = 9
"""Accelerations that are tried for each lane where somebody has broken a rule."""
_NEAREST = 12
"""Vehicles that a plan looks at."""


class ContinuousCore(Memory):
    """Filters throttle and steering, frame by frame.

    Parameters
    ----------
    config : settings; `ShieldConfig()` by default.
    actuators : what the policy controls. The fail-safe and the repair may use the throttle, the brake
        (`config.braking`) and the wheel in any case: they act between the decision and the actuators.
    predictive : whether the predictive filter takes part in the repair.
    model : what the predictive filter plans with; the bicycle by default. Its plans are verified on the bicycle.

    Raises
    ------
    ConfigError
        If the mode is one of the rules for meta-actions.
    """

    def __init__(
        self,
        config: ShieldConfig | None = None,
        actuators: Actuators | None = None,
        predictive: bool = True,
        model: StageModel | None = None,
    ) -> None:
        super().__init__(config)
        if self.config.mode not in ("none", "full"):
            raise ConfigError(f"mode {self.config.mode!r} judges meta-actions; for ContinuousAction use none or full")
        self.actuators = actuators if actuators is not None else Actuators()
        self.predictive, self.model = predictive, model
        self._filters: dict[float, PredictiveFilter] = {}

    @property
    def norm(self) -> str:
        """What the nearest input is nearest in, one of `shield.config.NORMS`."""
        return self.config.norm

    def reset(self) -> None:
        """Forget everything about the episode."""
        super().reset()
        for each in getattr(self, "_filters", {}).values():
            each.reset()

    def prepare(self, scene: Scene) -> None:
        """Compute what depends on the road alone, so that no frame has to wait for it."""
        if scene.finite:
            self._judge_inputs(scene, np.zeros((1, 2)), self._stop_lanes(scene)[:1])
            self._surveyor = None
            if self.predictive:
                self._filter_for(scene).prepare(_NEAREST, curved=scene.road.bends is not None)

    def filter(self, scene: Scene, proposal: FloatArray) -> tuple[FloatArray, Decision]:
        """What the actuators get for the next frame.

        Parameters
        ----------
        scene : the scene now.
        proposal : (acceleration [m/s^2], front wheel angle [rad]), shape (2,).

        Returns
        -------
        The inputs (2,), `proposal` itself where it verifies; and the record.
        """
        start = perf_counter()
        if not scene.finite:
            return self.brake_inputs(scene, proposal, Reason.BAD_SCENE, start)
        self._observe(scene)
        first, *others = self._stop_lanes(scene)
        judged = self._judge_inputs(scene, proposal[None], [first])
        if not judged.margin[0] >= 0 and others:
            judged = self._judge_inputs(scene, proposal[None], [first, *others])
        if judged.margin[0] >= 0:
            self.monitor.forgive()
            return proposal, self._record(scene, proposal, judged, Reason.NONE, Tier.PASSED, start)
        return self._repair_inputs(scene, proposal, judged, start)

    def brake_inputs(
        self,
        scene: Scene | None,
        proposal: Any,
        reason: Reason,
        start: float,
        tier: Tier = Tier.EMERGENCY,
        floor: float = -np.inf,
    ) -> tuple[FloatArray, Decision]:
        """The fail-safe manoeuvre's inputs for one frame, in the stored lane where there is one.

        Without a readable scene, or with an ego that is not finite in it, the wheel is kept straight and the brake is
        limited to `floor`, the acceleration that just stops the ego [m/s^2].
        """
        inputs = np.array([max(-self.config.braking, floor), 0.0])
        if scene is not None and np.isfinite(scene.ego).all():
            inputs = self._law(scene, self._stop_lane(scene))
        return inputs, Decision(proposal, inputs, reason, tier, np.nan, perf_counter() - start)

    # -- repair ------------------------------------------------------------------------------------------

    def _repair_inputs(
        self, scene: Scene, proposal: FloatArray, first: Judged, start: float
    ) -> tuple[FloatArray, Decision]:
        lane = self._stop_lane(scene)
        floor = np.array([self._floor(scene), -np.inf])
        lanes = list(dict.fromkeys((lane, int(first.lanes[0]))))
        least = np.minimum((-self.config.braking, self.actuators.steering[0]), proposal)
        most = np.maximum((self.actuators.acceleration[1], self.actuators.steering[1]), proposal)

        def judge(inputs: FloatArray, lanes: list[int], parts: bool) -> Judged:
            return self._judge_inputs(scene, inputs, lanes, parts)

        search = Search(judge, proposal, self._spans(scene), np.maximum(least, floor), np.maximum(most, floor))
        judged = search.run(lanes, self._law(scene, lane), self._stop_lanes(scene))
        if not judged.margin[0] >= 0 and self.predictive:
            plan = self._predict(scene, proposal, int(first.lanes[0]))
            if plan is not None:
                found = self._judge_inputs(scene, np.maximum(plan, floor)[None], lanes)
                judged = found if found.margin[0] >= 0 else judged
        if not judged.margin[0] >= 0:
            return self._fall_back(scene, proposal, judged, start)
        self.monitor.forgive()
        return judged.inputs[0], self._record(scene, proposal, judged, Reason.UNVERIFIED, Tier.GOVERNED, start)

    def _fall_back(
        self, scene: Scene, proposal: FloatArray, judged: Judged, start: float
    ) -> tuple[FloatArray, Decision]:
        """Nothing verifies against everybody. The stored plan is kept as long as it clears those who have broken no
        rule; among what clears them, what clears the others longest is taken."""
        violated, reason = self.monitor.violated, Reason.NO_SAFE_PLAN
        if self.stored_lane is not None:
            law = self._law(scene, self.stored_lane)[None]
            stored = self._judge_inputs(scene, law, [self.stored_lane], survey=self._lawful(scene))
            keeps = bool(stored.margin[0] >= -ROUNDING)
            if keeps and violated:
                evading = self._evade(scene)
                if evading is not None:
                    return evading.inputs[0], self._record(scene, proposal, evading, reason, Tier.EVADED, start)
            if keeps or not violated:
                return law[0], self._record(scene, proposal, stored, reason, Tier.STORED_PLAN, start)
        decision = self._record(scene, proposal, judged, reason, Tier.LARGEST_MARGIN, start)
        self.stored_lane = None
        return judged.inputs[0], decision

    def _evade(self, scene: Scene) -> Judged | None:
        """What clears everybody longest among what clears those who have broken no rule; None where nothing does."""
        lanes, braking = self._stop_lanes(scene), self.config.braking
        accelerations = np.linspace(-braking, self.actuators.acceleration[1], _EVASIONS)
        wheels = [float(self._law(scene, lane)[1]) for lane in lanes]
        inputs = np.array([(a, wheel) for wheel in wheels for a in np.maximum(accelerations, self._floor(scene))])
        lawful = self._judge_inputs(scene, inputs, lanes, survey=self._lawful(scene))
        keeps = np.flatnonzero(lawful.margin >= 0)
        if not keeps.size:
            return None
        every = self._judge_inputs(scene, inputs[keeps], lanes)
        return every.row(least_bad(Clearance(every.margin, every.clear)))

    def _filter_for(self, scene: Scene) -> PredictiveFilter:
        solver = self._filters.get(scene.dt)
        if solver is None:
            substeps = max(1, round(_STAGE / scene.dt))
            settings = FilterSettings(
                dt=scene.dt,
                substeps=max(substeps, self._frames),
                hold=self._frames,
                stages=_STAGES,
                acceleration=(-self.config.braking, max(self.actuators.acceleration[1], 1.0)),
                steering=max(abs(self.actuators.steering[0]), abs(self.actuators.steering[1])),
                braking=self.config.braking,
            )
            solver = self._filters[scene.dt] = PredictiveFilter(settings, self.model)
        return solver

    def _predict(self, scene: Scene, proposal: FloatArray, lane: int) -> FloatArray | None:
        """First input of the predictive filter's plan, or None where it has none that keeps its constraints."""
        solver = self._filter_for(scene)
        settings = solver.settings
        survey, b, road, dt = self._survey(scene), self.config.buffer, scene.road, scene.dt
        here, v = road.lane_at(float(scene.ego_road[RoadState.R])), max(float(scene.ego[State.SPEED]), 0.0)
        along, across = survey.growth
        half = (
            0.5 * float(scene.ego[Vehicle.LENGTH]) + b.longitudinal + along,
            0.5 * float(scene.ego[Vehicle.WIDTH]) + b.lateral + across,
        )
        low, high = edges_of(road, [here, lane], float(scene.ego_road[RoadState.R]), half[1])
        owned, duration = survey.owned[here] and survey.owned[lane], settings.ends[-1] * dt
        rows = survey.relevant((v + 2.0) * duration, followers=not owned)
        around = survey.around
        # Beyond its edges the plan meets nobody, and need not stay behind them either.
        rows = rows[(around.low[rows] < high) & (around.high[rows] > low)]
        rows = rows[np.argsort(np.abs(scene.others_road[rows, RoadState.S] - scene.ego_road[RoadState.S]))][:_NEAREST]
        problem = FilterProblem(
            state=scene.ego_road,
            proposal=proposal,
            occupancy=rectangles(around, rows, settings),
            half=half,
            edges=(low, high),
            curvature=curvature_ahead(scene, v, settings),
        )
        result = solver.solve(problem)
        first = result.inputs[0]
        return first if result.status.usable and np.isfinite(first).all() else None

    # -- pieces ------------------------------------------------------------------------------------------

    def _judge_inputs(
        self,
        scene: Scene,
        inputs: FloatArray,
        stops: list[int],
        parts: bool = False,
        survey: Surveyor | None = None,
    ) -> Judged:
        """Each input for one frame and then the fail-safe, in the first of the lanes `stops` where that verifies.

        With `parts`, for which there must be one lane only, what their margins are made of comes along. `survey` is who
        judges, everybody being looked at by default.
        """
        n, f = len(inputs), len(stops)
        fails = np.array(stops * n)
        held = inputs[:, None] if self._frames == 1 else np.repeat(inputs[:, None], self._frames, axis=1)
        began = self._rollouts_for(scene).run_inputs(scene.ego_road, held)
        paths = self._stopped(scene, began, fails)
        entered, edges, allowed, on_road = self._entered(scene, paths, fails)
        survey = survey if survey is not None else self._survey(scene)
        result = survey.clearance(paths, Candidates(paths, entered, fails), parts=parts)
        margin = verdicts(result.margin, edges, allowed, paths, self._frames)
        clear = np.minimum(result.clear, on_road)
        of = None if result.parts is None else np.hstack([result.parts, edges])

        def bind(row: int) -> Binding:
            if not margin[row] < result.margin[row]:
                return result.binding(row)
            return Binding("edge" if np.isfinite(margin[row]) or not allowed[row] else "rollback")

        if f == 1:
            return Judged(inputs, margin, clear, fails, paths, of, bind)
        # The first lane that verifies, in order; else the best.
        each = margin.reshape(n, f)
        good = each >= 0
        pick = np.where(good.any(axis=1), good.argmax(axis=1), np.nan_to_num(each, nan=-np.inf).argmax(axis=1))
        rows = np.arange(n) * f + pick
        return Judged(inputs, margin[rows], clear[rows], fails[rows], paths[rows], bind=lambda i: bind(int(rows[i])))

    def _stopped(self, scene: Scene, began: FloatArray, fails: Any) -> FloatArray:
        """Paths (n, h, 4) and the fail-safes after them, in lanes `fails` (n k,): (n k, h + frames, 4)."""
        top = max(float(began[:, -1, RoadState.SPEED].max()), 0.0)
        frames = int(np.ceil(top / (self.config.braking * scene.dt))) + 1
        return self._rollouts_for(scene).stop(began, scene.road.centers[fails], self.config.braking, frames)

    def _entered(self, scene: Scene, paths: FloatArray, fails: Any) -> tuple[Any, FloatArray, Any, Any]:
        """The lane that the body of each path enters beside those that the ego owns, (n,); the room that it leaves to
        the road's edges, (n, 2) [m]; whether it may go there, (n,): not into lanes on both sides at once; and the
        frames for which it stays on the road, (n,).
        """
        ego, survey, centers = scene.ego, self._survey(scene), scene.road.centers
        length, width, side = float(ego[Vehicle.LENGTH]), float(ego[Vehicle.WIDTH]), 0.5 * scene.road.width
        return lanes_touched(paths, length, width, survey.bare[1], centers, side, survey.owned, fails)

    def _stop_lanes(self, scene: Scene) -> list[int]:
        """Lanes in which the fail-safe may stop, in order of preference."""
        here = scene.road.lane_at(float(scene.ego_road[RoadState.R]))
        near = (self._stop_lane(scene), here, here - 1, here + 1)
        return list(dict.fromkeys(i for i in near if 0 <= i < scene.road.centers.size))

    def _stop_lane(self, scene: Scene) -> int:
        """The lane in which the fail-safe of the frame before would stop, however far; the ego's own without one."""
        if self.stored_lane is not None:
            return self.stored_lane
        return scene.road.lane_at(float(scene.ego_road[RoadState.R]))

    def _floor(self, scene: Scene) -> float:
        """The acceleration that just stops the ego within the frame [m/s^2]."""
        return -max(float(scene.ego[State.SPEED]), 0.0) / (self._frames * scene.dt)

    def _spans(self, scene: Scene) -> FloatArray:
        """Changes of throttle and steering that count alike, (2,) [m/s^2, rad]."""
        along, across = float(np.ptp(self.actuators.acceleration)), float(np.ptp(self.actuators.steering))
        if self.norm == "acceleration":
            v, along = max(float(scene.ego[State.SPEED]), 1.0), along or self.config.braking
            across = min(along * LENGTH / v**2, across or np.inf)
        return np.array([along, across])

    def _law(self, scene: Scene, lane: int) -> FloatArray:
        """Inputs of the fail-safe manoeuvre for one frame: brake, and steer to the lane's centre."""
        wheel = steer(scene.road, scene.ego_road, scene.road.centers[lane], scene.dt)
        v = float(scene.ego[State.SPEED])
        period, b = self._frames * scene.dt, self.config.braking
        return np.array([max(-b, self._floor(scene)) if v >= 0 else min(-v / period, b), wheel])

    def _record(
        self,
        scene: Scene,
        proposal: FloatArray,
        judged: Judged,
        reason: Reason,
        tier: Tier,
        start: float,
    ) -> Decision:
        if tier is not Tier.LARGEST_MARGIN:
            self.stored_lane = int(judged.lanes[0])
        plan = np.vstack([scene.ego_road, judged.paths[0]])
        occupancy = None
        if self.config.record:
            occupancy = self._survey(scene).around.occupancy(len(judged.paths[0]), scene.dt).rectangles()
        margin = float(judged.margin[0])
        binding, latency = judged.bind(0), perf_counter() - start
        inputs, clause, vehicle = judged.inputs[0], binding.clause, binding.vehicle
        return Decision(proposal, inputs, reason, tier, margin, latency, plan, occupancy, clause, vehicle)
