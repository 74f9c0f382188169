"""A small world in which the others may do anything within the assumptions, for property tests.

It shares no code with the verification: footprints are rotated rectangles compared by separating axes, the ego
moves by the numpy bicycle and controllers (checked against highway-env elsewhere), and the traffic by its own rules.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from cores import ShieldCore

from dynamics.roads.straight import StraightRoad
from dynamics.scenes.scene import EgoControl, Scene, Target
from dynamics.vehicle.bicycle import step
from dynamics.vehicle.controllers import speed_control, steering_control
from shield import Assumptions, ShieldConfig
from shield.pipelines.frames import FrameCommand

LENGTH, WIDTH = 5.0, 2.0


def corners(s: float, r: float, heading: float, length: float, width: float) -> np.ndarray:
    """Corners of a rotated rectangle (4, 2)."""
    local = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * [length / 2, width / 2]
    c, d = np.cos(heading), np.sin(heading)
    return local @ np.array([[c, d], [-d, c]]) + [s, r]


def separation(a: np.ndarray, b: np.ndarray) -> float:
    """Signed gap of two convex polygons along the best separating axis [m]; negative when they overlap."""
    best = -np.inf
    for polygon in (a, b):
        edges = np.roll(polygon, -1, axis=0) - polygon
        for normal in np.stack([edges[:, 1], -edges[:, 0]], axis=1):
            axis = normal / np.linalg.norm(normal)
            pa, pb = a @ axis, b @ axis
            best = max(best, float(pb.min() - pa.max()), float(pa.min() - pb.max()))
    return best


@dataclass
class Car:
    """Another vehicle: road state, the lane that it heads for, and what it wants to do."""

    s: float
    r: float
    speed: float
    lane: int
    heading: float = 0.0

    def row(self) -> list[float]:
        return [self.s, self.r, self.heading, self.speed, LENGTH, WIDTH, 0.0]


@dataclass
class World:
    """Ego under the shield's core among cars that keep to the assumptions."""

    config: ShieldConfig
    lanes: int
    ego: np.ndarray
    target: Target
    cars: list[Car]
    dt: float = 0.2
    period: int = 5
    speeds: tuple[float, ...] = (20.0, 25.0, 30.0)
    frame: int = 0
    road: StraightRoad = field(init=False)
    core: ShieldCore = field(init=False)
    visible: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.road = StraightRoad.from_lanes(self.lanes)
        self.visible = np.zeros(self.lanes, dtype=int)
        self.core = ShieldCore(self.config)

    @property
    def assumptions(self) -> Assumptions:
        return self.config.assumptions

    def scene(self) -> Scene:
        rows = np.array([c.row() for c in self.cars], dtype=float).reshape(-1, 7)
        ego = np.array([*self.ego, LENGTH, WIDTH, 0.0])
        control = EgoControl(self.target, self.speeds)
        return Scene(ego, rows, self.road, control, self.dt, self.period, self.frame)

    def buffer_gap(self) -> float:
        """Least separation of the inflated ego from any car [m]; below zero the buffer is violated."""
        b = self.config.buffer
        mine = corners(*self.ego[:3], LENGTH + 2 * b.longitudinal, WIDTH + 2 * b.lateral)
        gaps = [separation(mine, corners(c.s, c.r, c.heading, LENGTH, WIDTH)) for c in self.cars]
        return min(gaps, default=np.inf)

    def kept(self) -> bool:
        """The theorem: the ego keeps its buffer, or the monitor has counted a violation."""
        return self.buffer_gap() >= -1e-6 or self.core.violations > 0

    def move_ego(self, command: FrameCommand | None) -> None:
        """One frame of the ego: its own controllers, or the command of the core."""
        if command is None:
            lane = self.target.lane
            a = float(speed_control(self.ego[3], self.target.speed))
        else:
            lane, a = command.lane, max(command.acceleration, -max(self.ego[3], 0.0) / self.dt)
            self.target = Target(lane, self.target.speed)
        wheel = None if command is None else command.steering
        if wheel is None:
            wheel = float(steering_control(self.ego, self.road.centers[lane]))
        self.ego = step(self.ego, a, wheel, self.dt)

    # -- the traffic ---------------------------------------------------------------------------------------

    def in_way(self, car: Car) -> bool:
        """Whether a car's body, or its way to its lane, overlaps the ego's body sideways."""
        b = self.config.buffer
        half = 0.5 * WIDTH + b.lateral + (0.5 * LENGTH + b.longitudinal) * abs(np.sin(self.ego[2]))
        center = self.road.centers[car.lane]
        swing = 0.5 * WIDTH + 0.5 * LENGTH * abs(np.sin(car.heading))
        low, high = min(car.r, center) - swing, max(car.r, center) + swing
        return bool(low < self.ego[1] + half and high > self.ego[1] - half)

    def behind(self, car: Car) -> bool:
        return car.s < self.ego[0] - 0.5 * LENGTH

    def keeps_distance(self, car: Car, acceleration: float) -> bool:
        """Whether a follower that accelerates so for one frame can still stop behind a braking ego."""
        dt, a = self.dt, self.assumptions
        reach = 0.5 * LENGTH + self.config.buffer.longitudinal + 0.3 * abs(np.sin(self.ego[2])) * LENGTH
        mine, other = self.ego[0] - reach, car.s + 0.5 * LENGTH + 0.5
        v, w = max(self.ego[3], 0.0), car.speed
        rate = acceleration
        for _ in range(int(12 / dt)):
            mine, other = mine + v * np.cos(self.ego[2]) * dt, other + w * dt
            v, w = max(v - self.config.braking * dt, 0.0), max(w + rate * dt, 0.0)
            rate = -a.follower_braking
            if other > mine:
                return False
            if v == 0 and w == 0:
                break
        return True

    def may_enter(self, car: Car, lane: int) -> bool:
        """Whether a lane change of `car` is allowed: out of the ego's way, or with the gap that RSS asks for."""
        half = 0.5 * WIDTH + 0.5 * LENGTH * abs(np.sin(self.ego[2])) + 1.0
        center = self.road.centers[lane]
        touches_ego = abs(self.ego[1] - center) < half + 0.5 * WIDTH + 0.9
        visible = abs(self.ego[1] - center) <= self.assumptions.visible_distance
        if not touches_ego and not visible:
            # Nobody sees the ego in that lane. If it is about to enter it, those behind give way all the same.
            behind = car.s <= self.ego[0] - 1.0
            return not self.coming(car, lane) or (self.assumptions.simultaneous_merge and not behind)
        if self.behind(car):
            return self.keeps_distance(car, self.assumptions.acceleration)
        v, top = max(self.ego[3], 0.0), max(self.ego[3], 0.0) + 5 * self.dt
        need = (v + top) * self.dt + top**2 / (2 * self.config.braking)
        free = car.s - self.ego[0] - LENGTH - self.config.buffer.longitudinal - 1.5
        lead = (0.93 * car.speed) ** 2 / (2 * self.assumptions.braking)
        return bool(free > 1.0 and free + lead > need)

    def owes(self, car: Car) -> bool:
        """Whether a car, where it is behind, owes the ego its distance as soon as it touches its way."""
        return self.in_way(car)

    def coming(self, car: Car, lane: int) -> bool:
        """Whether `car` knows that the ego is about to enter `lane`."""
        return self.target.lane == lane and abs(self.ego[1] - self.road.centers[lane]) > 0.5

    def move_cars(self, wishes: list[tuple[float, int]]) -> None:
        """One frame of the traffic; each wish is (acceleration, lane step), cut down to the assumptions."""
        a, moved = self.assumptions, []
        self.frame += 1
        near = np.abs(self.ego[1] - self.road.centers) <= a.visible_distance
        self.visible = np.where(near, self.visible + 1, 0)
        reaction = int(np.ceil(a.reaction_time / self.dt - 1e-9))
        for car, (wish, turn) in zip(self.cars, wishes, strict=True):
            centered = abs(car.r - self.road.centers[car.lane]) < 0.2 and abs(car.heading) < 0.02
            lane = car.lane + turn
            if turn and centered and car.speed > 15 and 0 <= lane < self.lanes and self.may_enter(car, lane):
                car.lane = lane
            rate = float(np.clip(wish, -a.braking, a.acceleration))
            reacts = self.visible[car.lane] > reaction
            if self.behind(car) and (self.owes(car) or reacts):
                rates = [r for r in (rate, 0.0, -1.0, -2.0, -4.0) if r <= rate and self.keeps_distance(car, r)]
                rate = rates[0] if rates else min(rate, -a.follower_braking)
            moved.append(rate)
        for car, rate in zip(self.cars, moved, strict=True):
            offset = car.r - self.road.centers[car.lane]
            bound = 0.3 if abs(offset) > 0.4 else 0.036
            sine = np.clip(-offset / 0.6 / max(car.speed, 1e-3), -np.sin(bound), np.sin(bound))
            car.heading = float(np.arcsin(sine))
            car.s += car.speed * np.cos(car.heading) * self.dt
            car.r += car.speed * np.sin(car.heading) * self.dt
            car.speed = float(np.clip(car.speed + rate * self.dt, 0.0, max(car.speed, a.max_speed)))


