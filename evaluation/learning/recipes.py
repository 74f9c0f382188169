"""The recipes of the reference policies in `evaluation.policies`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from evaluation.names import check_name

__all__ = ["RECIPES", "Recipe", "get_recipe"]


@dataclass(frozen=True)
class Recipe:
    """Arguments of `train` for one reference policy.

    Attributes
    ----------
    name : name of the policy and of its file.
    setting : a name in `evaluation.settings.SETTINGS`.
    algorithm : a name in `ALGORITHMS`.
    steps : environment steps (decisions).
    seed : training seed.
    hyperparameters : keyword arguments of the algorithm.
    description : description in one line.
    normalise, exploration, fast, shield, sensor : as in `train`.
    """

    name: str
    setting: str
    algorithm: str
    steps: int
    seed: int
    hyperparameters: Mapping[str, Any] = field(hash=False)
    description: str = ""
    normalise: tuple[str, ...] = ()
    exploration: tuple[float, ...] = ()
    fast: bool = False
    shield: str = "none"
    sensor: str = "exact"


# Hyperparameters of highway-env's own examples, except the discount factor of the DQNs. A recipe has a seed other than
# 0 if the policy of seed 0 missed the recipe's purpose on traffic seeds 0 to 49. The purpose is a PPO that crashes now
# and then, or an adversary that crashes nearly always.
_PPO_HIGHWAY: dict[str, Any] = {
    "policy_kwargs": {"net_arch": {"pi": [256, 256], "vf": [256, 256]}},
    "n_steps": 160,
    "batch_size": 64,
    "n_epochs": 10,
    "learning_rate": 5e-4,
    "gamma": 0.8,
}
_DQN_ABZ: dict[str, Any] = {
    "policy_kwargs": {"net_arch": [256, 256]},
    "learning_rate": 5e-4,
    "buffer_size": 15_000,
    "learning_starts": 200,
    "batch_size": 32,
    "gamma": 0.9,
    "train_freq": 1,
    "gradient_steps": 1,
    "target_update_interval": 50,
}

# Steering has a range of 45 degrees to each side, and at 25 m/s 2 degrees move a car sideways by 9 m in two seconds. So
# steering is explored in a narrow range and the throttle in a wide one; otherwise one of the two is not learned.
_PPO_CONTINUOUS: dict[str, Any] = {
    "policy_kwargs": {"net_arch": [64, 64]},
    "n_steps": 1024,
    "batch_size": 64,
    "n_epochs": 10,
    "learning_rate": 5e-4,
    "gamma": 0.98,
}
_PPO_RACETRACK: dict[str, Any] = {
    "policy_kwargs": {"net_arch": [128, 128], "log_std_init": -1.0},
    "n_steps": 1024,
    "batch_size": 64,
    "n_epochs": 10,
    "learning_rate": 5e-4,
    "gamma": 0.98,
    "ent_coef": 0.003,
}

_PPO_ROADS: dict[str, Any] = {
    "policy_kwargs": {"net_arch": [64, 64]},
    "n_steps": 256,
    "batch_size": 64,
    "n_epochs": 10,
    "learning_rate": 5e-4,
    "gamma": 0.9,
}

# Hyperparameters of Dong et al. 2023; those that the paper does not name are Stable-Baselines3's defaults.
_DQN_COMPLEX: dict[str, Any] = {"learning_rate": 1e-4, "buffer_size": 50_000}
_TRPO_COMPLEX: dict[str, Any] = {"gamma": 0.99, "n_steps": 1024, "target_kl": 0.01}

RECIPES: Mapping[str, Recipe] = MappingProxyType(
    {
        recipe.name: recipe
        for recipe in (
            Recipe(
                "ppo-highway-fast",
                "highway-fast",
                "ppo",
                10_000,
                1,
                _PPO_HIGHWAY,
                "PPO on highway-fast-v0 as it comes: drives, and crashes now and then",
            ),
            Recipe(
                "dqn-abz-base",
                "abz",
                "dqn",
                20_000,
                0,
                _DQN_ABZ,
                "DQN on the ABZ 2025 highway, crash reward -1",
            ),
            Recipe(
                "dqn-abz-adversarial",
                "abz-adversarial",
                "dqn",
                20_000,
                1,
                _DQN_ABZ,
                "DQN on the ABZ 2025 highway, crash reward +1: it has learned to crash",
            ),
            Recipe(
                "ppo-highway-continuous",
                "highway-continuous-training",
                "ppo",
                24_576,
                0,
                _PPO_CONTINUOUS,
                "PPO for highway-continuous, trained at half its rates: keeps to the road, often crashes",
                normalise=("observations", "rewards"),
                exploration=(0.4, 0.06),
                fast=True,
            ),
            Recipe(
                "ppo-racetrack",
                "racetrack",
                "ppo",
                49_152,
                0,
                _PPO_RACETRACK,
                "PPO on racetrack-v0 as it comes: keeps to the track, often hits another car",
                normalise=("rewards",),
                fast=True,
            ),
            Recipe(
                "ppo-roundabout",
                "roundabout",
                "ppo",
                12_800,
                0,
                _PPO_ROADS,
                "PPO on roundabout-v0 as it comes",
            ),
            Recipe("ppo-merge", "merge", "ppo", 12_800, 0, _PPO_ROADS, "PPO on merge-v0 as it comes"),
            Recipe(
                "ppo-intersection",
                "intersection",
                "ppo",
                12_800,
                0,
                _PPO_ROADS,
                "PPO on intersection-v0 as it comes",
            ),
            *(
                Recipe(
                    f"ppo-{sensor}",
                    "highway-fast-seen",
                    "ppo",
                    20_000,
                    0,
                    {**_PPO_HIGHWAY, "policy_kwargs": {"net_arch": [64, 64]}},
                    f"PPO on highway-fast-v0 that sees 15 vehicles, the sensor {sensor}",
                    sensor=sensor,
                )
                for sensor in ("exact", "metric-0.5", "metric-2-late", "normalised-0.2", "normalised-0.5")
            ),
            *(
                Recipe(
                    f"{algorithm}-complex-roads" + ("" if shield == "none" else "-shielded"),
                    "complex-roads",
                    algorithm,
                    100_000,
                    0,
                    parameters,
                    f"{algorithm.upper()} on ComplexRoads-v0" + ("" if shield == "none" else ", inside the shield"),
                    shield=shield,
                )
                for algorithm, parameters in (("dqn", _DQN_COMPLEX), ("trpo", _TRPO_COMPLEX))
                for shield in ("none", "exact")
            ),
        )
    }
)
"""The recipes of the reference policies in `evaluation.policies`."""


def get_recipe(name: str) -> Recipe:
    """The recipe with that name; raises a `ConfigError` with the valid names if there is none."""
    check_name("recipe", name, sorted(RECIPES))
    return RECIPES[name]
