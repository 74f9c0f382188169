"""World models and drivers on disk: a folder with config.json and weights.safetensors. Nothing is unpickled."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import nn

from dynamics.errors import ConfigError, ModelError
from dynamics.world_model.config import WorldModelConfig
from dynamics.world_model.model import WorldModel

__all__ = [
    "CONFIG_FILE",
    "FORMAT",
    "WEIGHTS_FILE",
    "load_weights",
    "load_world_model",
    "read_config",
    "save_parts",
    "save_world_model",
]

FORMAT = "world-model/1"
"""Value of the key "format" in config.json."""
CONFIG_FILE, WEIGHTS_FILE = "config.json", "weights.safetensors"
WORLD_MODEL = "world_model"
"""Name of the world model among the parts of a checkpoint."""


def save_world_model(model: WorldModel, folder: str | Path, notes: Mapping[str, Any] | None = None) -> Path:
    """Write a world model's configuration and weights; see `save_parts`."""
    return save_parts({WORLD_MODEL: (model, model.config.to_json())}, folder, notes)


def save_parts(
    parts: Mapping[str, tuple[nn.Module, Mapping[str, Any]]],
    folder: str | Path,
    notes: Mapping[str, Any] | None = None,
) -> Path:
    """Write a checkpoint.

    Parameters
    ----------
    parts : networks by name, each with its configuration as JSON values.
    folder : created if missing; a checkpoint in it is replaced.
    notes : JSON values to store with it, such as the parameters of the training.

    Raises
    ------
    ModelError
        If a weight is not finite.
    """
    tensors = {
        f"{part}.{name}": weight.detach().contiguous()
        for part, (network, _) in parts.items()
        for name, weight in network.state_dict().items()
    }
    for name, weight in tensors.items():
        if not torch.isfinite(weight).all():
            raise ModelError(f"the weight {name!r} is not finite")
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    weights = save(tensors)
    config = {
        "format": FORMAT,
        **{part: dict(values) for part, (_, values) in parts.items()},
        "weights_sha256": hashlib.sha256(weights).hexdigest(),
        "notes": dict(notes or {}),
    }
    (folder / WEIGHTS_FILE).write_bytes(weights)
    (folder / CONFIG_FILE).write_text(json.dumps(config, indent=2) + "\n", encoding="utf-8")
    return folder


def read_config(folder: str | Path) -> dict[str, Any]:
    """The JSON of a checkpoint, its notes included.

    Raises
    ------
    ModelError
        If it is missing, damaged or has another format.
    """
    path = Path(folder, CONFIG_FILE)
    try:
        config = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ModelError(f"{folder} is no checkpoint: it is a folder with {CONFIG_FILE} and {WEIGHTS_FILE}") from None
    except (OSError, ValueError) as error:
        raise ModelError(f"{path} cannot be read: {error}") from error
    if not isinstance(config, dict) or config.get("format") != FORMAT:
        found = config.get("format") if isinstance(config, dict) else config
        raise ModelError(f"{path} says format {found!r}; {FORMAT!r} can be read")
    return config


def load_weights(folder: str | Path, parts: Mapping[str, nn.Module]) -> None:
    """Read the weights of networks that `save_parts` wrote into networks of the same form.

    Raises
    ------
    ModelError
        If the file is missing, damaged, or of other networks, or a weight is not finite.
    """
    path = Path(folder, WEIGHTS_FILE)
    try:
        weights = path.read_bytes()
    except OSError as error:
        raise ModelError(f"{path} cannot be read: {error}") from error
    if hashlib.sha256(weights).hexdigest() != read_config(folder).get("weights_sha256"):
        raise ModelError(f"{path} is not the file that {CONFIG_FILE} was written with: its checksum differs")
    try:
        tensors = load(weights)
        for part, network in parts.items():
            own = {name.removeprefix(f"{part}."): w for name, w in tensors.items() if name.startswith(f"{part}.")}
            network.load_state_dict(own)
    except (SafetensorError, RuntimeError, ValueError) as error:
        raise ModelError(f"{path} holds no weights of these networks: {error}") from error
    for name, weight in tensors.items():
        if not torch.isfinite(weight).all():
            raise ModelError(f"{path}: the weight {name!r} is not finite")


def load_world_model(folder: str | Path) -> WorldModel:
    """Read a world model that `save_world_model` wrote, alone or in a driver's checkpoint.

    Raises
    ------
    ModelError
        If a file is missing, damaged, foreign, or of another model, or a weight is not finite.
    """
    model = WorldModel(world_model_config(read_config(folder), folder))
    load_weights(folder, {WORLD_MODEL: model})
    model.eval().requires_grad_(False)
    return model


def world_model_config(config: Mapping[str, Any], folder: str | Path) -> WorldModelConfig:
    """The world model's configuration in the JSON of a checkpoint.

    Raises
    ------
    ModelError
        If it is not valid.
    """
    try:
        return WorldModelConfig.from_json(config.get(WORLD_MODEL))
    except ConfigError as error:
        raise ModelError(f"{Path(folder, CONFIG_FILE)}: {error}") from error
