"""Training of a world model and of the driver in it, from frames of the compiled highway."""

from __future__ import annotations

import copy
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from dynamics.errors import ModelError
from dynamics.world_model.episode_queue import EpisodeQueue
from dynamics.world_model.losses import Batch, world_model_losses
from dynamics.world_model.model import WorldModel
from evaluation.running.frame_episodes import FrameEpisodes, drive_frames, frame_world
from evaluation.running.manifest import commit
from evaluation.threads import one_thread
from evaluation.training.latent.collect import Collector, queue_columns
from evaluation.training.latent.options import FIRST_VALIDATION_SEED, SEED_SPAN, LatentTrainingOptions
from mpc.latent.actor_critic import ActorCritic, driver_losses
from mpc.latent.driver import LatentDriver
from mpc.latent.files import load_driver, save_driver
from shield.errors import ConfigError

__all__ = ["Progress", "TrainedDriver", "score", "train_latent"]

_RAMP, _KEEP, _LEAST_RATE, _FALL = 100, 3, 0.1, 0.4
"""Updates over which the learning rate rises; checkpoints that are compared again at the end; share of the rate at the
end, and share of the updates over which it falls to it."""
_LARGEST_GRADIENT, _DECAY = 10.0, 1e-4
_RETURN_OF_A_CRASH = 10.0
"""What a crash rate above the limit costs in the comparison of checkpoints, in return for each crash."""


@dataclass(frozen=True)
class Progress:
    """State of a training at a validation.

    Attributes
    ----------
    update, steps : updates and environment decisions so far. seconds : CPU time so far [s].
    losses : means of the parts since the last validation.
    returned, crash, speed : mean return, crash rate and mean speed [m/s] on the validation seeds.
    score : by which checkpoints are compared.
    """

    update: int
    steps: int
    seconds: float
    losses: dict[str, float]
    returned: float
    crash: float
    speed: float
    score: float


@dataclass(frozen=True)
class TrainedDriver:
    """A trained driver, its folder, and the states of its training at each validation."""

    driver: LatentDriver
    path: Path
    history: list[Progress]


def train_latent(options: LatentTrainingOptions, tell: Callable[[Progress], None] | None = None) -> TrainedDriver:
    """Train a driver on one thread of the processor, and write its best checkpoint.

    In each update the environments drive one decision with the driver, then the world model learns from a batch of the
    queue, and the driver from rollouts of the world model. Every `validate_every` updates the driver drives validation
    seeds; the best three checkpoints are compared again on others at the end.

    Parameters
    ----------
    tell : called at each validation.

    Raises
    ------
    ConfigError
        If the compiled highway does not support the setting or the shield, or `start` has other networks.
    ModelError
        If the training diverges, or `start` cannot be read.
    """
    with one_thread(), tempfile.TemporaryDirectory(prefix="world-model-") as folder:
        torch.manual_seed(options.seed)
        training = _Training(options, Path(folder) / "queue")
        for update in range(1, options.updates + 1):
            training.update(update)
            if update % options.validate_every == 0 or update == options.updates:
                progress = training.validate(update)
                if tell is not None:
                    tell(progress)
        best, again = training.best()
    notes = {
        "training": options.to_json(),
        "update": best.update,
        "steps": training.collector.steps,
        "cpu_seconds": round(training.seconds, 1),
        "validation": _figures(again),
        "commit": commit(),
    }
    driver = training.driver
    return TrainedDriver(driver, save_driver(driver, options.output, notes), training.history)


def _figures(episodes: FrameEpisodes) -> dict[str, Any]:
    return {
        "episodes": len(episodes.returns),
        "return": round(float(episodes.returns.mean()), 3),
        "crash": round(float(episodes.crashed.mean()), 4),
        "speed": round(float(episodes.speed.mean()), 3),
        "overridden": round(episodes.override_share, 4),
    }


@dataclass(frozen=True)
class _Checkpoint:
    update: int
    score: float
    weights: list[dict[str, Any]] = field(repr=False)


