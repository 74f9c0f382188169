"""Training, calibration and grading of a safety monitor on labelled frames."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from scipy.stats import rankdata

from dynamics.state import BoolArray, FloatArray, IntArray
from dynamics.world_model.monitor import SafetyMonitor
from evaluation.training.safety_labels import EpisodeOutcomes, LabelledStates
from shield.errors import ConfigError
from shield.wrappers.latent_shield import filtered_actions

__all__ = [
    "MIRRORED_ACTIONS",
    "MonitorGrade",
    "MonitorTraining",
    "auroc",
    "calibrated",
    "calibration_error",
    "conformal_threshold",
    "false_alarms_at",
    "filtered_driver",
    "fit",
    "grade",
    "named_driver",
]

MIRRORED_ACTIONS = (2, 1, 0, 3, 4)
"""Meta-action that has the effect of each in the scene mirrored left to right."""
_SOON = 2
"""Number of decisions within which a crash counts as near."""
_BINS = 15
"""Number of bins of the calibration error, as in Guo et al. 2017."""


@dataclass(frozen=True)
class MonitorTraining:
    """Parameters of `fit`.

    Attributes
    ----------
    epochs, batch : passes over the states, and states of an update. rate : greatest learning rate, of a cosine decay.
    decay : weight decay. mirror : whether half of the states of each update are mirrored left to right.
    seed : of the order of the states.
    """

    epochs: int = 8
    batch: int = 256
    rate: float = 1e-3
    decay: float = 1e-4
    mirror: bool = True
    seed: int = 0


def fit(
    monitor: SafetyMonitor,
    states: LabelledStates,
    training: MonitorTraining | None = None,
    progress: Callable[[int, float], None] = lambda epoch, loss: None,
) -> SafetyMonitor:
    """Train a monitor in place, by the binary cross-entropy of each action's label.

    Parameters
    ----------
    progress : called after each epoch with its number and its mean loss.
    """
    options = training or MonitorTraining()
    rng, n = np.random.default_rng(options.seed), len(states.frames)
    if n < options.batch:
        raise ConfigError(f"a safety monitor is trained on at least {options.batch} states, not {n}")
    updates = options.epochs * (n // options.batch)
    optimizer = torch.optim.AdamW(monitor.parameters(), options.rate, weight_decay=options.decay)
    decay = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, updates, 0.02 * options.rate)
    monitor.train()
    for epoch in range(options.epochs):
        order, total = rng.permutation(n), 0.0
        for k in range(n // options.batch):
            rows = np.sort(order[k * options.batch : (k + 1) * options.batch])
            frames, unsafe = states.frames[rows], states.unsafe[rows]
            if options.mirror:
                flip = rng.random(len(rows)) < 0.5
                frames[flip] = frames[flip][:, :, ::-1]
                unsafe[flip] = unsafe[flip][:, MIRRORED_ACTIONS]
            logits = monitor(torch.from_numpy(frames))
            loss = torch.nn.functional.binary_cross_entropy_with_logits(logits, torch.from_numpy(unsafe).float())
            optimizer.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(monitor.parameters(), 1.0)
            optimizer.step()
            decay.step()
            total += loss.item()
        progress(epoch, total / (n // options.batch))
    return monitor.eval()


@torch.no_grad()
def logits_of(monitor: SafetyMonitor, frames: Any, batch: int = 1024) -> FloatArray:
    """Logits of many frames, (n, actions)."""
    parts = [
        monitor(torch.from_numpy(np.ascontiguousarray(frames[k : k + batch]))) for k in range(0, len(frames), batch)
    ]
    return torch.cat(parts).double().numpy()


def conformal_threshold(risks: FloatArray, miss: float) -> float:
    """Threshold such that a new unsafe action has a risk at or below it with a probability of at most `miss`, if it is
    exchangeable with those of `risks`.

    It lies just below the k-th smallest risk, k = floor(miss (n + 1)). Source: split conformal prediction, Vovk et al.
    2005.

    Parameters
    ----------
    risks : of actions without a verified continuation, from episodes that were not trained on, (n,).

    Raises
    ------
    ConfigError
        If there are too few of them for this `miss`.
    """
    k = math.floor(miss * (len(risks) + 1))
    if k < 1:
        raise ConfigError(
            f"a threshold that misses at most {miss:g} of the unsafe actions needs {math.ceil(1 / miss) - 1} of them, "
            f"not {len(risks)}"
        )
    found = float(np.sort(risks)[k - 1])
    return float(np.clip(np.nextafter(found, 0.0), 1e-9, 1 - 1e-9))


def calibrated(monitor: SafetyMonitor, states: LabelledStates, miss: float) -> SafetyMonitor:
    """The monitor with probabilities and a threshold calibrated on states of episodes that were not trained on.

    Slope and offset of the logits: Platt scaling. Threshold: `conformal_threshold` over all unsafe actions.
    """
    logits, unsafe = torch.from_numpy(logits_of(monitor, states.frames)), torch.from_numpy(states.unsafe).double()
    scale = torch.zeros(2, dtype=torch.float64, requires_grad=True)
    optimizer = torch.optim.LBFGS([scale], max_iter=100)

    def closure() -> Any:
        optimizer.zero_grad()
        scaled = torch.exp(scale[0]) * logits + scale[1]
        loss = torch.nn.functional.binary_cross_entropy_with_logits(scaled, unsafe)
        loss.backward()
        return loss

    optimizer.step(closure)
    slope, offset = math.exp(scale[0].item()), scale[1].item()
    found = monitor.with_config(slope=slope, offset=offset)
    risks = _risks(found, logits.numpy())
    return found.with_config(threshold=conformal_threshold(risks[states.unsafe], miss))


def _risks(monitor: SafetyMonitor, logits: FloatArray) -> FloatArray:
    """Calibrated probabilities of logits, of the same shape."""
    risks: FloatArray = 1 / (1 + np.exp(-(monitor.config.slope * logits + monitor.config.offset)))
    return risks


def auroc(scores: FloatArray, positive: BoolArray) -> float:
    """Area under the receiver operating characteristic; NaN without both classes."""
    n, m = int(positive.sum()), int((~positive).sum())
    if n == 0 or m == 0:
        return math.nan
    return float((rankdata(scores)[positive].sum() - n * (n + 1) / 2) / (n * m))


def false_alarms_at(scores: FloatArray, positive: BoolArray, found: float) -> float:
    """Share of the negatives that have a score of at least that at which this share of the positives is found."""
    if not positive.any() or positive.all():
        return math.nan
    least = np.quantile(scores[positive], 1 - found, method="lower")
    return float((scores[~positive] >= least).mean())


def calibration_error(probabilities: FloatArray, positive: BoolArray) -> float:
    """Expected calibration error over 15 bins of equal width (Guo et al. 2017)."""
    bins = np.minimum((probabilities * _BINS).astype(int), _BINS - 1)
    total = 0.0
    for b in range(_BINS):
        inside = bins == b
        if inside.any():
            total += inside.mean() * abs(float(probabilities[inside].mean()) - float(positive[inside].mean()))
    return total


class MonitorGrade(NamedTuple):
    """Grade of a monitor against the labels of the simulator, over n states.

    Attributes
    ----------
    states : n. unsafe_share : of the actions, without a verified continuation. lost_share : of the states, where no
        action has one.
    auroc_action : of the actions. auroc_lost : of "no action has a verified continuation", by the least risk.
    auroc_crash : of a crash within two decisions, by the least risk.
    false_alarms : share of the states with a verified action at the score that finds 95 % of those without.
    calibration : expected calibration error of the actions' probabilities.
    false_pass, false_alarm : shares of the unsafe actions at most at the threshold, and of the safe ones above it.
    """

    states: int
    unsafe_share: float
    lost_share: float
    auroc_action: float
    auroc_lost: float
    auroc_crash: float
    false_alarms: float
    calibration: float
    false_pass: float
    false_alarm: float


def grade(monitor: SafetyMonitor, states: LabelledStates, outcomes: EpisodeOutcomes) -> MonitorGrade:
    """Grade a calibrated monitor on whole episodes (`gather_episodes`) that were neither trained nor calibrated on."""
    config, risks = monitor.config, _risks(monitor, logits_of(monitor, states.frames))
    lost: BoolArray = np.asarray(states.unsafe.all(axis=1))
    least = risks.min(axis=1)
    left = outcomes.lengths[states.episodes] - states.steps
    crash: BoolArray = outcomes.crashed[states.episodes] & (left <= _SOON)
    return MonitorGrade(
        states=len(risks),
        unsafe_share=float(states.unsafe.mean()),
        lost_share=float(lost.mean()),
        auroc_action=auroc(risks.ravel(), states.unsafe.ravel()),
        auroc_lost=auroc(least, lost),
        auroc_crash=auroc(least, crash),
        false_alarms=false_alarms_at(least, lost, 0.95),
        calibration=calibration_error(risks.ravel(), states.unsafe.ravel()),
        false_pass=float((risks[states.unsafe] <= config.threshold).mean()) if states.unsafe.any() else math.nan,
        false_alarm=float((risks[~states.unsafe] > config.threshold).mean()),
    )


def named_driver(name: str, actions: int = 5) -> Any:
    """A driver of `evaluation.training.safety_labels`: "random", "faster", "idle", "slower", or "mixed", in which each
    environment has one of random, faster, and random that mostly keeps its last action.

    Raises
    ------
    ConfigError
        If the name is another one.
    """
    fixed = {"idle": 1, "faster": 3, "slower": 4}
    if name in fixed:
        return lambda frames, rng: np.full(len(frames), fixed[name], np.intp)
    if name == "random":
        return lambda frames, rng: rng.integers(actions, size=len(frames))
    if name == "mixed":
        return _Mixed(actions)
    raise ConfigError(f"a driver is one of random, faster, idle, slower, mixed, not {name!r}")


class _Mixed:
    """Random actions in a third of the environments, FASTER with some random ones in another, and random ones that are
    kept for some decisions in the last."""

    def __init__(self, actions: int) -> None:
        self._actions = actions
        self._kept: IntArray = np.zeros(0, np.intp)

    def __call__(self, frames: Any, rng: np.random.Generator) -> IntArray:
        """Actions (e,)."""
        e = len(frames)
        drawn, kind = rng.integers(self._actions, size=e), np.arange(e) % 3
        if len(self._kept) != e:
            self._kept = drawn.copy()
        self._kept = np.where(rng.random(e) < 0.3, drawn, self._kept)
        actions = np.where(kind == 1, np.where(rng.random(e) < 0.8, 3, drawn), np.where(kind == 2, self._kept, drawn))
        return actions.astype(np.intp)


def filtered_driver(monitor: SafetyMonitor, drive: Any) -> Any:
    """A driver behind `LatentShield` without preferences."""

    def driven(frames: Any, rng: np.random.Generator) -> IntArray:
        return filtered_actions(monitor.probabilities(frames), drive(frames, rng), None, monitor.config.threshold)

    return driven
