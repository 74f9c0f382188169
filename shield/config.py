"""The shield's settings: frozen, validated at construction, and convertible to TOML and back."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from math import isfinite
from pathlib import Path
from types import MappingProxyType
from typing import Any

import tomli_w

from dynamics.deprecation import accept_former_fields, accept_former_keywords, warn_of_former_name, with_present_names
from dynamics.errors import nearest_name_hint
from dynamics.traffic.assumptions import FORMER_ASSUMPTIONS, Assumptions, present_profile
from shield.errors import ConfigError

__all__ = [
    "FORMER_SETTINGS",
    "MODES",
    "PERCEPTIONS",
    "PROFILES",
    "RULES_ALONE",
    "SIMULATED",
    "WORST_CASE",
    "Buffer",
    "ShieldConfig",
]

RULES_ALONE = ("distance", "rss", "ttc", "ttc-ranking")
"""Modes in which one rule decides alone."""
MODES = ("none", *RULES_ALONE, "full")
"""Valid `ShieldConfig.mode`: no shield, one rule alone, or the whole decision pipeline."""
PROFILES = ("default", "meta-actions", "roads", "simulated")
"""Names of `ShieldConfig.profile`."""
SIMULATED, WORST_CASE = "simulated", "worst-case"
"""Names of settings that depend on the environment (`shield.wrappers.defaults`)."""
REPAIRS = ("hold", "filter")
"""Valid `ShieldConfig.repair`: an acceleration cap, or the nearest inputs."""

PERCEPTIONS = ("simulator", "observation")
"""Sources of the scenes: the simulator's true state, or the policy's observations as the only source for the
traffic."""
NORMS = ("range", "acceleration")
"""Valid `ShieldConfig.norm`."""
FORMER_SETTINGS = {"patience": "failure_limit"}
"""Present names of fields of `ShieldConfig`, by the former name."""


def _positive(owner: str, name: str, value: Any, *, zero: bool = False) -> None:
    """Raise `ConfigError` unless a setting is a finite number above 0, or of at least 0 with `zero`."""
    good = isinstance(value, (int, float)) and not isinstance(value, bool) and isfinite(value)
    if not good or value < 0 or (value == 0 and not zero):
        raise ConfigError(f"{owner}.{name} must be a finite number {'at least' if zero else 'above'} 0, got {value!r}")


@dataclass(frozen=True, slots=True)
class Buffer:
    """Clearance kept around the ego, along and across its heading [m]."""

    longitudinal: float = 2.0
    lateral: float = 0.3

    def __post_init__(self) -> None:
        _positive("Buffer", "longitudinal", self.longitudinal, zero=True)
        _positive("Buffer", "lateral", self.lateral, zero=True)


@accept_former_fields(FORMER_SETTINGS)
@dataclass(frozen=True, slots=True)
class ShieldConfig:
    """Settings of `Shield` and `ShieldedEnv`.

    Attributes
    ----------
    mode : one of `MODES`. "distance", "rss" and "ttc" replace an action that the rule refuses by SLOWER. "ttc-ranking"
        replaces it by the first accepted action in the policy's order of preference. Without an accepted action, or
        without an order, it is SLOWER.
    buffer : the distance that no verified action may violate.
    assumptions : the rules of the road that the other vehicles are assumed to keep to.
    braking : deceleration of the ego's fail-safe [m/s^2]: 1 g, the limit of a dry road. For comparison, highway-env's
        own speed controller reaches up to 12.5 m/s^2 on SLOWER, and 8.3 from 25 to 20 m/s.
    perception_range : vehicles beyond this distance do not count [m].
    distance : threshold D of the fixed-distance rule [m].
    time_to_collision : threshold of the TTC rule [s].
    response_time : the ego's response time in the RSS rule used alone [s].
    horizon : horizon of `Shield` with meta-actions alone (`frames=False`) [s], for an ego that cannot stop, and for
        simulated traffic on a straight highway.
    network_horizon : the same for simulated traffic on a road network.
    repair : replacement, between two decisions, of a meta-action that does not verify any more. "hold" gives the
        greatest acceleration that verifies, "filter" the nearest inputs (the predictive filter).
    norm : distance between the proposed throttle and wheel angle on a road and the nearest ones: in shares of the
        actuators' "range"s, or in the resulting "acceleration"s along and across, a and v^2 delta / L. The latter
        swerves less.
    record : keep the others' occupancy in each `Decision` (for drawing), or the prediction in simulated traffic. Has no
        effect in a parking lot.
    clearance : the distance that no verified action may violate in a parking lot, on all sides [m].
    failure_limit : consecutive decisions in which the fallback acts if the scene, or the policy's action, cannot be
        read.
        One more raises the error. 0 for any number.
    """

    mode: str = "full"
    buffer: Buffer = field(default_factory=Buffer)
    assumptions: Assumptions = field(default_factory=Assumptions.idm)
    braking: float = 9.8
    perception_range: float = 200.0
    distance: float = 15.0
    time_to_collision: float = 2.0
    response_time: float = 0.5
    horizon: float = 4.0
    network_horizon: float = 12.0
    repair: str = "hold"
    norm: str = "range"
    record: bool = False
    clearance: float = 0.1
    failure_limit: int = 30

    def __post_init__(self) -> None:
        if self.mode not in MODES:
            raise ConfigError(
                f"unknown shield mode {self.mode!r}{nearest_name_hint(self.mode, MODES)}; valid are {', '.join(MODES)}"
            )
        if self.repair not in REPAIRS:
            raise ConfigError(f"unknown repair {self.repair!r}; valid are {', '.join(REPAIRS)}")
        if self.norm not in NORMS:
            raise ConfigError(f"unknown norm {self.norm!r}; valid are {', '.join(NORMS)}")
        if not isinstance(self.buffer, Buffer):
            raise ConfigError(f"ShieldConfig.buffer must be a Buffer, got {self.buffer!r}")
        if not isinstance(self.assumptions, Assumptions):
            raise ConfigError(f"ShieldConfig.assumptions must be Assumptions, got {self.assumptions!r}")
        if not isinstance(self.record, bool):
            raise ConfigError(f"ShieldConfig.record must be true or false, got {self.record!r}")
        if type(self.failure_limit) is not int or self.failure_limit < 0:
            raise ConfigError(
                f"ShieldConfig.failure_limit must be a whole number of decisions, got {self.failure_limit!r}"
            )
        for name in (
            "clearance",
            "braking",
            "perception_range",
            "distance",
            "time_to_collision",
            "response_time",
            "horizon",
            "network_horizon",
        ):
            _positive("ShieldConfig", name, getattr(self, name))

    @property
    def simulates(self) -> bool:
        """Whether actions are verified in simulated traffic (`Assumptions.simulated_traffic()`, mode not "none")."""
        return self.assumptions.simulated and self.mode != "none"

    @classmethod
    def for_meta_actions(cls) -> ShieldConfig:
        """Defaults of `Shield` with meta-actions alone, which cannot stop the ego: moderate assumptions."""
        return cls(assumptions=Assumptions.moderate())

    @classmethod
    @accept_former_keywords({"looks_ahead": "considers_connected_lanes"})
    def for_roads(
        cls, acceleration: float = 3.0, considers_connected_lanes: bool = False, gives_way: bool = False
    ) -> ShieldConfig:
        """Defaults on road networks, with the assumptions of `Assumptions.roads()`.

        Parameters
        ----------
        acceleration : greatest acceleration of the traffic [m/s^2]: 3 for highway-env's, except 6 at its intersections.
        considers_connected_lanes : whether followers consider vehicles beyond the end of their own lane, as on
            highway-env's roads with `neighbour_vehicles_connected_lanes`.
        gives_way : whether a vehicle with less right of way than the ego waits for it.
        """
        traffic = replace(
            Assumptions.roads(),
            acceleration=acceleration,
            considers_connected_lanes=considers_connected_lanes,
            gives_way=gives_way,
        )
        return cls(assumptions=traffic)

    @classmethod
    def simulated_traffic(cls) -> ShieldConfig:
        """Verification in simulated traffic: 30 s ahead on a straight highway, 12 s on a road network.

        Within a shorter horizon an ego that cannot stop may be boxed in before that is predicted. Exact prediction
        needs only a small buffer.
        """
        return cls(assumptions=Assumptions.simulated_traffic(), buffer=Buffer(0.5, 0.3), horizon=30.0)

    @classmethod
    def exact(cls) -> ShieldConfig:
        """The former name of `simulated_traffic`."""
        warn_of_former_name("ShieldConfig.exact()", "write ShieldConfig.simulated_traffic()")
        return cls.simulated_traffic()

    @classmethod
    def profile(cls, name: str) -> ShieldConfig:
        """Settings by name: "default", "meta-actions", "roads" or "simulated"."""
        name = present_profile(name)
        if name not in PROFILES:
            raise ConfigError(f"unknown settings {name!r}; valid are {', '.join(map(repr, PROFILES))}")
        if name == "meta-actions":
            return cls.for_meta_actions()
        return cls.for_roads() if name == "roads" else cls.simulated_traffic() if name == "simulated" else cls()

    def replace(self, **changes: Any) -> ShieldConfig:
        """A copy with some settings changed."""
        return replace(self, **changes)

    def to_toml(self) -> str:
        """The settings as a TOML document."""
        return tomli_w.dumps(asdict(self))

    @classmethod
    def from_toml(cls, text: str) -> ShieldConfig:
        """Read the output of `to_toml`; tables and keys may be left out.

        `assumptions` may be a table or the name of a profile ("idm", "roads", "moderate", "rss", "simulated").

        Raises
        ------
        ConfigError
            For invalid TOML, unknown keys, or values out of range; the message lists the valid ones.

        Examples
        --------
        >>> config = ShieldConfig(braking=6.0)
        >>> ShieldConfig.from_toml(config.to_toml()) == config
        True
        """
        try:
            data = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise ConfigError(f"not a TOML document: {error}") from error
        buffer = _build(Buffer, "buffer", data.pop("buffer", {}))
        given = data.pop("assumptions", {})
        if isinstance(given, str):
            assumptions = Assumptions.profile(given)
        else:
            assumptions = _build(Assumptions, "assumptions", given, FORMER_ASSUMPTIONS)
        found: ShieldConfig = _build(
            cls, "config", {**data, "buffer": buffer, "assumptions": assumptions}, FORMER_SETTINGS
        )
        return found

    @classmethod
    def load(cls, path: str | Path) -> ShieldConfig:
        """Read a TOML file.

        Raises
        ------
        ConfigError
            If there is no such file, or as in `from_toml`.
        """
        path = Path(path)
        if not path.is_file():
            raise ConfigError(f"there is no shield configuration {path}; `shield config` prints one")
        return cls.from_toml(path.read_text(encoding="utf-8"))

    @classmethod
    def of(cls, config: ShieldConfig | str | Path | None, default: ShieldConfig | None = None) -> ShieldConfig:
        """Settings from a user's argument: settings, "simulated", "worst-case", or the path of a TOML file; with None
        the default.

        Raises
        ------
        ConfigError
            If it is neither, or as in `load`.
        """
        if config is None:
            return default if default is not None else cls()
        if config == SIMULATED:
            return cls.simulated_traffic()
        if config == WORST_CASE:
            return cls()
        if isinstance(config, str | Path):
            return cls.load(config)
        if not isinstance(config, ShieldConfig):
            raise ConfigError(f"config must be a ShieldConfig or the path of a TOML file, got {config!r}")
        return config

    @classmethod
    def named(cls, name: str | Path) -> ShieldConfig | str:
        """Settings from a command line: the text "simulated" or "worst-case" itself, else those of the TOML file
        `name`."""
        return str(name) if str(name) in (SIMULATED, WORST_CASE) else cls.load(name)

    def save(self, path: str | Path) -> None:
        """Write a TOML file."""
        Path(path).write_text(self.to_toml(), encoding="utf-8")


def _build(kind: Any, table: str, values: Any, former: Mapping[str, str] = MappingProxyType({})) -> Any:
    """Instance of a settings class from a TOML table; raises `ConfigError` for unknown keys. Former keys warn."""
    if not isinstance(values, dict):
        raise ConfigError(f"{table} must be a table, got {values!r}")
    values = with_present_names(values, former, f"the table {table}")
    valid = [f.name for f in fields(kind)]
    unknown = sorted(set(values) - set(valid))
    if unknown:
        near = nearest_name_hint(unknown[0], valid)
        raise ConfigError(f"unknown key {unknown[0]!r} in {table}{near}; valid are {', '.join(valid)}")
    return kind(**values)
