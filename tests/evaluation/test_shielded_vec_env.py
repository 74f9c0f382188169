"""A VecEnv of shielded highways against `ShieldedEnv` in SB3's own."""

from __future__ import annotations

import numpy as np
import pytest
from policies import Always
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from dynamics.simulator.env import CompiledHighwayEnv
from evaluation.learning.shielded_vec_env import ShieldedVecEnv
from shield import ConfigError, Shield, ShieldConfig, ShieldedEnv

SHORT = {"duration": 8}


def test_it_is_a_vec_env_of_shielded_envs():
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
            overridden += a["shield"]["overridden"]
            if "episode" in a:
                assert (a["episode"]["r"], a["episode"]["l"]) == (b["episode"]["r"], b["episode"]["l"])
                assert np.array_equal(a["terminal_observation"], b["terminal_observation"])
        assert np.array_equal(rewards, found[1])
        assert np.array_equal(dones, found[2])
        # highway-env draws the next scene from its generator; here too.
        assert np.array_equal(obs, found[0]) or not first
        first = first and not dones.any()
    assert overridden > 0


def test_what_is_simulated_is_filtered_by_simulation():
    world, env = ShieldedVecEnv(2, "highway-fast-v0", shield=ShieldConfig.exact()), CompiledHighwayEnv()
    world.seed(60)
    world.reset()
    obs, _ = env.reset(seed=60)
    shield, overridden = Shield(Always(3), env, ShieldConfig.exact(), frames=False), 0
    for _ in range(12):
        _, rewards, _, infos = world.step([3, 3])
        action, _ = shield.predict(obs)
        obs, reward, *_ = env.step(int(action))
        assert reward == rewards[0]
        assert shield.report() == infos[0]["shield"]
        overridden += infos[0]["shield"]["overridden"]
    assert overridden > 0


@pytest.mark.parametrize("shield", [None, ShieldConfig.exact()], ids=["certificate", "exact"])
def test_a_model_learns_in_it(shield):
    world = ShieldedVecEnv(4, "highway-fast-v0", SHORT, shield)
    model = PPO("MlpPolicy", world, n_steps=16, batch_size=32, seed=0, device="cpu").learn(128)
    assert model.num_timesteps == 128


def test_what_is_not_compiled_is_refused():
    with pytest.raises(ConfigError, match="mode"):
        ShieldedVecEnv(2, shield=ShieldConfig(mode="ttc"))
