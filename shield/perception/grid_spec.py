"""Meaning of an occupancy grid: cells, layers, and what it leaves out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import floor, inf, isfinite
from typing import Any

from highway_env.envs.common.observation import OccupancyGridObservation
from highway_env.vehicle.kinematics import Vehicle

from shield.errors import ConfigError
from shield.perception.spec import ObservationSpec, unreadable

__all__ = ["GridSpec", "Spec", "spec_from_config", "spec_of"]

_NEEDED = ("presence", "vx", "vy")
_VELOCITY = ("vx", "vy")
_FAST = 2.0 * Vehicle.MAX_SPEED


@dataclass(frozen=True, slots=True)
class GridSpec:
    """An OccupancyGrid observation of highway-env: a layer of cells for each feature, with the ego in the middle.

    All values are relative to the ego. The layers x and y state a vehicle's position if they can be read; otherwise it
    is bounded by its cell. highway-env shows one vehicle in each cell, the first in its list.

    Attributes
    ----------
    features : layers, in order; presence, vx and vy are required.
    size : extent along and across, ((low, high), (low, high)) [m].
    step : sides of a cell [m].
    ranges : for each normalised feature the values that -1 and 1 stand for [m], [m/s]; by default highway-env's ranges
        of the velocities.
    clip : whether a value outside [-1, 1] is shown at its edge, normalised or not.
    aligned : whether the cells are aligned with the ego instead of the road.
    image : whether numbers are bytes, each of which stands for an interval.
    distance : vehicles beyond this distance are irrelevant [m].
    body : assumed length and width of each vehicle, since sizes are not observed [m].

    Raises
    ------
    ConfigError
        If a required layer is missing or cannot be read, or the grid does not hold the ego. The message says what to
        change in the environment's configuration.
    """

    features: tuple[str, ...] = tuple(OccupancyGridObservation.FEATURES)
    size: tuple[tuple[float, float], tuple[float, float]] = ((-27.5, 27.5), (-27.5, 27.5))
    step: tuple[float, float] = (5.0, 5.0)
    ranges: Mapping[str, tuple[float, float]] | None = None
    clip: bool = True
    aligned: bool = False
    image: bool = False
    distance: float = 5.0 * Vehicle.MAX_SPEED
    body: tuple[float, float] = (Vehicle.LENGTH, Vehicle.WIDTH)

    def __post_init__(self) -> None:
        usual = dict.fromkeys(_VELOCITY, (-_FAST, _FAST))
        object.__setattr__(self, "ranges", dict(usual if self.ranges is None else self.ranges))
        missing = [name for name in _NEEDED if name not in self.features]
        if missing:
            raise ConfigError(
                f"the grid lacks {', '.join(missing)}: add them to config['observation']['features'], which is "
                f"{list(self.features)}"
            )
        if len(set(self.features)) != len(self.features):
            raise ConfigError(f"each feature may be there once, not {list(self.features)}")
        if not all(isfinite(x) and x > 0 for x in (*self.step, *self.body, self.distance)):
            raise ConfigError(f"cells, bodies and distance are above 0, got {self.step}, {self.body}, {self.distance}")
        for low, high in self.size:
            if not -inf < low < 0 < high < inf:
                raise ConfigError(
                    f"the grid has to hold the ego: set config['observation']['grid_size'] around 0, not {self.size}"
                )
        for name, (low, high) in self.ranges.items():  # type: ignore[union-attr]
            if not -inf < low < high < inf:
                raise ConfigError(f"the range of {name!r} has to ascend, got {low} to {high}")
        cut = [name for name in _VELOCITY if not self.legible(name)]
        if cut:
            raise ConfigError(
                f"{', '.join(cut)} of the grid are cut off at 1: add them to config['observation']['features_range'], "
                "or set 'clip' to False"
            )

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of layers, of cells along and of cells across."""
        along, across = (floor((high - low) / step) for (low, high), step in zip(self.size, self.step, strict=True))
        return len(self.features), along, across

    @property
    def hides(self) -> bool:
        """Whether a cell may hold more than one body."""
        return self.step[0] > self.body[0] or self.step[1] > self.body[1]

    def legible(self, name: str) -> bool:
        """Whether a layer exists and its numbers can be read."""
        return name in self.features and (name in self.ranges or not (self.clip or self.image))  # type: ignore[operator]

    @classmethod
    def of(cls, env: Any) -> GridSpec:
        """Specification of the observations of a highway-env environment that has been reset.

        Raises
        ------
        ConfigError
            If the observation is not an OccupancyGrid, or cannot be used.
        """
        base = env.unwrapped
        kind = base.observation_type
        if type(kind) is not OccupancyGridObservation:
            raise ConfigError(unreadable(type(kind).__name__))
        return cls._made(kind.features, kind.grid_size, kind.grid_step, kind.features_range, vars(kind))

    @classmethod
    def from_config(cls, observation: Mapping[str, Any]) -> GridSpec:
        """Specification from highway-env's observation configuration.

        Raises
        ------
        ConfigError
            As `of`.
        """
        if observation.get("type") != "OccupancyGrid":
            raise ConfigError(unreadable(observation.get("type")))
        kind, given = OccupancyGridObservation, observation.get
        features, size, step = given("features"), given("grid_size"), given("grid_step")
        return cls._made(
            kind.FEATURES if features is None else features,
            kind.GRID_SIZE if size is None else size,
            kind.GRID_STEP if step is None else step,
            given("features_range"),
            observation,
        )

    @classmethod
    def _made(cls, features: Any, size: Any, step: Any, ranges: Any, options: Mapping[str, Any]) -> GridSpec:
        if options.get("absolute", False):
            raise ConfigError("highway-env has no grids in absolute coordinates: set 'absolute' to False")
        (x0, x1), (y0, y1) = ([float(x) for x in axis] for axis in size)
        along, across = map(float, step)
        known = None if not ranges else {name: (float(low), float(high)) for name, (low, high) in ranges.items()}
        return cls(
            features=tuple(features),
            size=((x0, x1), (y0, y1)),
            step=(along, across),
            ranges=known,
            clip=bool(options.get("clip", True)),
            aligned=bool(options.get("align_to_vehicle_axes", False)),
            image=bool(options.get("as_image", False)),
        )


Spec = ObservationSpec | GridSpec
"""Meaning of the observations from which scenes can be made."""


def spec_of(env: Any) -> Spec:
    """Specification of the observations of a highway-env environment that has been reset.

    Raises
    ------
    ConfigError
        If no scene can be made from them.
    """
    grid = type(env.unwrapped.observation_type) is OccupancyGridObservation
    return GridSpec.of(env) if grid else ObservationSpec.of(env)


def spec_from_config(observation: Mapping[str, Any], lanes: int) -> Spec:
    """Specification from highway-env's observation configuration, on a straight highway with `lanes` lanes.

    Raises
    ------
    ConfigError
        If no scene can be made from the observations.
    """
    grid = observation.get("type") == "OccupancyGrid"
    return GridSpec.from_config(observation) if grid else ObservationSpec.from_config(observation, lanes)
