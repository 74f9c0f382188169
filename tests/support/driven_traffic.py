"""Real highway-env episodes in which the others are driven by us, and what truly happened at every frame of them.

It shares nothing with the verification: the simulator moves everything, and clearance is that of the true rotated
rectangles, by separating axes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
from highway_env.vehicle import behavior, objects
from highway_env.vehicle.kinematics import Vehicle

from shield import Decision, ShieldConfig, ShieldedEnv, Tier

__all__ = ["Body", "Car", "Controller", "Moment", "Outcome", "Policy", "Scenario", "Setting", "drive", "overlap"]

LANE = 4.0
"""Width of a lane of highway-v0 [m]."""

TOUCH = 1e-6
"""Overlap from which on a breach counts [m]."""

BRAKES, REACTION = 6.0, 0.4
"""What is granted to a follower at the start [m/s^2, s]."""

UNCERTIFIED = (Tier.LARGEST_MARGIN, Tier.EMERGENCY)

Controller = Callable[["Moment"], tuple[float, float]]
"""What drives a car: acceleration [m/s^2] and front wheel angle [rad], at each frame."""

Policy = Callable[["Moment", np.random.Generator], Any]
"""What proposes the ego's action; `own` is the ego."""


@dataclass(frozen=True)
class Body:
    """Where a rectangle is and how fast it moves along its heading."""

    s: float
    r: float
    heading: float
    speed: float
    length: float = 5.0
    width: float = 2.0

    def corners(self, along: float = 0.0, across: float = 0.0) -> np.ndarray:
        """Its corners, grown at each end and at each side (4, 2)."""
        half = [0.5 * self.length + along, 0.5 * self.width + across]
        local = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * half
        c, d = np.cos(self.heading), np.sin(self.heading)
        return local @ np.array([[c, d], [-d, c]]) + [self.s, self.r]


@dataclass(frozen=True)
class Moment:
    """What a driver sees at a frame: itself, the ego with the inputs it is about to apply, and everybody in order."""

    time: float
    dt: float
    lanes: int
    own: Body
    ego: Body
    others: tuple[Body, ...]
    ego_input: tuple[float, float] = (0.0, 0.0)
    goal: float = 0.0

    @property
    def ds(self) -> float:
        """How far the own centre is ahead of the ego's [m]."""
        return self.own.s - self.ego.s


@dataclass
class Car:
    """One other vehicle: where it starts relative to the ego's start, and who drives it.

    `kind` is "driven" (by `controller`), a class of `highway_env.vehicle.behavior` or of `.objects`.
    """

    ds: float
    r: float
    speed: float
    controller: Controller | None = None
    heading: float = 0.0
    length: float = 5.0
    width: float = 2.0
    kind: str = "driven"
    target_speed: float | None = None


@dataclass
class Scenario:
    """A start and a cast."""

    cars: list[Car]
    policy: str
    lanes: int = 3
    ego_r: float = 4.0
    ego_speed: float = 25.0
    ego_heading: float = 0.0
    goal: float | None = None
    target_speeds: tuple[float, ...] | None = None


@dataclass(frozen=True)
class Setting:
    """Which environment it runs in."""

    action: str = "meta"
    hz: int = 15
    seconds: float = 6.0

    @property
    def period(self) -> int:
        """Decisions per second."""
        return 1 if self.action == "meta" else 5

    def __str__(self) -> str:
        return f"{self.action}@{self.hz}Hz"


