"""Training of a `LinearStructuredModel`: one-step loss, then multi-step loss; held-out episodes, early stopping.

The one-step loss is cheap and comes first; it yields most of the accuracy. The multi-step loss, over the model's own
rollouts, then reduces errors that accumulate.
"""

from __future__ import annotations

import copy
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import torch
from torch import Tensor

from dynamics.errors import ConfigError, DataError, ModelError
from dynamics.learned.data.transitions import Transitions
from dynamics.learned.models.linear import LinearStructuredModel, ModelConfig

__all__ = ["Fit", "FitConfig", "fit"]

_Windows: TypeAlias = tuple[Tensor, Tensor, Tensor]


@dataclass(frozen=True, slots=True)
class FitConfig:
    """Parameters of the training.

    Attributes
    ----------
    epochs : greatest number of passes over the training transitions with the one-step loss.
    rate : its highest learning rate (Adam); it falls to 0 along a cosine, unless `constant_rate`.
    horizon : number of decisions of a rollout in the multi-step loss; 1 for none.
    finish_epochs, finish_rate : the same for the multi-step loss.
    batch : windows in a step of the optimiser; None for all of them.
    held_out : share of the episodes that is not used in training.
    patience : number of checks without a better held-out loss after which training stops; the best weights are kept.
    check_every : epochs between checks.
    seed : of the split and of the batches.
    """

    epochs: int = 300
    rate: float = 2e-2
    constant_rate: bool = False
    horizon: int = 5
    finish_epochs: int = 30
    finish_rate: float = 2e-3
    batch: int | None = 256
    held_out: float = 0.2
    patience: int = 20
    check_every: int = 5
    seed: int = 0

    def __post_init__(self) -> None:
        counts = {"horizon": self.horizon, "patience": self.patience, "check_every": self.check_every}
        counts |= {"batch": 1 if self.batch is None else self.batch, "epochs + finish_epochs": self.total_epochs}
        for name, count in counts.items():
            if type(count) is not int or count < 1:
                raise ConfigError(f"{name} must be a positive whole number, got {count!r}")
        if not (self.rate > 0 and self.finish_rate > 0 and min(self.epochs, self.finish_epochs) >= 0):
            raise ConfigError("rate and finish_rate must be positive, epochs and finish_epochs not negative")

    @property
    def phases(self) -> list[tuple[int, int, float]]:
        """(horizon, epochs, rate) of the one-step and of the multi-step loss, as far as they are used."""
        both = [(1, self.epochs, self.rate), (self.horizon, self.finish_epochs, self.finish_rate)]
        return [phase for phase in both[: 1 if self.horizon == 1 else 2] if phase[1]]

    @property
    def total_epochs(self) -> int:
        """Greatest number of epochs."""
        return sum(epochs for _, epochs, _ in self.phases)


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A trained model, and the record of its training.

    Attributes
    ----------
    model : with the weights of the best held-out loss.
    train, held_out : the two parts of the data.
    history : (epoch, training loss, held-out loss) at each check; at the end with the multi-step loss.
    seconds : wall-clock time of the training [s].
    """

    model: LinearStructuredModel
    train: Transitions
    held_out: Transitions
    history: list[tuple[int, float, float]]
    seconds: float


def fit(
    data: Transitions,
    model: ModelConfig | LinearStructuredModel,
    config: FitConfig | None = None,
    *,
    progress: bool = False,
    tensorboard: str | None = None,
) -> Fit:
    """Train a new model, or continue the training of a copy of a given one, with its normalisation unchanged.

    It uses one torch thread. The result is the same for the same seeds on the same machine.

    Parameters
    ----------
    data : the transitions; the split is by episode.
    model : configuration of a new model, or a model to continue with.
    progress : whether to show a progress bar on stderr.
    tensorboard : folder for TensorBoard's event files.

    Raises
    ------
    ConfigError
        If `tensorboard` is given and TensorBoard is not installed.
    DataError
        If the data do not fit the model or have too few or too short episodes.
    ModelError
        If the training diverges.
    """
    config = config or FitConfig()
    target = model if isinstance(model, ModelConfig) else model.config
    if data.widths != (target.state_dim, target.action_dim):
        raise DataError(f"the model takes widths {(target.state_dim, target.action_dim)}, the data have {data.widths}")
    if abs(data.dt - target.dt) > 1e-9:
        raise DataError(f"the model's decisions take {target.dt} s, the data's {data.dt} s")
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with _writer(tensorboard) as write:
            return _fit(data, model, config, progress, write)
    finally:
        torch.set_num_threads(threads)


def _fit(
    data: Transitions,
    model: ModelConfig | LinearStructuredModel,
    config: FitConfig,
    progress: bool,
    write: Callable[[int, float, float], None],
) -> Fit:
    """`fit` without the checks of its arguments."""
    started = time.perf_counter()
    train, held_out = data.split(config.held_out, config.seed)
    if isinstance(model, ModelConfig):
        network = LinearStructuredModel(model)
        network.normalise(*(_tensor(part) for part in (train.states, train.actions, train.next_states)))
    else:
        network = copy.deepcopy(model).train().requires_grad_(True)
    generator = torch.Generator().manual_seed(config.seed)
    history: list[tuple[int, float, float]] = []
    before = 0

    def note(epoch: int, train_loss: float, held_out_loss: float) -> None:
        history.append((before + epoch, train_loss, held_out_loss))
        write(*history[-1])
        bar.set_postfix(train=f"{train_loss:.2e}", held_out=f"{held_out_loss:.2e}")

    with _bar(config.total_epochs, progress) as bar:
        for horizon, epochs, rate in config.phases:
            batches, checks = (_windows(part, horizon) for part in (train, held_out))
            phase = _Phase(batches, checks, _loss_scale(network, train), epochs, rate)
            _descend(network, phase, config, generator, note, bar)
            before = history[-1][0]
    network.eval().requires_grad_(False)
    network.require_finite()
    return Fit(network, train, held_out, history, time.perf_counter() - started)


class _Phase(NamedTuple):
    """One phase of the training: windows for the loss, windows for the choice of weights, unit of the error in each
    column, number of epochs, and initial learning rate."""

    batches: _Windows
    checks: _Windows
    scale: Tensor
    epochs: int
    rate: float


def _descend(
    network: LinearStructuredModel,
    phase: _Phase,
    config: FitConfig,
    generator: torch.Generator,
    note: Callable[[int, float, float], None],
    bar: Any,
) -> None:
    """Train for one phase; the network ends with the best weights."""
    (states, actions, after), epochs, rate = phase.batches, phase.epochs, phase.rate
    count = len(states)
    size = min(config.batch or count, count)
    optimiser = torch.optim.Adam(network.parameters(), lr=rate)
    steps = epochs * -(-count // size)
    schedule = torch.optim.lr_scheduler.LambdaLR(
        optimiser, lambda i: 1.0 if config.constant_rate else 0.5 * (1 + np.cos(np.pi * i / steps))
    )
    best, best_weights, waited = np.inf, copy.deepcopy(network.state_dict()), 0
    for epoch in range(1, epochs + 1):
        total = 0.0
        for rows in torch.randperm(count, generator=generator).split(size):
            loss = _loss(network, states[rows], actions[rows], after[rows], phase.scale)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
            total += float(loss.detach()) * len(rows) / count
        bar.update()
        if not np.isfinite(total):
            raise ModelError(f"the training diverged in epoch {epoch}; lower the rate (now {rate})")
        if epoch % config.check_every and epoch != epochs:
            continue
        with torch.no_grad():
            check = float(_loss(network, *phase.checks, phase.scale))
        note(epoch, total, check)
        waited += 1
        if check < best:
            best, best_weights, waited = check, copy.deepcopy(network.state_dict()), 0
        if waited == config.patience:
            break
    network.load_state_dict(best_weights)


def _loss(network: LinearStructuredModel, states: Tensor, actions: Tensor, after: Tensor, scale: Tensor) -> Tensor:
    """Mean squared error over members, windows, decisions and columns; each member rolls out separately."""
    now = states
    total = torch.zeros(())
    for k in range(actions.shape[1]):
        now = network.members(now, actions[:, k].expand(*now.shape[:-1], -1))
        total = total + ((now - after[:, k]) / scale).square().mean()
    return total / actions.shape[1]


def _windows(data: Transitions, horizon: int) -> _Windows:
    """All windows of `horizon` transitions as tensors.

    Raises
    ------
    DataError
        If there are none.
    """
    states, actions, after = data.sequences(horizon)
    if not len(states):
        raise DataError(
            f"the loss needs {horizon} transitions in a row, and no episode of the training or held-out part has them"
        )
    return _tensor(states), _tensor(actions), _tensor(after)


def _loss_scale(network: LinearStructuredModel, data: Transitions) -> Tensor:
    """Unit of the error in each column: its usual change in one decision, equal for x and y of a pair."""
    config = network.config
    if config.units is not None:
        return torch.tensor(config.units, dtype=torch.float32)
    change = np.square(data.next_states - data.states).mean(axis=0)
    for pair in (config.layout.position, config.layout.heading, *config.layout.vectors):
        change[list(pair)] = change[list(pair)].mean()
    return _tensor(np.where(change > 1e-12, np.sqrt(change), 1.0))


def _tensor(array: Any) -> Tensor:
    return torch.as_tensor(np.asarray(array, dtype=np.float32))


@contextmanager
def _writer(folder: str | None) -> Iterator[Callable[[int, float, float], None]]:
    """A function that logs (epoch, training loss, held-out loss) to TensorBoard, or does nothing."""
    if folder is None:
        yield lambda epoch, train, held_out: None
        return
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError as error:
        raise ConfigError("TensorBoard is not installed: pip install tensorboard, or leave it out") from error
    writer = SummaryWriter(folder)

    def write(epoch: int, train: float, held_out: float) -> None:
        writer.add_scalar("loss/train", train, epoch)
        writer.add_scalar("loss/held_out", held_out, epoch)

    try:
        yield write
    finally:
        writer.close()


def _bar(total: int, progress: bool) -> Any:
    from tqdm import tqdm

    return tqdm(total=total, desc="fit", unit="epoch", disable=not progress, file=sys.stderr)
