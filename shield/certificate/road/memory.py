"""The memory between decisions, and the observation of one scene with it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Generic, TypeVar

import numpy as np

from dynamics.scenes.scene import Scene
from dynamics.state import BoolArray, FloatArray, IntArray, RoadState, State, Vehicle
from dynamics.traffic.occupancy import OtherVehicles
from dynamics.traffic.tables import VehicleTables
from dynamics.vehicle.controllers import KP_SPEED
from dynamics.vehicle.rollouts import Rollouts
from shield.certificate.road.clauses.clause_inputs import LaneDistances, LaneState
from shield.certificate.road.clauses.followers import updated_lanes
from shield.certificate.road.clauses.others import TOUCH
from shield.certificate.road.manoeuvres import Manoeuvres, brake_candidates
from shield.certificate.road.monitor import ParkingMonitor, RoadMonitor
from shield.certificate.road.nesting import shrink_bounds
from shield.certificate.road.verify import Binding, Clearance, PathVerifier, SceneBefore, footprint_of
from shield.config import ShieldConfig

__all__ = ["FailSafe", "Memory", "ObservedScene", "observe"]

S = TypeVar("S")
_FIRST = np.zeros(0, dtype=np.intp), np.zeros(0, dtype=bool), np.zeros(0, dtype=bool), np.zeros((0, 0), dtype=bool)
"""State of the lanes before the first scene."""


@dataclass(frozen=True, slots=True, eq=False)
class Memory(Generic[S]):
    """State that persists between the decisions of an episode. A new episode starts with a new one.

    Attributes
    ----------
    frame : index of the last simulation frame; None if it is not known.
    stored : the fail-safe verified last: the lane that it stops in, the wheel angle that it holds [rad], or its
        remaining actions. None if there is none.
    verifier : judge of plans in the last scene. It holds the state of the lanes: those that the ego owns, for how many
        frames it has been visible in each, and the vehicles that may enter each.
    watch : state of the monitor.
    plan : last plan of the predictive filter, inputs (N, 2), from which the next one starts.
    entered : lane that the stored fail-safe enters on the way, besides the ego's own and the last; None if there is
        none.
    """

    frame: int | None = None
    stored: S | None = None
    verifier: PathVerifier | None = None
    watch: RoadMonitor | ParkingMonitor = field(default_factory=RoadMonitor)
    plan: FloatArray | None = None
    entered: int | None = None


@dataclass(frozen=True, slots=True)
class FailSafe:
    """The stored fail-safe from now on: the lane that it stops in, its path (K, 4), its margin [m], and the binding
    clause."""

    lane: int
    path: FloatArray
    margin: float
    binding: Binding


@dataclass(frozen=True, eq=False)
class ObservedScene:
    """One scene as observed with a memory: the input of each stage of a decision pipeline.

    Attributes
    ----------
    scene, config : the scene, and the shield's settings.
    memory : after the observation.
    rollouts : of the ego.
    verifier : judges plans in this scene.
    """

    scene: Scene
    config: ShieldConfig
    memory: Memory[Any]
    rollouts: Rollouts
    verifier: PathVerifier

    @cached_property
    def lawful(self) -> PathVerifier:
        """Judges plans against the vehicles without a violation."""
        assert isinstance(self.memory.watch, RoadMonitor)
        return self.verifier.without(self.memory.watch.offenders)

    def with_shrunk_bounds(self, share: float) -> PathVerifier:
        """Judges plans in the scene with shrunk bounds on the other vehicles: `share` of their width, see
        `Scene.with_shrunk_bounds`."""
        assert isinstance(self.memory.watch, RoadMonitor)
        scene, last, watch, lane = (
            self.scene.with_shrunk_bounds(share),
            self.verifier,
            self.memory.watch,
            self.memory.stored,
        )
        stored = lane if isinstance(lane, int) else None
        return PathVerifier(
            scene,
            self.config,
            last.visible,
            last.owned,
            None,
            None,
            SceneBefore(watch.obliged, last.comes, stored, self.memory.entered),
        )

    @cached_property
    def here(self) -> int:
        """The lane that the ego's centre is in."""
        return int(self.scene.road.lane_at(float(self.scene.ego_road[RoadState.R])))

    def judge(self, candidates: Manoeuvres, hold: int = 0) -> tuple[FloatArray, Clearance]:
        """Paths (n, K, 4) of the candidates, and the result for them; see `PathVerifier.clearance`."""
        paths = candidates.paths(self.rollouts, self.scene.ego_road)
        return paths, self.verifier.clearance(paths, candidates.lanes, candidates.fails, hold)

    def fail_safe(self, lawful: bool = False) -> FailSafe:
        """The stored fail-safe from now on, judged without precautions; if there is none, braking in the ego's own
        lane. With `lawful`, violators are left out."""
        lane = self.here if self.memory.stored is None else int(self.memory.stored)
        verifier = (self.lawful if lawful else self.verifier).without_cut_ins()
        path, result = _brake(self.scene, lane, self.config.braking, self.rollouts, verifier, self.memory.entered)
        return FailSafe(lane, path, float(result.margin[0]), result.binding(0))


