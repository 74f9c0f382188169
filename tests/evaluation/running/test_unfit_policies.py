"""A model for other actions or observations is refused with a PolicyError, at every entry point."""

import sys

import gymnasium as gym
import pytest
from stable_baselines3 import PPO
from typer.testing import CliRunner

from evaluation.commands.cli import app, main
from evaluation.running.certify import CertifyRun, certify
from evaluation.running.episodes import run_episode
from evaluation.running.records import PLACEMENTS, ShieldVariant
from evaluation.settings import Setting
from shield import Shield, ShieldedEnv
from shield.config import ShieldConfig
from shield.errors import PolicyError

META = {"action": {"type": "DiscreteMetaAction", "lateral": False}}
TWO_AXES = {"action": {"type": "ContinuousAction"}}
SEVEN = {"observation": {"type": "Kinematics", "vehicles_count": 7}}
SHORT = {"duration": 2, "vehicles_count": 3}


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """Three meta-actions of five, two axes of one, and five rows of seven: models and their files."""
    made, folder = {}, tmp_path_factory.mktemp("models")
    for name, env_id, config in (
        ("longitudinal", "highway-fast-v0", META),
        ("two-axes", "racetrack-v1", TWO_AXES),
        ("five-rows", "highway-fast-v0", {}),
    ):
        model = PPO("MlpPolicy", gym.make(env_id, config=config), n_steps=8, batch_size=8, device="cpu")
        model.save(folder / name)
        made[name] = model, str(folder / f"{name}.zip")
    return made


CASES = [
    (
        "longitudinal",
        "highway-fast-v0",
        SHORT,
        r"another action_space: it has Discrete\(3\), the environment Discrete\(5",
    ),
    (
        "two-axes",
        "racetrack-v1",
        {"duration": 2},
        r"another action_space: it has Box.*\(2,\).*the environment Box.*\(1,\)",
    ),
    ("five-rows", "highway-fast-v0", {**SHORT, **SEVEN}, r"another observation_space: it has Box.*\(5, 5\).*\(7, 5\)"),
]


@pytest.mark.parametrize(("name", "env_id", "config", "message"), CASES)
def test_no_row_is_driven_by_a_model_that_does_not_fit(models, name, env_id, config, message, tmp_path):
    model, path = models[name]
    setting = Setting("mine", env_id, config)
    for placement in PLACEMENTS:
        for policy in (model, path):
            with pytest.raises(PolicyError, match=message):
                run_episode(setting, policy, ShieldVariant(placement))
    with pytest.raises(PolicyError, match=message):
        certify(CertifyRun(setting, path, 1, 50, ShieldConfig()), tmp_path)
    env = gym.make(env_id, config=config)
    for made in (Shield, lambda policy, env: ShieldedEnv(env, policy=policy)):
        with pytest.raises(PolicyError, match=message):
            made(model, env)
    env.close()


@pytest.mark.parametrize("name", ["longitudinal", "five-rows"])
@pytest.mark.parametrize(
    "command",
    [
        ["evaluate", "--shield", "none", "--episodes", "1"],
        ["evaluate", "--shield", "full", "--placement", "all", "--episodes", "1", "--jobs", "1"],
        ["certify", "{folder}/parts", "--episodes", "1"],
        ["replay", "5"],
        ["film", "{folder}/film.gif"],
        ["falsify", "{folder}/worst.json", "--episodes", "500"],
        ["rare", "--samples", "20"],
        ["rare", "--samples", "20", "--sensor", "normalised-0.5"],
    ],
)
def test_every_command_answers_with_one_line(models, name, command, tmp_path, monkeypatch, capsys):
    setting = ["--setting", "abz" if name == "longitudinal" else "highway-fast-seen"]
    arguments = [each.format(folder=tmp_path) for each in command]
    monkeypatch.setattr(sys, "argv", ["shield", *arguments, *setting, "--policy", models[name][1]])
    with pytest.raises(SystemExit) as stop:
        main()
    told = capsys.readouterr()
    assert stop.value.code == 2
    lines = [line for line in told.err.strip().splitlines() if not line.startswith("looking for an override")]
    assert [line.startswith("Error: ") for line in lines] == [True]
    assert f"{name}.zip does not drive this environment: the policy was made for another" in told.err
    assert not told.out


def test_a_model_is_tried_before_the_first_episode(models, monkeypatch):
    monkeypatch.setattr("evaluation.running.comparing.run_paired", lambda *a, **k: pytest.fail("driven"))
    arguments = ["evaluate", "--policy", f"idle,{models['longitudinal'][1]}", "--episodes", "1", "--jobs", "1"]
    assert isinstance(CliRunner().invoke(app, arguments).exception, PolicyError)


@pytest.mark.parametrize(("algorithm", "setting"), [("dqn", "racetrack"), ("sac", "highway-fast"), ("td3", "merge")])
def test_training_refuses_actions_that_an_algorithm_does_not_have(algorithm, setting, monkeypatch, capsys, tmp_path):
    arguments = ["train", "--algorithm", algorithm, "--setting", setting, "--steps", "10"]
    monkeypatch.setattr(sys, "argv", ["shield", *arguments, "--output", str(tmp_path / "x.zip")])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 2
    assert "Error: " in capsys.readouterr().err


def test_spaces_within_a_dictionary_are_compared():
    """A goal of another size stands in a `Dict` of the same keys."""
    from shield.wrappers.policy_adapters import refuse_misfits

    def env(features):
        observation = {
            "type": "KinematicsGoal",
            "features": features,
            "scales": [1] * len(features),
            "normalize": False,
        }
        return gym.make("parking-v0", config={"observation": observation})

    class Model:
        def __init__(self, env):
            self.observation_space, self.action_space = env.observation_space, env.action_space

    full, less = env(["x", "y", "vx", "vy", "cos_h", "sin_h"]), env(["x", "y", "cos_h", "sin_h"])
    refuse_misfits(Model(full), full)
    with pytest.raises(PolicyError, match="another observation_space"):
        refuse_misfits(Model(full), less)
