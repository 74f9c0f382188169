"""A VecEnv of shielded highways against `ShieldedEnv` in SB3's own."""

from __future__ import annotations

from collections import Counter

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
import torch
from policies import Always
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.utils import get_action_masks, is_masking_supported
from stable_baselines3 import PPO
from stable_baselines3.common.logger import configure
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from dynamics.highway_simulator.env import CompiledHighwayEnv
from evaluation.learning.fast_road_vec_env import FastRoadVecEnv
from evaluation.learning.fast_vec_env import FastHighwayVecEnv
from evaluation.learning.shielded_vec_env import ShieldedVecEnv
from shield import ConfigError, Shield, ShieldCallback, ShieldConfig, ShieldedEnv
from shield.config import PROFILES
from shield.errors import ShieldError

SHORT = {"duration": 8}
EITHER = pytest.mark.parametrize(
    "shield", [ShieldConfig(), ShieldConfig.simulated_traffic()], ids=["certificate", "exact"]
)


def in_highway_env(shield, count=1):
    """The training environments without the compiled copy."""
    return DummyVecEnv([lambda: Monitor(ShieldedEnv(gym.make("highway-fast-v0", config=SHORT), shield))] * count)


def summed_up(info):
    """The summary of a finished episode in an info, without times; None if the episode goes on."""
    episode = info.get("shield_episode")
    return episode and {name: value for name, value in episode.items() if name != "latency_ms"}


def test_the_vec_env_equals_shielded_envs():
    theirs = DummyVecEnv([lambda: Monitor(ShieldedEnv(CompiledHighwayEnv("highway-fast-v0", SHORT)))] * 3)
    mine = ShieldedVecEnv(3, "highway-fast-v0", SHORT)
    for world in (theirs, mine):
        world.seed(50)
    assert np.array_equal(theirs.reset(), mine.reset())
    rng, overridden, first = np.random.default_rng(0), 0, True
    for _ in range(8):
        actions = rng.integers(5, size=3)
        (obs, rewards, dones, infos), found = theirs.step(actions), mine.step(actions)
        for a, b in zip(infos, found[3], strict=True):
            assert a["shield"] == b["shield"]
            assert a["action"] == b["action"]
            assert summed_up(a) == summed_up(b)
            overridden += a["shield"]["overridden"]
            if "episode" in a:
                assert a["shield_episode"].keys() == b["shield_episode"].keys()
                assert (a["episode"]["r"], a["episode"]["l"]) == (b["episode"]["r"], b["episode"]["l"])
                assert np.array_equal(a["terminal_observation"], b["terminal_observation"])
        assert np.array_equal(rewards, found[1])
        assert np.array_equal(dones, found[2])
        # highway-env draws the next scene from its generator; here too.
        assert np.array_equal(obs, found[0]) or not first
        first = first and not dones.any()
    assert overridden > 0


def test_simulated_traffic_settings_filter_by_simulation():
    world, env = ShieldedVecEnv(2, "highway-fast-v0", shield=ShieldConfig.simulated_traffic()), CompiledHighwayEnv()
    world.seed(60)
    world.reset()
    obs, _ = env.reset(seed=60)
    shield, overridden = Shield(Always(3), env, ShieldConfig.simulated_traffic(), frames=False), 0
    for _ in range(12):
        _, rewards, _, infos = world.step([3, 3])
        action, _ = shield.predict(obs)
        obs, reward, *_ = env.step(int(action))
        assert reward == rewards[0]
        assert shield.report() == infos[0]["shield"]
        overridden += infos[0]["shield"]["overridden"]
    assert overridden > 0


@pytest.mark.parametrize("name", PROFILES)
def test_each_profile_is_that_of_shielded_envs_in_highway_env(name):
    shield = ShieldConfig.profile(name)
    theirs, mine = in_highway_env(shield, 2), ShieldedVecEnv(2, "highway-fast-v0", SHORT, shield)
    for world in (theirs, mine):
        world.seed(70)
    assert np.array_equal(theirs.reset(), mine.reset())
    rng, overridden = np.random.default_rng(0), 0
    for _ in range(20):
        assert np.array_equal(get_action_masks(theirs), get_action_masks(mine))
        actions = rng.integers(5, size=2)
        (*one, infos), (*two, found) = theirs.step(actions), mine.step(actions)
        assert all(np.array_equal(a, b) for a, b in zip(one, two, strict=True))
        for a, b in zip(infos, found, strict=True):
            assert a["shield"] == b["shield"]
            assert summed_up(a) == summed_up(b)
            overridden += a["shield"]["overridden"]
    assert overridden > 0


