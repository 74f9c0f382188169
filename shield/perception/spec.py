"""Meaning of a Kinematics observation: columns, units, and what it leaves out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, isfinite
from typing import Any

from highway_env.road.lane import AbstractLane
from highway_env.vehicle.kinematics import Vehicle

from shield.errors import ConfigError

__all__ = ["STATE", "ObservationSpec", "unreadable"]

STATE = ("x", "y", "vx", "vy")
"""The required features."""
_KNOWN = (
    *("presence", *STATE, "heading", "cos_h", "sin_h", "cos_d", "sin_d", "long_off", "lat_off", "ang_off"),
    *("confidence", "intent"),  # what wrappers add
)
_THERE = 0.5
"""A row with at most this presence is empty."""
_ORDERS = ("sorted", "shuffled")


@dataclass(frozen=True, slots=True)
class ObservationSpec:
    """A Kinematics observation of highway-env: a row for the ego, and one for each vehicle that it sees.

    Attributes
    ----------
    features : columns, in order; x, y, vx and vy are required.
    rows : number of vehicles, the ego included.
    ranges : for each normalised feature the values that -1 and 1 stand for [m], [m/s]; empty without normalisation.
    absolute : whether the other vehicles are in the world frame instead of relative to the ego.
    clip : whether a value outside its range is shown at its edge.
    sorted : whether the rows are the nearest vehicles along the road. Shuffled rows of too many vehicles do not bound
        the distance of those left out.
    see_behind : whether vehicles more than `behind` behind the ego are seen.
    distance : how far the ego sees [m].
    sensor_range : distance ahead and behind within which a sensor in between shows vehicles [m].
    behind : how far back the ego sees without `see_behind`, from centre to centre [m].
    body : assumed length and width of each vehicle, since sizes are not observed [m].

    Raises
    ------
    ConfigError
        If a feature is unknown or a required one is missing. The message says what to change in the environment's
        configuration.

    Examples
    --------
    >>> spec = ObservationSpec(rows=15, see_behind=True, ranges={})
    >>> spec.features.index("vx")
    3
    """

    features: tuple[str, ...] = ("presence", *STATE)
    rows: int = 5
    ranges: Mapping[str, tuple[float, float]] | None = None
    absolute: bool = False
    clip: bool = True
    sorted: bool = True
    see_behind: bool = False
    distance: float = 5.0 * Vehicle.MAX_SPEED
    sensor_range: float = inf
    behind: float = 2.0 * Vehicle.LENGTH
    body: tuple[float, float] = (Vehicle.LENGTH, Vehicle.WIDTH)

    def __post_init__(self) -> None:
        object.__setattr__(self, "ranges", dict(self.ranges or {}))
        unknown = [name for name in self.features if name not in _KNOWN]
        if unknown:
            raise ConfigError(f"unknown features {', '.join(map(repr, unknown))}; have {', '.join(_KNOWN)}")
        missing = [name for name in STATE if name not in self.features]
        if missing:
            raise ConfigError(
                f"the observation lacks {', '.join(missing)}: add them to config['observation']['features'], which is "
                f"{list(self.features)}"
            )
        if len(set(self.features)) != len(self.features):
            raise ConfigError(f"each feature may be there once, not {list(self.features)}")
        if self.rows < 2:
            raise ConfigError("an observation of the ego alone shows no traffic: set vehicles_count to at least 2")
        if not all(isfinite(x) and x > 0 for x in (*self.body, self.distance)):
            raise ConfigError(f"distance and the sides of a body are above 0, got {self.distance}, {self.body}")
        if not self.sensor_range > 0:
            raise ConfigError(f"sensor_range is above 0, got {self.sensor_range}")
        for name, (low, high) in self.ranges.items():  # type: ignore[union-attr]
            if not -inf < low < high < inf:
                raise ConfigError(f"the range of {name!r} has to ascend, got {low} to {high}")
        low, high = self.ranges.get("presence", (-1.0, 1.0))  # type: ignore[union-attr]
        if not 2.0 * (1.0 - low) / (high - low) - 1.0 > _THERE:
            raise ConfigError(
                f"a row's presence of 1 has to be shown above {_THERE}: leave 'presence' out of "
                f"config['observation']['features_range'], which has [{low:g}, {high:g}]"
            )
        if self.clip and self.absolute and "x" in self.ranges:  # type: ignore[operator]
            raise ConfigError(
                "clipped absolute x is unknown once the ego has left its range: set 'absolute' or 'clip' "
                "of config['observation'] to False"
            )

    @property
    def sight(self) -> tuple[float, float]:
        """How far ahead and behind the ego sees [m]. Relative x may be clipped before `distance`."""
        far = min(self.distance, self.sensor_range)
        back = far if self.see_behind else min(self.behind, far)
        if self.clip and not self.absolute and "x" in self.ranges:  # type: ignore[operator]
            low, high = self.ranges["x"]  # type: ignore[index]
            return min(far, max(high, 0.0)), min(back, max(-low, 0.0))
        return far, back

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns."""
        return self.rows, len(self.features)

    @classmethod
    def of(cls, env: Any) -> ObservationSpec:
        """Specification of the observations of a highway-env environment that has been reset.

        Raises
        ------
        ConfigError
            If the observations are not Kinematics, or cannot be used.
        """
        base = env.unwrapped
        kind = base.observation_type
        if type(kind).__name__ != "KinematicObservation":
            raise ConfigError(unreadable(type(kind).__name__))
        ranges: Mapping[str, Any] = {}
        if kind.normalize:
            kind.normalize_obs({})  # computes the ranges, from an empty table
            ranges = {name: (float(low), float(high)) for name, (low, high) in kind.features_range.items()}
        return cls(
            features=tuple(kind.features),
            rows=int(kind.vehicles_count),
            ranges={name: each for name, each in ranges.items() if name in kind.features},
            absolute=bool(kind.absolute),
            clip=bool(kind.clip),
            sorted=kind.order == _ORDERS[0],
            see_behind=bool(kind.see_behind),
            distance=float(base.PERCEPTION_DISTANCE),
        )

    @classmethod
    def from_config(cls, observation: Mapping[str, Any], lanes: int) -> ObservationSpec:
        """Specification from highway-env's observation configuration, on a straight highway with `lanes` lanes. For an
        environment in another process.

        Raises
        ------
        ConfigError
            As `of`.
        """
        given = dict(observation)
        if given.get("type") != "Kinematics":
            raise ConfigError(unreadable(given.get("type")))
        features = tuple(given.get("features") or cls().features)
        wide = AbstractLane.DEFAULT_WIDTH * lanes
        far, fast = 5.0 * Vehicle.MAX_SPEED, 2.0 * Vehicle.MAX_SPEED
        usual = {"x": (-far, far), "y": (-wide, wide), "vx": (-fast, fast), "vy": (-fast, fast)}
        ranges = given.get("features_range") or usual
        return cls(
            features=features,
            rows=int(given.get("vehicles_count", 5)),
            ranges={k: (float(a), float(b)) for k, (a, b) in ranges.items() if k in features}
            if given.get("normalize", True)
            else {},
            absolute=bool(given.get("absolute", False)),
            clip=bool(given.get("clip", True)),
            sorted=given.get("order", "sorted") == _ORDERS[0],
            see_behind=bool(given.get("see_behind", False)),
        )


def unreadable(kind: Any) -> str:
    """Message for an observation of an unsupported kind."""
    return (
        f"scenes are made from Kinematics and OccupancyGrid observations, not {kind}: set "
        'config["observation"] = {"type": "Kinematics", "vehicles_count": 15, "see_behind": True}'
    )
