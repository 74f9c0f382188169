"""`ShieldedEnv` works in the places where users of Gymnasium and Stable-Baselines3 put an environment."""

import pickle
import warnings

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from policies import Always, make, model_of
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

from shield import ShieldConfig, ShieldedEnv

KEYS = {
    "overridden": bool,
    "intervention": str,
    "reason": str,
    "tier": str,
    "margin": float,
    "frames_overridden": int,
    "violations": int,
    "rules": dict,
    "guarantee": str,
    "verification": str,
}


def test_info_has_the_documented_keys_and_types():
    env = ShieldedEnv(make(duration=20))
    for seed in range(2):
        env.reset(seed=seed)
        done = False
        while not done:
            _, reward, terminated, truncated, info = env.step(3)
            done = terminated or truncated
            assert {k: type(v) for k, v in info["shield"].items()} == KEYS
            assert type(reward) is float
            assert env.latency > 0
            assert 0 <= info["shield"]["frames_overridden"] <= 5
            assert {"speed", "crashed", "action", "rewards"} <= set(info)
            pickle.dumps(info["shield"])
    env.close()


def test_gymnasiums_own_checker_passes():
    env = ShieldedEnv(make())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        check_env(env, skip_render_check=True)


@pytest.mark.parametrize("config", [None, ShieldConfig(mode="rss", braking=5.0)])
def test_the_spec_rebuilds_the_shielded_environment(config):
    env = ShieldedEnv(make(), config)
    for spec in (env.spec, pickle.loads(pickle.dumps(env.spec))):
        again = gym.make(spec)
        inner = again
        while not isinstance(inner, ShieldedEnv):
            inner = inner.env
        assert inner.config == (config or ShieldConfig())
        obs, _ = again.reset(seed=5)
        np.testing.assert_array_equal(obs, env.reset(seed=5)[0])
        np.testing.assert_array_equal(again.step(3)[0], env.step(3)[0])


class Uncopied(Always):
    """Holds an object that cannot be copied, as a model with environments in other processes does."""

    def __deepcopy__(self, memo):
        raise TypeError("cannot be copied")


def test_a_policy_that_cannot_be_copied_gives_its_order_all_the_same():
    env = ShieldedEnv(make(), policy=Uncopied(3))
    env.reset(seed=0)
    assert env.step(3)[4]["shield"]["tier"] in {"passed", "alternative", "governed"}


def test_a_path_as_configuration_and_its_spec_as_json(tmp_path):
    path = str(tmp_path / "shield.toml")
    ShieldConfig(braking=5.5).save(path)
    env = ShieldedEnv(make(), path)
    assert env.config.braking == 5.5
    assert "ShieldedEnv" in env.spec.to_json()


def test_inside_a_dummy_vector_environment():
    vec = DummyVecEnv([lambda: ShieldedEnv(make())] * 2)
    vec.reset()
    for _ in range(7):
        _, rewards, _, infos = vec.step(np.array([3, 4]))
    assert rewards.shape == (2,)
    assert all("shield" in info for info in infos)
    vec.close()


def shielded_short():
    return ShieldedEnv(make())


def test_inside_subprocesses():
    vec = SubprocVecEnv([shielded_short, shielded_short], start_method="fork")
    try:
        vec.seed(0)
        vec.reset()
        for _ in range(3):
            _, _, _, infos = vec.step(np.array([3, 4]))
        assert all(set(info["shield"]) == set(KEYS) for info in infos)
    finally:
        vec.close()


def test_ppo_learns_in_it():
    model = model_of("PPO", ShieldedEnv(make()))
    assert model.learn(64).num_timesteps == 64


def test_maskable_ppo_learns_with_its_masks():
    env = ShieldedEnv(make())
    env.reset(seed=0)
    mask = env.action_masks()
    assert mask.shape == (5,)
    assert mask.dtype == bool
    assert mask.any()
    assert model_of("MaskablePPO", env).learn(64).num_timesteps == 64


def test_a_masked_action_would_be_overridden():
    env, disagreed = ShieldedEnv(make(duration=15)), 0
    for seed in range(3):
        env.reset(seed=seed)
        done = False
        while not done:
            mask = env.action_masks()
            _, _, terminated, truncated, _ = env.step(3)
            if mask.sum() < 5 and mask.any():
                disagreed += 1
            # All True also stands for none: MaskablePPO cannot handle an empty mask.
            assert env.decisions[0].overridden == (not mask[3]) or mask.all()
            done = terminated or truncated
    assert disagreed
    env.close()


def record(env, policy, seed, steps=30):
    """Everything that an episode shows, but for the shield's own record of times."""
    rows = [env.reset(seed=seed)[0]]
    for i in range(steps):
        obs, reward, terminated, truncated, info = env.step(policy(i))
        episode = {name: value for name, value in info.pop("shield_episode", {}).items() if name != "latency_ms"}
        shield = {**info.pop("shield", {}), "episode": episode}
        ego = env.unwrapped.vehicle
        others = [(*v.position, v.heading, v.speed, v.crashed) for v in env.unwrapped.road.vehicles]
        rows.append((obs, reward, terminated, truncated, info, shield, ego.target_speed, others))
        if terminated or truncated:
            break
    env.close()
    return rows


def assert_bitwise(a, b, shield=True):
    assert len(a) == len(b)
    np.testing.assert_array_equal(a[0], b[0])
    for x, y in zip(a[1:], b[1:], strict=True):
        np.testing.assert_array_equal(x[0], y[0])
        assert x[1:4] == y[1:4]
        assert x[4] == y[4]
        assert x[6:] == y[6:]
        assert not shield or x[5] == y[5]


def playing(i):
    return (3, 0, 3, 2, 1, 4)[i % 6]


@pytest.mark.parametrize("env_id", ["highway-fast-v0", "highway-v0"])
def test_two_runs_on_one_seed_are_equal_to_the_bit(env_id):
    config = {"duration": 5}
    runs = [record(ShieldedEnv(gym.make(env_id, config=config)), playing, 7) for _ in range(2)]
    assert_bitwise(*runs)


def test_a_second_episode_does_not_depend_on_the_first():
    env = ShieldedEnv(make(duration=15))
    env.reset(seed=1)
    for _ in range(6):
        env.step(3)
    assert_bitwise(record(env, playing, 7), record(ShieldedEnv(make(duration=15)), playing, 7))


@pytest.mark.parametrize("seed", range(3))
def test_a_shielded_env_of_mode_none_is_the_unshielded_environment(seed):
    config = ShieldConfig(mode="none")
    shielded = record(ShieldedEnv(make(duration=20), config), playing, seed)
    assert_bitwise(shielded, record(make(duration=20), playing, seed), shield=False)
    assert {row[5]["tier"] for row in shielded[1:]} == {"off"}


def test_an_episode_without_an_override_is_that_of_the_unshielded_environment():
    compared = 0
    for seed in range(6):
        config = {"duration": 20, "vehicles_density": 0.3, "vehicles_count": 8}
        shielded = record(ShieldedEnv(make(**config)), lambda i: (1, 4, 1, 1)[i % 4], seed)
        if any(row[5]["overridden"] for row in shielded[1:]):
            continue
        compared += 1
        assert_bitwise(shielded, record(make(**config), lambda i: (1, 4, 1, 1)[i % 4], seed), shield=False)
    assert compared >= 2
