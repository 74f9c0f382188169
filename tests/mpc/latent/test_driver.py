"""`LatentDriver`: SB3's predict with a recurrent state, behind both wrappers of the shield, and its checkpoint."""

from __future__ import annotations

import gymnasium as gym
import highway_env  # noqa: F401
import numpy as np
import pytest
import torch

from dynamics.errors import ConfigError, ModelError, PolicyError
from dynamics.world_model.config import WorldModelConfig
from dynamics.world_model.files import load_world_model, save_world_model
from dynamics.world_model.model import WorldModel
from dynamics.world_model.view import FrameView
from evaluation.wrappers import BirdsEyeView
from mpc.latent.actor_critic import ActorCritic, DriverConfig
from mpc.latent.driver import LatentDriver
from mpc.latent.files import load_driver, save_driver
from shield import Shield, ShieldedEnv

VIEW = FrameView(size=16)
TINY = WorldModelConfig(view=VIEW, depth=8, embedding=16, recurrent=8, groups=2, classes=4, hidden=8)


def driver(lookahead: int = 0) -> LatentDriver:
    networks = ActorCritic(DriverConfig(hidden=8), TINY.features, TINY.actions)
    with torch.no_grad():
        networks.actor[-1].weight.normal_(generator=torch.Generator().manual_seed(1))
    return LatentDriver(WorldModel(TINY), networks, lookahead)


def frames(n: int) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 255, (n, *TINY.shape), np.uint8)


@pytest.mark.parametrize("lookahead", [0, 2])
def test_a_batch_is_driven_as_each_frame_alone(lookahead):
    """The recurrent state is carried by the caller, a row for each environment."""
    policy, seen = driver(lookahead), [frames(3), frames(3)[::-1]]
    state, alone = None, [None] * 3
    for t, observation in enumerate(seen):
        actions, state = policy.predict(observation, state, np.full(3, t == 0), deterministic=True)
        assert actions.shape == (3,)
        for i in range(3):
            action, alone[i] = policy.predict(observation[i], alone[i], np.array([t == 0]), deterministic=True)
            assert action.shape == ()
            assert action == actions[i]
            assert np.allclose(alone[i], state[i], atol=1e-5)


def test_the_state_is_blank_at_the_start_of_an_episode_and_matters_after():
    policy, observation = driver(), frames(2)
    _, state = policy.predict(observation, deterministic=True)
    _, fresh = policy.predict(observation, None, deterministic=True)
    _, mixed = policy.predict(observation, state, np.array([True, False]), deterministic=True)
    assert np.allclose(mixed[0], fresh[0], atol=1e-6)
    assert not np.allclose(mixed[1], fresh[1], atol=1e-3)


def test_samples_follow_the_actor():
    torch.manual_seed(0)
    policy, observation = driver(), np.repeat(frames(1), 4000, 0)
    actions, _ = policy.predict(observation)
    model = policy.model
    with torch.no_grad():
        state = model.first(model.embed(torch.from_numpy(frames(1))))
        wanted = torch.softmax(policy.networks.actor(state.features), -1)[0]
    assert np.allclose(np.bincount(actions, minlength=5) / 4000, wanted, atol=0.03)


@pytest.mark.parametrize("placed", ["Shield", "ShieldedEnv"])
def test_it_drives_behind_the_shield(placed):
    base = gym.make("highway-fast-v0", config={"duration": 4})
    policy = driver()
    env = BirdsEyeView(base, VIEW) if placed == "Shield" else BirdsEyeView(ShieldedEnv(base), VIEW)
    driving = Shield(policy, env=env) if placed == "Shield" else policy
    observation, _ = env.reset(seed=0)
    state, start, done = None, np.array([True]), False
    while not done:
        action, state = driving.predict(observation, state, start, deterministic=True)
        observation, _, terminated, truncated, info = env.step(int(action))
        done, start = terminated or truncated, np.array([False])
    assert not info["crashed"]
    assert state.shape == (1, TINY.recurrent)


def test_other_observations_and_states_are_refused():
    policy = driver()
    for wrong in (np.zeros((5, 5), np.float32), np.zeros((5, 64, 64), np.uint8), np.zeros(TINY.shape, np.float32)):
        with pytest.raises(PolicyError, match="uint8"):
            policy.predict(wrong)
    with pytest.raises(PolicyError, match="state"):
        policy.predict(frames(2), np.zeros((3, 8)))
    with pytest.raises(PolicyError, match="observation_space"):
        Shield(policy, env=gym.make("highway-fast-v0"))
    with pytest.raises(ConfigError, match="lookahead"):
        driver(-1)
    with pytest.raises(ConfigError, match="features"):
        LatentDriver(WorldModel(TINY), ActorCritic(DriverConfig(), 7, 5))


def test_a_driver_is_read_back(tmp_path):
    policy = driver()
    folder = save_driver(policy, tmp_path / "driver", {"note": 1})
    read = load_driver(folder, lookahead=1)
    assert read.lookahead == 1
    assert read.networks.config == policy.networks.config
    assert np.array_equal(
        load_driver(folder).predict(frames(9), deterministic=True)[0], policy.predict(frames(9), deterministic=True)[0]
    )
    assert load_world_model(folder).config == TINY


def test_a_world_model_alone_is_no_driver(tmp_path):
    with pytest.raises(ModelError, match="without a driver"):
        load_driver(save_world_model(WorldModel(TINY), tmp_path))
