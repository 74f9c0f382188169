"""The procedure for throttle and steering: the nearest input that verifies.

An input (a, delta) is verified for one frame: after it, the fail-safe (brake to a stop in a lane, steered by
highway-env's own lane controller) must stay clear of every place where the others can be, the ego's body must stay
on the road, and the ego must not roll backwards. The set of inputs that verify is not convex, so the repair looks for
the nearest one in three steps, and verifies each input like any other: the predictive filter (`mpc.filter`); where its
answer does not verify, a fan of inputs between the proposal and braking in a lane; and then rings around the proposal,
nearer than the best so far.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from dynamics.actuators import Actuators
from dynamics.curved import steer
from dynamics.rollout import BRAKE
from dynamics.scene import Scene
from dynamics.state import FloatArray, RoadState, State, Vehicle
from mpc.filter import PredictiveFilter
from mpc.problem import FilterProblem, FilterSettings
from shield.candidates import Candidates
from shield.config import ShieldConfig
from shield.core import ShieldCore
from shield.decision import Decision, Reason, Tier
from shield.errors import ConfigError
from shield.verify import Clearance, least_bad

__all__ = ["ContinuousCore", "Judged"]

_STAGE, _STAGES = 0.2, 20
"""Stage of the predictive filter [s], and how many."""
_FAN = np.array([(i, j) for j in (0.0, 0.25, 0.5, 0.75, 1.0) for i in (0.0, 0.25, 0.5, 0.75, 0.9, 1.0)][1:])
"""Shares of the way from the proposal to braking in a lane: (acceleration, steering)."""


def _rings(count: int, angles: FloatArray) -> FloatArray:
    taken, angle = (x.reshape(-1) for x in np.meshgrid(np.arange(1, count) / count, angles, indexing="ij"))
    return np.stack([taken, angle], axis=1)


_NEARER = (
    (4, _rings(4, np.linspace(-np.pi, np.pi, 17)[1:])),
    (5, _rings(5, np.linspace(-0.4, 0.4, 11))),
    (5, _rings(5, np.linspace(-0.12, 0.12, 11))),
)
"""Where nearer inputs are looked for, seen from the proposal: shares of a step that are taken off the distance of the
best so far, and angles [rad] from it. The first step is the distance itself, the next ones what lies between two rings
of the last. First all around, for what verifies need not be on the way to the best."""
_NEAR = 0.01
"""Step below which no nearer input is looked for, as a share of the actuators' ranges."""


@dataclass(frozen=True, slots=True)
class Judged:
    """Inputs (n, 2), and the best fail-safe of each: margin [m], frames that stay clear, lane, path."""

    inputs: FloatArray
    margin: FloatArray
    clear: Any
    lanes: Any
    paths: FloatArray


