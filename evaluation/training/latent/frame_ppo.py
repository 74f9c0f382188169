"""The baseline of a latent driver: PPO with convolutions on the same frames, for the same CPU time."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback

from dynamics.world_model.view import FrameView
from evaluation.learning.manifests import manifest_path
from evaluation.names import check_name
from evaluation.running.frame_episodes import drive_frames, frame_world
from evaluation.running.identity import file_hash
from evaluation.running.manifest import commit
from evaluation.settings import Setting, get_setting
from evaluation.threads import one_thread
from evaluation.training.latent.options import FIRST_VALIDATION_SEED, SEED_SPAN
from evaluation.training.latent.train import Progress, score
from shield.config import PROFILES, ShieldConfig
from shield.errors import ConfigError

__all__ = ["FramePPOOptions", "train_frame_ppo"]

_ENVS, _ROLLOUT = 32, 32
"""Environments, and decisions in each between two updates."""


@dataclass(frozen=True, kw_only=True)
class FramePPOOptions:
    """Options of the training of PPO on frames.

    Attributes
    ----------
    output : path of the zip file.
    cpu_seconds : CPU time after which the training ends [s], the validations included.
    setting, shield, seed, discount, validation_episodes, crash_limit : as in `LatentTrainingOptions`.
    validate_every : decisions between two validations.

    Raises
    ------
    ConfigError
        If a value is not valid.
    """

    output: Path
    cpu_seconds: float
    setting: str | Setting = "highway-fast"
    shield: str = "none"
    seed: int = 0
    discount: float = 0.95
    validate_every: int = 10 * _ENVS * _ROLLOUT
    validation_episodes: int = 192
    crash_limit: float = 0.025

    def __post_init__(self) -> None:
        if not (self.cpu_seconds > 0 and 0 < self.discount < 1 and 0 <= self.crash_limit <= 1):
            raise ConfigError("cpu_seconds is positive, discount lies between 0 and 1, crash_limit from 0 to 1")
        if not 0 <= self.seed < FIRST_VALIDATION_SEED // SEED_SPAN:
            raise ConfigError(f"seed is from 0 to {FIRST_VALIDATION_SEED // SEED_SPAN - 1}, not {self.seed}")
        if not (self.validate_every >= 1 and 1 <= self.validation_episodes <= 1_000):
            raise ConfigError("validate_every is at least 1, validation_episodes from 1 to 1,000")
        check_name("shield", self.shield, [*PROFILES, "none"])
        _ = self.environment

    @property
    def environment(self) -> Setting:
        """The setting."""
        return self.setting if isinstance(self.setting, Setting) else get_setting(self.setting)

    def to_json(self) -> dict[str, Any]:
        """As JSON values."""
        return {**asdict(self), "output": str(self.output), "setting": self.environment.name}


def train_frame_ppo(options: FramePPOOptions, tell: Callable[[Progress], None] | None = None) -> BaseAlgorithm:
    """Train PPO with SB3's `CnnPolicy` on one thread, and write the checkpoint that is best on the validation seeds.

    Parameters
    ----------
    tell : called at each validation.

    Raises
    ------
    ConfigError
        If the compiled highway does not support the setting or the shield.
    """
    shield = None if options.shield == "none" else ShieldConfig.profile(options.shield)
    view, setting = FrameView(), options.environment
    world = frame_world(setting, _ENVS, view, shield)
    world.seed(SEED_SPAN * options.seed)
    validation = frame_world(setting, min(options.validation_episodes, 128), view, shield)
    parameters: dict[str, Any] = {
        **{"n_steps": _ROLLOUT, "batch_size": 128, "n_epochs": 4, "gamma": options.discount, "ent_coef": 0.01},
        **{"learning_rate": 5e-4, "policy_kwargs": {"features_extractor_kwargs": {"features_dim": 128}}},
    }
    path = options.output.with_suffix(".zip")
    path.parent.mkdir(parents=True, exist_ok=True)
    with one_thread():
        model = PPO("CnnPolicy", world, seed=SEED_SPAN * options.seed, device="cpu", **parameters)
        callback = _Validation(options, validation, path, tell)
        model.learn(2**40, callback=callback)
    manifest = {
        "algorithm": "ppo",
        "training": options.to_json(),
        "hyperparameters": parameters,
        "steps_taken": model.num_timesteps,
        "cpu_seconds": round(callback.seconds, 1),
        "best": asdict(callback.best) if callback.best else None,
        "commit": commit(),
        "sha256": file_hash(path),
    }
    manifest_path(path).write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")
    return model


class _Validation(BaseCallback):
    """Drives the validation seeds, writes the best model, and ends the training after its CPU time."""

    def __init__(
        self, options: FramePPOOptions, validation: Any, path: Path, tell: Callable[[Progress], None] | None
    ) -> None:
        super().__init__()
        self._options, self._validation, self._path, self._tell = options, validation, path, tell
        self._started, self._next = time.process_time(), options.validate_every
        self.best: Progress | None = None

    @property
    def seconds(self) -> float:
        """CPU time so far [s]."""
        return time.process_time() - self._started

    def _on_step(self) -> bool:
        over = self.seconds > self._options.cpu_seconds
        if self.num_timesteps >= self._next or over:
            self._next += self._options.validate_every
            self._validate()
        return not over

    def _validate(self) -> None:
        seeds = range(FIRST_VALIDATION_SEED, FIRST_VALIDATION_SEED + self._options.validation_episodes)
        found = drive_frames(self.model, self._validation, seeds)
        returned, crash = float(found.returns.mean()), float(found.crashed.mean())
        progress = Progress(
            update=self.model._n_updates,
            steps=self.num_timesteps,
            seconds=self.seconds,
            losses={},
            returned=returned,
            crash=crash,
            speed=float(found.speed.mean()),
            score=score(found, self._options.crash_limit),
        )
        if self.best is None or progress.score > self.best.score:
            self.best = progress
            self.model.save(self._path)
        if self._tell is not None:
            self._tell(progress)
