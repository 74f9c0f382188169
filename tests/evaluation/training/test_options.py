"""`TrainingOptions`: one field is one option of `shield train` and one TOML key."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from evaluation.commands.cli import app
from evaluation.commands.training import _HELP
from evaluation.training.options import TrainingOptions
from evaluation.training.train import train
from shield.errors import ConfigError

ROLLOUT = ["--set", "n_steps=16", "--set", "batch_size=16", "--set", "n_epochs=1"]


def test_every_field_is_a_documented_option_of_the_command():
    command = typer.main.get_command(app).commands["train"]
    asked = {each.name for each in command.params} - {"recipe", "options", "set_", "help"}
    assert asked == {each.name for each in fields(TrainingOptions)} == set(_HELP)


def test_options_come_from_a_file_and_flags_override_it(tmp_path):
    """A file with some fields gives the options of the same flags; flags take precedence."""
    file = tmp_path / "options.toml"
    file.write_text(
        'setting = "highway-fast"\nsteps = 32\nenvs = 2\nseed = 5\nshield = "default"\noverride_penalty = 0.25\n'
        f'output = "{tmp_path / "policy.zip"}"\n[hyperparameters]\nn_steps = 16\nbatch_size = 16\nn_epochs = 1\n'
    )
    done = CliRunner().invoke(app, ["train", "--options", str(file), "--seed", "7", "--set", "gamma=0.8"])
    assert done.exit_code == 0, done.output
    told = json.loads((tmp_path / "policy.json").read_text())
    assert (told["seed"], told["envs"], told["shield"], told["override_penalty"]) == (7, 2, "default", 0.25)
    assert told["hyperparameters"] == {"n_steps": 16, "batch_size": 16, "n_epochs": 1, "gamma": 0.8}


def test_an_environment_of_the_users_is_trained_in_by_its_id(tmp_path):
    config = tmp_path / "few.toml"
    config.write_text("vehicles_count = 3\nduration = 8\n")
    where = ["--env-id", "highway-fast-v0", "--env-config", str(config), "--output", str(tmp_path / "x.zip")]
    done = CliRunner().invoke(app, ["train", *where, "--steps", "32", "--envs", "2", *ROLLOUT])
    assert done.exit_code == 0, done.output
    assert json.loads((tmp_path / "x.json").read_text())["setting"]["config"] == {"vehicles_count": 3, "duration": 8}


@pytest.mark.parametrize(
    ("args", "message"),
    [
        ([], "give either --recipe or --setting, or --env-id"),
        (["--setting", "highway-fast", "--env-id", "highway-v0"], "give either a setting or an env_id"),
        (["--setting", "highway-fast", "--videos"], "give evaluate_every"),
        (["--setting", "highway-fast", "--resume"], "resume goes with checkpoint_every"),
        (["--setting", "highway-fast", "--envs", "0"], "envs must be 1"),
        (["--setting", "highway-fast", "--learn-from", "executed"], "goes with a shield"),
        (["--options", "nowhere.toml"], "cannot be read as TOML"),
        (["--recipe", "ppo-merge", "--masks"], "give --setting with --masks"),
    ],
)
def test_invalid_options_are_refused_with_a_message(tmp_path, args, message):
    done = CliRunner().invoke(app, ["train", *args, *([] if "--recipe" in args else ["--output", str(tmp_path / "x")])])
    assert isinstance(done.exception, ConfigError)
    assert message in str(done.exception)


def test_an_unknown_key_is_answered_with_the_valid_ones(tmp_path):
    file = tmp_path / "options.toml"
    file.write_text('setting = "highway-fast"\npenalty = 1\n')
    with pytest.raises(ConfigError, match="override_penalty"):
        TrainingOptions.read(file)
    with pytest.raises(ConfigError, match=r"unknown training option 'penalty'.*override_penalty"):
        train("highway-fast", "ppo", 8, 0, output=tmp_path / "x", penalty=1)


def test_the_default_output_is_named_after_the_policy():
    options = TrainingOptions(setting="highway-fast", shield="default", masks=True)
    assert options.path == Path("runs/policies/maskableppo-highway-fast.zip")
