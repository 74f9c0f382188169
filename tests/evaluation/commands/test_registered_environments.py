"""An environment registered with its own settings is driven with them in every command that takes an id."""

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
from registered_highways import CONFIG, IDS, registered
from typer.testing import CliRunner

from dynamics.scenes.registration import spec_of
from evaluation.commands.cli import app
from evaluation.falsification.finds import Find, replay
from evaluation.report.video import _filmed
from evaluation.running.certify import CertifyRun, certify
from evaluation.running.episodes import run_episode
from evaluation.running.records import ShieldVariant
from evaluation.settings import Setting, setting_of
from shield.config import ShieldConfig
from shield.errors import ConfigError

RUN = CliRunner()


@pytest.fixture(autouse=True, scope="module")
def _registered():
    with registered():
        yield


def bare(env_id, seed, **config):
    """Return and number of decisions of always FASTER in the environment of `gym.make`."""
    env = gym.make(env_id, **({"config": {**CONFIG, **config}} if config else {}))
    env.reset(seed=seed)
    total, steps, done = 0.0, 0, False
    while not done:
        _, reward, terminated, truncated, _ = env.step(3)
        total, steps, done = total + reward, steps + 1, terminated or truncated
    env.close()
    return total, steps


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("name", ["{}", "registered_highways:{}"])
def test_a_setting_by_id_has_the_registered_configuration(env_id, name):
    env = setting_of(name.format(env_id)).make()
    try:
        assert {key: env.unwrapped.config[key] for key in CONFIG} == CONFIG
    finally:
        env.close()


def test_a_configuration_file_overrides_the_registered_configuration(tmp_path):
    (tmp_path / "longer.toml").write_text("duration = 5\n", encoding="utf-8")
    setting = setting_of("registered-stock-v0", tmp_path / "longer.toml")
    assert setting.configured == {**CONFIG, "duration": 5}
    assert setting.config == {"duration": 5}
    env = setting.make()
    assert {key: env.unwrapped.config[key] for key in CONFIG} == {**CONFIG, "duration": 5}
    env.close()
    for simulator in ("compiled", "highway-env"):
        record = run_episode(setting, "faster", seed=100_007, simulator=simulator)
        assert (record.return_, record.steps) == pytest.approx(bare("registered-stock-v0", 100_007, duration=5))


@pytest.mark.parametrize("env_id", IDS)
def test_the_command_drives_the_registered_environment(env_id, tmp_path):
    output = tmp_path / "x.csv"
    asked = ["evaluate", "--env-id", env_id, "--policy", "faster", "--shield", "none", "--episodes", "2", "--jobs", "1"]
    result = RUN.invoke(app, [*asked, "--seed", "100005", "--output", str(output)], catch_exceptions=False)
    assert result.exit_code == 0
    episodes = pd.read_csv(output)
    for k, seed in enumerate((100_005, 100_006)):
        assert tuple(episodes.loc[k, ["return", "steps"]]) == pytest.approx(bare(env_id, seed))


def test_certify_drives_the_registered_environment(tmp_path):
    asked = CertifyRun(setting_of("registered-stock-v0"), "faster", 2, 50, ShieldConfig())
    found = certify(asked, tmp_path)
    record = run_episode(asked.setting, "faster", ShieldVariant("env"), 51, simulator="highway-env")
    assert record.steps == CONFIG["duration"]
    assert tuple(found.loc[1, ["steps", "return", "min_gap"]]) == (record.steps, record.return_, record.min_gap)


def test_every_command_takes_an_environment_by_its_id(tmp_path):
    """The commands certify, replay, film and falsify drive the registered configuration with the changes of the
    file."""
    (tmp_path / "four.toml").write_text("duration = 4\nvehicle_count = 1\n", encoding="utf-8")
    mine = ["--env-id", "registered-stock-v0", "--env-config", str(tmp_path / "four.toml")]

    def shield(*arguments):
        result = RUN.invoke(app, [*arguments, *mine], catch_exceptions=False)
        assert result.exit_code == 0, result.output
        return result.output

    told = shield("certify", str(tmp_path / "parts"), "--episodes", "2", "--seed", "60", "--jobs", "1")
    assert "perhaps 'vehicles_count' is meant" in told
    (tmp_path / "four.toml").write_text("duration = 4\n", encoding="utf-8")
    episodes = pd.read_parquet(tmp_path / "parts" / "episodes.parquet")
    record = run_episode(setting_of("registered-stock-v0", tmp_path / "four.toml"), "faster", ShieldVariant("env"), 60)
    assert record.steps == 4
    assert tuple(episodes.loc[0, ["steps", "return", "min_gap"]]) == (4, record.return_, record.min_gap)
    assert str(record.min_gap) in shield("replay", "60")
    film = tmp_path / "film.gif"
    shield("film", str(film), "--policy", "faster")
    assert film.stat().st_size > 10_000
    assert _filmed(setting_of("registered-own-v0")).config["screen_width"] == 1100, "a strip along a straight road"
    find = tmp_path / "find.json"
    shield("falsify", str(find), "--episodes", "500")
    found = Find.load(find)
    assert found.made["environment"]["configuration"]["lanes_count"] == CONFIG["lanes_count"]
    assert found.made["environment"]["configuration"]["duration"] == 4
    assert replay(found).clearance == pytest.approx(found.clearance)


@pytest.mark.parametrize("command", [["certify", "{}"], ["replay", "5"], ["film", "{}.gif"], ["falsify", "{}.json"]])
def test_a_setting_and_an_id_are_not_both_given(command, tmp_path):
    arguments = [each.format(tmp_path / "x") for each in command]
    for more, message in (
        (["--setting", "merge", "--env-id", "merge-v0"], "give either --setting or --env-id"),
        (["--env-config", "x.toml"], "--env-config goes with --env-id"),
        (["--env-id", "nothing-v0"], "there is no environment 'nothing-v0'"),
    ):
        result = RUN.invoke(app, [*arguments, *more])
        assert isinstance(result.exception, ConfigError)
        assert message in str(result.exception)


def test_a_find_is_replayed_in_the_registered_environment():
    """Two lanes and four other vehicles: with the defaults of the class the scene would differ."""
    from dynamics.highway_simulator.simulator import Simulator

    setting = Setting("registered", "registered-stock-v0")
    draws = Simulator("registered-stock-v0", 1, setting.configured, replay_draws=True).draws
    shares = tuple(np.linspace(0.05, 0.95, draws).tolist())
    find = Find("registered-stock-v0", {}, ShieldConfig(mode="none").to_toml(), "any", shares, (3,), 0.0)
    explicit = Find("highway-fast-v0", CONFIG, find.shield, "any", shares, (3,), 0.0)
    assert replay(find).clearance == replay(explicit).clearance


def test_an_id_without_a_version_is_the_latest():
    assert spec_of("registered_highways:registered-own").id == "registered-own-v0"
    with pytest.raises(gym.error.Error):
        spec_of("registered-nothing-v0")