def observe(
    memory: Memory[S],
    scene: Scene,
    config: ShieldConfig,
    frames: int = 1,
    fail_safe: Callable[[PathVerifier], FloatArray] | None = None,
) -> ObservedScene:
    """Observe a scene. If its frame has been observed already, the result is the same instant.

    Parameters
    ----------
    memory : of the scene before. scene : the scene. config : the shield's settings.
    frames : number of simulation frames between the two scenes.
    fail_safe : separation of the ego's fail-safe from the places that each vehicle can reach, (m,) [m]; by default that
        of braking in the stored lane.
    """
    rollouts = Rollouts(scene.dt, scene.road)
    if memory.verifier is not None and scene.frame is not None and scene.frame == memory.frame:
        return ObservedScene(scene, config, memory, rollouts, memory.verifier)
    watch = memory.watch if isinstance(memory.watch, RoadMonitor) else RoadMonitor()
    last, lane = memory.verifier, memory.stored if isinstance(memory.stored, int) else None
    same = None if last is None else _same(last.scene, scene)
    if last is not None and same is not None and scene.blurred and frames == 1:
        scene = shrink_bounds(last.scene, last.around, same, scene)
    ego = float(scene.ego_road[RoadState.S])
    before: OtherVehicles | VehicleTables | None = None
    if last is not None and not scene.blurred:
        before = last.around if same is None else _before(last.around, same, scene, config, ego)
    # Over more than one frame, the distance that each vehicle has lost by turning is not known.
    frame_before = before if frames == 1 else None
    around = OtherVehicles(scene.others, scene.others_road, scene.road, config.assumptions, scene.dt, frame_before, ego)
    watch = watch.of(same, len(scene.others))
    visible, owned, coming = _lanes(last, scene, config, frames, lane, watch.obliged, same)
    followers = None if last is None else watch.obliged
    earlier = SceneBefore(followers, coming, stored=lane, entered=memory.entered)
    verifier = PathVerifier(scene, config, visible, owned, around, None, earlier)

    def separations() -> FloatArray:
        if fail_safe is not None:
            return fail_safe(verifier)
        stop = lane if lane is not None else scene.road.lane_at(float(scene.ego_road[RoadState.R]))
        return verifier.of_each(_brake(scene, stop, config.braking, rollouts, verifier, memory.entered)[1])

    if scene.observed:
        before = None
    new = None if same is None else same < 0
    watch = watch.next(verifier, before, new, verifier.counted(_followers(last, same)), frames * scene.dt, separations)
    memory = Memory(scene.frame, memory.stored, verifier, watch, memory.plan, memory.entered)
    return ObservedScene(scene, config, memory, rollouts, verifier)


def _same(last: Scene, scene: Scene) -> IntArray | None:
    """Index of each vehicle in the last scene, (m,), -1 for new ones; None if the vehicles and their order are the
    same. Without ids, all vehicles count as new where their number has changed."""
    if scene.ids is None or last.ids is None:
        if scene.ids is last.ids and len(last.others) == len(scene.others):
            return None
        return np.full(len(scene.others), -1)
    if scene.ids is last.ids and not (scene.observed or scene.blurred):
        return None
    if not len(last.ids):
        return np.full(len(scene.others), -1)
    same = (scene.ids[:, None] == last.ids) & (scene.ids[:, None] >= 0)
    return np.where(same.any(axis=1), same.argmax(axis=1), -1)


