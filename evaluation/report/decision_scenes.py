"""Five small scenes and the shield's decisions in them: the data of the figures about the decision.

The certificate and the decision pipelines compute all values; `evaluation.report.figures` draws them.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from dynamics.roads.straight import StraightRoad
from dynamics.scenes.scene import EgoControl, Scene, Target
from dynamics.state import FloatArray, RoadState, Vehicle
from dynamics.traffic.occupancy import Occupancy, OtherVehicles
from shield.alternatives.nearest_input import JudgedInputs
from shield.certificate.road.manoeuvres import brake_candidates
from shield.certificate.road.memory import Memory, ObservedScene, observe
from shield.certificate.road.verify import PathVerifier
from shield.config import ShieldConfig
from shield.decision import Decision
from shield.pipelines.decide import decide
from shield.pipelines.inputs import InputPipeline

__all__ = [
    "CONFIG",
    "LENGTH",
    "WIDTH",
    "CutInScene",
    "InputSearch",
    "Obligation",
    "ObligationScene",
    "ReachableBounds",
    "ReachableTube",
    "bounds",
    "cut_in_scene",
    "extents",
    "input_search",
    "obligation_scene",
    "passing",
    "tube",
]

CONFIG = ShieldConfig()
"""The default settings."""
LENGTH, WIDTH = 5.0, 2.0
"""Length and width of every vehicle [m]."""
_DT, _FINE = 1 / 15, 1 / 60
"""Duration of a frame, and of a shorter one for smooth curves [s]."""

RoadRow = tuple[float, float, float, float]
"""A vehicle: x, y [m], heading [rad], speed [m/s]."""


def _scene(ego: RoadRow, *others: RoadRow, lanes: int, lane: int | None = None, dt: float = _DT) -> Scene:
    """Vehicles of 5 m x 2 m on a straight road; lane i is centred at y = 4 i."""
    road = StraightRoad.from_lanes(lanes)
    rows = np.array([[*row, LENGTH, WIDTH, 0.0] for row in others], dtype=float).reshape(-1, len(Vehicle))
    target = Target(road.lane_at(ego[1]) if lane is None else lane, ego[3])
    return Scene(np.array([*ego, LENGTH, WIDTH, 0.0]), rows, road, EgoControl(target), dt, round(1 / dt))


def _stop(now: ObservedScene, lane: int, speed: float) -> tuple[FloatArray, float, FloatArray, FloatArray]:
    """Plan of one frame towards a lane and a speed [m/s], then braking to a stop in that lane.

    Returns
    -------
    The path (K, 4), the margin [m], and the least separations from each vehicle (m,) and from each possible cut-in (q,)
    [m].
    """
    candidates = brake_candidates(now.scene, [lane], [speed], [lane], 1, now.config.braking)
    paths, result = now.judge(candidates)
    return paths[0], float(result.margin[0]), now.verifier.of_each(result), result.cutting_in[0]


def extents(states: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Half extents of the ego with its buffer along and across the road at road states (..., 4), [m]."""
    lon, lat = 0.5 * LENGTH + CONFIG.buffer.longitudinal, 0.5 * WIDTH + CONFIG.buffer.lateral
    sin, cos = np.abs(np.sin(states[..., RoadState.HEADING])), np.abs(np.cos(states[..., RoadState.HEADING]))
    return lon * cos + lat * sin, lon * sin + lat * cos


@dataclass(frozen=True, slots=True, eq=False)
class ReachableTube:
    """Plan behind a slower vehicle: a proposal for one frame and its fail-safe.

    Attributes
    ----------
    scene : the ego and its leader.
    path : road states of the ego after frames 1..K, (K, 4).
    occupancy : reachable intervals of the leader in the same frames.
    front : foremost s of the ego with its buffer, (K,) [m].
    margin : margin of the plan [m].
    """

    scene: Scene
    path: FloatArray
    occupancy: Occupancy
    front: FloatArray
    margin: float

    @property
    def gaps(self) -> FloatArray:
        """Distance from the ego's buffer to the rear end of the leader's reachable interval, (K,) [m]."""
        found: FloatArray = self.occupancy.rear[0] - self.front
        return found


def tube() -> ReachableTube:
    """FASTER behind a slower vehicle, during a lane change."""
    scene = _scene((0.0, 5.3, -0.06, 25.0), (18.0, 4.0, 0.0, 20.0), lanes=3, lane=1)
    now = observe(Memory(), scene, CONFIG)
    path, margin, *_ = _stop(now, 1, 30.0)
    occupancy = now.verifier.around.occupancy(len(path))
    return ReachableTube(scene, path, occupancy, path[:, RoadState.S] + extents(path)[0], margin)


