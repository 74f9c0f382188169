"""Stable-Baselines3 observes and learns the same on compiled roads as in highway-env, to the bit."""

import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

from evaluation.learning.fast_road_vec_env import FastRoadVecEnv
from evaluation.settings import Setting, get_setting
from evaluation.training.train import train
from shield.errors import ConfigError


def told(info):
    """An info without the clock's time."""
    known = dict(info)
    if "episode" in known:
        known["episode"] = {name: value for name, value in known["episode"].items() if name != "t"}
    return known


@pytest.mark.parametrize(
    ("env_id", "config"), [("two-way-v0", {}), ("exit-v0", {"duration": 3}), ("intersection-v0", {"duration": 3})]
)
def test_steps_and_infos_are_those_of_monitors_around_highway_env(env_id, config):
    theirs, mine = make_vec_env(env_id, 2, env_kwargs={"config": config}), FastRoadVecEnv(2, env_id, config)
    for env in (theirs, mine):
        env.seed(5)
    assert np.array_equal(theirs.reset(), mine.reset())
    rng, ends = np.random.default_rng(0), 0
    for _ in range(6):
        actions = rng.integers(theirs.action_space.n, size=2)
        *one, infos = theirs.step(actions)
        *two, mine_infos = mine.step(actions)
        for a, b in zip(one, two, strict=True):
            assert a.dtype == b.dtype
            assert np.array_equal(a, b)
        for a, b in zip(infos, mine_infos, strict=True):
            np.testing.assert_equal(told(b), told(a))
        ends += one[2].sum()
    assert ends > 0


@pytest.mark.parametrize(
    "setting", [Setting("short", "merge-v0"), get_setting("roundabout").with_traffic("aggressive")]
)
def test_training_takes_it_by_itself_and_gives_the_same_model(tmp_path, setting):
    networks = []
    for simulator in ("highway-env", "auto"):
        trained = train(
            setting,
            "ppo",
            32,
            1,
            output=tmp_path / f"{simulator}.zip",
            hyperparameters={"n_steps": 16, "batch_size": 16, "n_epochs": 1},
            simulator=simulator,
            progress=False,
        )
        assert trained.manifest["simulator"] == ("highway-env" if simulator == "highway-env" else "compiled")
        model = PPO.load(trained.path, device="cpu")
        networks.append([parameter.detach().clone() for parameter in model.policy.parameters()])
    assert all(torch.equal(a, b) for a, b in zip(*networks, strict=True))


def test_a_missing_attribute_of_compiled_roads_is_named():
    env = FastRoadVecEnv(1, "merge-v0")
    with pytest.raises(ConfigError, match=r"has no 'road'; have config"):
        env.get_attr("road")
    with pytest.raises(ConfigError, match=r"has no method 'render'"):
        env.env_method("render")
