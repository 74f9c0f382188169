"""Losses of a world model on sequences of driving.

Sources: variance and covariance terms against collapse: Bardes et al., VICReg (2022). Targets without gradients over
several steps: Schwarzer et al., SPR (2021), and Hansen et al., TD-MPC2 (2024). KL balance and free bits: Hafner et al.,
DreamerV3 (2023). The embedding that a categorical state predicts: Barlow Twins (Zbontar et al. 2021), as in R2-Dreamer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from dynamics.errors import ModelError
from dynamics.world_model.model import LatentState, Observed, Outcomes, WorldModel
from dynamics.world_model.networks import Decoder
from dynamics.world_model.view import OTHERS, RELATIVE_SPEED

__all__ = ["COLUMNS", "Batch", "Losses", "Unrolled", "anti_collapse", "world_model_losses"]

COLUMNS = ("frame", "action", "reward", "terminated", "crashed")
"""Columns of an episode: the frame, the action at it, and its reward, end and collision."""
_TARGET_STD = 1.0
"""Standard deviation of each logit over a batch, below which it is trained up."""
_LATENT_WEIGHT, _SMALLEST = 1.0, 1e-5
_DECODER_SCALE, _OCCUPIED_WEIGHT = 8.0, 8.0
"""Weight of an error in occupied cells of the decoder's grid, which are few."""


@dataclass(frozen=True)
class Batch:
    """Sequences of b times l decisions.

    Attributes
    ----------
    frames : (b, l, channels, size, size) uint8.
    actions : (b, l) indices.
    rewards : (b, l). terminated, crashed : (b, l) bool, of the decision's outcome.
    first : (b, l) bool, first decisions of an episode or of the sequence.
    """

    frames: Tensor
    actions: Tensor
    rewards: Tensor
    terminated: Tensor
    crashed: Tensor
    first: Tensor

    @classmethod
    def of(cls, sample: Mapping[str, Any]) -> Batch:
        """From a sample of an `EpisodeQueue` with the columns `COLUMNS`."""
        as_tensors = {name: torch.from_numpy(sample[name]) for name in (*COLUMNS, "first")}
        return cls(
            as_tensors["frame"],
            as_tensors["action"].long(),
            as_tensors["reward"].float(),
            as_tensors["terminated"].bool(),
            as_tensors["crashed"].bool(),
            as_tensors["first"].bool(),
        )


class Unrolled(NamedTuple):
    """States imagined k decisions after the first l - k states of each sequence, without gradients, (b, l - k, ...),
    and whether their episode goes on so far, (b, l - k)."""

    state: LatentState
    alive: Tensor


@dataclass(frozen=True)
class Losses:
    """Losses of a batch.

    Attributes
    ----------
    total : to descend.
    parts : each weighted part, detached.
    observed : posterior states of the batch.
    unrolled : states imagined k = 1, 2, ... decisions after each.
    """

    total: Tensor
    parts: dict[str, Tensor]
    observed: Observed
    unrolled: list[Unrolled]


def world_model_losses(model: WorldModel, batch: Batch) -> Losses:
    """All losses of the model's objective.

    Raises
    ------
    ModelError
        If a sequence has fewer than 2 decisions.
    """
    config = model.config
    if batch.frames.shape[1] < 2:
        raise ModelError(f"a world model learns from sequences of 2 decisions or more, not {batch.frames.shape[1]}")
    observed = model.observe(batch.frames, batch.actions, batch.first)
    grids = Decoder.target(batch.frames[:, :, config.decoded])
    parts: dict[str, Tensor] = {}
    unrolled = _unroll(model, observed, batch, grids, parts)
    if config.latent == "categorical":
        parts["kl"] = _kl(model, observed)
    if config.predicts_embedding:
        predicted = model.predictor(observed.state.features).flatten(0, 1)
        parts["embedding"] = config.prediction * _barlow(predicted, observed.embeddings.detach().flatten(0, 1))
    if config.objective == "joint-embedding":
        variance, covariance = anti_collapse(observed.logits.flatten(0, 1).flatten(1))
        parts["variance"], parts["covariance"] = config.variance * variance, config.covariance * covariance
    grid = model.decoder(observed.state.features.flatten(0, 1))
    parts["decoder"] = config.decoding * _decoding(model, grid, grids.flatten(0, 1))
    total = torch.stack(list(parts.values())).sum()
    return Losses(total, {name: part.detach() for name, part in parts.items()}, observed, unrolled)


def anti_collapse(logits: Tensor) -> tuple[Tensor, Tensor]:
    """Variance and covariance terms of logits (n, d): without them, equal embeddings of all frames would be optimal.

    The first is the mean shortfall of the standard deviations below 1, the second the mean squared covariance of
    different columns, per column.
    """
    centred = logits - logits.mean(0)
    deviation = torch.sqrt(centred.square().mean(0) + 1e-4)
    covariance = centred.T @ centred / max(len(logits) - 1, 1)
    off = covariance.square().sum() - covariance.diagonal().square().sum()
    return torch.relu(_TARGET_STD - deviation).mean(), off / logits.shape[1]