@EITHER
def test_an_episodes_last_info_sums_it_up(shield):
    """Each episode by itself: those that ended before, and those that a reset cut short, are forgotten."""
    world = ShieldedVecEnv(3, "highway-fast-v0", SHORT, shield)
    world.seed(0)
    world.reset()
    world.step([3, 3, 3])
    world.reset()
    reports, latencies, over = [[] for _ in range(3)], [[] for _ in range(3)], 0
    for _ in range(20):
        *_, dones, infos = world.step([3, 1, 0])
        assert world.get_attr("latency") == [world.latency] * 3
        for i, info in enumerate(infos):
            reports[i].append(info["shield"])
            latencies[i].append(world.latency)
            assert ("shield_episode" in info) == dones[i]
            if dones[i]:
                episode = info["shield_episode"]
                assert episode["decisions"] == info["episode"]["l"] == len(reports[i])
                for name in ("overridden", "frames_overridden", "violations"):
                    assert episode[name] == sum(report[name] for report in reports[i])
                assert episode["rules"] == sum((Counter(report["rules"]) for report in reports[i]), Counter())
                assert episode["margin"] == min(report["margin"] for report in reports[i])
                assert episode["reasons"] == Counter(report["reason"] for report in reports[i])
                assert episode["latency_ms"] > 0
                assert episode["latency_ms"] == pytest.approx(1e3 * np.mean(latencies[i]))
                reports[i], latencies[i], over = [], [], over + 1
    assert over > 3


@EITHER
def test_maskable_ppo_ends_with_the_same_network(shield):
    networks = []
    for world in (in_highway_env(shield), ShieldedVecEnv(1, "highway-fast-v0", SHORT, shield)):
        torch.set_num_threads(1)
        model = MaskablePPO("MlpPolicy", world, n_steps=32, batch_size=32, n_epochs=2, seed=3, device="cpu").learn(64)
        networks.append([parameter.detach().clone() for parameter in model.policy.parameters()])
    assert all(torch.equal(a, b) for a, b in zip(*networks, strict=True))


@EITHER
def test_maskable_ppo_proposes_actions_that_pass(shield):
    world = ShieldedVecEnv(4, "highway-fast-v0", SHORT, shield)
    assert is_masking_supported(world)
    model = MaskablePPO("MlpPolicy", world, n_steps=16, batch_size=32, seed=0, device="cpu").learn(128)
    assert model.num_timesteps == 128
    obs = world.reset()
    for _ in range(10):
        masks = get_action_masks(world)
        action, _ = model.predict(obs, action_masks=masks)
        obs, *_ = world.step(action)
        # All True also stands for none.
        passed = world.highways.records.executed == action
        assert (passed | masks.all(axis=1)).all()


def test_masks_are_had_of_some_environments_as_of_all():
    world = ShieldedVecEnv(3, "highway-fast-v0", SHORT)
    world.seed(1)
    world.reset()
    masks = world.action_masks()
    assert masks.shape == (3, 5)
    assert np.array_equal(world.env_method("action_masks", indices=[2, 0]), masks[[2, 0]])
    assert np.array_equal([mask() for mask in world.get_attr("action_masks", [1])], masks[[1]])


@pytest.mark.parametrize("world", [ShieldedVecEnv, FastHighwayVecEnv, FastRoadVecEnv])
def test_a_missing_attribute_is_an_attribute_error(world):
    world = world(1)
    assert not world.has_attr("road")
    for name in ("action_masks", "latency"):
        assert world.has_attr(name) == isinstance(world, ShieldedVecEnv)
    for ask in (world.get_attr, world.env_method):
        for kind in (AttributeError, ShieldError, ConfigError):
            with pytest.raises(kind, match="'road'"):
                ask("road")


def test_the_interventions_are_logged(tmp_path):
    world = ShieldedVecEnv(2, "highway-fast-v0", SHORT)
    model = PPO("MlpPolicy", world, n_steps=8, batch_size=16, device="cpu")
    model.set_logger(configure(str(tmp_path), ["csv"]))
    model.learn(16, callback=ShieldCallback())
    header, row, *_ = (tmp_path / "progress.csv").read_text().splitlines()
    logged = dict(zip(header.split(","), row.split(","), strict=True))
    assert float(logged["shield/latency_ms"]) > 0
    assert 0 <= float(logged["shield/overridden"]) <= 1


@EITHER
def test_a_model_learns_in_it(shield):
    world = ShieldedVecEnv(4, "highway-fast-v0", SHORT, shield)
    model = PPO("MlpPolicy", world, n_steps=16, batch_size=32, seed=0, device="cpu").learn(128)
    assert model.num_timesteps == 128


def test_a_shield_that_is_not_compiled_is_refused():
    with pytest.raises(ConfigError, match="mode"):
        ShieldedVecEnv(2, shield=ShieldConfig(mode="ttc"))
