"""Lots made up at random, and a car in them that moves as highway-env moves it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dynamics.scenes.parking_lot import ParkingScene
from dynamics.scenes.rectangles import gaps
from dynamics.vehicle.bicycle import step

__all__ = ["DT", "Driver", "advance", "clearance_of", "random_lot"]

DT = 1 / 15
WALLS = [
    [0.0, -21.0, 0.0, 0.0, 70.0, 1.0],
    [0.0, 21.0, 0.0, 0.0, 70.0, 1.0],
    [-35.0, 0.0, np.pi / 2, 0.0, 42.0, 1.0],
    [35.0, 0.0, np.pi / 2, 0.0, 42.0, 1.0],
]


def random_lot(rng: np.random.Generator, obstacles: int = 8, speed: float = 8.0) -> ParkingScene:
    """Walls as in parking-v0 and parked cars anywhere, at any angle; some of them may be on top of the ego."""
    cars = np.empty((obstacles, 6))
    cars[:, 0], cars[:, 1] = rng.uniform(-30, 30, obstacles), rng.uniform(-18, 18, obstacles)
    cars[:, 2], cars[:, 3] = rng.uniform(-np.pi, np.pi, obstacles), 0.0
    cars[:, 4], cars[:, 5] = rng.uniform(1, 6, obstacles), rng.uniform(1, 3, obstacles)
    x, y = rng.uniform(-25, 25), rng.uniform(-14, 14)
    ego = np.array([x, y, rng.uniform(-np.pi, np.pi), rng.uniform(-speed, speed), 5.0, 2.0])
    return ParkingScene(ego, np.vstack([WALLS, cars]), DT)


def advance(lot: ParkingScene, inputs: np.ndarray) -> ParkingScene:
    """The lot a frame later."""
    ego = lot.ego.copy()
    ego[:4] = step(ego[:4], float(inputs[0]), float(inputs[1]), lot.dt)
    return replace(lot, ego=ego)


def clearance_of(lot: ParkingScene) -> tuple[float, float]:
    """Least gap and least coming gap of the ego now [m]."""
    now, coming = gaps(lot.ego[:4], tuple(lot.ego[4:]), lot.boxes, lot.dt)
    return float(now.min()), float(coming.min())


class Driver:
    """A careless driver: normalised actions, shape (2,) float32."""

    STYLES = ("noise", "throttle", "reverse", "bang", "ram")

    def __init__(self, rng: np.random.Generator, style: str) -> None:
        self.rng, self.style = rng, style
        self.bias = rng.uniform(-1, 1, 2)

    def act(self, lot: ParkingScene, k: int) -> np.ndarray:
        if self.style == "noise":
            action = self.rng.uniform(-1, 1, 2)
        elif self.style == "throttle":
            action = np.array([1.0, self.bias[1]])
        elif self.style == "reverse":
            action = np.array([-1.0, self.bias[1]])
        elif self.style == "bang":
            action = np.sign(np.sin(np.array([0.13, 0.31]) * k + 3 * self.bias))
        else:  # steer at the nearest obstacle and accelerate towards it
            way = lot.boxes[:, :2] - lot.ego[:2]
            to = way[np.hypot(*way.T).argmin()]
            turn = np.arctan2(to[1], to[0]) - lot.ego[2]
            front = np.cos(turn) > 0
            action = np.array([1.0 if front else -1.0, np.clip(2 * np.sin(turn), -1, 1)])
        return action.astype(np.float32)