def _unroll(
    model: WorldModel, observed: Observed, batch: Batch, grids: Tensor, parts: dict[str, Tensor]
) -> list[Unrolled]:
    """Imagine `unroll` decisions from every state; adds the losses of latents and outcomes to `parts`."""
    config, length = model.config, batch.frames.shape[1]
    state, alive = observed.state, torch.ones_like(batch.first)
    targets = observed.state.z.detach().unflatten(-1, (config.groups, config.classes))
    latent, outcome, decoded, unrolled = [], [], [], []
    last = min(config.unroll, length - 1)
    for k in range(1, last + 1):
        # The state after k decisions, of those that started at 0 .. l - k; the last outcome needs no later frame.
        after = model.imagine(state[:, : length - k + 1], batch.actions[:, k - 1 :])
        alive = alive[:, : length - k + 1]
        outcome.append(_outcome_loss(model.outcomes(after.features), batch, k, alive))
        # States go on if their episode does, and the sequence has the next frame.
        state, alive = after[:, :-1], alive[:, :-1] & ~batch.first[:, k:]
        unrolled.append(Unrolled(state.detach(), alive))
        if config.latent == "simnorm":
            latent.append(_divergence(targets[:, k:], state.z.unflatten(-1, targets.shape[-2:]), alive))
        if k in (1, last):
            grid = model.decoder(state.features[alive])
            decoded.append(_decoding(model, grid, grids[:, k:][alive]))
    if latent:
        parts["latent"] = config.prediction * _LATENT_WEIGHT * torch.stack(latent).mean()
    parts["outcomes"] = config.outcomes * torch.stack(outcome).mean()
    parts["imagined_decoder"] = config.decoding * torch.stack(decoded).mean()
    return unrolled


def _divergence(target: Tensor, found: Tensor, alive: Tensor) -> Tensor:
    """KL divergence of predicted latents from their targets, a mean over groups and states that are `alive`."""
    classes = target.shape[-1]
    ratio = torch.log(target + _SMALLEST) - torch.log(found + _SMALLEST)
    each = (target * ratio).sum(-1).mean(-1) / classes
    return (each * alive).sum() / alive.sum().clamp(min=1)


def _outcome_loss(outcomes: Outcomes, batch: Batch, k: int, alive: Tensor) -> Tensor:
    """Errors of reward, continuation and collision, k decisions after states that are `alive`."""
    weight = alive / alive.sum().clamp(min=1)
    reward = (outcomes.reward - batch.rewards[:, k - 1 :]).square()
    entropy = functional.binary_cross_entropy_with_logits
    going = entropy(outcomes.continuation, 1 - batch.terminated[:, k - 1 :].float(), reduction="none")
    collision = entropy(outcomes.collision, batch.crashed[:, k - 1 :].float(), reduction="none")
    return ((4 * reward + 2 * going + 2 * collision) * weight).sum()


def _decoding(model: WorldModel, grid: Tensor, target: Tensor) -> Tensor:
    """Error of decoded grids: of other vehicles and their speeds, or of all channels for reconstruction."""
    others, speed = (model.config.decoded.index(channel) for channel in (OTHERS, RELATIVE_SPEED))
    occupied = target[:, others] > 0
    weight = 1 + _OCCUPIED_WEIGHT * occupied
    if model.config.objective == "reconstruction":
        error = functional.binary_cross_entropy_with_logits(grid, target, reduction="none").sum(1)
        return (weight * error).mean() * _DECODER_SCALE
    error = functional.binary_cross_entropy_with_logits(grid[:, others], target[:, others], reduction="none")
    faster = (torch.sigmoid(grid[:, speed]) - target[:, speed]).square() * occupied
    return (weight * error + 16 * faster).mean() * _DECODER_SCALE


def _kl(model: WorldModel, observed: Observed) -> Tensor:
    """KL divergence of posterior and prior, balanced, above the free bits."""
    config = model.config
    prior, posterior = observed.log_prior, observed.log_posterior

    def divergence(p: Tensor, q: Tensor) -> Tensor:
        return (p.exp() * (p - q)).sum((-1, -2)).mean().clamp(min=config.free_bits)

    dynamics = divergence(posterior.detach(), prior)
    return config.kl_dynamics * dynamics + config.kl_representation * divergence(posterior, prior.detach())


def _barlow(predicted: Tensor, target: Tensor) -> Tensor:
    """Barlow Twins: the correlation of predicted and target embeddings (n, d) is to be the identity."""
    one, two = ((x - x.mean(0)) / (x.std(0) + 1e-4) for x in (predicted, target))
    correlation = one.T @ two / len(one)
    on = correlation.diagonal()
    off = correlation.square().sum() - on.square().sum()
    return ((1 - on).square().sum() + 0.005 * off) / predicted.shape[1]
