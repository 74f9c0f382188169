"""`MPCPolicy`: model predictive control as a policy, with SB3's `predict`.

In each decision it chooses a lane, and then solves the predictive filter's problem. The reference is that lane and the
desired speed. The proposal is the input that would track them on an empty road. The plan stays on the road, clear of
all reachable rectangles of the others within the assumptions, and able to stop. With a reference alone the ego would
follow too far behind: the plan ends in a stop, so a constant low speed costs the least. The policy reads the
simulator's true state.

Lanes are compared by room: the distance to the next vehicle ahead, plus its change in `_LOOKAHEAD_TIME` seconds at its
present speed. A lane change needs a gain of `_WORTH` metres of room, and has to leave followers their distance.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.errors import ConfigError, SceneError
from dynamics.scenes.scene import Scene, SceneReader
from dynamics.state import FloatArray, RoadState, Vehicle
from dynamics.traffic.assumptions import Assumptions
from dynamics.traffic.occupancy import OtherVehicles
from dynamics.vehicle.actuators import Actuators
from dynamics.vehicle.controllers import KP_SPEED
from dynamics.vehicle.curved_bicycle import steer
from mpc.filter.from_scene import curvature_ahead, edges_of, rectangles
from mpc.filter.predictive_filter import PredictiveFilter
from mpc.filter.problem import BACKENDS, FilterProblem, FilterSettings, Reference
from mpc.filter.program.road_step import StageModel
from mpc.filter.result import FilterResult

__all__ = ["MPCPolicy"]

_LOOKAHEAD_TIME = 4.0
_WORTH = 1.0
_FAR = 200.0
"""Room beyond which a lane counts as empty [m]."""
_STAGE, _HORIZON = 0.2, 6.0
"""Stage and horizon of the plan [s]; a stage is at least as long as a decision period."""
_LATE = 0.0
"""Additional reaction time of a follower to a car that enters its lane [s]."""
_DRIFT = 2.5
"""Lateral speed of the reference towards a new lane [m/s]."""
_AHEAD = 5
"""Stage of the lateral reference that the proposal steers to."""
_BEND = 4.0
"""Lateral acceleration that limits the speed in curves [m/s^2]."""
_NEAREST = 12
"""Largest number of vehicles in a plan's problem."""


