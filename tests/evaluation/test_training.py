"""Training writes what it says, and the reference policies load and act."""

import json

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3 import DQN

from evaluation.policies import list_references, load_reference, reference_manifest
from evaluation.settings import Setting, get_setting
from evaluation.training import (
    FIRST_EVALUATION_SEED,
    RECIPES,
    get_algorithm,
    manifest_path,
    train,
    train_recipe,
)
from shield.errors import ConfigError

TINY = Setting("tiny", "highway-fast-v0", {"vehicles_count": 3, "duration": 10})
CONTINUOUS = TINY.override({"action": {"type": "ContinuousAction"}}, name="tiny-continuous")
SMALL_NET = {"policy_kwargs": {"net_arch": [16]}}
OFF_POLICY = {**SMALL_NET, "learning_starts": 20, "buffer_size": 100}


@pytest.mark.parametrize(
    ("algorithm", "setting", "hyperparameters"),
    [
        ("ppo", TINY, {**SMALL_NET, "n_steps": 32, "batch_size": 16, "n_epochs": 1}),
        ("ppo", CONTINUOUS, {**SMALL_NET, "n_steps": 32, "batch_size": 16, "n_epochs": 1}),
        ("a2c", TINY, SMALL_NET),
        ("DQN", TINY, OFF_POLICY),
        ("sac", CONTINUOUS, OFF_POLICY),
        ("td3", CONTINUOUS, OFF_POLICY),
    ],
)
def test_training_writes_a_policy_and_its_manifest(tmp_path, algorithm, setting, hyperparameters):
    threads = torch.get_num_threads()
    trained = train(
        setting,
        algorithm,
        60,
        seed=1,
        hyperparameters=hyperparameters,
        output=tmp_path / "new" / "policy",
        progress=False,
    )
    assert trained.path == tmp_path / "new" / "policy.zip"
    assert torch.get_num_threads() == threads

    manifest = json.loads(manifest_path(trained.path).read_text())
    assert manifest == trained.manifest
    assert manifest["algorithm"] == algorithm.lower()
    assert manifest["setting"]["name"] == setting.name
    assert manifest["seed"] == 1
    assert manifest["steps_taken"] >= manifest["steps"] == 60
    assert manifest["hyperparameters"] == hyperparameters
    assert manifest["command"].startswith("python -c ")
    assert "torch" in manifest["versions"]

    model = get_algorithm(algorithm).load(trained.path, device="cpu")
    env = setting.make()
    try:
        obs, _ = env.reset(seed=0)
        action, _ = model.predict(obs, deterministic=True)
        assert env.action_space.contains(action if isinstance(env.action_space, gym.spaces.Box) else int(action))
    finally:
        env.close()


def test_the_same_seed_trains_the_same_policy(tmp_path):
    weights = []
    for name in ("a", "b"):
        path = train(
            TINY,
            "dqn",
            60,
            seed=2,
            hyperparameters=OFF_POLICY,
            output=tmp_path / name,
            progress=False,
        ).path
        weights.append(DQN.load(path, device="cpu").policy.state_dict())
    for key, value in weights[0].items():
        assert torch.equal(value, weights[1][key]), key


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"setting": "motorway"}, "highway-fast"),
        ({"algorithm": "cem"}, "dqn.*ppo"),
        ({"algorithm": "sac"}, "have .*'dqn'"),
        ({"setting": CONTINUOUS}, "have .*'sac'"),
        ({"steps": 0}, "positive"),
        ({"seed": FIRST_EVALUATION_SEED}, "kept for evaluation"),
        ({"seed": -1}, "training seeds"),
    ],
)
def test_what_cannot_be_trained_is_refused_before_anything_is_written(tmp_path, arguments, message):
    valid = {"setting": TINY, "algorithm": "dqn", "steps": 10, "seed": 0}
    with pytest.raises(ConfigError, match=message):
        train(**{**valid, **arguments}, output=tmp_path / "policy", progress=False)
    assert not list(tmp_path.iterdir())


def test_an_unknown_recipe_is_answered_with_the_valid_ones():
    with pytest.raises(ConfigError, match=r"dqn-abz-adversarial.*ppo-highway-fast"):
        train_recipe("nobody")


def test_every_recipe_has_its_reference_policy():
    assert list_references() == sorted(RECIPES)


@pytest.mark.parametrize("name", sorted(RECIPES))
def test_a_reference_policy_is_small_and_its_manifest_repeats_its_recipe(name):
    from importlib.resources import files

    recipe, manifest = RECIPES[name], reference_manifest(name)
    assert len((files("evaluation.policies") / f"{name}.zip").read_bytes()) < 2_000_000
    assert manifest["command"] == f"shield train --recipe {name}"
    assert manifest["algorithm"] == recipe.algorithm
    assert manifest["steps"] == recipe.steps
    assert manifest["seed"] == recipe.seed
    assert manifest["hyperparameters"] == recipe.hyperparameters
    setting = get_setting(recipe.setting)
    assert manifest["setting"] == {
        "name": setting.name,
        "env_id": setting.env_id,
        "config": dict(setting.config),
    }


@pytest.mark.parametrize("name", sorted(RECIPES))
def test_a_reference_policy_loads_with_its_environment_and_acts(name):
    env = get_setting(RECIPES[name].setting).make()
    try:
        model = load_reference(name, env=env)
        obs, _ = env.reset(seed=0)
        action, _ = model.predict(obs, deterministic=True)
        again, _ = load_reference(name).predict(obs, deterministic=True)
        assert env.action_space.contains(int(action))
        np.testing.assert_array_equal(action, again)
    finally:
        env.close()


def test_an_unknown_reference_is_answered_with_the_valid_ones():
    with pytest.raises(ConfigError, match="dqn-abz-base"):
        load_reference("nobody")


def _drive(name, setting_name, seeds):
    """Crash rate, and mean speed [m/s] over all decisions."""
    model, env = load_reference(name), get_setting(setting_name).make()
    crashes, speeds = [], []
    try:
        for seed in seeds:
            obs, info = env.reset(seed=seed)
            done = False
            while not done:
                action, _ = model.predict(obs, deterministic=True)
                obs, _, terminated, truncated, info = env.step(int(action))
                speeds.append(info["speed"])
                done = terminated or truncated
            crashes.append(info["crashed"])
    finally:
        env.close()
    return float(np.mean(crashes)), float(np.mean(speeds))


@pytest.mark.slow
@pytest.mark.parametrize("setting", ["abz-idm", "abz-aggressive"])
def test_the_adversarial_policy_crashes_nearly_always(setting):
    crash_rate, _ = _drive("dqn-abz-adversarial", setting, range(20))
    assert crash_rate > 0.9


@pytest.mark.slow
def test_the_base_policy_drives_and_mostly_arrives():
    crash_rate, speed = _drive("dqn-abz-base", "abz-idm", range(20))
    assert crash_rate < 0.3
    assert speed >= 20