@dataclass(frozen=True, slots=True, eq=False)
class ReachableBounds:
    """Reachable intervals of vehicles, along and across the road.

    Attributes
    ----------
    speeds : speed of a vehicle without a leader, and of one behind a vehicle at rest, (2,) [m/s].
    moving, queueing : (rear, front) of these vehicles' bodies after 1..K frames, each (K,) [m].
    time : time of the frames, (K,) [s].
    stands : rear of the vehicle at rest [m].
    across : a road with a vehicle in the middle of its lane, one off the middle, and one across a marking.
    around : reachable intervals of these three.
    """

    speeds: tuple[float, float]
    moving: tuple[FloatArray, FloatArray]
    queueing: tuple[FloatArray, FloatArray]
    time: FloatArray
    stands: float
    across: Scene
    around: OtherVehicles


def bounds() -> ReachableBounds:
    """A vehicle at 20 m/s, one at 4 m/s that approaches a vehicle at rest, and three at different lateral positions."""
    frames = round(4.0 / _DT)

    def along(*rows: RoadRow) -> tuple[FloatArray, FloatArray]:
        scene = _scene((-100.0, 0.0, 0.0, 20.0), *rows, lanes=1)
        found = OtherVehicles(scene.others, scene.others_road, scene.road, CONFIG.assumptions, scene.dt)
        return found.rear(frames)[0], found.front(frames)[0]

    stands = (9.0, 0.0, 0.0, 0.0)
    across = _scene(
        (-100.0, 0.0, 0.0, 20.0), (6.0, 0.0, 0.0, 20.0), (15.0, 4.7, 0.0, 20.0), (24.0, 10.1, 0.0, 20.0), lanes=4
    )
    around = OtherVehicles(across.others, across.others_road, across.road, CONFIG.assumptions, across.dt)
    time: FloatArray = _DT * np.arange(1, frames + 1, dtype=np.float64)
    rear = stands[0] - 0.5 * LENGTH
    speeds = 20.0, 4.0
    moving, queueing = along((0.0, 0.0, 0.0, speeds[0])), along((0.0, 0.0, 0.0, speeds[1]), stands)
    return ReachableBounds(speeds, moving, queueing, time, rear, across, around)


class Obligation(Enum):
    """Right-of-way obligation of a vehicle towards an ego that is about to enter a lane."""

    DISTANCE = "behind, in a lane that the ego owns: owes it its distance"
    NOT_YET = "behind, in the lane that the ego enters: owes nothing yet"
    ENTERS = "may enter that lane too"
    NOTHING = "ahead or alongside: owes nothing"


@dataclass(frozen=True, slots=True, eq=False)
class ObligationScene:
    """A lane change, and the obligation of each other vehicle.

    Attributes
    ----------
    scene : the scene.
    goal : the lane that the ego enters.
    path : road states of the ego after frames 1..K, (K, 4).
    obligations : obligation of each vehicle, (m,).
    separations : separation of the plan from each vehicle, (m,) [m]; +inf for one that must keep its distance.
    margin : margin of the plan [m].
    verifier : the surveyor that computed these values.
    """

    scene: Scene
    goal: int
    path: FloatArray
    obligations: tuple[Obligation, ...]
    separations: FloatArray
    margin: float
    verifier: PathVerifier


def obligation_scene() -> ObligationScene:
    """The ego changes from lane 1 to lane 2 of four."""
    # A vehicle beside one in the ego's target lane has no incentive to change into that lane too.
    behind, leader, alongside = (-47.0, 4.0, 0.0, 27.0), (42.0, 4.0, 0.0, 22.0), (3.0, 0.0, 0.0, 25.0)
    entered, ahead = (-44.0, 8.0, 0.0, 24.0), (55.0, 8.0, 0.0, 20.0)
    held_up, slow = (10.0, 12.0, 0.0, 24.0), (32.0, 12.0, 0.0, 16.0)
    others = (behind, leader, alongside, entered, ahead, held_up, slow)
    scene = _scene((0.0, 4.0, 0.0, 25.0), *others, lanes=4)
    goal = 2
    now = observe(Memory(), scene, CONFIG)
    path, margin, separations, _ = _stop(now, goal, 25.0)
    seen, center = now.verifier.others, scene.road.centers[goal]
    there = (seen.low < center) & (seen.high > center)
    obligations = []
    for j in range(len(others)):
        if seen.behind[j] and seen.in_owned_lane[j]:
            obligations.append(Obligation.DISTANCE)
        elif seen.behind[j] and there[j]:
            obligations.append(Obligation.NOT_YET)
        else:
            obligations.append(Obligation.ENTERS if seen.comes[goal, j] else Obligation.NOTHING)
    return ObligationScene(scene, goal, path, tuple(obligations), separations, margin, now.verifier)


