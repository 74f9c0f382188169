"""The two readings of the report, as data: its text, and its published script."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from types import MappingProxyType
from typing import Any

from evaluation.names import check_name
from evaluation.reproduction.text import HIGHWAY, ROUNDABOUT, Scale
from evaluation.settings import Setting
from evaluation.wrappers.skills import REPORT_SKILLS

__all__ = [
    "PRESETS",
    "PUBLISHED",
    "PUBLISHED_ROUNDABOUT",
    "ROUNDABOUT_PRESETS",
    "Preset",
    "PublishedFigures",
    "get_preset",
    "published_for",
]


@dataclass(frozen=True)
class PublishedFigures:
    """A row of the report's table.

    Attributes
    ----------
    label : name of the row.
    mean, deviation : mean and standard deviation of the return.
    crash_rate : crash rate of the episodes.
    confidence : the logged confidence.
    episodes : number of episodes.
    """

    label: str
    mean: float
    deviation: float | None
    crash_rate: float
    confidence: float | None = None
    episodes: int = 10


@dataclass(frozen=True)
class Preset:
    """One reading of the report.

    Attributes
    ----------
    name, description : name, and description in one line.
    setting : the environment.
    envs : number of environments in PPO's training.
    hyperparameters : hyperparameters of PPO.
    sigma : standard deviation of the noise, in normalised units.
    noise : "all rows", with the ego's and absent ones, or "others".
    confidence : "features", across the four features of a row, or "time".
    intent : "normalised", with a threshold on the normalised speed, or "metres".
    override : "score" (`script.overriding_action`), or "lane changes" (`text.override_lane_changes`).
    skills : names and primitive actions of the skills.
    interrupted : whether a skill ends as soon as a vehicle is nearer than `distance`; otherwise it is gated at its
        start.
    steps : number of decisions of training.
    distance : distance of the override rule and of interrupted skills [m]; a choice, because the report has no value.
    road : "highway" or "roundabout".
    scale : scale of its observations.
    """

    name: str
    description: str
    setting: Setting
    envs: int
    hyperparameters: Mapping[str, Any] = field(hash=False)
    sigma: float
    noise: str
    confidence: str
    intent: str
    override: str
    skills: Mapping[str, tuple[int, ...]] = field(hash=False)
    interrupted: bool
    steps: int = 10_000
    distance: float = 20.0
    road: str = "highway"
    scale: Scale = HIGHWAY

    @property
    def gamma(self) -> float:
        """Discount of a decision, for all learners."""
        return float(self.hyperparameters["gamma"])

    def as_dict(self) -> dict[str, Any]:
        """The values that determine episodes, as plain values."""
        left_out = {"description"} | ({"road", "scale"} if self.road == "highway" else set())
        plain = {each.name: getattr(self, each.name) for each in fields(self) if each.name not in left_out}
        if "scale" in plain:
            plain["scale"] = asdict(self.scale)
        setting = {"id": self.setting.env_id, "configuration": dict(self.setting.config)}
        return {**plain, "setting": setting, "hyperparameters": dict(self.hyperparameters), "skills": dict(self.skills)}


_PPO: dict[str, Any] = {"learning_rate": 5e-4, "batch_size": 64, "n_steps": 1024, "n_epochs": 10}

PRESETS: Mapping[str, Preset] = MappingProxyType(
    {
        preset.name: preset
        for preset in (
            Preset(
                name="as-coded",
                description="what the published script does, its mistakes included",
                setting=Setting("highway-fast", "highway-fast-v0", {}),
                envs=1,
                hyperparameters={
                    **_PPO,
                    "gamma": 0.8,
                    "policy_kwargs": {"net_arch": {"pi": [256] * 2, "vf": [256] * 2}},
                },
                sigma=0.5,
                noise="all rows",
                confidence="features",
                intent="normalised",
                override="score",
                skills=REPORT_SKILLS,
                interrupted=False,
            ),
            Preset(
                name="as-written",
                description="what the text says",
                setting=Setting(
                    "highway-hard",
                    "highway-v0",
                    {
                        "lanes_count": 4,
                        "vehicles_count": 50,
                        "vehicles_density": 1,
                        "duration": 40,
                        "policy_frequency": 10,
                        "simulation_frequency": 30,
                        "other_vehicles_type": "highway_env.vehicle.behavior.AggressiveVehicle",
                        "collision_reward": -10,
                        "lane_change_reward": -0.2,
                        "right_lane_reward": 0.3,
                        "high_speed_reward": 1.0,
                        "reward_speed_range": [25, 35],
                        "normalize_reward": False,
                    },
                ),
                envs=4,
                hyperparameters={**_PPO, "gamma": 0.99, "policy_kwargs": {"net_arch": [256, 256]}},
                sigma=0.2,
                noise="others",
                confidence="time",
                intent="metres",
                override="lane changes",
                skills={
                    "FOLLOW": (1, 1, 1, 1),
                    "OVERTAKE_LEFT": (0, 3, 3, 2),
                    "OVERTAKE_RIGHT": (2, 3, 3, 0),
                    "SLOW_DOWN": (4, 4, 4, 4),
                    "KEEP_RIGHT": (2, 2, 1, 1),
                },
                interrupted=True,
            ),
        )
    }
)
"""Presets of the highway, by name."""

_AS_CODED, _AS_WRITTEN = PRESETS["as-coded"], PRESETS["as-written"]

ROUNDABOUT_PRESETS: Mapping[str, Preset] = MappingProxyType(
    {
        "as-coded": replace(
            _AS_CODED,
            name="roundabout-as-coded",
            setting=Setting(
                "roundabout-as-coded",
                "roundabout-v0",
                {
                    "duration": 60,
                    "simulation_frequency": 15,
                    "policy_frequency": 15,
                    "action": {"type": "DiscreteMetaAction", "target_speeds": [20, 25, 30]},
                    "other_vehicles_type": "highway_env.vehicle.behavior.AggressiveVehicle",
                    "collision_reward": -5,
                    "lane_change_reward": -0.1,
                    "reward_speed_range": [20, 30],
                    "normalize_reward": False,
                },
                "the report's hard roundabout as its script makes it: the car cannot stop",
            ),
            sigma=0.2,
            road="roundabout",
            scale=ROUNDABOUT,
        ),
        "as-written": replace(
            _AS_WRITTEN,
            name="roundabout-as-written",
            setting=Setting("roundabout-60", "roundabout-v0", {"duration": 60}),
            road="roundabout",
            scale=ROUNDABOUT,
        ),
    }
)
"""Presets of the roundabout, by name."""

PUBLISHED: Mapping[str, PublishedFigures] = MappingProxyType(
    {
        "ppo": PublishedFigures("PPO", 21.54, 0.72, 0.00),
        "noise": PublishedFigures("noise", 16.97, 7.68, 0.30, 0.736),
        "noise-intent": PublishedFigures("noise + intent", 20.79, 2.79, 0.20),
        "noise-override": PublishedFigures("+ safety", 8.78, 6.39, 0.90, 0.737),
        "noise-override-skills": PublishedFigures("+ safety + skills", 21.28, 0.90, 0.00, 0.731),
    }
)
"""Rows of the report's table of the highway, by variant (see `evaluation.reproduction.variants`)."""

