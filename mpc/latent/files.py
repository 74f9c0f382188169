"""Latent drivers on disk: the world model, the actor and the critic in one checkpoint."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dynamics.errors import ConfigError, ModelError
from dynamics.world_model.files import (
    CONFIG_FILE,
    WORLD_MODEL,
    load_weights,
    read_config,
    save_parts,
    world_model_config,
)
from dynamics.world_model.model import WorldModel
from mpc.latent.actor_critic import ActorCritic, DriverConfig
from mpc.latent.driver import LatentDriver

__all__ = ["load_driver", "save_driver"]

_DRIVER = "driver"


def save_driver(driver: LatentDriver, folder: str | Path, notes: Mapping[str, Any] | None = None) -> Path:
    """Write a driver's configurations and weights; see `dynamics.world_model.files.save_parts`."""
    model, networks = driver.model, driver.networks
    parts = {WORLD_MODEL: (model, model.config.to_json()), _DRIVER: (networks, networks.config.to_json())}
    return save_parts(parts, folder, notes)


def load_driver(folder: str | Path, lookahead: int = 0) -> LatentDriver:
    """Read a driver that `save_driver` wrote.

    Raises
    ------
    ConfigError
        If `lookahead` is negative.
    ModelError
        If a file is missing, damaged, foreign, or of other networks, or a weight is not finite.
    """
    config = read_config(folder)
    model = WorldModel(world_model_config(config, folder))
    if _DRIVER not in config:
        raise ModelError(f"{folder} is a world model without a driver")
    try:
        settings = DriverConfig.from_json(config[_DRIVER])
    except ConfigError as error:
        raise ModelError(f"{Path(folder, CONFIG_FILE)}: {error}") from error
    networks = ActorCritic(settings, model.config.features, model.config.actions)
    load_weights(folder, {WORLD_MODEL: model, _DRIVER: networks})
    for network in (model, networks):
        network.eval().requires_grad_(False)
    return LatentDriver(model, networks, lookahead)
