"""Variants of learning the dynamics of parking, from HighwayEnv's notebook to the default, with one change at a
time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from dynamics.errors import ConfigError
from dynamics.learned.models.linear import ModelConfig
from dynamics.learned.tasks.parking_state import SCALES
from dynamics.learned.training.fit import FitConfig
from dynamics.learned.training.on_policy_rounds import RoundsConfig

__all__ = ["DEFAULT", "VARIANTS", "LearningVariant", "variant"]


@dataclass(frozen=True, slots=True)
class LearningVariant:
    """A model, its training, and its data.

    Attributes
    ----------
    what : description of the difference to the variant before, for readers.
    model, fit, data : configuration of each.
    """

    what: str
    model: ModelConfig = field(default_factory=ModelConfig)
    fit: FitConfig = field(default_factory=FitConfig)
    data: RoundsConfig = field(default_factory=lambda: RoundsConfig(rounds=0))

    def seeded(self, seed: int) -> LearningVariant:
        """The variant with all its seeds set to one seed."""
        parts = (replace(part, seed=seed) for part in (self.model, self.fit, self.data))
        return LearningVariant(self.what, *parts)  # type: ignore[arg-type]


_NOTEBOOK = ModelConfig(
    form="plain",
    hide_position=False,
    hidden=(64,),
    shared=False,
    activation="relu",
    members=1,
    units=tuple(float(scale) for scale in SCALES),
    unit_heading=False,
)
_NOTEBOOK_FIT = FitConfig(
    epochs=1500, rate=1e-2, constant_rate=True, batch=None, horizon=1, held_out=0.3, patience=1500
)
_ONE_STEP = FitConfig(horizon=1, epochs=330)
_SINGLE = ModelConfig(members=1)

DEFAULT = "rounds"
"""Name of the default variant."""

VARIANTS: Mapping[str, LearningVariant] = MappingProxyType(
    {
        "notebook": LearningVariant(
            "A multiplies the absolute position; 2,000 transitions",
            _NOTEBOOK,
            _NOTEBOOK_FIT,
            RoundsConfig(transitions=2000, rounds=0, episode_steps=None, hold=2),
        ),
        "plain": LearningVariant(
            "the same formula, normalised, two layers, minibatches; 1,000 transitions",
            replace(_SINGLE, form="plain", hide_position=False),
            _ONE_STEP,
        ),
        "masked": LearningVariant("A ignores the position too", replace(_SINGLE, form="plain"), _ONE_STEP),
        "body": LearningVariant("in the body frame", _SINGLE, _ONE_STEP),
        "multi-step": LearningVariant("30 of the 330 epochs with the 5-step loss", _SINGLE),
        "ensemble": LearningVariant("three members"),
        "more": LearningVariant("1,800 random transitions", data=RoundsConfig(transitions=1800, rounds=0)),
        "round": LearningVariant("1,000 random and 400 on-policy", data=RoundsConfig(rounds=1)),
        "rounds": LearningVariant("1,000 random and twice 400 on-policy (the default)", data=RoundsConfig()),
    }
)
"""Variants by name; each changes one thing of an earlier one."""


def variant(name: str) -> LearningVariant:
    """A variant by name.

    Raises
    ------
    ConfigError
        If the name is unknown.
    """
    if name not in VARIANTS:
        raise ConfigError(f"unknown variant {name!r}; have {', '.join(VARIANTS)}")
    return VARIANTS[name]
