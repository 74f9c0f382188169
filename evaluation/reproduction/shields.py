"""Shields to compare on each road: the road's bundled model, and the variant of the shield."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, cast

from evaluation.reproduction.presets import get_preset
from evaluation.running.records import ShieldVariant, config_on
from evaluation.settings import Setting, get_setting
from shield.config import RULES_ALONE, SIMULATED, WORST_CASE, ShieldConfig
from shield.errors import ConfigError

__all__ = [
    "BASELINES",
    "MOST",
    "ROADS",
    "SHIELDS",
    "ShieldTableRoad",
    "driven_on",
    "rows_of",
    "variant_on",
]


@dataclass(frozen=True)
class ShieldTableRoad:
    """A road and the bundled model that drives it.

    Attributes
    ----------
    name, setting : name and environment.
    policy : name of the model.
    baselines : whether the road has rows of the policies without observations.
    """

    name: str
    setting: Setting
    policy: str
    baselines: bool = True


ROADS: Mapping[str, ShieldTableRoad] = MappingProxyType(
    {
        each.name: each
        for each in (
            ShieldTableRoad("highway-fast", get_setting("highway-fast"), "ppo-highway-fast"),
            ShieldTableRoad("abz", get_setting("abz-idm"), "dqn-abz-base"),
            ShieldTableRoad("abz-adversarial", get_setting("abz-idm"), "dqn-abz-adversarial", baselines=False),
            ShieldTableRoad("merge", get_setting("merge"), "ppo-merge"),
            ShieldTableRoad("roundabout", get_setting("roundabout"), "ppo-roundabout"),
            ShieldTableRoad("intersection", get_setting("intersection"), "ppo-intersection"),
            ShieldTableRoad("racetrack", get_setting("racetrack"), "ppo-racetrack"),
        )
    }
)
"""Roads by name. Both ABZ agents drive on the same road, which has the rows of the baselines once."""

BASELINES: Mapping[str, str] = MappingProxyType(
    {
        "slower": "always SLOWER, no shield",
        "idle": "always IDLE, no shield",
        "faster": "always FASTER, no shield",
        "stopped": "a car that stops, no shield",
    }
)
"""Policies that ignore observations, by name."""

SHIELDS: Mapping[str, str] = MappingProxyType(
    {
        "none": "no shield",
        "distance": "the report's override as written: SLOWER in place of a lane change with a car nearer than 20 m",
        "rss": "gaps of RSS, else SLOWER",
        "ttc-ranking": "time to collision over four decisions, down the policy's ranking to the first action that "
        "keeps it, else SLOWER (ABZ's kind)",
        "worst-case": "`ShieldedEnv` against anything that the rules of the road allow",
        "simulated": "`ShieldedEnv` in simulated traffic",
        "observed": "`ShieldedEnv` from observations alone",
        **BASELINES,
    }
)
"""Rows of the table, by name."""

_TTC_DECISIONS = 4
_STOPPING = [0, 15, 30]
_NETWORKS = ("merge", "roundabout", "intersection")
MOST: Mapping[tuple[str, str], int] = MappingProxyType(
    {
        **{(road, "observed"): 300 for road in ("highway-fast", "abz", "abz-adversarial")},
        **{(road, "worst-case"): 100 for road in _NETWORKS},
        ("racetrack", "worst-case"): 20,
        ("racetrack", "simulated"): 20,
    }
)
"""Largest number of episodes, by road and row, if an episode takes 0.2 to 20 CPU seconds."""


def variant_on(road: ShieldTableRoad, shield: str) -> ShieldVariant:
    """The variant of the shield in a row of `SHIELDS` on a road.

    Raises
    ------
    ConfigError
        If the road does not support that shield.
    """
    if shield == "none" or shield in BASELINES:
        return ShieldVariant()
    if shield in RULES_ALONE and road.name in _NETWORKS:
        raise ConfigError("a rule alone reads one road of straight parallel lanes")
    if shield == "distance":
        return ShieldVariant("env", ShieldConfig(mode="distance", distance=get_preset("as-written").distance))
    if shield == "rss":
        return ShieldVariant("env", ShieldConfig(mode="rss"))
    if shield == "ttc-ranking":
        seconds = _TTC_DECISIONS / _configuration(road.setting)["policy_frequency"]
        return ShieldVariant("env", ShieldConfig(mode="ttc-ranking", time_to_collision=seconds))
    if shield == "observed":
        return ShieldVariant("env", config_on(road.setting, None, observes=True), "observation")
    given = {"worst-case": WORST_CASE, "simulated": SIMULATED}[shield]
    return ShieldVariant("env", config_on(road.setting, given), note=shield)


def driven_on(road: ShieldTableRoad, shield: str) -> tuple[Setting, str]:
    """The environment and the policy of a row of `SHIELDS`.

    Raises
    ------
    ConfigError
        If the road does not support that baseline.
    """
    if shield not in BASELINES:
        return road.setting, road.policy
    if shield != "stopped":
        return road.setting, shield
    configuration = _configuration(road.setting)
    if "duration" not in configuration:
        raise ConfigError("an episode ends at a place on this road, which a car that stops does not reach")
    action = configuration["action"]
    if action["type"] != "DiscreteMetaAction":
        raise ConfigError("a car that stops is always SLOWER with a target speed of 0, which needs meta-actions")
    stopping = {"action": {**action, "target_speeds": _STOPPING}}
    return road.setting.override(stopping, name=f"{road.setting.name}, stopping"), "slower"


def _configuration(setting: Setting) -> Mapping[str, Any]:
    env = setting.make()
    try:
        return dict(cast(Any, env.unwrapped).config)
    finally:
        env.close()


def rows_of(road: ShieldTableRoad, shields: Iterable[str]) -> list[str]:
    """The rows of `shields` that a road has."""
    return [each for each in shields if road.baselines or each not in BASELINES]
