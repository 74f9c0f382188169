"""Returns of imagined rollouts against returns by hand, and the losses of actor and critic."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from dynamics.errors import ConfigError
from dynamics.world_model.config import WorldModelConfig
from dynamics.world_model.losses import Batch, world_model_losses
from dynamics.world_model.model import LatentState, Outcomes, WorldModel
from dynamics.world_model.view import FrameView
from mpc.latent.actor_critic import ActorCritic, DriverConfig, action_returns, driver_losses

TINY = WorldModelConfig(
    view=FrameView(size=16), actions=3, depth=8, embedding=8, recurrent=4, groups=2, classes=4, hidden=8
)


class Counting(WorldModel):
    """A known world: the state counts actions; action 2 is worth 1, and action 0 ends the episode with certainty."""

    def imagine(self, state: LatentState, actions: torch.Tensor) -> LatentState:
        h = torch.zeros_like(state.h)
        h[..., 0] = actions.float()
        return LatentState(h, state.z)

    def outcomes(self, features: torch.Tensor) -> Outcomes:
        action = features[..., 0]
        going = torch.where(action == 0, -100.0, 100.0)
        return Outcomes((action == 2).float(), going, -going)


def networks(config: DriverConfig, always: int, value: float) -> ActorCritic:
    """An actor that takes one action always, and a critic with one value."""
    made = ActorCritic(config, TINY.features, TINY.actions)
    with torch.no_grad():
        made.actor[-1].bias[always] = 100.0
        place = (value - made.bins[0]) / (made.bins[1] - made.bins[0])
        made.slow_critic[-1].bias[int(place.round())] = 100.0
    return made


@pytest.mark.parametrize("trace", [0.0, 0.7, 1.0])
def test_imagined_returns_are_those_by_hand(trace):
    """λ-returns of every first action, followed by the actor's, with an end after action 0."""
    config = DriverConfig(discount=0.9, horizon=3, trace=trace, bins=11)
    driver, value = networks(config, always=2, value=5.0), 5.0
    found = action_returns(Counting(TINY), driver, LatentState(torch.zeros(2, 4), torch.zeros(2, 8)), 3, greedy=True)
    after = value
    for _ in range(2):
        after = 1 + 0.9 * ((1 - trace) * value + trace * after)
    expected = [0.0, 0.9 * ((1 - trace) * value + trace * after), 1 + 0.9 * ((1 - trace) * value + trace * after)]
    assert torch.allclose(found, torch.tensor([expected, expected]), atol=1e-4)


def test_the_critic_learns_a_value_between_two_bins():
    torch.manual_seed(0)
    driver = ActorCritic(DriverConfig(bins=5, discount=0.75), TINY.features, TINY.actions)
    assert driver.bins.tolist() == pytest.approx([0, 1, 2, 3, 4])
    features = torch.randn(64, TINY.features)
    optimiser = torch.optim.Adam(driver.critic.parameters(), lr=0.05)
    for _ in range(60):
        optimiser.zero_grad()
        driver.value_loss(features, torch.full((64,), 2.6)).mean().backward()
        optimiser.step()
    assert torch.allclose(driver.values(features), torch.full((64,), 2.6), atol=0.05)
    before = driver.values(features, slow=True)
    driver.update_slow()
    assert (driver.values(features, slow=True) - before).abs().max() > 0


def batch(b: int = 4, l: int = 5) -> Batch:  # noqa: E741
    first = torch.zeros(b, l, dtype=torch.bool)
    first[:, 0] = True
    return Batch(
        torch.randint(0, 255, (b, l, *TINY.shape), dtype=torch.uint8),
        torch.randint(0, 3, (b, l)),
        torch.rand(b, l),
        torch.zeros(b, l, dtype=torch.bool),
        torch.zeros(b, l, dtype=torch.bool),
        first,
    )


@pytest.mark.parametrize("starts", [None, 6])
def test_the_actor_learns_the_action_of_the_largest_return(starts):
    """Action 2 is rewarded in the known world, action 0 ends it; the world model gets no gradient."""
    torch.manual_seed(0)
    model = Counting(TINY)
    driver = ActorCritic(DriverConfig(horizon=2, bins=11), TINY.features, TINY.actions)
    optimiser = torch.optim.Adam(driver.parameters(), lr=0.02)
    for _ in range(40):
        losses = driver_losses(model, driver, world_model_losses(model, batch()), starts)
        optimiser.zero_grad()
        losses.total.backward()
        optimiser.step()
    assert all(weight.grad is None for weight in model.parameters())
    state = model.first(model.embed(batch().frames[:, 0]))
    assert (driver.actor(state.features).argmax(-1) == 2).all()
    assert losses.entropy < 0.5


@pytest.mark.parametrize(
    "change",
    [{"discount": 1.0}, {"horizon": 0}, {"bins": 1}, {"temperature": 0.0}, {"trace": 2.0}, {"reward_high": -1.0}],
)
def test_bad_configurations_are_refused(change):
    with pytest.raises(ConfigError):
        replace(DriverConfig(), **change)