def _followers(last: PathVerifier | None, same: IntArray | None) -> tuple[BoolArray, BoolArray] | None:
    """`PathVerifier.behind` and `PathVerifier.in_owned_lane` of the last scene, (m,) bool, in the order of this scene's
    vehicles."""
    if last is None or same is None:
        return None if last is None else (last.behind, last.in_owned_lane)
    flags, known = np.zeros((2, len(same)), dtype=bool), same >= 0
    flags[0, known], flags[1, known] = last.behind[same[known]], last.in_owned_lane[same[known]]
    return flags[0], flags[1]


def _before(last: OtherVehicles, same: IntArray, scene: Scene, config: ShieldConfig, ego: float) -> VehicleTables:
    """The other vehicles in the last scene. New vehicles are taken to have kept their speed, and lost no distance by
    turning."""
    fresh = OtherVehicles(scene.others, scene.others_road, scene.road, config.assumptions, scene.dt, None, ego)
    known = np.flatnonzero(same >= 0)
    rows, states, tables = scene.others.copy(), scene.others_road.copy(), fresh.tables
    way = states[:, RoadState.SPEED] * scene.dt
    states[:, RoadState.S] -= way * np.cos(states[:, RoadState.HEADING])
    states[:, RoadState.R] -= way * np.sin(states[:, RoadState.HEADING])
    rows[known], states[known] = last.others[same[known]], last.states[same[known]]
    then = same[known]
    tables.marks[:, known], tables.numbers[:, known] = last.tables.marks[:, then], last.tables.numbers[:, then]
    tables.brakes[known], tables.recent[known] = last.tables.brakes[then], last.tables.recent[then]
    return VehicleTables(rows, states, tables)


def _lanes(
    last: PathVerifier | None,
    scene: Scene,
    config: ShieldConfig,
    frames: int,
    stored: int | None,
    obliged: BoolArray,
    same: IntArray | None,
) -> Any:
    """Number of frames for which the ego has been visible in each lane; the lanes that it owns; and the vehicles that
    might enter each lane in the last scene. Every new vehicle might."""
    before: Any = _FIRST
    if last is not None and last.visible is not None and last.visible.shape == scene.road.centers.shape:
        comes = last.comes
        if same is not None:
            comes = np.ones((len(last.visible), len(same)), dtype=bool)
            comes[:, same >= 0] = last.comes[:, same[same >= 0]]
        before = last.visible, last.owned, obliged, comes
    visible, owned, obliged, comes = before
    r, psi, sight = scene.ego_road[RoadState.R], scene.ego_road[RoadState.HEADING], config.assumptions.visible_distance
    length, width = float(scene.ego[Vehicle.LENGTH]), float(scene.ego[Vehicle.WIDTH])
    half = 0.5 * (length * abs(math.sin(psi)) + width * abs(math.cos(psi)))
    half += footprint_of(length, width, config.buffer, scene.road.bends)[0].body_growth_across
    near = LaneDistances(sight, TOUCH + half, 0.5 * float(scene.road.width) + half)
    lanes, stop = LaneState(scene.road.centers, owned, visible), -1 if stored is None else stored
    return updated_lanes(float(r), frames, near, stop, lanes, obliged, comes)


def _brake(
    scene: Scene, lane: int, braking: float, rollouts: Rollouts, verifier: PathVerifier, entered: int | None
) -> tuple[FloatArray, Clearance]:
    """Braking to a stop in a lane from now on: its path (K, 4), and the result for it. `entered` is the lane that the
    plan entered on the way, None if there is none."""
    speed = float(scene.ego[State.SPEED]) - braking / KP_SPEED
    candidates = brake_candidates(scene, [lane], [speed], [lane], 1, braking)
    paths = candidates.paths(rollouts, scene.ego_road)
    lanes = candidates.lanes if entered is None else verifier.entered(paths, candidates.fails)[0]
    return paths[0], verifier.clearance(paths, lanes, candidates.fails)
