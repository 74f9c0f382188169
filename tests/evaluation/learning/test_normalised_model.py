"""A model trained in VecNormalize is driven with the statistics in its folder."""

from __future__ import annotations

import pickle

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize
from typer.testing import CliRunner

from evaluation.commands.cli import app
from evaluation.learning.normalised_model import NormalisedModel, statistics_beside
from evaluation.running.named_policies import make_policy
from shield import Shield, ShieldedEnv
from shield.errors import PolicyError
from shield.wrappers.ranking import ranking_of


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A model, its environment, and the folder of its two files."""
    folder = tmp_path_factory.mktemp("zoo")
    inside = VecNormalize(DummyVecEnv([lambda: gym.make("highway-fast-v0")]), clip_obs=2.0)
    model = PPO("MlpPolicy", inside, n_steps=32, batch_size=32, seed=1, device="cpu").learn(96)
    model.save(folder / "mine.zip")
    inside.save(folder / "vecnormalize.pkl")
    return model, inside, folder


def test_actions_and_preferences_are_those_of_the_model_in_its_own_environment(trained):
    model, inside, folder = trained
    env = gym.make("highway-fast-v0")
    policy = make_policy(str(folder / "mine.zip"), env)
    assert isinstance(policy, NormalisedModel)
    differs = False
    for seed in range(30):
        raw, _ = env.reset(seed=seed)
        seen = inside.normalize_obs(raw)
        expected, _ = model.predict(seen, deterministic=True)
        action, _ = policy.predict(raw, deterministic=True)
        assert action == expected
        assert np.array_equal(ranking_of(policy, raw), ranking_of(model, seen))
        differs |= model.predict(raw, deterministic=True)[0] != expected
    assert differs, "the statistics make no difference here: another model is needed for this test"


def test_both_wrappers_accept_a_normalised_model(trained):
    _, _, folder = trained
    env = gym.make("highway-fast-v0")
    policy = make_policy(str(folder / "mine.zip"), env)
    obs, _ = env.reset(seed=3)
    shield = Shield(policy, env=env)
    shield.predict(obs, deterministic=True)
    around = ShieldedEnv(gym.make("highway-fast-v0"), policy=policy)
    obs, _ = around.reset(seed=3)
    around.step(policy.predict(obs, deterministic=True)[0])
    assert around.last_decision.executed == shield.last_decision.executed


@pytest.mark.parametrize(
    ("model", "statistics"),
    [
        ("a.zip", "a_vecnormalize.pkl"),
        ("a.zip", "a-vecnormalize.pkl"),
        ("a.zip", "vecnormalize.pkl"),
        ("a.zip", "vec_normalize.pkl"),
        ("rl_model_500_steps.zip", "rl_model_vecnormalize_500_steps.pkl"),
    ],
)
def test_the_usual_names_are_found(tmp_path, model, statistics):
    (tmp_path / statistics).touch()
    (tmp_path / "rl_model_vecnormalize_400_steps.pkl").touch()
    (tmp_path / "a_replay_buffer.pkl").touch()
    assert statistics_beside(tmp_path / model) == tmp_path / statistics


def test_a_model_alone_has_none(tmp_path):
    assert statistics_beside(tmp_path / "a.zip") is None


def test_the_command_line_names_the_statistics(trained):
    _, _, folder = trained
    result = CliRunner().invoke(
        app, ["evaluate", "--policy", str(folder / "mine.zip"), "--shield", "none", "--episodes", "1", "--jobs", "1"]
    )
    assert result.exit_code == 0, result.output
    assert "normalised by vecnormalize.pkl" in " ".join(result.stderr.split())


@pytest.mark.parametrize("content", [b"nothing", pickle.dumps([1, 2])], ids=["bytes", "list"])
def test_a_file_that_holds_no_statistics_is_named(trained, tmp_path, content):
    model, _, _ = trained
    model.save(tmp_path / "mine.zip")
    (tmp_path / "vecnormalize.pkl").write_bytes(content)
    with pytest.raises(PolicyError, match=r"vecnormalize.pkl (cannot be read|holds a list)"):
        make_policy(str(tmp_path / "mine.zip"), gym.make("highway-fast-v0"))


def test_statistics_of_other_observations_are_refused(trained, tmp_path):
    model, _, _ = trained
    model.save(tmp_path / "mine.zip")
    other = gym.make("highway-fast-v0", config={"observation": {"type": "Kinematics", "vehicles_count": 3}})
    VecNormalize(DummyVecEnv([lambda: other])).save(tmp_path / "vecnormalize.pkl")
    with pytest.raises(PolicyError, match=r"observations of shape \(3, 5\), the model takes \(5, 5\)"):
        make_policy(str(tmp_path / "mine.zip"), gym.make("highway-fast-v0"))