class ContinuousCore(ShieldCore):
    """Filters throttle and steering, frame by frame.

    Parameters
    ----------
    config : settings; `ShieldConfig()` by default.
    actuators : what the policy controls. The fail-safe and the repair may use the throttle, the brake
        (`config.braking`) and the wheel in any case: they act between the decision and the actuators.
    predictive : whether the predictive filter takes part in the repair.

    Raises
    ------
    ConfigError
        If the mode is one of the rules for meta-actions.
    """

    # highway-env's traffic aborts a lane change for the target of a `ControlledVehicle`; this ego is none.
    _announced = False

    def __init__(
        self, config: ShieldConfig | None = None, actuators: Actuators | None = None, predictive: bool = True
    ) -> None:
        super().__init__(config)
        if self.config.mode not in ("none", "full"):
            raise ConfigError(f"mode {self.config.mode!r} judges meta-actions; for ContinuousAction use none or full")
        self.actuators = actuators if actuators is not None else Actuators()
        self.predictive = predictive
        self._filters: dict[float, PredictiveFilter] = {}

    def reset(self) -> None:
        """Forget everything about the episode."""
        super().reset()
        for each in getattr(self, "_filters", {}).values():
            each.reset()

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
            return proposal, self._record(scene, proposal, judged, 0, Reason.NONE, Tier.PASSED, start)
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
        law = self._law(scene, lane)
        floor = np.array([self._floor(scene), -np.inf])
        lanes = list(dict.fromkeys((lane, int(first.lanes[0]))))
        plan = self._predict(scene, proposal, int(first.lanes[0])) if self.predictive else None
        judged = None if plan is None else self._judge_inputs(scene, np.maximum(plan, floor)[None], lanes)
        if judged is None or not judged.margin[0] >= 0:
            judged = self._judge_inputs(scene, np.maximum(proposal + _FAN * (law - proposal), floor), lanes)
        good = np.flatnonzero(judged.margin >= 0)
        if not good.size:
            return self._fall_back(scene, proposal, judged, law, start)
        best = int(good[self._distance(judged.inputs[good], proposal).argmin()])
        step = float(np.sqrt(self._distance(judged.inputs[best], proposal)))
        for count, rings in _NEARER:
            if not step > _NEAR:
                break
            nearer = self._nearer(judged.inputs[best], proposal, step, rings)
            judged = _join(judged, best, self._judge_inputs(scene, np.maximum(nearer, floor), lanes))
            good = np.flatnonzero(judged.margin >= 0)
            best = int(good[self._distance(judged.inputs[good], proposal).argmin()])
            step /= count
        return judged.inputs[best], self._record(scene, proposal, judged, best, Reason.UNVERIFIED, Tier.GOVERNED, start)

    def _fall_back(
        self, scene: Scene, proposal: FloatArray, judged: Judged, law: FloatArray, start: float
    ) -> tuple[FloatArray, Decision]:
        if self.stored_lane is not None and not self.monitor.violated:
            return self.brake_inputs(scene, proposal, Reason.NO_SAFE_PLAN, start, Tier.STORED_PLAN)
        best = least_bad(Clearance(judged.margin, judged.clear))
        inputs = judged.inputs[best]
        decision = self._record(scene, proposal, judged, best, Reason.NO_SAFE_PLAN, Tier.LARGEST_MARGIN, start)
        self.stored_lane = None
        return inputs, decision

    def _predict(self, scene: Scene, proposal: FloatArray, lane: int) -> FloatArray | None:
        """First input of the predictive filter's plan, or None where it has none that keeps its constraints."""
        solver = self._filters.get(scene.dt)
        if solver is None:
            substeps = max(1, round(_STAGE / scene.dt))
            settings = FilterSettings(
                dt=scene.dt,
                substeps=substeps,
                stages=_STAGES,
                acceleration=(-self.config.braking, max(self.actuators.acceleration[1], 1.0)),
                steering=max(abs(self.actuators.steering[0]), abs(self.actuators.steering[1])),
                braking=self.config.braking,
            )
            solver = self._filters[scene.dt] = PredictiveFilter(settings)
        settings = solver.settings
        survey, b, road = self._survey(scene), self.config.buffer, scene.road
        ends = settings.substeps * np.arange(1, settings.stages + 1) - 1
        frames = int(ends[-1]) + 1
        here = road.lane_at(float(scene.ego_road[RoadState.R]))
        owned = survey.owned[here] and survey.owned[lane]
        v = max(float(scene.ego[State.SPEED]), 0.0)
        lanes = road.centers[[here, lane]]
        along, across = survey.growth
        side, r = 0.5 * float(scene.ego[Vehicle.WIDTH]) + b.lateral + across, float(scene.ego_road[RoadState.R])
        # A change of lane that is half done may still use the lane that it came from.
        low = min(float(lanes.min()) - 0.5 * road.width, r - side)
        high = max(float(lanes.max()) + 0.5 * road.width, r + side)
        rows = survey.relevant((v + 2.0) * frames * scene.dt, frames * scene.dt, followers=not owned)
        around = survey.around
        # Beyond its edges the plan meets nobody, and need not stay behind them either.
        rows = rows[(around.low[rows] < high) & (around.high[rows] > low)]
        rows = rows[np.argsort(np.abs(scene.others_road[rows, RoadState.S] - scene.ego_road[RoadState.S]))][:12]
        seen = around.occupancy(frames, scene.dt)
        boxes = np.empty((settings.stages, rows.size, 4))
        boxes[..., 0], boxes[..., 1] = seen.rear[np.ix_(rows, ends)].T, seen.front[np.ix_(rows, ends)].T
        boxes[..., 2], boxes[..., 3] = seen.low[rows], seen.high[rows]
        bend = None
        if road.bends is not None:
            bend = road.curvature(float(scene.ego_road[RoadState.S]) + v * settings.stage * np.arange(settings.stages))
        problem = FilterProblem(
            state=scene.ego_road,
            proposal=proposal,
            occupancy=boxes,
            half=(0.5 * scene.ego[Vehicle.LENGTH] + b.longitudinal + along, side),
            edges=(low, high),
            curvature=bend,
        )
        result = solver.solve(problem, elapsed=1)
        first = result.inputs[0]
        return first if result.status.usable and np.isfinite(first).all() else None

    # -- pieces ------------------------------------------------------------------------------------------

    def _judge_inputs(self, scene: Scene, inputs: FloatArray, stops: list[int]) -> Judged:
        """Each input for one frame and then the fail-safe, in the first of the lanes `stops` where that verifies."""
        lanes = np.array(stops)
        n, f = len(inputs), lanes.size
        fails = np.tile(lanes, n)
        held = np.broadcast_to(inputs[:, None, :], (n, self._frames, 2))
        began = self._rollouts_for(scene).run_inputs(scene.ego_road, held)
        paths = self._stopped(scene, np.repeat(began, f, axis=0), fails)
        entered, room = self._entered(scene, paths, fails)
        result = self._survey(scene).clearance(paths, Candidates(paths, entered, fails))
        margin = np.minimum(result.margin, room)
        # Rolling backwards has no fail-safe: the brake stands still.
        backwards = np.repeat(began[:, -1, RoadState.SPEED] < -1e-9, f)
        margin = np.where(backwards, -np.inf, margin).reshape(n, f)
        # The first lane that verifies, in order; else the best.
        good = margin >= 0
        pick = np.where(good.any(axis=1), good.argmax(axis=1), np.nan_to_num(margin, nan=-np.inf).argmax(axis=1))
        rows = np.arange(n) * f + pick
        return Judged(inputs, margin.reshape(-1)[rows], result.clear[rows], fails[rows], paths[rows])

    def _stopped(self, scene: Scene, began: FloatArray, fails: Any) -> FloatArray:
        """Paths (n, h, 4) and the fail-safe after them, each in its lane of `fails`, (n, h + frames, 4)."""
        top = max(float(began[:, -1, RoadState.SPEED].max()), 0.0)
        frames = int(np.ceil(top / (self.config.braking * scene.dt))) + 1
        commands = np.empty((len(fails), frames, 3))
        commands[..., 0] = scene.road.centers[fails][:, None]
        commands[..., 1], commands[..., 2] = BRAKE, self.config.braking
        return np.concatenate([began, self._rollouts_for(scene).run(began[:, -1], commands)], axis=1)

    def _entered(self, scene: Scene, paths: FloatArray, fails: Any) -> tuple[Any, FloatArray]:
        """The lane that the body of each path enters beside those that the ego owns, and the room that it leaves [m].

        Room is what is left to the road's edge; none where a path enters lanes on both sides.
        """
        road, ego = scene.road, scene.ego
        sin, cos = np.abs(np.sin(paths[..., RoadState.HEADING])), np.abs(np.cos(paths[..., RoadState.HEADING]))
        half = 0.5 * (ego[Vehicle.LENGTH] * sin + ego[Vehicle.WIDTH] * cos) + self._survey(scene).bare[1]
        low, high = paths[..., RoadState.R] - half, paths[..., RoadState.R] + half
        least, most = low.min(axis=1), high.max(axis=1)
        centers, side, owned = road.centers, 0.5 * road.width, self._survey(scene).owned
        new = (most[:, None] > centers - side) & (least[:, None] < centers + side) & ~owned
        new[np.arange(len(fails)), fails] = False
        entered = np.where(new.any(axis=1), new.argmax(axis=1), fails)
        room = np.minimum(least - (centers[0] - side), (centers[-1] + side) - most)
        room = np.where(room >= 0, np.inf, room)
        # Nobody keeps a place free in a lane that the ego has left: it does not come back to one.
        within = (low[..., None] < centers[owned] + 1.0) & (high[..., None] > centers[owned] - 1.0)
        returns = (within[:, 1:] & ~within[:, :-1]).any(axis=(1, 2))
        return entered, np.where((new.sum(axis=1) > 1) | returns, -np.inf, room)

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

    def _law(self, scene: Scene, lane: int) -> FloatArray:
        """Inputs of the fail-safe manoeuvre for one frame: brake, and steer to the lane's centre."""
        wheel = steer(scene.road, scene.ego_road, scene.road.centers[lane], scene.dt)
        v = float(scene.ego[State.SPEED])
        period, b = self._frames * scene.dt, self.config.braking
        return np.array([max(-b, self._floor(scene)) if v >= 0 else min(-v / period, b), wheel])

    def _nearer(self, inputs: FloatArray, proposal: FloatArray, step: float, rings: FloatArray) -> FloatArray:
        """Inputs (n, 2) on `rings` around the proposal, up to `step` nearer to it than `inputs` (2,)."""
        spans = np.array([np.ptp(self.actuators.acceleration), np.ptp(self.actuators.steering)])
        a, delta = (inputs - proposal) / spans
        radius = np.maximum(np.hypot(a, delta) - step * rings[:, 0], 0.0)
        angle = np.arctan2(delta, a) + rings[:, 1]
        around = proposal + spans * np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
        least = np.minimum((-self.config.braking, self.actuators.steering[0]), proposal)
        most = np.maximum((self.actuators.acceleration[1], self.actuators.steering[1]), proposal)
        return np.clip(around, least, most)

    def _distance(self, inputs: FloatArray, proposal: FloatArray) -> FloatArray:
        """How far inputs (..., 2) are from the proposal, in shares of the actuators' ranges, squared."""
        spans = np.array([np.ptp(self.actuators.acceleration), np.ptp(self.actuators.steering)])
        return np.asarray(np.square((inputs - proposal) / spans).sum(axis=-1))

    def _record(
        self,
        scene: Scene,
        proposal: FloatArray,
        judged: Judged,
        i: int,
        reason: Reason,
        tier: Tier,
        start: float,
    ) -> Decision:
        if tier is not Tier.LARGEST_MARGIN:
            self.stored_lane = int(judged.lanes[i])
        plan = np.vstack([scene.ego_road, judged.paths[i]])
        occupancy = None
        if self.config.record:
            occupancy = self._survey(scene).around.occupancy(len(judged.paths[i]), scene.dt).rectangles()
        margin = float(judged.margin[i])
        return Decision(proposal, judged.inputs[i], reason, tier, margin, perf_counter() - start, plan, occupancy)


def _join(first: Judged, keep: int, second: Judged) -> Judged:
    """One row of the first, and the second; paths are padded with their last state."""
    frames = max(first.paths.shape[1], second.paths.shape[1])

    def pad(paths: FloatArray) -> FloatArray:
        return np.pad(paths, ((0, 0), (0, frames - paths.shape[1]), (0, 0)), mode="edge")

    one = slice(keep, keep + 1)
    return Judged(
        np.vstack([first.inputs[one], second.inputs]),
        np.concatenate([first.margin[one], second.margin]),
        np.concatenate([first.clear[one], second.clear]),
        np.concatenate([first.lanes[one], second.lanes]),
        np.concatenate([pad(first.paths[one]), pad(second.paths)]),
    )