@dataclass
class Outcome:
    """What happened in one run, as far as the first breach.

    Attributes
    ----------
    clearance : least separation of the inflated ego from anybody [m]; negative is the depth of a breach.
    breach_frame, breach_vehicle : the first breach; -1 where there was none.
    crashed : whether highway-env counts a collision of the ego.
    violations_before : of the assumptions, counted in the frames up to the breach.
    violations_at : counted when the shield sees the breach itself; that somebody crashed into the ego is withheld.
    started : whether the start was clear and the first decisions were verified.
    tiers : how many frames each tier acted.
    tier : the tier of the frame that ended in the breach.
    uncertified_frame : the first that acted without a certificate; -1 where there was none.
    """

    clearance: float = float("inf")
    breach_frame: int = -1
    breach_vehicle: int = -1
    crashed: bool = False
    violations_before: int = 0
    violations_at: int = 0
    started: bool = True
    frames: int = 0
    tiers: Counter[str] = field(default_factory=Counter)
    tier: str = ""
    uncertified_frame: int = -1

    @property
    def breached(self) -> bool:
        return self.breach_frame >= 0

    @property
    def flagged(self) -> bool:
        return self.violations_before + self.violations_at > 0

    @property
    def clean_breach(self) -> bool:
        """A breach that nobody has been blamed for, from a start that was verified."""
        return self.started and self.breached and not self.flagged

    @property
    def clean_loss(self) -> bool:
        """A certificate that was lost and nobody blamed for it, whether or not it came to a breach."""
        return self.started and self.uncertified_frame >= 0 and not self.flagged


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    """Signed gap of two rectangles along the best separating axis [m]; negative where they overlap."""
    edges = np.concatenate([a[1:3] - a[:2], b[1:3] - b[:2]])
    normals = np.stack([edges[:, 1], -edges[:, 0]], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    pa, pb = a @ normals.T, b @ normals.T
    return float(np.maximum(pb.min(axis=0) - pa.max(axis=0), pa.min(axis=0) - pb.max(axis=0)).max())


def body_of(thing: Any) -> Body:
    """The true state of one of highway-env's objects."""
    s, r = thing.position
    return Body(float(s), float(r), float(thing.heading), float(thing.speed), thing.LENGTH, thing.WIDTH)


class DrivenVehicle(Vehicle):
    """A vehicle of any size that does what its controller says."""

    def __init__(self, road: Any, start: Car, s: float, stage: _Stage) -> None:
        super().__init__(road, [s, start.r], start.heading, start.speed)
        self.LENGTH, self.WIDTH = start.length, start.width
        self.diagonal = float(np.hypot(self.LENGTH, self.WIDTH))
        self._controller, self._stage = start.controller, stage

    def act(self, action: Any = None) -> None:
        if self._controller is None:
            super().act({"acceleration": 0.0, "steering": 0.0})
            return
        acceleration, steering = self._controller(self._stage.moment(self))
        wheel = float(np.clip(steering, -np.pi / 3, np.pi / 3))
        super().act({"acceleration": float(np.clip(acceleration, -12.0, 12.0)), "steering": wheel})


class _Stage:
    """Puts the cast onto the road, and watches every simulation frame of it."""

    def __init__(self, base: Any, scenario: Scenario, buffer: tuple[float, float]) -> None:
        self._base, self._scenario, self._buffer = base, scenario, buffer
        self.outcome = Outcome()
        self.ended = False
        self._look = False

    def populate(self) -> None:
        """In place of `HighwayEnv._create_vehicles`."""
        base, plan = self._base, self._scenario
        road, s0 = base.road, 400.0
        ego = base.action_type.vehicle_class(road, [s0, plan.ego_r], plan.ego_heading, plan.ego_speed)
        base.controlled_vehicles = [ego]
        road.vehicles = [ego]
        for car in plan.cars:
            place, s = [s0 + car.ds, car.r], s0 + car.ds
            if car.kind == "driven":
                road.vehicles.append(DrivenVehicle(road, car, s, self))
            elif car.kind in ("Obstacle", "Landmark"):
                road.objects.append(getattr(objects, car.kind)(road, place, car.heading))
            else:
                kind = getattr(behavior, car.kind)
                road.vehicles.append(kind(road, place, car.heading, car.speed, target_speed=car.target_speed))
                road.vehicles[-1].randomize_behavior()
        if "fast" in base.spec.id:
            for vehicle in road.vehicles[1:]:
                vehicle.check_collisions = False
        self._act, self._step = road.act, road.step
        road.act, road.step = self._on_act, self._on_step
        self.outcome.started = self._clearance()[0] > TOUCH and not any(map(self._doomed, road.vehicles[1:]))

    def moment(self, own: Any) -> Moment:
        base = self._base
        ego, others = body_of(base.vehicle), tuple(body_of(v) for v in base.road.vehicles[1:])
        action, dt = base.vehicle.action, 1.0 / base.config["simulation_frequency"]
        inputs = (float(action["acceleration"]), float(action["steering"]))
        goal = self._scenario.ego_r if self._scenario.goal is None else self._scenario.goal
        return Moment(self.outcome.frames * dt, dt, base.config["lanes_count"], body_of(own), ego, others, inputs, goal)

    def _doomed(self, thing: Any) -> bool:
        """Whether a follower starts so near and fast that its brakes could not keep it from a steady ego."""
        ego, other = body_of(self._base.vehicle), body_of(thing)
        if other.s > ego.s or abs(other.r - ego.r) > 0.5 * (ego.width + other.width) + self._buffer[1] + 0.2:
            return False
        gap = ego.s - other.s - 0.5 * (ego.length + other.length) - self._buffer[0]
        closing = max(other.speed - ego.speed, 0.0)
        return gap < closing**2 / (2 * BRAKES) + closing * REACTION

    def look(self) -> None:
        """Let the shield see the scene once more, without anything moving."""
        self._look = True

    def _on_act(self) -> None:
        if not self.ended or self._look:
            self._look = False
            self._act()

    def _on_step(self, dt: float) -> None:
        if self.ended:
            return
        others = (*self._base.road.vehicles[1:], *self._base.road.objects)
        struck = {id(thing) for thing in others if thing.crashed or thing.impact is not None}
        self._step(dt)
        out = self.outcome
        out.frames += 1
        clearance, who = self._clearance()
        out.clearance = min(out.clearance, clearance)
        ego = self._base.vehicle
        # An impact is a collision that highway-env has counted for the coming frame.
        out.crashed = bool(ego.crashed) or ego.impact is not None
        if clearance < -TOUCH or out.crashed:
            out.breach_frame, out.breach_vehicle, self.ended = out.frames, who, True
            # What tells of the breach itself is withheld from the shield; collisions among the others are not.
            mine = body_of(ego).corners()
            for thing in others:
                if id(thing) not in struck and (ego.impact is not None or overlap(mine, body_of(thing).corners()) <= 0):
                    thing.crashed = False
            ego.crashed, ego.impact = False, None

    def _clearance(self) -> tuple[float, int]:
        road = self._base.road
        ego = body_of(road.vehicles[0])
        mine = ego.corners(*self._buffer)
        best, who = np.inf, -1
        solid = [o for o in road.objects if o.solid]
        for i, thing in enumerate((*road.vehicles[1:], *solid)):
            other = body_of(thing)
            if np.hypot(other.s - ego.s, other.r - ego.r) < 40.0:
                gap = overlap(mine, other.corners())
                if gap < best:
                    best, who = gap, i
        return float(best), who


def make_env(scenario: Scenario, setting: Setting) -> gym.Env[Any, Any]:
    """The environment with the scenario's road; the cast comes at `reset`."""
    action: dict[str, Any] = {"type": "ContinuousAction"}
    if setting.action == "meta":
        action = {"type": "DiscreteMetaAction"}
        if scenario.target_speeds is not None:
            action["target_speeds"] = list(scenario.target_speeds)
    config = {
        "action": action,
        "simulation_frequency": setting.hz,
        "policy_frequency": setting.period,
        "lanes_count": scenario.lanes,
        "duration": 1e3,
    }
    name = "highway-fast-v0" if setting.hz == 5 else "highway-v0"
    return gym.make(name, config=config, disable_env_checker=True)


def drive(
    scenario: Scenario, setting: Setting, policy: Policy, seed: int = 0, config: ShieldConfig | None = None
) -> Outcome:
    """Run the scenario behind `ShieldedEnv` until the first breach, the first violation or the end."""
    config = config or ShieldConfig()
    env = ShieldedEnv(make_env(scenario, setting), config=config)
    base: Any = env.unwrapped
    stage = _Stage(base, scenario, (config.buffer.longitudinal, config.buffer.lateral))
    base._create_vehicles = stage.populate
    env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    out = stage.outcome
    try:
        for step in range(round(setting.seconds * setting.period)):
            if not out.started:
                break
            before = out.frames
            *_, info = env.step(policy(stage.moment(base.vehicle), rng))
            decisions = env.frame_decisions
            _note(out, decisions, before)
            if step == 0 and not (env.decisions[0].tier.verified and decisions[0].tier.verified):
                out.started = False
            out.violations_before += info["shield"]["violations"]
            if out.breached and not out.flagged:
                stage.look()
                *_, info = env.step(policy(stage.moment(base.vehicle), rng))
                out.violations_at = info["shield"]["violations"]
            if out.breached or out.flagged:
                break
    finally:
        env.close()
    return out


def _note(out: Outcome, decisions: Sequence[Decision], before: int) -> None:
    for frame, decision in enumerate(decisions):
        out.tiers[decision.tier.value] += 1
        if decision.tier in UNCERTIFIED and out.uncertified_frame < 0:
            out.uncertified_frame = before + frame
    if out.breached and decisions:
        out.tier = decisions[-1].tier.value
