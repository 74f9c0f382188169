"""World models: shapes, sizes, gradients, what they learn on toy driving, and that their embeddings do not collapse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from dynamics.errors import ConfigError, ModelError
from dynamics.world_model.config import WorldModelConfig
from dynamics.world_model.losses import Batch, anti_collapse, world_model_losses
from dynamics.world_model.model import LatentState, WorldModel
from dynamics.world_model.networks import sample_categorical
from dynamics.world_model.view import EGO, OTHERS, RELATIVE_SPEED, FrameView

SMALL = WorldModelConfig(
    view=FrameView(size=16), actions=3, depth=8, embedding=32, recurrent=32, groups=4, classes=8, hidden=32, unroll=2
)
EVERY = [
    replace(SMALL, latent=latent, objective=objective)
    for latent in ("simnorm", "categorical")
    for objective in ("joint-embedding", "reconstruction")
]


def toy(rng: np.random.Generator, b: int = 24, l: int = 5, size: int = 16) -> Batch:  # noqa: E741
    """A block that each action moves along the columns by -2, 0 or 2; the ego crashes, and is rewarded, at the last."""
    frames = np.zeros((b, l, 5, size, size), np.uint8)
    actions = rng.integers(3, size=(b, l))
    reward = np.zeros((b, l), np.float32)
    place = rng.integers(size // 2, size=b) * 2
    first = np.zeros((b, l), bool)
    first[:, 0] = True
    for t in range(l):
        frames[:, t, EGO, 6:10, :2] = 200
        for i in range(b):
            frames[i, t, OTHERS, 4:12, place[i] : place[i] + 2] = 255
            frames[i, t, RELATIVE_SPEED, 4:12, place[i] : place[i] + 2] = 128
        place = np.clip(place + 2 * (actions[:, t] - 1), 0, size - 2)
        reward[:, t] = place == size - 2
    as_tensors = [torch.from_numpy(x) for x in (frames, actions, reward, reward > 0.5, reward > 0.5, first)]
    return Batch(*as_tensors)


def trained(config: WorldModelConfig, updates: int) -> WorldModel:
    torch.manual_seed(0)
    rng, model = np.random.default_rng(0), WorldModel(config)
    optimiser = torch.optim.Adam(model.parameters(), lr=8e-3)
    for _ in range(updates):
        optimiser.zero_grad()
        world_model_losses(model, toy(rng)).total.backward()
        optimiser.step()
    return model


@pytest.mark.parametrize("config", EVERY, ids=lambda c: f"{c.latent}-{c.objective}")
def test_every_variant_has_finite_losses_and_gradients_in_every_weight(config):
    """No part of a variant is left without a gradient, whichever its objective."""
    model = WorldModel(config)
    losses = world_model_losses(model, toy(np.random.default_rng(0)))
    losses.total.backward()
    assert all(torch.isfinite(part) for part in losses.parts.values())
    lazy = [name for name, weight in model.named_parameters() if weight.grad is None or not weight.grad.any()]
    # The last layer of the heads begins at zero, so that the layer before it has no gradient yet.
    assert set(lazy) <= {name for name, _ in model.named_parameters() if name.startswith("outcome.")}


@pytest.mark.parametrize(
    ("config", "least", "most"),
    [
        (WorldModelConfig(), 0.57e6, 0.7e6),
        (WorldModelConfig(latent="categorical"), 0.57e6, 0.7e6),
        (WorldModelConfig.large(), 2.4e6, 2.7e6),
        (WorldModelConfig.large(latent="categorical"), 2.4e6, 2.7e6),
    ],
)
def test_sizes_are_the_documented_ones(config, least, most):
    assert least < WorldModel(config).parameter_count() < most


def test_the_weights_depend_on_the_seed_alone():
    one, two, other = (WorldModel(replace(SMALL, seed=seed)).state_dict() for seed in (0, 0, 1))
    assert all(torch.equal(one[name], two[name]) for name in one)
    assert not torch.equal(one["posterior.weight"], other["posterior.weight"])


def test_convolutions_begin_orthogonal_with_zero_biases():
    model = WorldModel(SMALL)
    for part in model.encoder.modules():
        if isinstance(part, torch.nn.Conv2d):
            assert not part.bias.any()
            rows = part.weight.flatten(1)
            gram = rows @ rows.T if rows.shape[0] <= rows.shape[1] else rows.T @ rows
            assert torch.allclose(gram, 2 * torch.eye(len(gram)), atol=1e-4)


def test_simnorm_groups_have_mean_one_and_are_deterministic():
    model = WorldModel(SMALL)
    frames = torch.randint(0, 255, (5, *SMALL.shape), dtype=torch.uint8)
    one, two = (model.first(model.embed(frames)) for _ in range(2))
    assert torch.equal(one.z, two.z)
    assert torch.allclose(one.z.unflatten(-1, (4, 8)).mean(-1), torch.ones(5, 4))


def test_categoricals_are_one_hot_mixed_with_a_uniform_and_pass_gradients_through():
    logits = torch.zeros(2000, 1, 4)
    logits[..., 0] = 50.0
    logits.requires_grad_()
    sample, logs = sample_categorical(logits, 0.2)
    assert torch.allclose(logs.exp().sum(-1), torch.ones(2000, 1))
    # 0.8 of the first class and a quarter of 0.2 of each.
    assert torch.allclose(logs.exp()[0, 0], torch.tensor([0.85, 0.05, 0.05, 0.05]), atol=1e-4)
    assert sample.detach().round().sum() == 2000
    assert 0.82 < float(sample.detach()[..., 0].mean()) < 0.88
    (sample * torch.tensor([1.0, 2.0, 3.0, 4.0])).sum().backward()
    assert torch.isfinite(logits.grad).all()


@pytest.mark.parametrize("latent", ["simnorm", "categorical"])
def test_observation_forgets_at_first_decisions(latent):
    """The states of an episode do not depend on the episode before it in a sequence."""
    model = WorldModel(replace(SMALL, latent=latent))
    batch = toy(np.random.default_rng(0), b=1)
    first = batch.first.clone()
    first[:, 3] = True
    states = []
    for actions in (batch.actions, (batch.actions + 1) % 3):
        torch.manual_seed(3)
        mixed = torch.cat([actions[:, :3], batch.actions[:, 3:]], 1)
        states.append(model.observe(batch.frames, mixed, first).state.h)
    assert not torch.equal(states[0][:, :3], states[1][:, :3])
    assert torch.equal(states[0][:, 3], states[1][:, 3])
    assert not states[0][:, 3].any()


def test_predictions_stop_at_the_end_of_an_episode():
    """Frames after the end of an episode are no targets for its predictions."""
    model = WorldModel(SMALL)
    batch = toy(np.random.default_rng(0))
    batch.first[:, 3] = True
    for k, unrolled in enumerate(world_model_losses(model, batch).unrolled, 1):
        begin = np.arange(5 - k)
        crossed = (begin < 3) & (begin + k >= 3)
        assert torch.equal(unrolled.alive, torch.from_numpy(~crossed).expand(24, -1))


@pytest.mark.parametrize(("latent", "places"), [("simnorm", 0.9), ("categorical", 0.6)])
def test_the_model_learns_a_toy_world(latent, places):
    """Reward, collision and the others' places are predicted two decisions ahead, without frames."""
    model = trained(replace(SMALL, latent=latent), 130)
    batch = toy(np.random.default_rng(7), b=64)
    with torch.no_grad():
        state = model.first(model.embed(batch.frames[:, 0]))
        for k in range(2):
            state = model.imagine(state, batch.actions[:, k])
        outcomes = model.outcomes(state.features)
        grid = model.decode(state.features)[:, 0]
    crashed = batch.crashed[:, 1]
    assert crashed.any()
    assert (outcomes.reward - batch.rewards[:, 1]).abs().mean() < 0.15
    assert ((outcomes.collision > 0) == crashed).float().mean() > 0.9
    assert ((outcomes.continuation < 0) == crashed).float().mean() > 0.9
    columns = batch.frames[:, 2, OTHERS, 8, ::2].float().argmax(-1)
    assert (grid.mean(1).argmax(-1) == columns).float().mean() > places


