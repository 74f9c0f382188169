"""`WorldModel`: frames to a recurrent latent state, and that state under imagined actions.

Notation
--------
o frames (uint8), a actions (indices), e embeddings, h recurrent state, z latent, both at decision t:

    h[t+1] = cell(h[t], z[t], a[t])         prior      ẑ[t+1] from h[t+1]
                                            posterior   z[t+1] from e[t+1], and from h[t+1] too if it is categorical

Batch first; n states, b sequences of l decisions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import torch
from torch import Tensor, nn

from dynamics.errors import ModelError
from dynamics.world_model.config import WorldModelConfig
from dynamics.world_model.networks import (
    Decoder,
    Encoder,
    RecurrentCell,
    mlp,
    sample_categorical,
    simnorm,
    zero_bias_orthogonal,
)

__all__ = ["LatentState", "Observed", "Outcomes", "WorldModel"]


@dataclass(frozen=True, slots=True, eq=False)
class LatentState:
    """State of the model: `h` (..., recurrent) and `z` (..., groups * classes)."""

    h: Tensor
    z: Tensor

    @property
    def features(self) -> Tensor:
        """Both, (..., features), for heads and drivers."""
        return torch.cat([self.h, self.z], -1)

    def detach(self) -> LatentState:
        """Without gradients."""
        return LatentState(self.h.detach(), self.z.detach())

    def __getitem__(self, index: Any) -> LatentState:
        """Some of the states."""
        return LatentState(self.h[index], self.z[index])

    def flat(self) -> LatentState:
        """All leading axes as one."""
        return LatentState(self.h.flatten(0, -2), self.z.flatten(0, -2))


class Observed(NamedTuple):
    """Sequences that were observed.

    Attributes
    ----------
    state : posterior states, (b, l, ...).
    logits : of the posterior, (b, l, groups, classes).
    log_prior, log_posterior : log-probabilities of categoricals, (b, l, groups, classes); empty with SimNorm.
    embeddings : (b, l, embedding).
    """

    state: LatentState
    logits: Tensor
    log_prior: Tensor
    log_posterior: Tensor
    embeddings: Tensor


class Outcomes(NamedTuple):
    """What a decision led to, of n imagined states.

    Attributes
    ----------
    reward : of the decision, (n,).
    continuation, collision : logits that the episode goes on, and that the ego has crashed, (n,).
    """

    reward: Tensor
    continuation: Tensor
    collision: Tensor


class WorldModel(nn.Module):
    """Predicts latent states, rewards, ends of episodes and collisions from frames and actions.

    Examples
    --------
    >>> model = WorldModel(WorldModelConfig())
    >>> state = model.first(model.embed(torch.zeros(2, 5, 64, 64, dtype=torch.uint8)))
    >>> model.outcomes(model.imagine(state, torch.tensor([3, 1])).features).reward.shape
    torch.Size([2])
    """

    def __init__(self, config: WorldModelConfig) -> None:
        super().__init__()
        self.config = config
        channels, size, _ = config.shape
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)
            self.encoder = Encoder(channels, size, config.depth, config.embedding)
            own = config.embedding + (config.recurrent if config.latent == "categorical" else 0)
            self.posterior = nn.Linear(own, config.code)
            zero_bias_orthogonal(self.posterior, 1.0)
            self.cell = RecurrentCell(config.code + config.actions, config.recurrent)
            self.prior = mlp(config.recurrent, config.hidden, config.code)
            self.outcome = mlp(config.features, config.hidden, 3, zero=True)
            self.decoder = Decoder(config.features, len(config.decoded), size)
            self.predictor = (
                mlp(config.features, config.hidden, config.embedding) if config.predicts_embedding else nn.Identity()
            )

    def embed(self, frames: Tensor) -> Tensor:
        """Embeddings of frames, (..., channels, size, size) uint8 to (..., embedding).

        Raises
        ------
        ModelError
            If the frames have another shape or type.
        """
        if frames.shape[-3:] != self.config.shape or frames.dtype != torch.uint8:
            raise ModelError(
                f"frames have shape (..., {', '.join(map(str, self.config.shape))}) and type uint8, "
                f"not {tuple(frames.shape)} and {frames.dtype}"
            )
        found: Tensor = self.encoder(frames.reshape(-1, *self.config.shape))
        return found.reshape(*frames.shape[:-3], self.config.embedding)

    def blank(self, count: int) -> Tensor:
        """Recurrent state at the beginning of `count` episodes, (count, recurrent)."""
        return torch.zeros(count, self.config.recurrent)

    def first(self, embeddings: Tensor) -> LatentState:
        """States of the first decisions of episodes, from embeddings (n, embedding)."""
        return self.posterior_state(self.blank(len(embeddings)), embeddings)

    def posterior_state(self, h: Tensor, embeddings: Tensor) -> LatentState:
        """States after a frame, from recurrent states and embeddings (n, ...); categoricals are sampled."""
        return LatentState(h, self._coded(self._posterior_logits(h, embeddings))[0].flatten(-2))

    def advance(self, state: LatentState, actions: Tensor) -> Tensor:
        """Recurrent states after actions (n,)."""
        hot = nn.functional.one_hot(actions, self.config.actions).to(state.z.dtype)
        return cast(Tensor, self.cell(state.h, torch.cat([state.z, hot], -1)))

    def imagine(self, state: LatentState, actions: Tensor) -> LatentState:
        """Prior states one decision later, without a frame."""
        h = self.advance(state, actions)
        return LatentState(h, self._coded(self.prior_logits(h))[0].flatten(-2))

    def prior_logits(self, h: Tensor) -> Tensor:
        """Logits of the latent that the recurrent state predicts, (..., groups, classes)."""
        return self._grouped(self.prior(h))

    def outcomes(self, features: Tensor) -> Outcomes:
        """Outcomes of the decisions that led to imagined states, of features (n, features)."""
        reward, continuation, collision = self.outcome(features).unbind(-1)
        return Outcomes(reward, continuation, collision)

    def decode(self, features: Tensor) -> Tensor:
        """The channels `config.decoded` in the coarse grid of `Decoder`, (n, channels, size / 4, size / 2), 0 to 1."""
        return torch.sigmoid(self.decoder(features))

    def observe(self, frames: Tensor, actions: Tensor, first: Tensor) -> Observed:
        """Posterior states of sequences.

        Parameters
        ----------
        frames, actions, first : (b, l, ...); `first` marks first decisions of episodes, at which the state is blank.
        """
        embeddings = self.embed(frames)
        h, states, logits, priors, posteriors = self.blank(len(frames)), [], [], [], []
        stochastic = self.config.latent == "categorical"
        # The scan is over decisions of a sequence, in training only.
        for t in range(frames.shape[1]):
            h = h * ~first[:, t, None]
            found = self._posterior_logits(h, embeddings[:, t])
            z, log_posterior = self._coded(found)
            state = LatentState(h, z.flatten(-2))
            states.append(state)
            logits.append(found)
            if stochastic:
                posteriors.append(log_posterior)
                priors.append(self._coded(self.prior_logits(h))[1])
            h = self.advance(state, actions[:, t])
        empty = embeddings.new_zeros(0)
        return Observed(
            LatentState(torch.stack([s.h for s in states], 1), torch.stack([s.z for s in states], 1)),
            torch.stack(logits, 1),
            torch.stack(priors, 1) if stochastic else empty,
            torch.stack(posteriors, 1) if stochastic else empty,
            embeddings,
        )

    def parameter_count(self) -> int:
        """Number of weights, without the decoder and the predictor of embeddings, which serve the training."""
        parts = [self.encoder, self.posterior, self.cell, self.prior, self.outcome]
        return sum(weight.numel() for part in parts for weight in part.parameters())

    def _posterior_logits(self, h: Tensor, embeddings: Tensor) -> Tensor:
        inputs = torch.cat([embeddings, h], -1) if self.config.latent == "categorical" else embeddings
        return self._grouped(self.posterior(inputs))

    def _grouped(self, logits: Tensor) -> Tensor:
        return logits.reshape(*logits.shape[:-1], self.config.groups, self.config.classes)

    def _coded(self, logits: Tensor) -> tuple[Tensor, Tensor]:
        """The latent of logits, and log-probabilities (of categoricals)."""
        if self.config.latent == "simnorm":
            return simnorm(logits), logits
        return sample_categorical(logits, self.config.unimix)