class MPCPolicy:
    """Drives one environment with `ContinuousAction`.

    Parameters
    ----------
    env : the highway-env environment, wrapped or not.
    speed : desired speed [m/s]; without throttle the ego keeps its present speed.
    buffer : (longitudinal, lateral) clearance of plans [m].
    assumptions : assumptions about the others; `Assumptions.moderate()` by default.
    model : dynamics model of plans (see `PredictiveFilter`); highway-env's bicycle by default.
    backend : solver of the quadratic programs, "daqp" or "osqp".

    Attributes
    ----------
    last_result : the last plan (`FilterResult`); None before the first, and if the scene could not be read.
    fallbacks : number of decisions without a usable plan, in which the ego braked in its lane.

    Raises
    ------
    ConfigError
        If the environment's actions are not `ContinuousAction`, or a value is out of range.
    """

    def __init__(
        self,
        env: Any,
        speed: float = 30.0,
        buffer: tuple[float, float] = (2.0, 0.3),
        assumptions: Assumptions | None = None,
        model: StageModel | None = None,
        backend: str = "daqp",
    ) -> None:
        base = getattr(env, "unwrapped", env)
        kind = type(getattr(base, "action_type", None)).__name__
        if kind != "ContinuousAction" or getattr(base.action_type, "dynamical", False):
            raise ConfigError(
                f"MPCPolicy drives ContinuousAction on the kinematic bicycle; this environment has {kind}. Pass "
                'config={"action": {"type": "ContinuousAction", "dynamical": False}} to gym.make'
            )
        if not (np.isfinite(speed) and speed > 0):
            raise ConfigError(f"speed must be positive and finite [m/s], got {speed!r}")
        if not (np.isfinite(buffer).all() and min(buffer) >= 0):
            raise ConfigError(f"buffer must be two lengths of at least 0 m, got {buffer!r}")
        if backend not in BACKENDS:
            raise ConfigError(f"unknown backend {backend!r}; valid are {', '.join(BACKENDS)}")
        self.speed, self.buffer = float(speed), buffer
        self.assumptions = assumptions if assumptions is not None else Assumptions.moderate()
        self.model, self.backend = model, backend
        self.actuators = Actuators.of(base.action_type)
        self._reader = SceneReader(base, curved=True)
        self._filter: PredictiveFilter | None = None
        self._road: Any = None
        self.reset()

    def reset(self) -> None:
        """Forget the last plan and lane; happens automatically at the start of an episode."""
        if self._filter is not None:
            self._filter.reset()
        self._lane: int | None = None
        self.last_result: FilterResult | None = None
        self.fallbacks = 0

    def predict(
        self, observation: Any = None, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Any, Any]:
        """The next action, shape (size,) float32, and `state` unchanged.

        The observation is ignored: this policy reads the simulator's true state.

        Raises
        ------
        SceneError
            If the environment's road is missing or not supported, or the scene has values that are not finite.
        """
        scene = self._reader.read()
        if self._reader.road is not self._road:
            self._road = self._reader.road
            self.reset()
        if not scene.finite:
            raise SceneError("the scene holds values that are not finite")
        lane, around = self._choose(scene)
        result = self._solve(scene, lane, around)
        self.last_result = result
        if result.status.usable:
            self._lane = lane
            return self.actuators.normalised(result.inputs[0]), state
        self.fallbacks += 1
        return self.actuators.normalised(self._brake(scene)), state

    def _choose(self, scene: Scene) -> tuple[int, OtherVehicles]:
        """The lane to drive in, and the reachable intervals of the others."""
        road, ego = scene.road, scene.ego_road
        around = OtherVehicles(scene.others, scene.others_road, road, self.assumptions, scene.dt)
        here = road.lane_at(float(ego[RoadState.R]))
        free_distance = np.full(road.centers.size, _FAR)
        if around.lane.size:
            s, v = scene.others_road[:, RoadState.S] - ego[RoadState.S], scene.others_road[:, RoadState.SPEED]
            inside = (around.low[:, None] < road.centers + 1.0) & (around.high[:, None] > road.centers - 1.0)
            ahead = s > 0
            gain = s - around.reach + _LOOKAHEAD_TIME * (v - ego[RoadState.SPEED])
            free_distance = np.minimum(np.where(inside & ahead[:, None], gain[:, None], _FAR).min(axis=0), _FAR)
        now = here if self._lane is None or abs(self._lane - here) > 1 else self._lane
        best = now
        for lane in (here - 1, here, here + 1):
            if not 0 <= lane < road.centers.size or road.forbidden[lane]:
                continue
            if free_distance[lane] > free_distance[best] + (_WORTH if best == now else 0.0) and self._free(
                scene, around, here, lane
            ):
                best = lane
        if best != here and not self._free(scene, around, here, best):
            best = here
        return best, around

    def _free(self, scene: Scene, around: OtherVehicles, here: int, lane: int) -> bool:
        """Whether no vehicle is alongside in the lane, and its followers keep the RSS distance."""
        if lane == here or not around.lane.size:
            return True
        a, ego = self.assumptions, scene.ego_road
        center = scene.road.centers[lane]
        inside = (around.low < center + 1.0) & (around.high > center - 1.0)
        gap = np.abs(scene.others_road[:, RoadState.S] - ego[RoadState.S])
        gap = gap - around.reach - 0.5 * scene.ego[Vehicle.LENGTH] - self.buffer[0]
        v, w = max(float(ego[RoadState.SPEED]), 0.0), scene.others_road[:, RoadState.SPEED]
        behind = scene.others_road[:, RoadState.S] < ego[RoadState.S]
        brake = -self.actuators.acceleration[0]
        reaction = a.reaction_time + _LATE
        top = w + a.acceleration * reaction
        need = (
            w * reaction + 0.5 * a.acceleration * reaction**2 + top**2 / (2 * a.follower_braking) - v**2 / (2 * brake)
        )
        return bool(np.all(~inside | (gap > np.where(behind, np.maximum(need, 0.0), 0.0))))

    def _solve(self, scene: Scene, lane: int, around: OtherVehicles) -> FilterResult:
        period = scene.frames_per_decision * scene.dt
        low, high = self.actuators.acceleration if self.actuators.longitudinal else (-1e-3, 1e-3)
        if self._filter is None:
            substeps = max(scene.frames_per_decision, round(_STAGE / scene.dt))
            stages = int(np.clip(round(_HORIZON / (substeps * scene.dt)), 6, 40))
            self._filter = PredictiveFilter(
                FilterSettings(
                    dt=scene.dt,
                    substeps=substeps,
                    stages=stages,
                    free_moves=min(8, stages),
                    acceleration=(low, high),
                    steering=min(abs(x) for x in self.actuators.steering) if self.actuators.lateral else 1e-3,
                    braking=max(-low, 1e-3),
                    backend=self.backend,
                ),
                self.model,
            )
        settings, road, ego = self._filter.settings, scene.road, scene.ego_road
        here, v, r = road.lane_at(float(ego[RoadState.R])), float(ego[RoadState.SPEED]), float(ego[RoadState.R])
        length, width = float(scene.ego[Vehicle.LENGTH]), float(scene.ego[Vehicle.WIDTH])
        half = (0.5 * length + self.buffer[0], 0.5 * width + self.buffer[1])
        if road.bends is not None:
            grown = road.bends.growth(length, width)
            half = (half[0] + grown[0], half[1] + grown[1])
        bend, edges = curvature_ahead(scene, v, settings), edges_of(road, [here, lane], r, half[1])
        rows = self._rows(scene, around, here, lane, edges)
        boxes = rectangles(around, rows, settings)
        times = scene.dt * np.array(settings.ends)
        # Followers have their braking distance (`_free`), and are assumed not to accelerate into it.
        behind = np.flatnonzero(scene.others_road[rows, RoadState.S] < ego[RoadState.S])
        back = rows[behind]
        w = np.maximum(scene.others_road[back, RoadState.SPEED], 0.0)
        steady = scene.others_road[back, RoadState.S] + around.reach[back] + w * times[:, None]
        boxes[:, behind, 1] = np.minimum(boxes[:, behind, 1], steady)
        aim = float(road.centers[lane])
        way = r + np.clip(aim - r, -_DRIFT * times, _DRIFT * times)
        speed = np.full(settings.stages, self.speed if self.actuators.longitudinal else v)
        if bend is not None:
            tight = np.abs(bend) / np.maximum(1 - bend * r, 0.1)
            speed = np.minimum(speed, np.sqrt(_BEND / np.maximum(tight, 1e-6)))
        problem = FilterProblem(
            state=ego,
            proposal=self._tracking_proposal(scene, float(speed[0]), float(way[min(_AHEAD, settings.stages) - 1])),
            occupancy=boxes,
            half=half,
            edges=edges,
            curvature=bend,
            reference=Reference(r=way, v=speed, lateral=0.01, heading=0.1, speed=1e-4),
        )
        return self._filter.solve(problem, elapsed=max(1, round(period / scene.dt)))

    def _rows(self, scene: Scene, around: OtherVehicles, here: int, lane: int, edges: tuple[float, float]) -> Any:
        """Indices of the vehicles in the problem: the nearest ones between the edges, without followers in the own
        lane.
        """
        ds = scene.others_road[:, RoadState.S] - scene.ego_road[RoadState.S]
        behind = ds < -0.5 * scene.ego[Vehicle.LENGTH]
        center = scene.road.centers[lane]
        enters = (around.low < center + 1.0) & (around.high > center - 1.0) & (lane != here)
        between = (around.low < edges[1]) & (around.high > edges[0])
        rows = np.flatnonzero((~behind | enters) & between)
        return rows[np.argsort(np.abs(ds[rows]), kind="stable")][:_NEAREST]

    def _tracking_proposal(self, scene: Scene, speed: float, r: float) -> FloatArray:
        """Proposal on an empty road: track a speed [m/s] and a lateral position [m]."""
        low, high = self.actuators.acceleration if self.actuators.longitudinal else (0.0, 0.0)
        a = float(np.clip(KP_SPEED * (speed - scene.ego_road[RoadState.SPEED]), low, high))
        return np.array([a, float(np.clip(self._wheel(scene, r), *self.actuators.steering))])

    def _wheel(self, scene: Scene, r: float) -> float:
        return steer(scene.road, scene.ego_road, r, scene.dt)

    def _brake(self, scene: Scene) -> FloatArray:
        """Brake in the ego's present lane, as hard as the actuators can."""
        road, ego = scene.road, scene.ego_road
        wheel = self._wheel(scene, float(road.centers[road.lane_at(float(ego[RoadState.R]))]))
        v = float(ego[RoadState.SPEED])
        stop = -v / (scene.frames_per_decision * scene.dt)
        least = self.actuators.acceleration[0] if v > 0 else 0.0
        return np.array([max(least, min(stop, 0.0)) if v >= 0 else min(KP_SPEED * -v, 1.0), wheel])