PUBLISHED_ROUNDABOUT: Mapping[str, PublishedFigures] = MappingProxyType(
    {
        "provided-baseline": PublishedFigures("provided baseline", 9.17, None, 0.00),
        "ppo": PublishedFigures("PPO", 16.88, 9.78, 0.30),
        "noise": PublishedFigures("noise", 11.43, 9.79, 0.40, 0.806),
        "noise-intent": PublishedFigures("noise + intent", 20.46, 7.00, 0.10),
        "noise-override": PublishedFigures("+ safety", 7.28, 9.14, 0.50, 0.816),
        "noise-override-skills": PublishedFigures("+ safety + skills", 8.45, 9.53, 0.50, 0.007),
    }
)
"""Rows of its table of the roundabout; the first row has no deviation."""


def published_for(preset: str) -> Mapping[str, PublishedFigures]:
    """The published rows for a preset, by its `Preset.name`."""
    return PUBLISHED_ROUNDABOUT if preset.startswith("roundabout") else PUBLISHED


def get_preset(name: str, road: str = "highway") -> Preset:
    """The preset of that name on a road, "highway" or "roundabout".

    Raises
    ------
    ConfigError
        With the valid names.
    """
    presets = ROUNDABOUT_PRESETS if road == "roundabout" else PRESETS
    check_name("preset", name, presets)
    return presets[name]
