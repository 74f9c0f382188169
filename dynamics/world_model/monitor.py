"""`SafetyMonitor`: the probability, for each action, that no verified continuation exists after it, from a bird's-eye
frame.

The labels come from the simulated traffic (`evaluation.training.safety_labels`). The monitor itself reads frames only.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from dynamics.errors import ConfigError, ModelError
from dynamics.state import FloatArray
from dynamics.world_model.config import STRIDE, check_keys
from dynamics.world_model.files import load_weights, read_config, save_parts
from dynamics.world_model.networks import Encoder, mlp
from dynamics.world_model.view import CHANNELS, FrameView

__all__ = ["MonitorConfig", "SafetyMonitor", "load_monitor", "save_monitor"]

_PART = "safety_monitor"
"""Name of the monitor among the parts of a checkpoint."""


@dataclass(frozen=True)
class MonitorConfig:
    """Configuration of a safety monitor.

    Attributes
    ----------
    view : part of the scene that the frames show; its size is a multiple of 16.
    actions : number of discrete actions.
    depth, embedding, hidden : channels of the first convolution; width of a frame's embedding; width of the hidden
        layer.
    threshold : an action with a greater score is refused. It is set on calibration episodes
        (`evaluation.training.monitor.calibrated`).
    slope, offset : the probability is the logistic function of slope times logit plus offset, set in the same way.
    seed : of the initial weights.

    Raises
    ------
    ConfigError
        If a value is not one of the valid ones.
    """

    view: FrameView = field(default_factory=FrameView)
    actions: int = 5
    depth: int = 24
    embedding: int = 192
    hidden: int = 128
    threshold: float = 0.5
    slope: float = 1.0
    offset: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("actions", "depth", "embedding", "hidden"):
            value = getattr(self, name)
            if type(value) is not int or value < 1:
                raise ConfigError(f"{name} of a safety monitor is a positive whole number, not {value!r}")
        if not 0 < self.threshold < 1:
            raise ConfigError(f"threshold of a safety monitor is between 0 and 1, not {self.threshold!r}")
        if not (np.isfinite(self.slope) and self.slope > 0 and np.isfinite(self.offset)):
            raise ConfigError(
                "slope and offset of a safety monitor are finite, the slope above 0, not "
                f"{self.slope!r} and {self.offset!r}"
            )
        if self.view.size % STRIDE:
            raise ConfigError(f"the size of a safety monitor's frames is a multiple of {STRIDE}, not {self.view.size}")

    @classmethod
    def from_json(cls, values: Any) -> MonitorConfig:
        """From JSON values.

        Raises
        ------
        ConfigError
            If they do not describe a configuration.
        """
        check_keys(cls, values, "a safety monitor")
        return cls(**{**values, "view": FrameView(**values["view"])})


class SafetyMonitor(nn.Module):
    """Encoder of a frame, and a logit for each action: no verified continuation exists after it.

    Attributes
    ----------
    config : its configuration.

    Examples
    --------
    >>> monitor = SafetyMonitor(MonitorConfig(depth=4, embedding=8, hidden=8))
    >>> monitor.probabilities(np.zeros((2, 5, 64, 64), np.uint8)).shape
    (2, 5)
    """

    def __init__(self, config: MonitorConfig) -> None:
        super().__init__()
        self.config = config
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)
            self.encoder = Encoder(len(CHANNELS), config.view.size, config.depth, config.embedding)
            self.head = mlp(config.embedding, config.hidden, config.actions)

    def forward(self, frames: Tensor) -> Tensor:
        """Logits, (n, actions), of frames (n, channels, size, size) uint8."""
        found: Tensor = self.head(self.encoder(frames))
        return found

    @torch.no_grad()
    def probabilities(self, frames: Any) -> FloatArray:
        """Calibrated probabilities that no verified continuation exists after each action, (n, actions).

        Parameters
        ----------
        frames : (n, channels, size, size) uint8.

        Raises
        ------
        ConfigError
            If the frames have another shape or type.
        """
        frames = np.asarray(frames)
        shape = len(CHANNELS), self.config.view.size, self.config.view.size
        if frames.shape[1:] != shape or frames.dtype != np.uint8:
            raise ConfigError(
                f"a safety monitor reads uint8 frames of shape (n, {shape}), not {frames.dtype} of shape {frames.shape}"
            )
        logits = self(torch.from_numpy(np.ascontiguousarray(frames)))
        return torch.sigmoid(self.config.slope * logits + self.config.offset).double().numpy()

    def with_config(self, **changes: Any) -> SafetyMonitor:
        """The same network with another threshold or calibration."""
        other = SafetyMonitor(replace(self.config, **changes))
        other.load_state_dict(self.state_dict())
        return other.eval()


def save_monitor(monitor: SafetyMonitor, folder: str | Path, notes: dict[str, Any] | None = None) -> Path:
    """Write a monitor's configuration and weights; see `dynamics.world_model.files.save_parts`."""
    return save_parts({_PART: (monitor, asdict(monitor.config))}, folder, notes)


def load_monitor(folder: str | Path) -> SafetyMonitor:
    """Read a monitor that `save_monitor` wrote.

    Raises
    ------
    ModelError
        If a file is missing, damaged, foreign, or of another network, or a weight is not finite.
    """
    try:
        monitor = SafetyMonitor(MonitorConfig.from_json(read_config(folder).get(_PART)))
    except (ConfigError, TypeError) as error:
        raise ModelError(f"{folder} holds no safety monitor: {error}") from error
    load_weights(folder, {_PART: monitor})
    monitor.eval().requires_grad_(False)
    return monitor
