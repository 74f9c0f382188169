"""highway-env's lane keeping, behind the shield that verifies by simulation."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

import evaluation.scenarios  # noqa: F401  (registers the environments)
from dynamics.road_networks.simulation.compiled_frames import CompiledFrames
from evaluation.running.episodes import run_episode
from evaluation.running.records import ShieldVariant
from evaluation.settings import get_setting
from shield import ConfigError, ShieldConfig, ShieldedEnv

STEPS = 120


def drive(env, seed):
    """Steering at random: how often the ego is off the road, and how often it was overridden."""
    env.reset(seed=seed)
    env.action_space.seed(seed)
    off = overridden = 0
    for _ in range(STEPS):
        *_, info = env.step(env.action_space.sample())
        off += not env.unwrapped.vehicle.on_road
        overridden += bool(info.get("shield", {}).get("overridden", False))
    return off, overridden


@pytest.mark.parametrize("seed", [1, 2])
def test_steering_at_random_keeps_to_the_road(seed):
    bare, _ = drive(gym.make("lane-keeping-v0"), seed)
    assert bare > STEPS // 2
    off, overridden = drive(ShieldedEnv(gym.make("lane-keeping-v0"), ShieldConfig.simulated_traffic()), seed)
    assert off == 0
    assert 0 < overridden < STEPS, "only where it is needed"


def test_an_episode_of_the_setting_ends():
    record = run_episode("lane-keeping", "idle", ShieldVariant(), seed=3)
    assert record.steps == 300
    assert record.off_road
    assert not record.crashed


def test_the_setting_can_be_rendered():
    env = get_setting("lane-keeping").make(render_mode="rgb_array")
    env.reset(seed=0)
    assert np.asarray(env.render()).ndim == 3
    env.close()


def test_the_worst_case_is_refused_with_slipping_tyres():
    with pytest.raises(ConfigError, match="dynamical"):
        ShieldedEnv(gym.make("lane-keeping-v0"), "worst-case")


def test_lane_keeping_with_compiled_frames_is_the_same():
    own, compiled = gym.make("lane-keeping-v0"), CompiledFrames(gym.make("lane-keeping-v0"))
    rng = np.random.default_rng(0)
    own.reset(seed=1)
    compiled.reset(seed=1)
    for _ in range(STEPS):
        action = rng.uniform(-1, 1, 1)
        (seen, reward, *_), (other, paid, *_) = own.step(action), compiled.step(action)
        assert all(np.array_equal(seen[name], other[name]) for name in seen)
        assert reward == paid
        assert np.array_equal(own.unwrapped.vehicle.state, compiled.unwrapped.vehicle.state)
