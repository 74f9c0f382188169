"""Training writes its files, and the reference policies load and act."""

import json
import shlex

import gymnasium as gym
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from stable_baselines3 import DQN, PPO
from typer.testing import CliRunner

from evaluation.commands.cli import app
from evaluation.learning.algorithms import get_algorithm
from evaluation.learning.manifests import manifest_path
from evaluation.learning.normalisation import fold, normalised
from evaluation.learning.recipes import RECIPES
from evaluation.names import FIRST_EVALUATION_SEED
from evaluation.policies import list_references, load_reference, reference_manifest
from evaluation.running.identity import file_hash
from evaluation.settings import Setting, get_setting
from evaluation.training.train import train, train_recipe
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
        ("trpo", TINY, {**SMALL_NET, "n_steps": 32, "batch_size": 16}),
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
    assert manifest["sha256"] == file_hash(trained.path)
    assert "commit" in manifest

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


NORMALISED = {"normalise": ["observations", "rewards"], "exploration": [0.3, 0.05], "fast": True}
ROLLOUT = {**SMALL_NET, "n_steps": 32, "batch_size": 16, "n_epochs": 1}


def test_options_are_in_the_manifest_and_its_command_repeats_the_training(tmp_path, monkeypatch):
    arguments = {"hyperparameters": ROLLOUT, "progress": False, **NORMALISED}
    first = train(CONTINUOUS, "ppo", 60, seed=3, output=tmp_path / "a.zip", **arguments)
    assert {key: first.manifest[key] for key in NORMALISED} == NORMALISED
    (tmp_path / "again").mkdir()
    monkeypatch.chdir(tmp_path / "again")
    code = shlex.split(first.manifest["command"])[2].replace("train(Setting", "train(progress=False, setting=Setting")
    code = code.replace("'ppo', 60, 3,", "algorithm='ppo', steps=60, seed=3,")
    exec(code, {})
    policies = [PPO.load(path, device="cpu").policy.state_dict() for path in (first.path, tmp_path / "again" / "a.zip")]
    for key, value in policies[0].items():
        assert torch.equal(value, policies[1][key]), key


def test_fast_observations_train_the_same_policy(tmp_path):
    weights = []
    for fast in (False, True):
        options = {"hyperparameters": ROLLOUT, "fast": fast, "simulator": "highway-env", "progress": False}
        path = train(CONTINUOUS, "ppo", 64, 3, output=tmp_path / str(fast), **options).path
        weights.append(PPO.load(path, device="cpu").policy.state_dict())
    for key, value in weights[0].items():
        torch.testing.assert_close(value, weights[1][key], atol=1e-4, rtol=1e-3)


def test_exploration_starts_at_the_configured_deviation(tmp_path):
    hyperparameters = {**ROLLOUT, "learning_rate": 0.0}
    trained = train(
        CONTINUOUS, "ppo", 32, 0, output=tmp_path / "x", hyperparameters=hyperparameters, progress=False, **NORMALISED
    )
    deviations = PPO.load(trained.path, device="cpu").policy.log_std.exp().detach().numpy()
    np.testing.assert_allclose(deviations, [0.3, 0.05], rtol=1e-6)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**31), st.floats(0.01, 100), st.floats(-20, 20))
def test_a_folded_policy_acts_on_raw_observations_as_on_normalised_ones(seed, spread, middle):
    random = np.random.default_rng(seed)

    class Scattered(gym.Env):
        observation_space = gym.spaces.Box(-np.inf, np.inf, (3, 2), np.float32)
        action_space = gym.spaces.Box(-1, 1, (2,), np.float32)

        def reset(self, *, seed=None, options=None):
            return self.step(None)[0], {}

        def step(self, action):
            return (middle + spread * random.standard_normal((3, 2))).astype(np.float32), 1.0, False, False, {}

    world = normalised(Scattered(), ["observations"], 0.9)
    model = PPO(
        "MlpPolicy", world, n_steps=32, batch_size=16, n_epochs=1, seed=seed, device="cpu",
        policy_kwargs={"net_arch": [8]},
    )  # fmt: skip
    model.learn(32)
    raw = middle + spread * random.standard_normal((20, 3, 2))
    before = model.policy.get_distribution(torch.as_tensor(world.normalize_obs(raw)).float()).distribution.mean
    value = model.policy.predict_values(torch.as_tensor(world.normalize_obs(raw)).float())
    fold(model)
    after = model.policy.get_distribution(torch.as_tensor(raw).float()).distribution.mean
    torch.testing.assert_close(after, before, atol=2e-4, rtol=1e-3)
    torch.testing.assert_close(model.policy.predict_values(torch.as_tensor(raw).float()), value, atol=5e-3, rtol=1e-2)