@dataclass(frozen=True, slots=True, eq=False)
class CutInScene:
    """An ego that passes a slower vehicle which its leader obstructs, so that it may cut in.

    Attributes
    ----------
    ahead : positions of the ego's centre relative to the slower vehicle's, (n,) [m].
    offsets : lateral offsets of the ego from the centre line of its lane, (2,) [m].
    separations : separations of the cut-in clause, (2, n) [m]; +inf where no vehicle may cut in.
    at : index of the position with the greatest difference between the two offsets.
    shown : the scene there, with the second offset.
    """

    ahead: FloatArray
    offsets: tuple[float, float]
    separations: FloatArray
    at: int
    shown: Scene


def passing(ahead: float, offset: float) -> Scene:
    """The ego in lane 0, `offset` [m] off its centre line and `ahead` [m] of a slower vehicle in lane 1."""
    return _scene((ahead, offset, 0.0, 30.0), (0.0, 4.0, 0.0, 18.0), (24.0, 4.0, 0.0, 17.0), lanes=2, dt=_FINE)


def cut_in_scene(step: float = 0.25) -> CutInScene:
    """Separations of the cut-in clause at positions `step` [m] apart."""
    ahead, offsets = np.arange(-4.0, 10.0 + step, step), (0.0, 0.7)
    separations = np.full((2, ahead.size), np.inf)
    for i, offset in enumerate(offsets):
        for k, x in enumerate(ahead):
            *_, slipping = _stop(observe(Memory(), passing(float(x), offset), CONFIG), 0, 30.0)
            separations[i, k] = slipping.min(initial=np.inf)
    known = np.where(np.isfinite(separations).all(axis=0), separations, 0.0)
    at = int((known[0] - known[1]).argmax())
    return CutInScene(ahead, offsets, separations, at, passing(float(ahead[at]), offsets[1]))


@dataclass(frozen=True, slots=True, eq=False)
class InputSearch:
    """A search for the nearest input that verifies.

    Attributes
    ----------
    scene : the scene.
    proposal : the proposed input (2,) [m/s^2, rad].
    decision : the decision.
    linearised : inputs that were verified to linearise the certificate, (n, 2).
    strewn : all other inputs that were verified, (n, 2).
    accelerations, wheels : axes of a grid [m/s^2], [rad].
    margins : margins over the grid, (accelerations, wheels) [m].
    """

    scene: Scene
    proposal: FloatArray
    decision: Decision
    linearised: FloatArray
    strewn: FloatArray
    accelerations: FloatArray
    wheels: FloatArray
    margins: FloatArray


class _RecordingInputs(InputPipeline):
    """Pipeline of inputs that records the inputs it verifies."""

    def __init__(self) -> None:
        super().__init__(CONFIG, predictive=False)
        self.linearised: list[FloatArray] = []
        self.strewn: list[FloatArray] = []

    def judge(
        self,
        now: ObservedScene,
        inputs: FloatArray,
        stops: list[int],
        parts: bool = False,
        verifier: PathVerifier | None = None,
    ) -> JudgedInputs:
        """Record the inputs, and verify them."""
        (self.linearised if parts else self.strewn).append(inputs)
        return super().judge(now, inputs, stops, parts, verifier)


def input_search(points: tuple[int, int] = (201, 301)) -> InputSearch:
    """Throttle behind one leader and beside another vehicle; the grid has `points` accelerations and wheel angles."""
    scene = _scene((0.0, 3.0, 0.0, 21.5), (9.5, 4.0, 0.0, 17.5), (8.0, 0.0, 0.0, 19.0), lanes=3)
    proposal, noted, plain = np.array([4.0, 0.01]), _RecordingInputs(), InputPipeline(CONFIG, predictive=False)
    decision, _ = decide(Memory(), scene, proposal, noted)
    now, _ = plain.observe(Memory(), scene)
    (_, gas), (left, right) = plain.actuators.acceleration, plain.actuators.steering
    accelerations, wheels = np.linspace(-CONFIG.braking, gas, points[0]), np.linspace(left, right, points[1])
    grid = np.stack(np.meshgrid(accelerations, wheels, indexing="ij"), axis=-1).reshape(-1, 2)
    margins = plain.judge(now, grid, plain.stop_lanes(now)).margin.reshape(accelerations.size, wheels.size)
    judged = np.concatenate(noted.linearised), np.concatenate(noted.strewn)
    return InputSearch(scene, proposal, decision, *judged, accelerations, wheels, margins)
