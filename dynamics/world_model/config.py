"""Configuration of a world model."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, fields
from typing import Any, Literal, get_args

from dynamics.errors import ConfigError
from dynamics.world_model.view import CHANNELS, OTHERS, RELATIVE_SPEED, FrameView

__all__ = ["Latent", "Objective", "WorldModelConfig", "check_keys"]

Latent = Literal["simnorm", "categorical"]
"""Kind of the latent: softmax groups without randomness, or sampled categoricals."""
Objective = Literal["joint-embedding", "reconstruction"]
"""What the latent learns from: the embeddings of later frames, or the frames themselves."""

STRIDE = 16
"""Rows of a frame for each row of the encoder's last layer."""


@dataclass(frozen=True)
class WorldModelConfig:
    """Configuration of a world model.

    The defaults make a deterministic model of 0.6 million parameters with a joint embedding, besides the decoder, which
    serves the training. `WorldModelConfig.large()` has 2.5 million.

    Attributes
    ----------
    view : part of the scene that the frames show; its size is a multiple of 16.
    actions : number of discrete actions.
    latent : "simnorm" (deterministic) or "categorical" (stochastic, with straight-through gradients).
    objective : "joint-embedding" or "reconstruction".
    depth, embedding : channels of the first convolution; width of a frame's embedding.
    recurrent : width of the recurrent state h.
    groups, classes : the latent z has this many groups of this many classes.
    hidden : width of the hidden layers of the prior and the heads.
    unroll : decisions over which predictions are trained without seeing frames.
    unimix : share of a uniform distribution in each categorical.
    free_bits : KL divergence [nats] below which the categorical latent is not trained.
    kl_dynamics, kl_representation : weights of the KL divergence for the prior and for the posterior.
    variance, covariance : weights of the terms against collapse of the embedding.
    prediction, decoding, outcomes : weights of the predicted latents, the decoder, and the heads.
    seed : of the initial weights.

    Raises
    ------
    ConfigError
        If a value is not one of the valid ones.

    Examples
    --------
    >>> WorldModelConfig(latent="categorical").features
    448
    """

    view: FrameView = field(default_factory=FrameView)
    actions: int = 5
    latent: Latent = "simnorm"
    objective: Objective = "joint-embedding"
    depth: int = 24
    embedding: int = 192
    recurrent: int = 192
    groups: int = 16
    classes: int = 16
    hidden: int = 128
    unroll: int = 4
    unimix: float = 0.01
    free_bits: float = 1.0
    kl_dynamics: float = 0.5
    kl_representation: float = 0.1
    variance: float = 1.0
    covariance: float = 0.04
    prediction: float = 1.0
    decoding: float = 1.0
    outcomes: float = 1.0
    seed: int = 0

    def __post_init__(self) -> None:
        _check_name("latent", self.latent, get_args(Latent))
        _check_name("objective", self.objective, get_args(Objective))
        for name in ("actions", "depth", "embedding", "recurrent", "groups", "classes", "hidden", "unroll"):
            value = getattr(self, name)
            if type(value) is not int or value < 1:
                raise ConfigError(f"{name} of a world model is a positive whole number, not {value!r}")
        if type(self.seed) is not int or self.seed < 0:
            raise ConfigError(f"seed of a world model is a whole number from 0 on, not {self.seed!r}")
        for name in _WEIGHTS:
            value = getattr(self, name)
            if not (isinstance(value, float | int) and math.isfinite(value) and value >= 0):
                raise ConfigError(f"{name} of a world model is a finite number from 0 on, not {value!r}")
        if not self.unimix < 1:
            raise ConfigError(f"unimix of a world model is a share below 1, not {self.unimix!r}")
        if self.view.size % STRIDE:
            raise ConfigError(f"a world model reads frames whose size is a multiple of {STRIDE}, not {self.view.size}")

    @classmethod
    def large(cls, **changes: Any) -> WorldModelConfig:
        """The configuration of 2.5 million parameters, with these changes."""
        sizes = {"depth": 48, "embedding": 384, "recurrent": 448, "hidden": 256}
        return cls(**{**sizes, **changes})

    @property
    def code(self) -> int:
        """Width of the latent z."""
        return self.groups * self.classes

    @property
    def features(self) -> int:
        """Width of the recurrent state and the latent together."""
        return self.recurrent + self.code

    @property
    def decoded(self) -> tuple[int, ...]:
        """Channels that the decoder predicts: others and their speeds, or all for reconstruction."""
        every = tuple(range(len(CHANNELS)))
        return every if self.objective == "reconstruction" else (OTHERS, RELATIVE_SPEED)

    @property
    def predicts_embedding(self) -> bool:
        """Whether a categorical state predicts the embedding of its frame, in place of the frame."""
        return self.latent == "categorical" and self.objective == "joint-embedding"

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of a frame: channels, rows, columns."""
        return len(CHANNELS), self.view.size, self.view.size

    def to_json(self) -> dict[str, Any]:
        """As JSON values."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: Any) -> WorldModelConfig:
        """From JSON values.

        Raises
        ------
        ConfigError
            If they do not describe a configuration.
        """
        check_keys(cls, values, "a world model")
        try:
            return cls(**{**values, "view": FrameView(**values["view"])})
        except TypeError as error:
            raise ConfigError(f"a world model's configuration has an invalid value: {error}") from error


_WEIGHTS = (
    *("unimix", "free_bits", "kl_dynamics", "kl_representation", "variance", "covariance"),
    *("prediction", "decoding", "outcomes"),
)


def check_keys(config: type[Any], values: Any, what: str) -> None:
    """Raise `ConfigError` unless JSON values are a dict of all fields of a configuration, a dataclass. `what` names its
    owner."""
    names = {each.name for each in fields(config)}
    if not isinstance(values, dict) or set(values) != names:
        have = sorted(values) if isinstance(values, dict) else type(values).__name__
        raise ConfigError(f"{what}'s configuration has the keys {sorted(names)}, not {have}")


def _check_name(what: str, name: Any, valid: tuple[str, ...]) -> None:
    if name not in valid:
        raise ConfigError(f"{what} of a world model is one of {', '.join(valid)}, not {name!r}")
