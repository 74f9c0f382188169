"""Training of a latent driver and of its baseline: tiny runs from end to end, and the parts between."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from stable_baselines3 import PPO

import evaluation.training.latent.frame_ppo as frame_ppo
import evaluation.training.latent.train as training
from dynamics.errors import ModelError
from dynamics.world_model.config import WorldModelConfig
from dynamics.world_model.files import read_config
from dynamics.world_model.view import FrameView
from evaluation.running.frame_episodes import FrameEpisodes, drive_frames, frame_world
from evaluation.running.named_policies import ConstantPolicy
from evaluation.settings import get_setting
from evaluation.training.latent.collect import Collector
from evaluation.training.latent.frame_ppo import FramePPOOptions, train_frame_ppo
from evaluation.training.latent.options import LatentTrainingOptions
from evaluation.training.latent.train import score, train_latent
from mpc.latent.files import load_driver
from shield.config import ShieldConfig
from shield.errors import ConfigError

VIEW = FrameView(size=16)
FAST = get_setting("highway-fast")


class Scripted:
    """Always FASTER, and a record of the arguments of each call."""

    def __init__(self):
        self.calls = []

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        self.calls.append((observation.copy(), state, np.array(episode_start)))
        return np.full(len(observation), 3), (0 if state is None else state) + 1


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("world-model") / "driver"
    options = LatentTrainingOptions(
        output=folder, updates=4, envs=8, warm_up=64, capacity=400, batch=4, length=4, starts=8,
        validate_every=2, validation_episodes=4,
    )  # fmt: skip
    told = []
    return train_latent(options, told.append), told, options


def test_a_tiny_training_writes_a_driver_that_drives(trained):
    made, told, options = trained
    assert [each.update for each in told] == [2, 4]
    assert told == made.history
    notes = read_config(made.path)["notes"]
    assert notes["training"]["updates"] == 4
    assert notes["update"] in (2, 4)
    assert notes["validation"]["episodes"] == options.validation_episodes
    world = frame_world(FAST, 2, WorldModelConfig().view)
    driven = [drive_frames(driver, world, range(50, 52)) for driver in (made.driver, load_driver(options.output))]
    assert np.array_equal(driven[0].returns, driven[1].returns)


def test_the_same_seed_trains_the_same_weights(trained, tmp_path):
    made, _, options = trained
    again = train_latent(LatentTrainingOptions(**{**vars(options), "output": tmp_path}))
    ours, theirs = made.driver.model.state_dict(), again.driver.model.state_dict()
    assert all(np.array_equal(ours[name], theirs[name]) for name in ours)


def test_a_training_continues_from_a_driver_with_the_same_networks(trained, tmp_path):
    """The warm-up is driven by the earlier driver, and one small step changes its weights a little."""
    made, _, options = trained
    given = {**vars(options), "start": made.path, "updates": 1, "rate": 1e-7}
    again = train_latent(LatentTrainingOptions(**{**given, "output": tmp_path / "more", "horizon": 2}))
    ours, theirs = made.driver.model.state_dict(), again.driver.model.state_dict()
    assert all(np.allclose(ours[name], theirs[name], atol=1e-5) for name in ours)
    assert again.driver.networks.config.horizon == 2
    with pytest.raises(ConfigError, match="another world model"):
        train_latent(LatentTrainingOptions(**{**given, "output": tmp_path, "latent": "categorical"}))


def test_episodes_of_the_collector_are_whole_and_rewarded_as_in_the_environment():
    """Each episode begins at a reset: its frames, and the driver's calls, follow each other; a crash ends it."""
    world = frame_world(FAST, 3, VIEW)
    policy = Scripted()
    collector = Collector(world, 7, exploration=0.0)
    episodes = [episode for _ in range(40) for episode in collector.step(policy)]
    assert collector.steps == 120
    assert len(episodes) >= 3
    first = episodes[0]
    assert set(first) == {"frame", "action", "reward", "terminated", "crashed"}
    assert (first["action"] == 3).all()
    assert first["terminated"][-1] == first["crashed"][-1]
    assert not first["terminated"][:-1].any()
    direct = drive_frames(ConstantPolicy(3), world, range(7, 10))
    length = len(first["reward"])
    assert (length, pytest.approx(float(first["reward"].sum()), abs=1e-4)) in list(
        zip(direct.steps.tolist(), direct.returns.tolist(), strict=True)
    )
    starts = [start for _, _, start in policy.calls]
    assert starts[0].all()
    assert any(start.any() and not start.all() for start in starts[1:])


