"""Configuration of a learned model."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any, Literal, get_args

from dynamics.errors import ConfigError
from dynamics.learned.models.body_frame import Layout

__all__ = ["ACTIVATIONS", "ModelConfig", "ModelForm"]

ModelForm = Literal["plain", "body"]

ACTIVATIONS = ("relu", "silu", "tanh")
"""Functions of `torch.nn.functional` between the layers."""


@dataclass(frozen=True, slots=True)
class ModelConfig:
    """Configuration of a learned model.

    Attributes
    ----------
    state_dim, action_dim : d and m.
    dt : duration of a decision [s].
    form : "body" or "plain".
    hide_position : plain form: whether A ignores the position too (the body frame has none).
    hidden : widths of the hidden layers of the networks.
    shared : whether A and B are outputs of one network, or of two.
    activation : one of `ACTIVATIONS`.
    members : size E of the ensemble.
    units : fixed scales of the state, shape (d,), in place of a fitted normalisation; None fits one.
    unit_heading : whether the heading is scaled to length 1 after each step.
    layout : the columns of positions, headings and vectors.
    seed : of the initial weights.

    Raises
    ------
    ConfigError
        If a value is not one of the valid ones.
    """

    state_dim: int = 6
    action_dim: int = 2
    dt: float = 0.2
    form: ModelForm = "body"
    hide_position: bool = True
    hidden: tuple[int, ...] = (32, 32)
    shared: bool = True
    activation: str = "silu"
    members: int = 3
    units: tuple[float, ...] | None = None
    unit_heading: bool = True
    layout: Layout = field(default_factory=Layout)
    seed: int = 0

    def __post_init__(self) -> None:
        if self.form not in get_args(ModelForm):
            raise ConfigError(f"form must be one of {get_args(ModelForm)}, got {self.form!r}")
        if self.activation not in ACTIVATIONS:
            raise ConfigError(f"activation must be one of {tuple(ACTIVATIONS)}, got {self.activation!r}")
        sizes = {"state_dim": self.state_dim, "action_dim": self.action_dim, "members": self.members}
        sizes |= {f"hidden[{i}]": width for i, width in enumerate(self.hidden)}
        for name, size in sizes.items():
            if type(size) is not int or size < 1:
                raise ConfigError(f"{name} must be a positive whole number, got {size!r}")
        if not (math.isfinite(self.dt) and self.dt > 0):
            raise ConfigError(f"dt must be a positive duration [s], got {self.dt!r}")
        if self.units is not None and (len(self.units) != self.state_dim or min(self.units) <= 0):
            raise ConfigError(f"units must be {self.state_dim} positive scales, got {self.units}")
        self.layout.check(self.state_dim)

    def to_json(self) -> dict[str, Any]:
        """As JSON values."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: Any) -> ModelConfig:
        """From JSON values.

        Raises
        ------
        ConfigError
            If they do not describe a configuration.
        """
        if not isinstance(values, dict) or set(values) != set(cls.__slots__):
            have = sorted(values) if isinstance(values, dict) else type(values).__name__
            raise ConfigError(f"a model's configuration has the keys {sorted(cls.__slots__)}, got {have}")
        try:
            given = {**values, "hidden": tuple(values["hidden"]), "layout": Layout.of(**values["layout"])}
            if values["units"] is not None:
                given["units"] = tuple(float(unit) for unit in values["units"])
            return cls(**given)
        except (TypeError, ValueError, IndexError) as error:
            raise ConfigError(f"a model's configuration has an invalid value: {error}") from error