def test_a_policy_without_normalisation_cannot_be_folded(tmp_path):
    env = TINY.make()
    try:
        with pytest.raises(ConfigError, match="nothing to fold"):
            fold(PPO("MlpPolicy", env, policy_kwargs={"net_arch": [8]}))
        with pytest.raises(ConfigError, match="not DQNPolicy"):
            fold(DQN("MlpPolicy", env, buffer_size=10))
    finally:
        env.close()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"setting": "motorway"}, "highway-fast"),
        ({"algorithm": "cem"}, "dqn.*ppo"),
        ({"algorithm": "sac"}, "have .*'dqn'"),
        ({"setting": CONTINUOUS}, "have .*'sac'"),
        ({"steps": 0}, "positive"),
        ({"normalise": ["rewards"]}, "dqn cannot normalise rewards; a2c, ppo, maskableppo can"),
        ({"algorithm": "ppo", "normalise": ["actions"]}, "can normalise observations and rewards"),
        ({"exploration": [0.1]}, "of which there are 0"),
        ({"algorithm": "ppo", "setting": CONTINUOUS, "exploration": [0.1]}, "of which there are 2"),
        ({"algorithm": "ppo", "setting": CONTINUOUS, "exploration": [0.1, 0.0]}, "positive number"),
        ({"seed": FIRST_EVALUATION_SEED}, "kept for evaluation"),
        ({"seed": -1}, "training seeds"),
    ],
)
def test_invalid_training_is_refused_before_any_file_is_written(tmp_path, arguments, message):
    valid = {"setting": TINY, "algorithm": "dqn", "steps": 10, "seed": 0}
    with pytest.raises(ConfigError, match=message):
        train(**{**valid, **arguments}, output=tmp_path / "policy", progress=False)
    assert not list(tmp_path.iterdir())


def test_an_unknown_recipe_is_answered_with_the_valid_ones():
    with pytest.raises(ConfigError, match=r"dqn-abz-adversarial.*ppo-highway-fast"):
        train_recipe("nobody")


@pytest.mark.parametrize("shield", ["default", "simulated"])
@pytest.mark.parametrize("algorithm", ["ppo", "dqn"])
def test_inside_the_shield_either_simulator_gives_the_same_model(tmp_path, shield, algorithm):
    weights, hyperparameters = [], {"ppo": {**SMALL_NET, "n_steps": 32, "batch_size": 16}, "dqn": OFF_POLICY}[algorithm]
    for simulator in ("highway-env", "compiled", "auto"):
        options = {"hyperparameters": hyperparameters, "shield": shield, "simulator": simulator, "progress": False}
        trained = train(TINY, algorithm, 64, 1, output=tmp_path / simulator, **options)
        assert trained.manifest["shield"] == shield
        assert trained.manifest["simulator"] == ("highway-env" if simulator == "highway-env" else "compiled")
        assert f"shield={shield!r}" in shlex.split(trained.manifest["command"])[2]
        weights.append(get_algorithm(algorithm).load(trained.path, device="cpu").policy.state_dict())
    for other in weights[1:]:
        assert weights[0].keys() == other.keys()
        assert all(torch.equal(value, other[key]) for key, value in weights[0].items())


@pytest.mark.parametrize(
    ("setting", "sensor", "message"),
    [
        (CONTINUOUS, "exact", "ContinuousAction"),
        (TINY, "normalised-0.5", "observes highway-env itself"),
        (Setting("merge", "merge-v0", {"duration": 4}), "exact", "merge-v0"),
    ],
)
def test_a_shielded_setting_that_is_not_compiled_is_trained_in_highway_env(tmp_path, setting, sensor, message):
    options = {"hyperparameters": {**SMALL_NET, "n_steps": 8, "batch_size": 8}, "shield": "default", "progress": False}
    trained = train(setting, "ppo", 8, 1, output=tmp_path / "policy", sensor=sensor, **options)
    assert trained.manifest["simulator"] == "highway-env"
    with pytest.raises(ConfigError, match=message):
        train(setting, "ppo", 8, 1, output=tmp_path / "policy", sensor=sensor, simulator="compiled", **options)


def test_an_unknown_shield_profile_is_refused_in_training(tmp_path):
    options = {"hyperparameters": {**SMALL_NET, "n_steps": 16, "batch_size": 16}, "progress": False}
    with pytest.raises(ConfigError, match="'default', 'meta-actions', 'roads', 'simulated'"):
        train(TINY, "ppo", 16, 1, output=tmp_path / "policy", shield="paper", **options)


def test_every_recipe_has_its_reference_policy():
    assert list_references() == sorted(RECIPES)