class _Training:
    """Environments, queue, networks and optimisers of a training."""

    def __init__(self, options: LatentTrainingOptions, folder: Path) -> None:
        self.options, self._started = options, time.process_time()
        config, shield = options.model, options.shield_config
        self._world = frame_world(options.environment, options.envs, config.view, shield)
        self._validation = frame_world(options.environment, min(options.validation_episodes, 128), config.view, shield)
        self.model = WorldModel(config)
        self.networks = ActorCritic(options.driver, config.features, config.actions)
        self.driver = LatentDriver(self.model, self.networks)
        if options.start is not None:
            self._continue(load_driver(options.start))
        self.collector = Collector(self._world, SEED_SPAN * options.seed, options.exploration, options.override_penalty)
        self._rng = np.random.default_rng(options.seed)
        self._optimisers = [
            torch.optim.AdamW(network.parameters(), lr=options.rate, eps=1e-6, weight_decay=decay)
            for network, decay in ((self.model, _DECAY), (self.networks, 0.0))
        ]
        self._queue = EpisodeQueue(folder, queue_columns(config), options.capacity)
        while len(self._queue) < options.warm_up:
            self._drive(None if options.start is None else self.driver)
        self._losses: dict[str, float] = {}
        self._since = 0
        self.history: list[Progress] = []
        self._checkpoints: list[_Checkpoint] = []

    @property
    def seconds(self) -> float:
        """CPU time so far [s]."""
        return time.process_time() - self._started

    def _continue(self, earlier: LatentDriver) -> None:
        """Take over the weights of an earlier driver."""
        if earlier.model.config != replace(self.model.config, seed=earlier.model.config.seed):
            raise ConfigError(f"{self.options.start} has another world model: {earlier.model.config}")
        self.model.load_state_dict(earlier.model.state_dict())
        self.networks.load_state_dict(earlier.networks.state_dict())

    def _drive(self, driver: LatentDriver | None) -> None:
        for episode in self.collector.step(driver):
            self._queue.add(episode)

    def update(self, update: int) -> None:
        """One decision in each environment, one update of the world model, and one of the driver."""
        options = self.options
        self._drive(self.driver)
        batch = Batch.of(self._queue.sample(options.batch, options.length, self._rng))
        rate = options.rate * _rate_share(update, options.updates)
        losses = world_model_losses(self.model, batch)
        _descend(self._optimisers[0], self.model, losses.total, rate)
        drives = driver_losses(self.model, self.networks, losses, options.starts)
        _descend(self._optimisers[1], self.networks, drives.total, rate)
        self.networks.update_slow()
        parts = {name: float(part) for name, part in losses.parts.items()}
        for name, value in {**parts, "value": drives.value, "entropy": drives.entropy}.items():
            self._losses[name] = self._losses.get(name, 0.0) + value
        self._since += 1

    def validate(self, update: int) -> Progress:
        """Drive the validation seeds, and keep the weights if they are among the best."""
        means = {name: total / self._since for name, total in self._losses.items()}
        if not np.isfinite(list(means.values())).all():
            raise ModelError(f"the training diverged before update {update}; lower the rate (now {self.options.rate})")
        self._losses, self._since = {}, 0
        episodes = self._driven(0)
        progress = Progress(
            update,
            self.collector.steps,
            self.seconds,
            means,
            float(episodes.returns.mean()),
            float(episodes.crashed.mean()),
            float(episodes.speed.mean()),
            self._score(episodes),
        )
        self.history.append(progress)
        weights = [copy.deepcopy(network.state_dict()) for network in (self.model, self.networks)]
        self._checkpoints.append(_Checkpoint(update, progress.score, weights))
        self._checkpoints.sort(key=lambda each: -each.score)
        del self._checkpoints[_KEEP:]
        return progress

    def best(self) -> tuple[_Checkpoint, FrameEpisodes]:
        """The best checkpoint on further validation seeds, whose weights the driver gets, and its episodes."""
        found: list[tuple[float, _Checkpoint, FrameEpisodes]] = []
        for checkpoint in self._checkpoints:
            self._load(checkpoint)
            episodes = self._driven(self.options.validation_episodes)
            found.append((self._score(episodes) + checkpoint.score, checkpoint, episodes))
        _, best, episodes = max(found, key=lambda each: each[0])
        self._load(best)
        return best, episodes

    def _driven(self, first: int) -> FrameEpisodes:
        begin = FIRST_VALIDATION_SEED + first
        return drive_frames(self.driver, self._validation, range(begin, begin + self.options.validation_episodes))

    def _score(self, episodes: FrameEpisodes) -> float:
        return score(episodes, self.options.crash_limit, self.options.override_penalty)

    def _load(self, checkpoint: _Checkpoint) -> None:
        for network, weights in zip((self.model, self.networks), checkpoint.weights, strict=True):
            network.load_state_dict(weights)


def score(episodes: FrameEpisodes, crash_limit: float, override_penalty: float = 0.0) -> float:
    """Mean return, less what crashes above the limit and overridden decisions cost."""
    excess = max(float(episodes.crashed.mean()) - crash_limit, 0.0)
    overrides = float(episodes.overridden.mean())
    return float(episodes.returns.mean()) - _RETURN_OF_A_CRASH * excess - override_penalty * overrides


def _rate_share(update: int, updates: int) -> float:
    """Share of the learning rate: it rises, holds, and falls."""
    left = 1 - (update - 1) / updates
    return min(1.0, update / _RAMP) * max(_LEAST_RATE, min(1.0, left / _FALL))


def _descend(optimiser: torch.optim.Optimizer, network: nn.Module, loss: torch.Tensor, rate: float) -> None:
    for group in optimiser.param_groups:
        group["lr"] = rate
    optimiser.zero_grad()
    loss.backward()
    nn.utils.clip_grad_norm_(network.parameters(), _LARGEST_GRADIENT)
    optimiser.step()
