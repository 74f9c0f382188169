"""An environment and its configuration.

Slow imports happen only when an environment is made, so wrong names are reported at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from dynamics.errors import ConfigError
from evaluation.continuous_roads import ROADS, continuous_id, continuous_remedy

if TYPE_CHECKING:
    import gymnasium as gym

__all__ = ["TRAFFIC", "Setting"]

TRAFFIC: Mapping[str, str] = MappingProxyType(
    {
        "idm": "highway_env.vehicle.behavior.IDMVehicle",
        "linear": "highway_env.vehicle.behavior.LinearVehicle",
        "aggressive": "highway_env.vehicle.behavior.AggressiveVehicle",
        "defensive": "highway_env.vehicle.behavior.DefensiveVehicle",
        "trucks": "dynamics.traffic.mixed.WithTrucks",
    }
)
"""Classes of vehicles by short names: highway-env's driver models, and IDM with every third vehicle a truck."""


@dataclass(frozen=True)
class Setting:
    """An environment and its configuration.

    Attributes
    ----------
    name : name in reports.
    env_id : a Gymnasium id; "module:id" first imports a module that registers it.
    config : changes to the registered configuration and the class's default, in highway-env's units (speeds in m/s,
        frequencies in Hz, durations in s). Read-only.
    description : description in one line.
    road : whether the shield's default settings support the road or parking lot. If so, comparisons have the modes none
        and full by default. On road networks with throttle and steering they stop with an error.
    """

    name: str
    env_id: str
    config: Mapping[str, Any] = field(default_factory=dict, hash=False)
    description: str = ""
    road: bool = True

    def __post_init__(self) -> None:
        # A deep copy with a read-only view, so that no two settings share a nested dictionary.
        object.__setattr__(self, "config", MappingProxyType(deepcopy(dict(self.config))))

    def make(self, render_mode: str | None = None) -> gym.Env[Any, Any]:
        """Make a new environment; with `render_mode` "rgb_array" or "human" for pictures.

        Raises
        ------
        ConfigError
            If there is no such environment, it has no road and vehicles of highway-env, or it does not support the
            configuration. For throttle and steering the message contains the remedy.
        """
        import gymnasium as gym

        from dynamics.scenes.scene import has_road_and_vehicles
        from dynamics.traffic.crossing import make

        config = self.configured
        try:
            env = make(self.env_id, config, **({"render_mode": render_mode} if render_mode else {}))
        except (gym.error.Error, ModuleNotFoundError) as error:
            raise ConfigError(f"there is no environment {self.env_id!r}: {error}") from None
        except (TypeError, ValueError, KeyError, AttributeError) as error:
            raise ConfigError(
                continuous_remedy(self.env_id, self.config)
                or f"{self.env_id} cannot be made with {dict(self.config) or 'its defaults'}: "
                f"{type(error).__name__}: {error}"
            ) from error
        if not has_road_and_vehicles(env.unwrapped):
            env.close()
            raise ConfigError(f"{self.env_id} is not a highway-env environment: it has no road and vehicles")
        return env

    @property
    def configured(self) -> dict[str, Any]:
        """The full configuration: `config` replaces keys of the registered configuration, by whole values as in
        highway-env.

        Raises
        ------
        ConfigError
            If there is no such environment.
        """
        import gymnasium as gym

        from dynamics.scenes.registration import registered_config, spec_of

        try:
            registered = registered_config(spec_of(self.env_id))
        except (gym.error.Error, ModuleNotFoundError) as error:
            raise ConfigError(f"there is no environment {self.env_id!r}: {error}") from None
        return {**registered, **deepcopy(dict(self.config))}

    def override(self, config: Mapping[str, Any], name: str | None = None) -> Setting:
        """A copy of the setting with these keys replaced, by whole values, because highway-env does not merge.

        The name is kept by default; give another one if results are stored.
        """
        return replace(self, config={**self.config, **config}, name=name or self.name)

    def with_traffic(
        self,
        kind: str | None = None,
        *,
        vehicles: int | None = None,
        density: float | None = None,
    ) -> Setting:
        """A copy of the setting with other traffic, and a name that contains the changes.

        Parameters
        ----------
        kind : a name in `TRAFFIC`, or the dotted path of a vehicle class.
        vehicles : number of other vehicles.
        density : highway-env's `vehicles_density`, a factor (the default traffic is 1).

        Raises
        ------
        ConfigError
            If the name is unknown, or a number is out of range.
        """
        config: dict[str, Any] = {}
        label = []
        if kind is not None:
            if kind not in TRAFFIC and "." not in kind:
                raise ConfigError(f"unknown traffic {kind!r}; have {sorted(TRAFFIC)}, or a dotted class path")
            config["other_vehicles_type"] = TRAFFIC.get(kind, kind)
            label.append(kind)
        if vehicles is not None:
            if vehicles < 0:
                raise ConfigError(f"vehicles must be 0 or more, not {vehicles}")
            config["vehicles_count"] = vehicles
            label.append(f"vehicles={vehicles}")
        if density is not None:
            if density <= 0:
                raise ConfigError(f"density must be positive, not {density}")
            config["vehicles_density"] = density
            label.append(f"density={density:g}")
        return self.override(config, name="+".join([self.name, *label]))

    def with_action_grid(self, grid: str) -> Setting:
        """A copy of the setting with a grid of throttle and steering as actions.

        Parameters
        ----------
        grid : "NxM", the number of values of throttle and of steering, from full braking to full throttle and from left
            to right in even steps. Options of the environment's `ContinuousAction` are kept; a disabled axis is
            enabled.

        Raises
        ------
        ConfigError
            If the text has another form, or a number is below 2 or above 99.

        Examples
        --------
        >>> Setting("fast", "highway-fast-v0").with_action_grid("5x9").make().action_space
        Discrete(45)
        """
        from dynamics.vehicle.action_grid import KEPT, read_grid

        counts = read_grid(grid)
        action = self.configured.get("action") or {}
        kept = {key: value for key, value in action.items() if key in KEPT}
        road = self.env_id.rpartition(":")[2]
        return replace(
            self,
            name=f"{self.name}+{grid}",
            env_id=f"evaluation.wrappers:{continuous_id(road)}" if road in ROADS else self.env_id,
            config={**self.config, "action": {"type": "DiscreteAction", "actions_per_axis": counts, **kept}},
            road=self.road and road.startswith(("highway", "racetrack", "parking")),
        )