def random_world(rng: np.random.Generator, config: ShieldConfig | None = None, cars: int | None = None) -> World:
    """A world with the ego in the middle of a lane and cars around it, none of them overlapping another."""
    config = config if config is not None else ShieldConfig()
    lanes = int(rng.integers(2, 5))
    lane = int(rng.integers(lanes))
    dt, period = (0.2, 5) if rng.random() < 0.7 else (1 / 15, 15)
    ego = np.array([0.0, 4.0 * lane, 0.0, rng.uniform(15, 32)])
    target = Target(lane, float(rng.choice([20.0, 25.0, 30.0])))
    placed: list[Car] = []
    for _ in range(int(rng.integers(1, 8)) if cars is None else cars):
        car_lane = int(rng.integers(lanes))
        s = float(rng.uniform(-60, 120))
        near = [c for c in placed if c.lane == car_lane and abs(c.s - s) < 9]
        if near or (car_lane == lane and abs(s) < 12):
            continue
        placed.append(Car(s, 4.0 * car_lane, float(rng.uniform(12, 32)), car_lane))
    world = World(config, lanes, ego, target, placed, dt, period)
    # A follower too close for its speed is not one that has kept to its duty so far.
    world.cars = [
        c
        for c in placed
        if not (world.behind(c) and world.in_way(c)) or world.keeps_distance(c, world.assumptions.acceleration)
    ]
    return world
