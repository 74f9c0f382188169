"""The adversarial world with raw inputs: the ego may straddle a marking for as long as it likes.

Who owes what (the head of `shield.certificate.road.verify`, and `Assumptions`)
--------------------------------------------------------------
A vehicle behind in a lane that the ego *owns* keeps its distance. The ego owns the lane that it starts in, and one
that it enters once a plan to stop there has been verified, until its body no longer reaches where vehicles in the
middle of that lane drive. A vehicle behind in any other lane owes nothing to an ego that leans over the marking until
the ego has been visible in that lane for the reaction time. Nobody gives way to an intention: highway-env's traffic
looks at the targets of `ControlledVehicle`s only, which an ego with `ContinuousAction` is not.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from adversarial_world import LENGTH, WIDTH, Car, World, corners
from cores import ContinuousCore

from dynamics.scenes.scene import Target
from dynamics.vehicle.actuators import Actuators
from dynamics.vehicle.bicycle import step
from shield import ShieldConfig

__all__ = ["STYLES", "Adversary", "ContinuousWorld", "propose", "random_continuous_world"]

STYLES = ("random", "throttle", "left", "weave", "nearest")
FRAMES = (1 / 20, 0.1, 1 / 15)


@dataclass
class ContinuousWorld(World):
    """Ego with throttle and steering under `ContinuousCore`, among cars that keep to the assumptions."""

    predictive: bool = False
    core: ContinuousCore = field(init=False)
    owned: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.core = ContinuousCore(self.config, Actuators(), predictive=self.predictive)
        self.owned = np.arange(self.lanes) == self.road.lane_at(self.ego[1])

    def move_inputs(self, inputs: np.ndarray) -> None:
        """One frame of the ego, by the numpy bicycle."""
        self.ego = step(self.ego, inputs[0], inputs[1], self.dt)

    def body(self, buffered: bool = False) -> np.ndarray:
        """Corners of the ego (4, 2) in the road frame [m]."""
        b = self.config.buffer
        more = (2 * b.longitudinal, 2 * b.lateral) if buffered else (0.0, 0.0)
        return corners(*self.ego[:3], LENGTH + more[0], WIDTH + more[1])

    def off_road(self) -> float:
        """How far the ego's body reaches beyond the road's edges [m]; negative on the road."""
        r, half = self.body()[:, 1], 0.5 * self.road.width
        return float(max(self.road.centers[0] - half - r.min(), r.max() - self.road.centers[-1] - half))

    # -- duties --------------------------------------------------------------------------------------------

    def claim(self, stored: int | None) -> None:
        """Take in the lane that the last verified plan stops in."""
        r = self.body()[:, 1]
        reached = (r.min() < self.road.centers + 1.0) & (r.max() > self.road.centers - 1.0)
        if stored is not None:
            self.owned = self.owned | (np.arange(self.lanes) == stored)
        self.owned = self.owned & reached

    def owes(self, car: Car) -> bool:
        """Whether a car behind drives, or is on its way to, where it owes the ego its distance."""
        center = self.road.centers[car.lane]
        swing = 0.5 * WIDTH + 0.5 * LENGTH * abs(np.sin(car.heading))
        low, high = min(car.r, center) - swing, max(car.r, center) + swing
        in_owned = self.owned & (low < self.road.centers + 1.0) & (high > self.road.centers - 1.0)
        return bool(in_owned.any())

    def coming(self, car: Car, lane: int) -> bool:
        return False


def random_continuous_world(
    rng: np.random.Generator, config: ShieldConfig | None = None, predictive: bool = False, cars: int | None = None
) -> ContinuousWorld:
    """The ego anywhere near the middle of a lane, at any speed, and cars around it that do not overlap."""
    config = config if config is not None else ShieldConfig()
    lanes = int(rng.integers(1, 5))
    lane = int(rng.integers(lanes))
    dt = float(rng.choice(FRAMES))
    ego = np.array([0.0, 4.0 * lane + rng.uniform(-0.6, 0.6), rng.uniform(-0.05, 0.05), rng.uniform(0, 35)])
    placed: list[Car] = []
    for _ in range(int(rng.integers(1, 9)) if cars is None else cars):
        car_lane, s = int(rng.integers(lanes)), float(rng.uniform(-60, 100))
        near = [c for c in placed if c.lane == car_lane and abs(c.s - s) < 9]
        if near or (car_lane == lane and abs(s) < 8):
            continue
        speed = float(rng.uniform(5, 35)) if rng.random() < 0.5 else float(np.clip(ego[3] + rng.normal(0, 4), 0, 35))
        placed.append(Car(s, 4.0 * car_lane + float(rng.uniform(-0.35, 0.35)), speed, car_lane))
    world = ContinuousWorld(config, lanes, ego, Target(lane, 25.0), placed, dt, 1, predictive=predictive)
    world.claim(lane)
    # A follower too close for its speed is not one that has kept to its duty so far.
    world.cars = [
        c
        for c in placed
        if not (world.behind(c) and world.owes(c)) or world.keeps_distance(c, world.assumptions.acceleration)
    ]
    return world


def propose(rng: np.random.Generator, style: str, world: ContinuousWorld, frame: int) -> np.ndarray:
    """The proposal of a reckless driver: (acceleration [m/s^2], front wheel angle [rad]) inside the actuators' box."""
    wheel = np.pi / 4
    if style == "random":
        return np.array([rng.uniform(-5, 5), rng.uniform(-wheel, wheel)])
    if style == "throttle":
        return np.array([5.0, 0.0])
    if style == "left":
        return np.array([5.0, -wheel])
    if style == "weave":
        return np.array([rng.uniform(-2, 5), 0.15 * np.sin(0.25 * frame) + rng.normal(0, 0.02)])
    ahead = [c for c in world.cars if abs(c.s - world.ego[0]) < 40]
    if not ahead:
        return np.array([5.0, rng.uniform(-0.05, 0.05)])
    car = min(ahead, key=lambda c: np.hypot(c.s - world.ego[0], c.r - world.ego[1]))
    bearing = np.arctan2(car.r - world.ego[1], max(car.s - world.ego[0], 1.0)) - world.ego[2]
    return np.array([float(np.clip(car.s - world.ego[0], -5, 5)), float(np.clip(bearing, -wheel, wheel))])


