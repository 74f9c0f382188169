"""The algorithm of a saved model is read from its file; a file that does not fit is named."""

from __future__ import annotations

import zipfile

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import pytest

from evaluation.learning.algorithms import ALGORITHMS, algorithm_of, get_algorithm, load_model
from evaluation.names import BASELINES, TRAINABLE
from evaluation.running.named_policies import make_policy
from evaluation.training.train import _ACTION_SPACES
from shield.errors import ConfigError, PolicyError

INPUTS = ("ddpg", "sac", "td3", "tqc", "crossq")
POLICIES = {"ars": "LinearPolicy", "recurrentppo": "MlpLstmPolicy"}
BUFFERED = ("dqn", "qrdqn", *INPUTS)


def env_for(name):
    config = {"action": {"type": "ContinuousAction"}} if name in INPUTS else {}
    return gym.make("highway-fast-v0", config=config)


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("models")
    for name in ALGORITHMS:
        options = {"buffer_size": 10} if name in BUFFERED else {}
        get_algorithm(name)(POLICIES.get(name, "MlpPolicy"), env_for(name), device="cpu", **options).save(folder / name)
    return folder


@pytest.mark.parametrize("name", ALGORITHMS)
def test_a_models_file_says_its_algorithm(saved, name):
    path = saved / f"{name}.zip"
    assert algorithm_of(path) == {"ddpg": "td3"}.get(name, name)
    policy = make_policy(str(path), env_for(name), None)
    assert isinstance(policy, get_algorithm(algorithm_of(path)))
    assert isinstance(load_model(path, name), get_algorithm(name))


def test_a_model_of_another_algorithm_is_named_as_such(saved):
    with pytest.raises(PolicyError, match=r"sac.zip was trained with sac, not with dqn; pass --algorithm sac"):
        load_model(saved / "sac.zip", "dqn")


@pytest.mark.parametrize("content", [None, b"nothing", {}, {"data": "[1"}], ids=["none", "bytes", "empty", "broken"])
def test_a_file_that_is_no_model_is_named(tmp_path, content):
    path = tmp_path / "model.zip"
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None:
        with zipfile.ZipFile(path, "w") as archive:
            for name, text in content.items():
                archive.writestr(name, text)
    with pytest.raises(PolicyError, match=r"model.zip is not a model saved by Stable-Baselines3"):
        algorithm_of(path)


def test_algorithms_go_by_their_names():
    assert get_algorithm("Maskable-PPO") is get_algorithm("maskableppo")
    with pytest.raises(ConfigError, match=r"unknown algorithm 'reinforce'; have a2c, ars"):
        get_algorithm("reinforce")


def test_the_names_on_the_command_line_are_those_of_the_registry():
    assert sorted(TRAINABLE) == sorted(_ACTION_SPACES)
    for name in BASELINES:
        parks = name.startswith("cem-")
        env = gym.make("parking-v0") if parks else env_for("sac" if name in ("throttle", "mpc") else "ppo")
        assert callable(make_policy(name, env).predict)
