"""A key that highway-env ignores is reported, at any place in a configuration."""

import highway_env.envs.common.action as actions
import highway_env.envs.common.observation as observations
import pytest
from typer.testing import CliRunner

from evaluation.commands.cli import app
from evaluation.commands.shared_options import read_settings
from evaluation.commands.unknown_keys import arguments_of, unknown_keys
from evaluation.settings import Setting

TYPES = {
    "TimeToCollision": ("observation", {"horizon": 5}, "horizons"),
    "Kinematics": ("observation", {"vehicles_count": 5}, "vehicle_count"),
    "OccupancyGrid": ("observation", {"as_image": False}, "as_images"),
    "GrayscaleObservation": (
        "observation",
        {"observation_shape": (16, 8), "stack_size": 1, "weights": [0.3, 0.3, 0.4]},
        "stacksize",
    ),
    "AttributesObservation": ("observation", {"attributes": ["time"]}, "attribute"),
    "LidarObservation": ("observation", {"cells": 8}, "cell"),
    "ContinuousAction": ("action", {"clip": True}, "clipped"),
    "DiscreteAction": ("action", {"actions_per_axis": 3}, "actions_per_axes"),
    "DiscreteMetaAction": ("action", {"target_speeds": [0, 5, 10]}, "target_speed"),
}


@pytest.mark.parametrize("kind", TYPES)
def test_a_misspelt_key_of_every_type_is_reported_with_the_nearest_one(kind):
    where, valid, wrong = TYPES[kind]
    setting = Setting("mine", "highway-fast-v0", {where: {"type": kind, **valid}})
    assert unknown_keys(setting) == []
    nested = Setting("mine", "highway-fast-v0", {where: {"type": kind, **valid, wrong: 1}})
    (right,) = [key for key in valid if key[:4] == wrong[:4]] or [None]
    (told,) = unknown_keys(nested)
    assert f"has no {wrong!r} in [{where}] of type {kind}, and ignores it; perhaps {right!r} is meant" in told


def test_the_known_keys_of_a_type_are_its_constructor_arguments():
    """`DiscreteAction` ignores a `speed_range`; the observation of a goal passes on keys that it does not use."""
    assert "speed_range" in arguments_of(actions.ContinuousAction)
    assert "speed_range" not in arguments_of(actions.DiscreteAction)
    assert {"scales", "vehicles_count"} <= set(arguments_of(observations.KinematicsGoalObservation))
    for module in (actions, observations):
        for kind in vars(module).values():
            if isinstance(kind, type) and kind.__module__ == module.__name__:
                assert "kwargs" not in arguments_of(kind)


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (
            {
                "observation": {
                    "type": "MultiAgentObservation",
                    "observation_config": {"type": "Kinematics", "feature": []},
                }
            },
            "no 'feature' in [observation.observation_config] of type Kinematics, and ignores it; perhaps 'features'",
        ),
        (
            {
                "observation": {
                    "type": "TupleObservation",
                    "observation_configs": [{"type": "Kinematics"}, {"type": "LidarObservation", "max_range": 1}],
                }
            },
            "no 'max_range' in [observation.observation_configs] of type LidarObservation, and ignores it; perhaps "
            "'maximum_range'",
        ),
        (
            {
                "action": {
                    "type": "MultiAgentAction",
                    "action_config": {"type": "DiscreteMetaAction", "lateraly": False},
                }
            },
            "no 'lateraly' in [action.action_config] of type DiscreteMetaAction, and ignores it; perhaps 'lateral'",
        ),
        (
            {"observation": {"type": "Kinematics", "features_range": {"vxx": [-20, 20]}}},
            "no 'vxx' in the features of [observation] of type Kinematics",
        ),
        ({"lane_count": 2}, "no 'lane_count' in its configuration, and ignores it; perhaps 'lanes_count' is meant"),
    ],
)
def test_keys_are_looked_for_at_every_depth(config, message):
    (told,) = unknown_keys(Setting("mine", "highway-fast-v0", config))
    assert message in told


@pytest.mark.parametrize("env_id", ["highway-v0", "parking-v0", "intersection-v1", "exit-v0", "racetrack-v1"])
def test_the_default_configuration_has_no_unknown_keys(env_id):
    config = dict(Setting("mine", env_id).make().unwrapped.config)
    assert unknown_keys(Setting("mine", env_id, config)) == []


def test_the_command_tells_nested_keys_and_drives(tmp_path, capsys):
    config = tmp_path / "env.toml"
    text = 'duration = 2\nvehicles_count = 3\n[observation]\ntype = "Kinematics"\nvehicle_count = 9\n'
    config.write_text(text, encoding="utf-8")
    (setting,) = read_settings(None, "highway-fast-v0", config)
    assert setting.config["duration"] == 2
    assert "perhaps 'vehicles_count' is meant" in capsys.readouterr().err
    arguments = [
        "--policy",
        "idle",
        "--shield",
        "none",
        "--episodes",
        "1",
        "--jobs",
        "1",
        "--env-id",
        "highway-fast-v0",
    ]
    assert CliRunner().invoke(app, ["evaluate", *arguments, "--env-config", str(config)]).exit_code == 0
