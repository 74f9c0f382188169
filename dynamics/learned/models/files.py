"""Models on disk: a folder with config.json and weights.pt. Only tensors are unpickled."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from dynamics.errors import ConfigError, ModelError
from dynamics.learned.models.linear import LinearStructuredModel, ModelConfig

__all__ = ["CONFIG_FILE", "FORMAT", "WEIGHTS_FILE", "load_model", "read_config", "save_model"]

FORMAT = "linear-structured-model/1"
"""Value of the key "format" in config.json."""
CONFIG_FILE, WEIGHTS_FILE = "config.json", "weights.pt"


def save_model(model: LinearStructuredModel, folder: str | Path, notes: Mapping[str, Any] | None = None) -> Path:
    """Write a model's configuration and weights.

    Parameters
    ----------
    folder : created if missing; a model in it is replaced.
    notes : JSON values to store with it, such as the parameters of its training.

    Raises
    ------
    ModelError
        If a weight is not finite.
    """
    model.require_finite()
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    buffer = io.BytesIO()
    torch.save(model.state_dict(), buffer)
    weights = buffer.getvalue()
    config = {
        "format": FORMAT,
        "model": model.config.to_json(),
        "weights_sha256": hashlib.sha256(weights).hexdigest(),
        "notes": dict(notes or {}),
    }
    (folder / WEIGHTS_FILE).write_bytes(weights)
    (folder / CONFIG_FILE).write_text(json.dumps(config, indent=2) + "\n", encoding="utf-8")
    return folder


def read_config(folder: str | Path) -> dict[str, Any]:
    """The JSON of a saved model, its notes included.

    Raises
    ------
    ModelError
        If it is missing, damaged or has another format.
    """
    path = Path(folder, CONFIG_FILE)
    try:
        config = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ModelError(f"{folder} is no model: a model is a folder with {CONFIG_FILE} and {WEIGHTS_FILE}") from None
    except (OSError, ValueError) as error:
        raise ModelError(f"{path} cannot be read: {error}") from error
    if not isinstance(config, dict) or config.get("format") != FORMAT:
        found = config.get("format") if isinstance(config, dict) else config
        raise ModelError(f"{path} says format {found!r}; {FORMAT!r} can be read")
    return config


def load_model(folder: str | Path) -> LinearStructuredModel:
    """Read a model that `save_model` wrote.

    Raises
    ------
    ModelError
        If a file is missing, damaged, foreign, or of another model, or a weight is not finite.
    """
    config = read_config(folder)
    path = Path(folder, WEIGHTS_FILE)
    try:
        weights = path.read_bytes()
    except OSError as error:
        raise ModelError(f"{path} cannot be read: {error}") from error
    if hashlib.sha256(weights).hexdigest() != config.get("weights_sha256"):
        raise ModelError(f"{path} is not the file that {CONFIG_FILE} was written with: its checksum differs")
    try:
        model = LinearStructuredModel(ModelConfig.from_json(config.get("model")))
        model.load_state_dict(torch.load(io.BytesIO(weights), weights_only=True))
    except ConfigError as error:
        raise ModelError(f"{Path(folder, CONFIG_FILE)}: {error}") from error
    except Exception as error:
        raise ModelError(f"{path} holds no weights of this model: {error}") from error
    model.eval().requires_grad_(False)
    model.require_finite()
    return model
