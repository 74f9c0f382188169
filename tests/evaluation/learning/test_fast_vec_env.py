"""Stable-Baselines3 learns the same in the compiled highway as in highway-env, to the bit."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecNormalize

from evaluation.learning.fast_vec_env import FastHighwayVecEnv
from evaluation.settings import Setting
from evaluation.training.train import train
from shield.errors import ConfigError

CONFIG = {"vehicles_count": 6, "duration": 6}
SHORT = Setting("short", "highway-fast-v0", CONFIG)


def told(info):
    """An info without the clock's time."""
    known = dict(info)
    if "episode" in known:
        known["episode"] = {name: value for name, value in known["episode"].items() if name != "t"}
    return known


@pytest.mark.parametrize("action", ["DiscreteMetaAction", "ContinuousAction"])
def test_steps_and_infos_are_those_of_monitors_around_highway_env(action):
    config = {**CONFIG, "action": {"type": action}}
    theirs = make_vec_env("highway-fast-v0", 3, env_kwargs={"config": config})
    mine = FastHighwayVecEnv(3, "highway-fast-v0", config)
    for env in (theirs, mine):
        env.seed(5)
    assert np.array_equal(theirs.reset(), mine.reset())
    rng, ends = np.random.default_rng(0), 0
    for _ in range(40):
        actions = rng.integers(5, size=3) if action.startswith("D") else rng.uniform(-1, 1, (3, 2)).astype(np.float32)
        *one, infos = theirs.step(actions)
        *two, mine_infos = mine.step(actions)
        for a, b in zip(one, two, strict=True):
            assert a.dtype == b.dtype
            assert np.array_equal(a, b)
        for a, b in zip(infos, mine_infos, strict=True):
            np.testing.assert_equal(told(b), told(a))
        ends += one[2].sum()
    assert ends > 2


def test_ppo_ends_with_the_same_network():
    networks = []
    for env in (make_vec_env("highway-fast-v0", 2, env_kwargs={"config": CONFIG}), FastHighwayVecEnv(2, config=CONFIG)):
        torch.set_num_threads(1)
        model = PPO("MlpPolicy", env, n_steps=32, batch_size=32, n_epochs=2, seed=3, device="cpu").learn(192)
        networks.append([parameter.detach().clone() for parameter in model.policy.parameters()])
    assert all(torch.equal(a, b) for a, b in zip(*networks, strict=True))


@pytest.mark.parametrize("normalise", [(), ("observations", "rewards")])
def test_training_in_either_simulator_gives_the_same_model(tmp_path, normalise):
    networks = []
    for simulator in ("highway-env", "compiled", "auto"):
        trained = train(
            SHORT,
            "ppo",
            64,
            1,
            output=tmp_path / f"{simulator}.zip",
            hyperparameters={"n_steps": 32, "batch_size": 16, "n_epochs": 1},
            normalise=normalise,
            simulator=simulator,
            progress=False,
        )
        assert trained.manifest["simulator"] == ("highway-env" if simulator == "highway-env" else "compiled")
        model = PPO.load(trained.path, device="cpu")
        networks.append([parameter.detach().clone() for parameter in model.policy.parameters()])
    for other in networks[1:]:
        assert all(torch.equal(a, b) for a, b in zip(networks[0], other, strict=True))


def test_a_setting_that_is_not_compiled_is_trained_in_highway_env(tmp_path):
    setting = Setting("grid", "highway-fast-v0", {**CONFIG, "observation": {"type": "TimeToCollision"}})
    options = {"hyperparameters": {"n_steps": 8, "batch_size": 8, "n_epochs": 1}, "progress": False}
    trained = train(setting, "ppo", 8, 1, output=tmp_path / "x.zip", **options)
    assert trained.manifest["simulator"] == "highway-env"
    with pytest.raises(ConfigError, match="TimeToCollision"):
        train(setting, "ppo", 8, 1, output=tmp_path / "x.zip", simulator="compiled", **options)
    with pytest.raises(ConfigError, match=r"unknown simulator 'fast'; have auto, compiled, highway-env"):
        train(setting, "ppo", 8, 1, output=tmp_path / "x.zip", simulator="fast", **options)


def test_evaluate_policy_and_vecnormalize_take_it_as_any_other():
    env = FastHighwayVecEnv(2, config=CONFIG)
    model = PPO("MlpPolicy", VecNormalize(env), n_steps=16, batch_size=16, device="cpu").learn(32)
    mean, _ = evaluate_policy(model, model.get_env(), n_eval_episodes=3)
    assert np.isfinite(mean)
    assert env.env_is_wrapped(Monitor) == [True, True]
    assert env.get_attr("config", [1])[0]["vehicles_count"] == 6


def test_a_missing_attribute_of_a_compiled_highway_is_named():
    env = FastHighwayVecEnv(2, config=CONFIG)
    with pytest.raises(ConfigError, match=r"has no 'road'; have config"):
        env.get_attr("road")
    with pytest.raises(ConfigError, match=r"has no method 'render'.*simulator.store"):
        env.env_method("render")
    with pytest.raises(ConfigError, match="cannot be set"):
        env.set_attr("config", {})


def test_a_live_environment_continues_the_compiled_one():
    env, live = FastHighwayVecEnv(2, config=CONFIG), gym.make("highway-fast-v0", config=CONFIG)
    env.seed(3)
    env.reset()
    live.reset(seed=8)
    env.step(np.array([3, 1]))
    env.simulator.store(live, 1)
    for action in (1, 0, 3):
        observations, rewards, _, _ = env.step(np.array([1, action]))
        seen, reward, *_ = live.step(action)
        assert np.array_equal(seen, observations[1])
        assert np.float32(reward) == rewards[1]
