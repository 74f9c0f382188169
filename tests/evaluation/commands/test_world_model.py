"""`shield world-model`: a tiny driver is trained, measured beside the baselines, and dreams; bad input is refused."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest
import torch
from PIL import Image
from typer.testing import CliRunner

from dynamics.world_model.config import WorldModelConfig
from dynamics.world_model.model import WorldModel
from dynamics.world_model.view import OTHERS, RELATIVE_SPEED
from evaluation.commands.cli import app
from evaluation.running.dreams import _moved, dream, imagination_quality
from evaluation.running.frame_table import frame_table, load_frame_driver
from evaluation.settings import get_setting
from mpc.latent.actor_critic import ActorCritic, DriverConfig
from mpc.latent.driver import LatentDriver
from mpc.latent.files import save_driver
from shield.errors import ConfigError, ShieldError

FAST = get_setting("highway-fast")


def shield(*words: object):
    return CliRunner().invoke(app, ["world-model", *map(str, words)])


def untrained() -> LatentDriver:
    """Always SLOWER, with the networks of an untrained driver."""
    config = WorldModelConfig(depth=8, embedding=16, recurrent=8, groups=2, classes=4, hidden=8)
    networks = ActorCritic(DriverConfig(hidden=8), config.features, config.actions)
    with torch.no_grad():
        networks.actor[-1].bias[4] = 10.0
    return LatentDriver(WorldModel(config), networks)


@pytest.fixture(scope="module")
def driver(tmp_path_factory):
    return save_driver(untrained(), tmp_path_factory.mktemp("driver") / "untrained")


def test_train_writes_a_driver_and_tells_of_its_validations(tmp_path, monkeypatch):
    import evaluation.training.latent.options as options

    small = {"envs": 8, "warm_up": 64, "capacity": 400, "batch": 4, "length": 4, "validation_episodes": 2}
    original = options.LatentTrainingOptions
    monkeypatch.setattr(options, "LatentTrainingOptions", lambda **given: original(**{**small, **given}))
    result = shield("train", "--updates", 1, "--output", tmp_path / "driver")
    assert result.exit_code == 0, result.output
    assert re.search(r"update 1, \d+ decisions", result.output)
    assert isinstance(load_frame_driver(tmp_path / "driver"), LatentDriver)


def test_the_table_has_the_baselines_beside_the_driver_on_the_same_seeds(driver, tmp_path):
    table = tmp_path / "table.csv"
    words = ("--episodes", 6, "--seed", 20_000, "--shield", "none", "--output", table, "--markdown")
    result = shield("evaluate", driver, *words)
    assert result.exit_code == 0, result.output
    rows = pd.read_csv(table).set_index("driver")
    assert list(rows.index) == ["random", "slower", "faster", "stopped", "untrained"]
    # The driver's networks always propose SLOWER.
    assert rows.loc["untrained", "return"] == pytest.approx(rows.loc["slower", "return"])
    assert rows.loc["faster", "crash"] > 0.8
    assert rows.loc["stopped", "speed"] < 5 < rows.loc["slower", "speed"]
    assert rows["crash_low"].le(rows["crash"]).all()
    assert "| untrained | none | 6 |" in result.output


def test_behind_the_shield_the_table_counts_overrides():
    table = frame_table(["faster", "stopped"], FAST, range(20_000, 20_004), ("none", "default")).set_index(
        ["driver", "shield"]
    )
    assert list(table.index) == [("faster", "none"), ("faster", "default"), ("stopped", "none")]
    assert table.loc[("faster", "default"), "crash"] == 0
    assert table.loc[("faster", "default"), "overridden"] > 0


def test_dream_writes_a_strip_and_a_film(driver, tmp_path):
    strip, film = tmp_path / "out" / "strip.png", tmp_path / "film.gif"
    result = shield("dream", driver, "--output", strip, "--film", film, "--context", 2, "--steps", 3)
    assert result.exit_code == 0, result.output
    assert Image.open(strip).width > 5 * 128
    assert Image.open(film).n_frames == 5


def test_a_dream_sees_its_context_alone():
    """Imagined occupancy is a function of the seen frames and the actions: it is that of a fresh rollout."""
    policy = untrained()
    found = dream(policy, FAST, 20_000, context=3, steps=2)
    assert found.frames.shape == (5, 5, 64, 64)
    assert found.occupancy.shape == (5, 16, 32)
    model, h = policy.model, policy.model.blank(1)
    with torch.no_grad():
        for t in range(3):
            state = model.posterior_state(h, model.embed(torch.from_numpy(found.frames[t][None])))
            h = model.advance(state, torch.from_numpy(found.actions[t : t + 1]))
        for t in (2, 3):
            state = model.imagine(state, torch.from_numpy(found.actions[t : t + 1]))
        assert np.allclose(model.decode(state.features)[0, 0], found.occupancy[4], atol=1e-5)


def test_constant_velocity_moves_cells_by_their_relative_speed():
    """A vehicle 8 m/s faster than the ego is two cells of 4 m further after a second."""
    policy = untrained()
    cells = np.zeros((1, 2, 16, 32), np.float32)
    cells[0, 0, 8, 10], cells[0, 1, 8, 10] = 1, (128 + 127 * 8 / 20) / 255
    moved = _moved(cells, policy, 1.0)
    assert np.argwhere(moved[0]).tolist() == [[8, 12]]


def test_imagined_occupancy_is_compared_with_two_baselines():
    found = imagination_quality(untrained(), FAST, range(20_000, 20_003))
    assert [each.ahead for each in found] == [1, 3, 10]
    for each in found:
        assert all(0 <= value <= 1 for value in (each.imagined, each.constant_velocity, each.mean_map))
    assert found[0].constant_velocity > found[2].constant_velocity
    assert {OTHERS, RELATIVE_SPEED} == {3, 4}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("train", "--algorithm", "sac"), "cnn-ppo"),
        (("train", "--cpu-seconds", 3), "latent has no --cpu-seconds"),
        (("train", "--algorithm", "cnn-ppo", "--updates", 3), "cnn-ppo has no --updates"),
        (("train", "--latent", "gaussian"), "simnorm"),
        (("train", "--size", "huge"), "small"),
        (("train", "--seed", 90), "below 90"),
        (("train", "--setting", "roundabout", "--updates", 1), ""),
        (("evaluate", "nowhere"), "no driver"),
        (("evaluate", "--no-baselines"), "leaves no driver"),
        (("evaluate", "--shield", "steel"), "unknown shield"),
        (("evaluate", "--output", "table.txt"), "csv"),
        (("dream", "nowhere"), "no checkpoint"),
        (("dream", "nowhere", "--output", "dream.jpg"), ".png"),
        (("dream", "nowhere", "--film", "dream.mp4"), ".gif"),
    ],
)
def test_bad_input_is_an_error_of_the_project(words, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = shield(*words)
    assert isinstance(result.exception, ShieldError)
    assert message in str(result.exception)


def test_a_policy_of_another_observation_is_no_frame_driver(tmp_path):
    from evaluation.policies import list_references, reference_file

    name = next(name for name in list_references() if "highway" in name)
    with pytest.raises(ShieldError, match="frames of shape"):
        load_frame_driver(reference_file(name))
    with pytest.raises(ConfigError, match="ends after"):
        dream(untrained(), FAST, 20_000, context=40, steps=1)