class Adversary:
    """Traffic that wishes the ego ill; `World.move_cars` cuts its wishes down to the assumptions."""

    moods = ("brake", "random", "squeeze", "swarm", "push", "wall")

    def __init__(self, rng: np.random.Generator, mood: str | None = None) -> None:
        self.rng = rng
        self.mood = str(rng.choice(self.moods)) if mood is None else mood

    def wishes(self, world: ContinuousWorld) -> list[tuple[float, int]]:
        return [self._wish(world, car) for car in world.cars]

    def _wish(self, world: ContinuousWorld, car: Car) -> tuple[float, int]:
        rng, gap = self.rng, car.s - world.ego[0]
        toward = int(np.sign(world.ego[1] - car.r)) if abs(world.ego[1] - car.r) > 2 else 0
        if self.mood == "brake":
            return (-9.0 if gap > 0 else 9.0), 0
        if self.mood == "random":
            return float(rng.uniform(-9, 9)), int(rng.integers(-1, 2))
        if self.mood == "squeeze":
            flip = rng.random() < 0.1
            return (9.0 if flip or gap < 0 else -9.0), toward if rng.random() < 0.3 else 0
        if self.mood == "push":
            return 9.0, 0
        if self.mood == "wall":
            # Beside the ego, always: whoever wants to change lanes finds somebody there.
            return float(np.clip(2.0 * (world.ego[3] - car.speed) - gap, -9, 9)), 0
        return (9.0 if gap < -8 else -9.0 if gap > 8 else float(rng.uniform(-9, 9))), toward
