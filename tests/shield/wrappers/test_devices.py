"""Models and networks on every device of this machine: the CPU, and a GPU if PyTorch sees one.

SB3 loads a model to the GPU by default, so each reader of a network has to move its inputs and results.
"""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
import torch
from policies import make
from sb3_contrib import QRDQN, MaskablePPO
from stable_baselines3 import A2C, DQN, PPO, SAC

from evaluation.learning.normalisation import fold, normalised
from evaluation.training.executed_actions import LearnFromExecuted
from shield import Shield, ShieldedEnv
from shield.wrappers.ranking import ranking_of

DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]
WHEEL = {"action": {"type": "ContinuousAction"}}
ALGORITHMS = {"ppo": PPO, "a2c": A2C, "dqn": DQN, "qrdqn": QRDQN, "maskable": MaskablePPO, "sac": SAC}


def driven(env, act, steps=4):
    """Whether each step was shielded."""
    obs, _ = env.reset(seed=0)
    for _ in range(steps):
        obs, _, terminated, truncated, info = env.step(act(obs))
        yield info.get("shield")
        if terminated or truncated:
            return


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.bfloat16], ids=str)
def test_a_network_is_read_on_its_own_device_and_in_its_own_precision(device, dtype):
    """The observation was handed to every network as float32 on the CPU: others raised at the first decision."""
    torch.manual_seed(0)
    env = make()
    network = torch.nn.Sequential(torch.nn.Flatten(), torch.nn.Linear(25, 5)).to(device=device, dtype=dtype)
    shield = Shield(network, env=env)
    obs, _ = env.reset(seed=0)
    shield.predict(obs)
    scores = network(torch.as_tensor(obs[None]).to(device=device, dtype=dtype)).detach().float().cpu().numpy()
    np.testing.assert_array_equal(ranking_of(shield.policy, obs), scores.astype(float))
    assert shield.last_decision.proposed == scores.argmax()


def test_a_network_without_parameters_takes_float32():
    """It has no device to read."""
    env = make()
    obs, _ = env.reset(seed=0)
    assert Shield(torch.nn.Flatten(), env=env).policy.action_scores(obs).shape == (1, 25)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("name", ALGORITHMS)
def test_a_model_drives_behind_both_wrappers_on_each_device(name, device):
    """Proposals, rankings and actions behind `Shield` and `ShieldedEnv`."""
    config = WHEEL if name == "sac" else {}
    env = make(**config)
    options = {} if name in ("ppo", "a2c", "maskable") else {"buffer_size": 100}
    model = ALGORITHMS[name]("MlpPolicy", env, device=device, seed=0, **options)
    shield = Shield(model, env=env)
    list(driven(env, lambda obs: shield.predict(obs, deterministic=True)[0]))
    assert str(shield.device).split(":")[0] == device
    env = ShieldedEnv(make(**config), policy=model)
    for report in driven(env, lambda obs: model.predict(obs, deterministic=True)[0]):
        assert report is not None
    if name != "sac":
        obs, _ = env.reset(seed=0)
        assert ranking_of(model, obs).shape == (1, 5)


@pytest.mark.parametrize("device", DEVICES)
def test_learning_from_executed_actions_works_on_each_device(device):
    """The executed actions take the place of the proposed ones in the rollout."""
    env = ShieldedEnv(gym.make("highway-fast-v0", config={"duration": 5, "vehicles_count": 5}))
    model = PPO("MlpPolicy", env, n_steps=8, batch_size=8, n_epochs=1, device=device, seed=0)
    model.learn(16, callback=LearnFromExecuted())
    assert model.num_timesteps == 16


@pytest.mark.parametrize("device", DEVICES)
def test_normalisation_is_folded_into_a_model_on_each_device(device):
    """The folded model acts on raw observations as the model did on normalised ones."""
    world = normalised(make(), ["observations"], 0.9)
    model = PPO("MlpPolicy", world, n_steps=32, batch_size=32, n_epochs=1, device=device, seed=0).learn(32)
    obs = world.unnormalize_obs(world.reset())
    before = ranking_of(model, world.normalize_obs(obs))
    fold(model)
    np.testing.assert_allclose(ranking_of(model, obs), before, atol=1e-4)
