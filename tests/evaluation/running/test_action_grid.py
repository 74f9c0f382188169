"""Grids of throttle and steering on highway-env's own environments."""

from __future__ import annotations

import copy
import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from evaluation.commands.cli import app
from evaluation.running.episodes import run_episode
from evaluation.running.records import make_variants
from evaluation.settings import get_setting, setting_of
from shield import ShieldedEnv
from shield.errors import ConfigError

STOCK = ["highway-fast", "merge", "roundabout", "intersection", "exit", "two-way", "u-turn", "racetrack", "parking"]
SHORT = {"vehicles_count": 4, "duration": 6}


def inputs_of(env: Any) -> set[tuple[float, float]]:
    """The inputs that the actions of an environment put on its vehicle."""
    found = set()
    for action in range(env.action_space.n):
        env.unwrapped.action_type.act(action)
        asked = env.unwrapped.vehicle.action
        found.add((float(asked["acceleration"]), float(asked["steering"])))
    return found


@settings(max_examples=10, deadline=None)
@given(st.integers(2, 9), st.integers(2, 9))
def test_a_grid_has_every_pair_of_its_values_and_stays_after_a_reset(n, m):
    env = get_setting("highway-fast").override(SHORT).with_action_grid(f"{n}x{m}").make()
    try:
        for seed in (0, 1):
            env.reset(seed=seed)
            found = inputs_of(env)
            throttle, steering = (sorted({pair[k] for pair in found}) for k in (0, 1))
            assert len(found) == n * m == env.action_space.n
            assert throttle == pytest.approx(np.linspace(-5, 5, n))
            assert steering == pytest.approx(np.linspace(-np.pi / 4, np.pi / 4, m))
    finally:
        env.close()


@pytest.mark.parametrize("name", STOCK)
def test_every_stock_environment_is_driven_on_a_grid(name):
    env = get_setting(f"{name}+5x9").make()
    try:
        observation, _ = env.reset(seed=0)
        assert env.action_space.n == 45
        for _ in range(3):
            observation, _, terminated, truncated, _ = env.step(22)
            assert env.observation_space.contains(observation)
            assert env.unwrapped.vehicle.action == {"acceleration": 0.0, "steering": 0.0}
            if terminated or truncated:
                break
    finally:
        env.close()


def test_shields_support_a_grid_where_they_support_throttle_and_steering():
    """On road networks throttle and steering are compared without the shield unless requested."""
    read = {name: get_setting(f"{name}+5x9").road for name in ("highway-fast", "racetrack", "parking", "merge", "exit")}
    assert read == {"highway-fast": True, "racetrack": True, "parking": True, "merge": False, "exit": False}
    assert setting_of("highway_env:highway-v0+5x9").road


def test_options_of_the_environments_own_inputs_are_kept():
    env = get_setting("intersection-continuous+3x5").make()
    env.reset(seed=0)
    assert type(env.unwrapped.vehicle).__name__ == "BicycleVehicle"
    assert max(pair[1] for pair in inputs_of(env)) == pytest.approx(np.pi / 3)
    env.close()


def test_a_copy_has_a_grid_of_its_own():
    """A copy that is reset defines its own spaces, and not those of the original."""
    env = get_setting("highway-fast+3x3").make()
    env.reset(seed=0)
    copied = copy.deepcopy(env)
    before = env.unwrapped.action_type
    copied.reset(seed=1)
    assert env.unwrapped.action_type is before
    assert copied.unwrapped.action_type.env is copied.unwrapped
    assert copied.action_space.n == 9
    env.close()


def test_a_configuration_file_may_say_the_same(tmp_path):
    file = tmp_path / "grid.toml"
    file.write_text('duration = 4\n[action]\ntype = "DiscreteAction"\nactions_per_axis = [5, 9]\n')
    one, two = setting_of("highway-v0", file).make(), setting_of("highway-v0+5x9").make()
    assert one.action_space == two.action_space
    assert inputs_of(one) == inputs_of(two)


@pytest.mark.parametrize("grid", ["5x", "x9", "5x9x2", "5.5x9", "five", "1x9", "5x0", "5x100", "-5x9"])
def test_sizes_that_make_no_sense_are_refused_by_name(grid):
    with pytest.raises(ConfigError, match=r"NxM|two from 2 to 99"):
        get_setting(f"highway-fast+{grid}")


def test_the_shield_drives_on_a_grid_without_a_crash():
    """Full throttle runs into vehicles ahead; behind the shield it does not crash."""
    setting = get_setting("highway-fast").override({"vehicles_count": 20, "duration": 15}).with_action_grid("5x9")
    bare, shielded = make_variants(["none", "full"], ["env"])
    crashes = [run_episode(setting, "throttle", bare, seed).crashed for seed in range(4)]
    records = [run_episode(setting, "throttle", shielded, seed) for seed in range(4)]
    assert any(crashes)
    assert not any(record.crashed for record in records)
    assert sum(record.overridden for record in records) > 0


@pytest.mark.parametrize("shield", ["none", "default"])
def test_training_and_evaluation_support_a_grid(tmp_path, shield):
    file, model = tmp_path / "few.toml", tmp_path / "x.zip"
    file.write_text("vehicles_count = 3\nduration = 3\n")
    where = ["--env-id", "highway-fast-v0+3x5", "--env-config", str(file)]
    learn = ["--algorithm", "dqn", "--set", "learning_starts=4", "--set", "buffer_size=50", "--envs", "1"]
    done = CliRunner().invoke(
        app, ["train", *where, *learn, "--steps", "12", "--shield", shield, "--output", str(model)]
    )
    assert done.exit_code == 0, done.output
    told = json.loads(model.with_suffix(".json").read_text())
    assert told["setting"]["config"]["action"] == {"type": "DiscreteAction", "actions_per_axis": [3, 5]}
    args = ["evaluate", *where, "--policy", str(model), "--shield", "none", "--episodes", "1", "--jobs", "1"]
    done = CliRunner().invoke(app, args)
    assert done.exit_code == 0, done.output


def test_the_article_s_environment_runs_with_its_configuration_as_printed():
    """Dong et al. 2023: the registration by `import evaluation`, its keys, and 5 by 9 actions."""
    import gymnasium as gym

    import evaluation  # noqa: F401

    config = {
        "submap_counts": {"merge": 2, "intersection": 2, "roundabout": 2, "straight": 4},
        "vehicle_density": 10,
        "random_start": False,
        "use_signed_lane_obs": True,
        "duration": 1000,
        "action": {"type": "DiscreteAction", "actions_per_axis": [5, 9]},
    }
    with pytest.warns(UserWarning, match="ComplexRoads-v0"):
        alias = gym.make("ComplexRoads", config=config)
    env = gym.make("ComplexRoads-v0", config=config)
    for each in (alias, env):
        observation, info = each.reset(seed=1)
        assert each.action_space.n == 45
        assert each.observation_space.contains(observation)
        assert info["destination"] in each.unwrapped.course.exits
        each.step(22)
    assert env.unwrapped.config == {**gym.make("ComplexRoads-v0").unwrapped.config, **config}
    assert ShieldedEnv(env).reset(seed=0)[0].shape == observation.shape
