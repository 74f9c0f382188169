"""`LatentTrainingOptions`: all options of `shield world-model train`."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from dynamics.world_model.config import Latent, Objective, WorldModelConfig
from evaluation.names import check_name, check_penalty
from evaluation.settings import Setting, get_setting
from mpc.latent.actor_critic import DriverConfig
from shield.config import PROFILES, ShieldConfig
from shield.errors import ConfigError

__all__ = ["FIRST_VALIDATION_SEED", "SEED_SPAN", "LatentTrainingOptions"]

FIRST_VALIDATION_SEED = 9_000
"""First of the 1,000 seeds on which checkpoints are compared; training has lower ones."""
SEED_SPAN = 100
"""Number of environment seeds that belong to a training seed."""

Size = Literal["small", "large"]


@dataclass(frozen=True, kw_only=True)
class LatentTrainingOptions:
    """Options of the training of a latent driver.

    Attributes
    ----------
    output : folder of the checkpoint.
    setting : a straight highway with meta-actions.
    shield : a profile of `ShieldConfig` to learn inside the shield, or "none".
    override_penalty : deduction from the reward of each overridden decision in training; 0 without a shield.
    updates : number of updates of the world model and of the driver.
    seed : training seed, 0 to 89.
    latent, objective : of the world model, see `WorldModelConfig`. size : "small" (0.6 million weights) or "large".
    discount, horizon : γ of the driver, and decisions that it imagines.
    start : folder of a driver with the same networks, from whose weights the training continues; None for new ones.
    envs : environments that drive a decision in each update.
    warm_up : decisions with uniform actions before the first update.
    capacity : decisions that the episode queue holds.
    batch, length : sequences of an update, and their decisions.
    exploration : share of uniform actions in training.
    rate : learning rate; it falls to a tenth over the last two fifths of the updates.
    starts : states from which the driver imagines in an update.
    validate_every : updates between two validations. validation_episodes : episodes of each.
    crash_limit : crash rate above which a checkpoint's return counts less, by 0.1 for each 1 % more.

    Raises
    ------
    ConfigError
        If a value is not valid.
    """

    output: str | Path
    setting: str | Setting = "highway-fast"
    shield: str = "none"
    override_penalty: float = 0.0
    updates: int = 2_600
    seed: int = 0
    latent: Latent = "simnorm"
    objective: Objective = "joint-embedding"
    size: Size = "small"
    discount: float = 0.95
    horizon: int = 4
    start: Path | None = None
    envs: int = 32
    warm_up: int = 4_000
    capacity: int = 60_000
    batch: int = 24
    length: int = 10
    exploration: float = 0.1
    rate: float = 1e-3
    starts: int = 96
    validate_every: int = 200
    validation_episodes: int = 192
    crash_limit: float = 0.025

    def __post_init__(self) -> None:
        for name in ("updates", "envs", "warm_up", "batch", "starts", "validate_every", "validation_episodes"):
            self._check_count(name, 1)
        self._check_count("length", 2)
        self._check_count("seed", 0)
        self._check_count("capacity", 2 * self.warm_up)
        if not self.seed < FIRST_VALIDATION_SEED // SEED_SPAN:
            raise ConfigError(f"seed is below {FIRST_VALIDATION_SEED // SEED_SPAN}, not {self.seed}")
        if self.envs > SEED_SPAN or 2 * self.validation_episodes > 1_000:
            raise ConfigError(f"there are at most {SEED_SPAN} envs and 500 validation_episodes")
        if not (0 <= self.exploration <= 1 and 0 <= self.crash_limit <= 1):
            raise ConfigError("exploration and crash_limit are shares, from 0 to 1")
        if not (math.isfinite(self.rate) and self.rate > 0):
            raise ConfigError(f"rate is a positive number, not {self.rate!r}")
        if self.warm_up < self.batch * self.length:
            raise ConfigError(f"warm_up has at least one batch, {self.batch * self.length} decisions")
        if check_penalty(self.override_penalty) and self.shield == "none":
            raise ConfigError("an override penalty needs a shield")
        check_name("size", self.size, get_args(Size))
        check_name("shield", self.shield, [*PROFILES, "none"])
        _ = self.environment, self.model, self.driver

    def _check_count(self, name: str, least: int) -> None:
        value = getattr(self, name)
        if type(value) is not int or value < least:
            raise ConfigError(f"{name} is a whole number from {least} on, not {value!r}")

    @property
    def environment(self) -> Setting:
        """The setting."""
        return self.setting if isinstance(self.setting, Setting) else get_setting(self.setting)

    @property
    def shield_config(self) -> ShieldConfig | None:
        """The shield's settings; None for no shield."""
        return None if self.shield == "none" else ShieldConfig.profile(self.shield)

    @property
    def model(self) -> WorldModelConfig:
        """Configuration of the world model."""
        choices: dict[str, Any] = {"latent": self.latent, "objective": self.objective, "seed": self.seed}
        return WorldModelConfig.large(**choices) if self.size == "large" else WorldModelConfig(**choices)

    @property
    def driver(self) -> DriverConfig:
        """Configuration of the driver."""
        return DriverConfig(discount=self.discount, horizon=self.horizon, seed=self.seed)

    def to_json(self) -> dict[str, Any]:
        """As JSON values."""
        paths = {"output": str(self.output), "start": None if self.start is None else str(self.start)}
        return {**asdict(self), **paths, "setting": self.environment.name}