def test_episodes_side_by_side_are_those_one_by_one():
    """The batch, and its last part of fewer seeds, drive each seed as alone."""
    many = drive_frames(Scripted(), frame_world(FAST, 4, VIEW), range(100, 106))
    one = frame_world(FAST, 1, VIEW)
    for k in range(6):
        alone = drive_frames(Scripted(), one, range(100 + k, 101 + k))
        assert alone.returns[0] == pytest.approx(many.returns[k], abs=1e-9)
        assert alone.crashed[0] == many.crashed[k]
        assert alone.steps[0] == many.steps[k] == many.actions[k].sum()


def test_the_shield_overrides_in_its_world_only():
    bare = drive_frames(ConstantPolicy(3), frame_world(FAST, 8, VIEW), range(8))
    shielded = drive_frames(ConstantPolicy(3), frame_world(FAST, 8, VIEW, ShieldConfig()), range(8))
    assert bare.crashed.mean() > 0.8
    assert bare.override_share == 0
    assert not shielded.crashed.any()
    assert 0 < shielded.override_share < 1


def test_overrides_cost_their_penalty_in_training_only():
    """The same driving with and without a penalty: rewards differ by it where the shield overrode."""
    found = []
    for penalty in (0.0, 0.25):
        collector = Collector(frame_world(FAST, 4, VIEW, ShieldConfig()), 7, 0.0, penalty)
        found.append([episode for _ in range(31) for episode in collector.step(Scripted())])
    differences = np.concatenate([a["reward"] - b["reward"] for a, b in zip(*found, strict=True)])
    assert set(np.round(differences, 5)) == {0.0, 0.25}


def test_crashes_above_the_limit_count_less():
    def episodes(crashes: int) -> FrameEpisodes:
        crashed = np.arange(100) < crashes
        zeros = np.zeros(100)
        return FrameEpisodes(np.full(100, 20.0), crashed, zeros, zeros, zeros, zeros)

    assert score(episodes(2), 0.025) == 20
    assert score(episodes(10), 0.025) == pytest.approx(20 - 0.75)
    overridden = replace(episodes(0), overridden=np.full(100, 4.0))
    assert score(overridden, 0.025, 0.15) == pytest.approx(20 - 0.6)


def test_a_training_that_diverges_stops_with_an_error(tmp_path, monkeypatch):
    real = training.driver_losses

    def broken(*arguments):
        losses = real(*arguments)
        return type(losses)(losses.total, float("nan"), losses.entropy)

    monkeypatch.setattr(training, "driver_losses", broken)
    options = LatentTrainingOptions(
        output=tmp_path, updates=1, envs=8, warm_up=64, capacity=400, batch=4, length=4, validation_episodes=2
    )
    with pytest.raises(ModelError, match="diverged"):
        train_latent(options)


@pytest.mark.parametrize(
    "change",
    [
        {"updates": 0}, {"seed": 90}, {"seed": -1}, {"length": 1}, {"envs": 101}, {"validation_episodes": 501},
        {"exploration": 1.5}, {"rate": 0.0}, {"warm_up": 10}, {"capacity": 5000}, {"size": "huge"},
        {"override_penalty": 0.1},
        {"override_penalty": -1.0, "shield": "default"},
        {"shield": "steel"}, {"setting": "highway-slow"}, {"latent": "gaussian"}, {"discount": 1.0},
    ],
)  # fmt: skip
def test_bad_options_are_refused(tmp_path, change):
    with pytest.raises(ConfigError):
        LatentTrainingOptions(output=tmp_path, **change)


def test_other_roads_are_refused(tmp_path):
    with pytest.raises(ConfigError):
        train_latent(LatentTrainingOptions(output=tmp_path, setting="roundabout", updates=1))


def test_the_baseline_ends_after_its_time_and_writes_a_policy(tmp_path, monkeypatch):
    monkeypatch.setattr(frame_ppo, "_ROLLOUT", 4)
    options = FramePPOOptions(output=tmp_path / "ppo.zip", cpu_seconds=0.5, validate_every=128, validation_episodes=4)
    told = []
    train_frame_ppo(options, told.append)
    assert told[-1].seconds > 0.5
    manifest = json.loads((tmp_path / "ppo.json").read_text())
    assert manifest["best"]["score"] == max(each.score for each in told)
    driven = drive_frames(PPO.load(tmp_path / "ppo.zip"), frame_world(FAST, 2, FrameView()), range(50, 52))
    assert driven.steps.sum() > 2


@pytest.mark.parametrize("change", [{"cpu_seconds": 0.0}, {"seed": 90}, {"shield": "steel"}, {"discount": 0.0}])
def test_bad_options_of_the_baseline_are_refused(tmp_path, change):
    with pytest.raises(ConfigError):
        FramePPOOptions(**{"output": tmp_path / "ppo.zip", "cpu_seconds": 1.0, **change})
