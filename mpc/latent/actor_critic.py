"""Actor and critic on the latent state of a world model, and returns of imagined rollouts.

The actor is trained towards a softmax over the imagined returns of each first action (a policy of maximum entropy, as
in Abdolmaleki et al., MPO, 2018); the critic towards their mean under the actor, with two-hot targets (Hafner et al.,
DreamerV3, 2023).
"""

from __future__ import annotations

import copy
import math
from dataclasses import asdict, dataclass, fields
from typing import Any

import torch
from torch import Tensor, nn

from dynamics.errors import ConfigError
from dynamics.world_model.config import check_keys
from dynamics.world_model.losses import Losses
from dynamics.world_model.model import LatentState, WorldModel
from dynamics.world_model.networks import mlp

__all__ = ["ActorCritic", "DriverConfig", "DriverLosses", "action_returns", "driver_losses"]


@dataclass(frozen=True)
class DriverConfig:
    """Configuration of a latent actor-critic.

    Attributes
    ----------
    discount : γ for each decision.
    horizon : imagined decisions, the first action included.
    trace : λ of the returns.
    temperature : scale of the returns [reward] at which the actor prefers actions.
    hidden : width of the hidden layers.
    bins : number of the critic's values.
    reward_low, reward_high : bounds of a decision's reward.
    slow : share of the critic that its target takes over in each update.
    seed : of the initial weights.

    Raises
    ------
    ConfigError
        If a value is not valid.
    """

    discount: float = 0.95
    horizon: int = 4
    trace: float = 0.95
    temperature: float = 0.1
    hidden: int = 128
    bins: int = 41
    reward_low: float = 0.0
    reward_high: float = 1.0
    slow: float = 0.02
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("horizon", "hidden", "bins"):
            value, least = getattr(self, name), 2 if name == "bins" else 1
            if type(value) is not int or value < least:
                raise ConfigError(f"{name} of a latent driver is a whole number from {least} on, not {value!r}")
        if type(self.seed) is not int or self.seed < 0:
            raise ConfigError(f"seed of a latent driver is a whole number from 0 on, not {self.seed!r}")
        numbers = {each.name: getattr(self, each.name) for each in fields(self)}
        for name, value in numbers.items():
            if not (isinstance(value, float | int) and math.isfinite(value)):
                raise ConfigError(f"{name} of a latent driver is a finite number, not {value!r}")
        if not (0 < self.discount < 1 and 0 <= self.trace <= 1 and 0 < self.slow <= 1):
            raise ConfigError("discount lies between 0 and 1, trace from 0 to 1, slow above 0 up to 1")
        if not (self.temperature > 0 and self.reward_low < self.reward_high):
            raise ConfigError("temperature is positive, and reward_low less than reward_high")

    def to_json(self) -> dict[str, Any]:
        """As JSON values."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: Any) -> DriverConfig:
        """From JSON values.

        Raises
        ------
        ConfigError
            If they do not describe a configuration.
        """
        check_keys(cls, values, "a latent driver")
        return cls(**values)


class ActorCritic(nn.Module):
    """Scores of actions and values of latent states, from features (n, features)."""

    bins: Tensor

    def __init__(self, config: DriverConfig, features: int, actions: int) -> None:
        super().__init__()
        self.config = config
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)
            self.actor = mlp(features, config.hidden, actions, zero=True)
            self.critic = mlp(features, config.hidden, config.bins, zero=True)
        self.slow_critic = copy.deepcopy(self.critic).requires_grad_(False)
        scale = 1 / (1 - config.discount)
        self.register_buffer(
            "bins",
            torch.linspace(config.reward_low * scale, config.reward_high * scale, config.bins),
            persistent=False,
        )

    def values(self, features: Tensor, slow: bool = False) -> Tensor:
        """Expected discounted returns, (n,), by the critic or its slow copy."""
        logits = (self.slow_critic if slow else self.critic)(features)
        return torch.softmax(logits, -1) @ self.bins

    def value_loss(self, features: Tensor, returns: Tensor) -> Tensor:
        """Cross-entropy of the critic for returns (n,), of each row, (n,)."""
        step = self.bins[1] - self.bins[0]
        place = ((returns - self.bins[0]) / step).clamp(0, len(self.bins) - 1.001)
        low = place.floor().long()
        above = (place - low).unsqueeze(-1)
        logs = torch.log_softmax(self.critic(features), -1)
        pair = torch.cat([logs.gather(-1, low.unsqueeze(-1)), logs.gather(-1, low.unsqueeze(-1) + 1)], -1)
        return -((1 - above) * pair[..., :1] + above * pair[..., 1:]).squeeze(-1)

    def update_slow(self) -> None:
        """Move the slow critic towards the critic."""
        with torch.no_grad():
            for slow, fast in zip(self.slow_critic.parameters(), self.critic.parameters(), strict=True):
                slow.lerp_(fast, self.config.slow)


def action_returns(
    model: WorldModel, driver: ActorCritic, state: LatentState, horizon: int, greedy: bool = False
) -> Tensor:
    """Imagined returns of each first action, (n, actions), without gradients.

    Parameters
    ----------
    state : n states. horizon : imagined decisions, followed by the slow critic's value.
    greedy : whether the actor's best actions follow the first one, or samples.
    """
    config, actions = driver.config, model.config.actions
    rewards, going, values = [], [], []
    with torch.no_grad():
        n = len(state.h)
        now = LatentState(state.h.repeat_interleave(actions, 0), state.z.repeat_interleave(actions, 0))
        chosen = torch.arange(actions).repeat(n)
        # Imagined decisions follow each other; all states and first actions are one batch.
        for k in range(horizon):
            now = model.imagine(now, chosen)
            features = now.features
            outcomes = model.outcomes(features)
            rewards.append(outcomes.reward.clamp(config.reward_low, config.reward_high))
            going.append(torch.sigmoid(outcomes.continuation))
            values.append(driver.values(features, slow=True))
            if k + 1 < horizon:
                logits = driver.actor(features)
                drawn = torch.rand_like(logits).clamp(1e-9).log().neg().log().neg()
                chosen = (logits if greedy else logits + drawn).argmax(-1)
        found = values[-1]
        for reward, alive, value in zip(reversed(rewards), reversed(going), reversed(values), strict=True):
            found = reward + config.discount * alive * ((1 - config.trace) * value + config.trace * found)
    return found.reshape(n, actions)


@dataclass(frozen=True)
class DriverLosses:
    """Losses of the actor and the critic, to descend, and figures of the batch: the mean value, and the actor's
    entropy [nats]."""

    total: Tensor
    value: float
    entropy: float


def driver_losses(model: WorldModel, driver: ActorCritic, losses: Losses, states: int | None = None) -> DriverLosses:
    """Losses on states of a batch. The critic also learns the values of imagined states, as in MuZero (Schrittwieser
    et al. 2020), because a rollout ends in one.

    Parameters
    ----------
    states : number of states from which rollouts start, drawn from the batch; all by default.
    """
    config, observed = driver.config, losses.observed.state.detach()
    count = observed.h.shape[0] * observed.h.shape[1]
    chosen = torch.arange(count) if states is None else torch.randperm(count)[:states]
    starts = observed.flat()[chosen]
    returns = action_returns(model, driver, starts, config.horizon)
    target = torch.softmax(returns / config.temperature, -1)
    logs = torch.log_softmax(driver.actor(starts.features), -1)
    policy = logs.detach().exp()
    values = (policy * returns).sum(-1)
    loss = -(target * logs).sum(-1).mean() + driver.value_loss(starts.features, values).mean()
    later = torch.full((count,), torch.nan).index_put((chosen,), values).reshape(observed.h.shape[:2])
    for k, (imagined, alive) in enumerate(losses.unrolled, 1):
        known = alive & ~later[:, k:].isnan()
        if known.any():
            loss = loss + driver.value_loss(imagined.features[known], later[:, k:][known]).mean() / len(losses.unrolled)
    entropy = -(policy * logs.detach()).sum(-1).mean()
    return DriverLosses(loss, float(values.mean()), float(entropy))