@pytest.mark.parametrize("name", list_references())
def test_a_reference_policy_is_small_and_its_manifest_repeats_its_recipe(name):
    from importlib.resources import files

    recipe, manifest = RECIPES[name], reference_manifest(name)
    assert len((files("evaluation.policies") / f"{name}.zip").read_bytes()) < 2_000_000
    assert manifest["command"] == f"shield train --recipe {name}"
    assert manifest["algorithm"] == recipe.algorithm
    assert manifest["steps"] == recipe.steps
    assert manifest["seed"] == recipe.seed
    assert manifest["hyperparameters"] == recipe.hyperparameters
    assert manifest.get("normalise", []) == list(recipe.normalise)
    assert manifest.get("exploration", []) == list(recipe.exploration)
    assert manifest.get("fast", False) == recipe.fast
    assert manifest.get("shield", "none") == recipe.shield
    assert manifest.get("sensor", "exact") == recipe.sensor
    setting = get_setting(recipe.setting)
    assert manifest["setting"] == {
        "name": setting.name,
        "env_id": setting.env_id,
        "config": dict(setting.config),
    }


@pytest.mark.parametrize("name", list_references())
def test_a_reference_policy_loads_with_its_environment_and_acts(name):
    env = get_setting(RECIPES[name].setting).make()
    try:
        model = load_reference(name, env=env)
        obs, _ = env.reset(seed=0)
        action, _ = model.predict(obs, deterministic=True)
        again, _ = load_reference(name).predict(obs, deterministic=True)
        assert env.action_space.contains(action if isinstance(env.action_space, gym.spaces.Box) else int(action))
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


def test_fewer_steps_than_the_recipes_are_those_that_are_trained(tmp_path, monkeypatch):
    asked = {}
    told = lambda options, **kwargs: asked.update(options=options, **kwargs)  # noqa: E731
    monkeypatch.setattr("evaluation.training.train.train_with", told)
    train_recipe("ppo-highway-fast", tmp_path / "x.zip", steps=77)
    assert asked["options"].steps == 77
    assert asked["command"].endswith("--steps 77")


def test_several_environments_teach_the_same_in_either_simulator(tmp_path):
    """Two side by side have the seeds of two in a row, compiled or not."""
    models = []
    for simulator in ("compiled", "highway-env"):
        trained = train(
            "highway-fast",
            "ppo",
            64,
            3,
            output=tmp_path / simulator,
            hyperparameters={"n_steps": 32, "batch_size": 32},
            simulator=simulator,
            envs=2,
            progress=False,
        )
        assert trained.manifest["envs"] == 2
        assert trained.manifest["steps_taken"] == 64
        models.append(PPO.load(trained.path, device="cpu").policy.state_dict())
    assert all(torch.equal(models[0][key], models[1][key]) for key in models[0])


def test_hyperparameters_come_from_a_file_and_single_settings(tmp_path):
    file = tmp_path / "ppo.toml"
    file.write_text("n_steps = 16\nbatch_size = 16\n[policy_kwargs]\nnet_arch = [8]\n")
    output = tmp_path / "policy.zip"
    args = f"train --setting highway-fast --steps 32 --envs 2 --hyperparameters {file} --output {output}"
    done = CliRunner().invoke(app, [*args.split(), "--set", "n_steps=8", "--set", "gamma=0.8"])
    assert done.exit_code == 0, done.output
    model = PPO.load(output, device="cpu")
    assert (model.n_steps, model.batch_size, model.gamma, model.n_envs) == (8, 16, 0.8, 2)
    assert model.policy_kwargs["net_arch"] == [8]


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["--set", "n_step=8"], "takes no such hyperparameters"),
        (["--set", "n_steps"], "KEY=VALUE"),
        (["--hyperparameters", "nowhere.toml"], "cannot be read as TOML"),
        (["--recipe", "ppo-merge", "--envs", "2"], "a recipe has its own"),
    ],
)
def test_unknown_hyperparameters_are_refused(tmp_path, args, message):
    setting = [] if "--recipe" in args else ["--setting", "highway-fast"]
    done = CliRunner().invoke(app, ["train", *setting, "--steps", "8", "--output", str(tmp_path / "x.zip"), *args])
    assert message in str(done.exception)


def test_steps_added_by_a_rollout_are_warned_of(tmp_path, caplog):
    """An algorithm on policy finishes its rollout: 40 steps of rollouts of 32 are 64."""
    options = {"hyperparameters": {**ROLLOUT}, "progress": False}
    train(TINY, "ppo", 64, 0, output=tmp_path / "whole", **options)
    assert "steps are driven" not in caplog.text
    trained = train(TINY, "ppo", 40, 0, output=tmp_path / "more", **options)
    assert "64 steps are driven, not 40: a rollout has n_steps x environments = 32 x 1 steps" in caplog.text
    assert PPO.load(trained.path, device="cpu").num_timesteps == 64