def spread(config: WorldModelConfig) -> float:
    """Mean standard deviation of the latent's logits over frames, after training on predicted latents alone."""
    model = trained(replace(config, decoding=0.0, outcomes=0.0), 40)
    with torch.no_grad():
        logits = model.observe(*(getattr(toy(np.random.default_rng(5)), n) for n in ("frames", "actions", "first")))
    return float(logits.logits.flatten(0, 1).flatten(1).std(0).mean())


def test_embeddings_collapse_without_the_term_that_prevents_it_and_not_with_it():
    """Predicting one's own embedding alone is solved by a constant; the default configuration does not fall for it."""
    assert spread(replace(SMALL, variance=0.0, covariance=0.0)) < 0.3
    assert spread(SMALL) > 0.7


def test_terms_against_collapse_are_zero_for_independent_columns_of_unit_deviation():
    sample = torch.randn(20_000, 4, generator=torch.Generator().manual_seed(0)) * 1.1
    assert max(map(float, anti_collapse(sample))) < 1e-3
    variance, covariance = anti_collapse(sample[:, :1].expand(-1, 4))
    assert float(variance) < 1e-3
    assert float(covariance) > 1
    assert float(anti_collapse(0 * sample)[0]) == pytest.approx(0.99, abs=0.01)


def test_a_state_is_indexed_and_flattened_as_a_whole():
    state = LatentState(torch.zeros(3, 4, 5), torch.ones(3, 4, 7))
    assert state[:, 0].features.shape == (3, 12)
    assert state.flat().h.shape == (12, 5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"latent": "gaussian"}, "simnorm, categorical"),
        ({"objective": "both"}, "joint-embedding, reconstruction"),
        ({"groups": 0}, "positive whole number"),
        ({"seed": -1}, "from 0 on"),
        ({"variance": float("nan")}, "finite number"),
        ({"unimix": 1.0}, "below 1"),
        ({"view": FrameView(size=40)}, "multiple of 16"),
    ],
)
def test_bad_configurations_are_refused(change, message):
    with pytest.raises(ConfigError, match=message):
        replace(SMALL, **change)


def test_bad_frames_and_short_sequences_are_refused():
    model = WorldModel(SMALL)
    for frames in (torch.zeros(5, 32, 32, dtype=torch.uint8), torch.zeros(SMALL.shape)):
        with pytest.raises(ModelError, match="uint8"):
            model.embed(frames)
    with pytest.raises(ModelError, match="2 decisions or more"):
        world_model_losses(model, toy(np.random.default_rng(0), l=1))
