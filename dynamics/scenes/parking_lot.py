"""A parking lot at one instant: the ego and the obstacles around it. Its lanes have no meaning.

`ParkingSceneReader` reads the simulator's true state. highway-env's observation of a lot contains neither walls nor
other vehicles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.errors import SceneError
from dynamics.state import BoolArray, FloatArray

__all__ = ["BODY", "BOX", "ParkingScene", "ParkingSceneReader", "is_parking_lot"]

BODY = ("x", "y", "heading", "speed", "length", "width")
"""Columns of a vehicle in a lot: [m], [m], [rad], [m/s], [m], [m], world frame; the first four are those of `State`."""
BOX = (0, 1, 2, 4, 5)
"""Indices of the columns that make a rectangle, in the order of `dynamics.scenes.rectangles`."""


@dataclass(frozen=True, slots=True, eq=False)
class ParkingScene:
    """Ego, obstacles and timing.

    Attributes
    ----------
    ego : shape (6,), columns `BODY`.
    obstacles : walls, parked vehicles and other solid objects as rotated rectangles, shape (m, 6), columns `BODY`.
    dt : duration of a simulation frame [s].
    bodies : the simulator's objects of the obstacles, row by row; None where there are none.

    Raises
    ------
    SceneError
        If a shape or the duration is wrong, or a length or width is not positive.
    """

    ego: FloatArray
    obstacles: FloatArray
    dt: float
    bodies: Sequence[Any] | None = None

    def __post_init__(self) -> None:
        if self.ego.shape != (len(BODY),):
            raise SceneError(f"Lot.ego must have shape ({len(BODY)},), columns {', '.join(BODY)}; got {self.ego.shape}")
        if self.obstacles.ndim != 2 or self.obstacles.shape[1] != len(BODY):
            raise SceneError(
                f"Lot.obstacles must have shape (m, {len(BODY)}), columns {', '.join(BODY)}; got {self.obstacles.shape}"
            )
        if not self.dt > 0:
            raise SceneError(f"Lot.dt must be positive, got {self.dt} s")
        sizes = np.vstack([self.ego, self.obstacles])[:, 4:]
        if (sizes <= 0).any():
            raise SceneError(f"lengths and widths in a Lot must be positive, the least is {sizes.min():g} m")

    @property
    def finite(self) -> bool:
        """Whether every number is finite."""
        return bool(np.isfinite(self.ego).all() and np.isfinite(self.obstacles).all())

    @property
    def moving(self) -> BoolArray:
        """Whether each obstacle moves, (m,): such obstacles violate the assumption about a lot."""
        return np.asarray(self.obstacles[:, 3] != 0)

    @property
    def boxes(self) -> FloatArray:
        """The obstacles as rectangles, (m, 5): x, y, heading, length, width."""
        return self.obstacles[:, BOX]

    @classmethod
    def from_env(cls, env: Any) -> ParkingScene:
        """Read the true state of a parking environment (see `ParkingSceneReader`)."""
        return ParkingSceneReader(env).read()


def is_parking_lot(env: Any) -> bool:
    """Whether a highway-env environment is a parking lot: a `ParkingEnv`, or one derived from it."""
    from highway_env.envs.parking_env import ParkingEnv

    return isinstance(getattr(env, "unwrapped", env), ParkingEnv)


class ParkingSceneReader:
    """Reads lots from the simulator's true state.

    Parameters
    ----------
    env : a parking environment, wrapped or not, with one controlled vehicle.

    Raises
    ------
    SceneError
        If it is no parking environment, or has several controlled vehicles.
    """

    def __init__(self, env: Any) -> None:
        self._env = getattr(env, "unwrapped", env)
        if not is_parking_lot(self._env):
            raise SceneError(f"{type(self._env).__name__} is no parking lot; valid are ParkingEnv and its subclasses")
        count = int(self._env.config["controlled_vehicles"])
        if count != 1:
            raise SceneError(f"the shield supports one controlled vehicle, got {count}")

    def check(self) -> None:
        """Check that the lot can be read.

        Raises
        ------
        SceneError
            If not.
        """
        self.read()

    def read(self) -> ParkingScene:
        """The present lot.

        Raises
        ------
        SceneError
            If there is no road or no ego yet, or a rectangle has no size.
        """
        env = self._env
        if env.road is None or env.vehicle is None:
            raise SceneError("the environment has no road or no ego vehicle yet; call reset() first")
        ego = env.vehicle
        around = [v for v in env.road.vehicles if v is not ego]
        around += [o for o in env.road.objects if o.solid]
        obstacles = np.array([_row(body) for body in around], dtype=float).reshape(-1, len(BODY))
        return ParkingScene(np.array(_row(ego), dtype=float), obstacles, 1 / env.config["simulation_frequency"], around)


def _row(v: Any) -> tuple[float, ...]:
    """A vehicle as a row with columns `BODY`."""
    x, y = v.position.tolist()
    return (x, y, v.heading, v.speed, v.LENGTH, v.WIDTH)
