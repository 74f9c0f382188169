"""A table of drivers on frames and of drivers that need none, bare and behind the shield, on the same seeds."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from dynamics.world_model.config import WorldModelConfig
from dynamics.world_model.files import CONFIG_FILE
from evaluation.learning.algorithms import load_model
from evaluation.learning.manifests import manifest_path
from evaluation.measuring.statistics import bootstrap_mean, wilson
from evaluation.running.frame_episodes import FrameEpisodes, drive_frames, frame_world
from evaluation.running.named_policies import ConstantPolicy, Policy
from evaluation.settings import Setting
from mpc.latent.files import load_driver
from shield.config import PROFILES, ShieldConfig
from shield.errors import ConfigError, PolicyError

__all__ = ["BASELINES", "RandomDriver", "frame_table", "load_frame_driver"]

BASELINES = ("random", "slower", "faster", "stopped")
"""Drivers that read no frame: uniform actions, always SLOWER, always FASTER, and a car that stops."""
_FASTER, _SLOWER = 3, 4
_STOPPING = (0, 5, 10, 15, 20, 25, 30)
"""Target speeds with which always SLOWER stops [m/s]; the setting's own ones may begin at 20."""
_SIDE_BY_SIDE = 128


class RandomDriver:
    """Uniform actions for a batch, the same for the same seed.

    Parameters
    ----------
    actions : number of actions. seed : of all actions.
    """

    def __init__(self, actions: int, seed: int = 0) -> None:
        self._actions, self._rng = actions, np.random.default_rng(seed)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """An action for each of the observations."""
        return self._rng.integers(self._actions, size=len(observation)), state


def load_frame_driver(path: str | Path, lookahead: int = 0) -> Policy:
    """A latent driver from its folder, or a Stable-Baselines3 model from its zip file.

    Raises
    ------
    ConfigError
        If the path is neither.
    ModelError, PolicyError
        If the file is damaged or foreign.
    """
    path = Path(path)
    if (path / CONFIG_FILE).is_file():
        return load_driver(path, lookahead)
    if path.suffix != ".zip" or not path.is_file():
        raise ConfigError(f"{path} is no driver: neither a folder of `shield world-model train` nor an SB3 .zip file")
    manifest = manifest_path(path)
    algorithm = json.loads(manifest.read_text(encoding="utf-8")).get("algorithm") if manifest.is_file() else None
    model: Policy = load_model(path, algorithm, None)
    space: Any = getattr(model, "observation_space", None)
    if getattr(space, "shape", None) != WorldModelConfig().shape:
        raise PolicyError(f"{path} observes {space}, not frames of shape {WorldModelConfig().shape}")
    return model


def frame_table(
    drivers: Sequence[str],
    setting: Setting,
    seeds: range,
    shields: Sequence[str] = ("none", "default"),
    lookahead: int = 0,
    tell: Callable[[str], None] | None = None,
) -> pd.DataFrame:
    """Drive every driver with every shield.

    Parameters
    ----------
    drivers : names in `BASELINES`, and paths (see `load_frame_driver`).
    setting, seeds : a straight highway with meta-actions, and an episode for each seed.
    shields : "none", and names of `ShieldConfig.profile`.
    lookahead : see `LatentDriver`.
    tell : called with the name of each row before it is driven.

    Returns
    -------
    A row for each: driver, shield, episodes, crash rate with its 95 % Wilson interval, return with its 95 % bootstrap
    interval, mean speed [m/s], and the share of overridden decisions. A stopped car has a setting of its own, with
    target speeds from 0 on, and is driven bare.

    Raises
    ------
    ConfigError
        On an unknown driver or shield, or a setting without a compiled copy.
    """
    for shield in shields:
        if shield not in ("none", *PROFILES):
            raise ConfigError(f"unknown shield {shield!r}; have none, {', '.join(PROFILES)}")
    loaded = {name: None if name in BASELINES else load_frame_driver(name, lookahead) for name in drivers}
    rows = []
    for name, driver in loaded.items():
        for shield in shields:
            if name == "stopped" and shield != "none":
                continue
            if tell is not None:
                tell(f"{name}, {shield}")
            rows.append(
                {"driver": _label(name), "shield": shield, **_row(_driven(name, driver, setting, seeds, shield))}
            )
    return pd.DataFrame(rows)


def _driven(name: str, driver: Policy | None, setting: Setting, seeds: range, shield: str) -> FrameEpisodes:
    if name == "stopped":
        action = {"type": "DiscreteMetaAction", "target_speeds": list(_STOPPING)}
        setting = replace(setting, config={**setting.config, "action": action})
    config = None if shield == "none" else ShieldConfig.profile(shield)
    view = WorldModelConfig().view if driver is None or not hasattr(driver, "model") else driver.model.config.view
    world = frame_world(setting, min(len(seeds), _SIDE_BY_SIDE), view, config)
    if driver is None:
        constant = {"slower": _SLOWER, "stopped": _SLOWER, "faster": _FASTER}
        actions: Any = world.action_space
        driver = RandomDriver(int(actions.n)) if name == "random" else ConstantPolicy(constant[name])
    return drive_frames(driver, world, seeds)


def _row(episodes: FrameEpisodes) -> dict[str, Any]:
    crash = wilson(int(episodes.crashed.sum()), len(episodes.crashed))
    returned = bootstrap_mean(episodes.returns)
    return {
        "episodes": crash.n,
        "crash": crash.estimate,
        "crash_low": crash.low,
        "crash_high": crash.high,
        "return": returned.estimate,
        "return_low": returned.low,
        "return_high": returned.high,
        "speed": float(episodes.speed.mean()),
        "overridden": episodes.override_share,
    }


def _label(name: str) -> str:
    """Name in the table: of a path its last part."""
    return name if name in BASELINES else Path(name).stem
