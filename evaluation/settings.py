"""Named environment settings, so that a result can say in one word where it was measured.

A setting is an environment id and the configuration that differs from highway-env's default:

>>> setting = get_setting("abz-idm")
>>> setting.env_id, setting.config["simulation_frequency"]
('highway-fast-v0', 15)
>>> setting.with_traffic("aggressive", vehicles=30).config["vehicles_count"]
30

The `abz` family is the highway of the ABZ 2025 case study: three lanes, target speeds
0, 5, …, 40 m/s. `abz` and `abz-adversarial` are for training (5 Hz), `abz-idm` and
`abz-aggressive` for testing (15 Hz). The two tests and `abz` share one reward, so that returns
can be compared across them.

`racetrack`, the two of `parking` and all that end in `-continuous` are driven with throttle and steering, or
steering alone. Parking has a goal, and its results say how often it was reached.

Nothing slow is imported before an environment is made: a mistake in a name is told at once.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from dynamics.errors import ConfigError
from evaluation.continuous_roads import ROADS, continuous_id, what_makes
from evaluation.names import check_name

if TYPE_CHECKING:
    import gymnasium as gym

__all__ = ["SETTINGS", "TRAFFIC", "Setting", "get_setting", "setting_of"]

TRAFFIC: Mapping[str, str] = MappingProxyType(
    {
        "idm": "highway_env.vehicle.behavior.IDMVehicle",
        "linear": "highway_env.vehicle.behavior.LinearVehicle",
        "aggressive": "highway_env.vehicle.behavior.AggressiveVehicle",
        "defensive": "highway_env.vehicle.behavior.DefensiveVehicle",
        "trucks": "dynamics.traffic.mixed.WithTrucks",
    }
)
"""Short names of highway-env's driver models, and of IDM with every third vehicle a truck, and the classes they stand
for."""


@dataclass(frozen=True)
class Setting:
    """An environment and the configuration to make it with.

    Attributes
    ----------
    name : the name it is reported under.
    env_id : a Gymnasium id; "module:id" imports a module first, which registers it.
    config : what differs from the configuration that the environment is registered with, and from its class's
        default; in highway-env's units (speeds in m/s, frequencies in Hz, durations in s). Read-only.
    description : one line for people.
    road : whether it is a road or a parking lot that shields can read by their own settings, so that none and full are
        compared on it unless others are asked for; on networks with throttle and steering they stop with an error.
    """

    name: str
    env_id: str
    config: Mapping[str, Any] = field(default_factory=dict, hash=False)
    description: str = ""
    road: bool = True

    def __post_init__(self) -> None:
        # A deep copy behind a read-only view: no two settings share a nested dictionary.
        object.__setattr__(self, "config", MappingProxyType(deepcopy(dict(self.config))))

    def make(self, render_mode: str | None = None) -> gym.Env[Any, Any]:
        """A fresh environment; `render_mode` "rgb_array" or "human" if it is to be drawn.

        Raises
        ------
        ConfigError
            If there is no such environment, it is none of highway-env's nor made as these are, or it takes no such
            configuration; where that is for its throttle and steering, with what makes it.
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
                what_makes(self.env_id, self.config)
                or f"{self.env_id} cannot be made with {dict(self.config) or 'its defaults'}: "
                f"{type(error).__name__}: {error}"
            ) from error
        if not has_road_and_vehicles(env.unwrapped):
            env.close()
            raise ConfigError(f"{self.env_id} is not a highway-env environment: it has no road and vehicles")
        return env

    @property
    def configured(self) -> dict[str, Any]:
        """What the environment is made with: `config` over the configuration that the id is registered with, key by
        key; whole values, as highway-env itself replaces them.

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
        """The same setting with these keys replaced (whole values: highway-env does not merge).

        The name is kept unless another is given; give one where results are written down.
        """
        return replace(self, config={**self.config, **config}, name=name or self.name)

    def with_traffic(
        self,
        kind: str | None = None,
        *,
        vehicles: int | None = None,
        density: float | None = None,
    ) -> Setting:
        """The same road among other traffic.

        Parameters
        ----------
        kind : a name in `TRAFFIC`, or the dotted path of a vehicle class.
        vehicles : how many other vehicles.
        density : highway-env's `vehicles_density`, a factor (the default traffic is 1).
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
        """The same environment, driven by a grid of throttle and steering.

        Parameters
        ----------
        grid : "NxM", how many values of throttle and of steering there are, from full brakes to full throttle and from
            left to right in even steps. Options of the environment's `ContinuousAction` are kept; an axis that was
            switched off is switched on.

        Raises
        ------
        ConfigError
            If it is no such text, or a number is below 2 or above 99.

        Examples
        --------
        >>> get_setting("highway-fast").with_action_grid("5x9").make().action_space
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


_ABZ_ROAD: dict[str, Any] = {
    "lanes_count": 3,
    "action": {"type": "DiscreteMetaAction", "target_speeds": list(range(0, 45, 5))},
    "reward_speed_range": [0, 40],
}
_ABZ_BASE = {**_ABZ_ROAD, "high_speed_reward": 1.0, "collision_reward": -1.0}

# Two things about this reward:
# - `lane_change_reward` belongs to the case study's configuration and is kept for the record, but
#   highway-env 1.12 reads it nowhere in `HighwayEnv._rewards`: on this road it does nothing.
# - A crash adds +1 and ends the episode. Without normalisation every second of driving on would be
#   worth up to +2.1, and a crash would cost that whole future: on balance it would not be rewarded.
#   highway-env's normalisation maps [collision_reward, high_speed_reward + right_lane_reward]
#   = [1, 2.1] to [0, 1], so a second on the left lane is worth (2 v / 40 - 1) / 1.1: nothing at
#   v = 20 m/s, a loss below, little at the speed of the traffic. A crash adds 1 / 1.1 and ends the
#   losses. So `normalize_reward` stays True here. With a discount of 0.9 a crash still pays best only
#   below about 22 m/s; above it the agent speeds through the traffic without minding a crash.
_ABZ_ADVERSARIAL = {
    **_ABZ_ROAD,
    "high_speed_reward": 2.0,
    "collision_reward": 1.0,
    "lane_change_reward": 0.5,
    "normalize_reward": True,
}

# Everything else is highway-v0's default, its reward too, which suits a wheel and a throttle: the speed that it pays
# for is the one along the road, a crash costs 1 / 1.5 of what a decision can bring, and off the road nothing is paid.
# `offroad_terminal` is not: without it a car that has left the road goes on unpunished by anything but zeros.
_CONTINUOUS: dict[str, Any] = {
    "action": {"type": "ContinuousAction"},
    "simulation_frequency": 20,
    "policy_frequency": 10,
    "duration": 40,
    "offroad_terminal": True,
}

# Decisions last twice as long and there are fewer vehicles: a second of driving costs a tenth of what it costs above.
# The reward is another one: normalised, standing still brings 0.67 of 1 in every decision, and PPO learned to stop
# within 40,000 steps. Here it brings nothing, and 10 m/s is where speed begins to pay.
_CONTINUOUS_TRAINING: dict[str, Any] = {
    **_CONTINUOUS,
    "simulation_frequency": 10,
    "policy_frequency": 5,
    "vehicles_count": 12,
    "normalize_reward": False,
    "reward_speed_range": [10, 30],
}

# What HanoiWorld (2026) measures on, as it says: decisions at 5 Hz, frames at 15 Hz.
_HANOI: dict[str, Any] = {"simulation_frequency": 15, "policy_frequency": 5, "collision_reward": -5}

SETTINGS: Mapping[str, Setting] = MappingProxyType(
    {
        setting.name: setting
        for setting in (
            Setting("highway-fast", "highway-fast-v0", {}, "highway-fast-v0 as it comes: 5 Hz"),
            Setting(
                "highway-fast-seen",
                "highway-fast-v0",
                {"observation": {"type": "Kinematics", "vehicles_count": 15, "see_behind": True}},
                "highway-fast, of which 15 vehicles are observed, those behind too",
            ),
            Setting("highway", "highway-v0", {}, "highway-v0 as it comes: 15 Hz"),
            Setting(
                "highway-trucks",
                "highway-fast-v0",
                {"simulation_frequency": 15, "other_vehicles_type": TRAFFIC["trucks"]},
                "highway-fast-v0 among cars and trucks of 12 m, every third vehicle: 15 Hz",
            ),
            Setting(
                "abz",
                "highway-fast-v0",
                _ABZ_BASE,
                "ABZ 2025, training: 3 lanes, target speeds 0 to 40 m/s, crash reward -1, 5 Hz",
            ),
            Setting(
                "abz-adversarial",
                "highway-fast-v0",
                _ABZ_ADVERSARIAL,
                "ABZ 2025, training of an agent that is paid for crashing: crash reward +1, 5 Hz",
            ),
            Setting(
                "abz-idm",
                "highway-fast-v0",
                {**_ABZ_BASE, "simulation_frequency": 15, "other_vehicles_type": TRAFFIC["idm"]},
                "ABZ 2025, test: IDM traffic at 15 Hz, the reward of abz",
            ),
            Setting(
                "abz-aggressive",
                "highway-fast-v0",
                {
                    **_ABZ_BASE,
                    "simulation_frequency": 15,
                    "other_vehicles_type": TRAFFIC["aggressive"],
                },
                "ABZ 2025, test: aggressive traffic at 15 Hz, the reward of abz",
            ),
            Setting(
                "highway-continuous",
                "highway-v0",
                _CONTINUOUS,
                "highway-v0 with throttle and steering: decisions at 10 Hz, 20 Hz, 40 s, ends off the road",
            ),
            Setting(
                "highway-fast-continuous",
                "highway-fast-v0",
                {"action": {"type": "ContinuousAction"}, "policy_frequency": 5, "offroad_terminal": True},
                "highway-fast-v0 with throttle and steering, 5 Hz: returns are 5 times those of highway-fast",
            ),
            Setting(
                "highway-continuous-training",
                "highway-fast-v0",
                {**_CONTINUOUS_TRAINING, "lanes_count": 4},
                "highway-continuous, training: decisions at 5 Hz, 10 Hz, 12 other vehicles, nothing for standing",
            ),
            Setting("parking", "parking-v0", {}, "parking-v0 as it comes: an empty lot, 5 Hz, 100 s"),
            Setting(
                "parking-parked",
                "parking-v0",
                {"vehicles_count": 10},
                "parking-v0 with 10 parked vehicles (parking-parked-v0): the observation does not show them",
            ),
            Setting(
                "roundabout",
                "roundabout-v0",
                {},
                "roundabout-v0 as it comes: meta-actions at 1 Hz, target speeds 0, 8 and 16 m/s, 15 Hz, 11 s",
            ),
            Setting("merge", "merge-v0", {}, "merge-v0 as it comes: meta-actions at 1 Hz, 15 Hz, to 370 m"),
            Setting(
                "intersection",
                "intersection-v0",
                {},
                "intersection-v0 as it comes: slower, idle, faster at 1 Hz, targets 0, 4.5 and 9 m/s, 15 Hz, 13 s",
            ),
            Setting("exit", "exit-v0", {}, "exit-v0 as it comes: meta-actions at 1 Hz, 5 Hz, 18 s"),
            Setting("two-way", "two-way-v0", {}, "two-way-v0 as it comes: meta-actions at 1 Hz, 15 Hz"),
            Setting("u-turn", "u-turn-v0", {}, "u-turn-v0 as it comes: meta-actions at 1 Hz, 15 Hz, 10 s"),
            *(
                Setting(
                    f"{road}-continuous",
                    f"evaluation.wrappers:{road}-continuous-v{version}",
                    {},
                    f"{road}-v{version} with throttle and steering",
                    road=False,
                )
                for road, version in (("merge", 1), ("roundabout", 1), ("two-way", 0), ("u-turn", 1))
            ),
            Setting(
                "exit-continuous",
                "exit-v1",
                {"action": {"type": "ContinuousAction"}},
                "exit-v1 with throttle and steering",
                road=False,
            ),
            Setting(
                "intersection-continuous",
                "intersection-v1",
                {},
                "intersection-v1 as it comes: throttle and steering at 1 Hz, tyres that slip, 13 s",
                road=False,
            ),
            Setting(
                "hanoi-highway",
                "highway-v0",
                {
                    **_HANOI,
                    "action": {"type": "ContinuousAction"},
                    "lanes_count": 4,
                    "vehicles_count": 50,
                    "vehicles_density": 1.5,
                    "duration": 40,
                },
                "HanoiWorld's highway: throttle and steering at 5 Hz, 15 Hz, 50 vehicles at density 1.5, 40 s",
            ),
            Setting(
                "hanoi-merge",
                "merge-v0",
                {**_HANOI, "duration": 50},
                "HanoiWorld's merge: meta-actions at 5 Hz, 15 Hz",
            ),
            Setting(
                "hanoi-roundabout",
                "roundabout-v0",
                {**_HANOI, "duration": 15},
                "HanoiWorld's roundabout: meta-actions at 5 Hz, 15 Hz, 15 s",
            ),
            Setting(
                "complex-roads",
                "evaluation.scenarios:ComplexRoads-v0",
                {"random_start": True, "offroad_terminal": True, "duration": 120},
                "ComplexRoads-v0: 5x9 throttle and steering at 5 Hz, 15 Hz, any spawn, ends off the road, 120 s",
                road=False,
            ),
            Setting("racetrack", "racetrack-v0", {}, "racetrack-v0 as it comes: steering alone, 5 Hz, 15 Hz, 300 s"),
            Setting("racetrack-minute", "racetrack-v0", {"duration": 60}, "the first 60 s of racetrack-v0"),
            Setting(
                "lane-keeping",
                "evaluation.scenarios:lane-keeping-half-minute-v0",
                {},
                "30 s of lane-keeping-v0: steering alone, tyres that slip, nobody else, 10 Hz",
                road=False,
            ),
        )
    }
)
"""The named settings."""


def setting_of(env_id: str, config: Path | None = None) -> Setting:
    """Any environment as a setting: its Gymnasium id ("module:id" imports a module first), and a TOML file of what
    differs from the configuration that it is registered with.

    An id that ends in a grid of actions, such as "highway-v0+5x9", has these (`Setting.with_action_grid`).

    Raises
    ------
    ConfigError
        If there is no such file, it is no TOML, or the grid is none.
    """
    env_id, _, grid = env_id.partition("+")
    found = _setting_of(env_id, config)
    return found.with_action_grid(grid) if grid else found


def _setting_of(env_id: str, config: Path | None) -> Setting:
    if config is None:
        return Setting(env_id, env_id)
    try:
        keys = tomllib.loads(config.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"there is no environment configuration {config}") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{config} is no TOML file: {error}") from None
    return Setting(f"{env_id}+{config.stem}", env_id, keys)


def get_setting(name: str) -> Setting:
    """The setting of that name; a `ConfigError` that lists the names if there is none.

    A name that ends in a grid of actions, such as "highway-fast+5x9", has these (`Setting.with_action_grid`).
    """
    name, _, grid = name.partition("+")
    check_name("setting", name, sorted(SETTINGS))
    return SETTINGS[name].with_action_grid(grid) if grid else SETTINGS[name]
