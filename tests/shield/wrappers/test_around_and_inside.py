"""Wrappers around a shield, and inside: actions are filtered as without them, or construction refuses the
combination."""

import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import StickyAction, TransformAction
from stable_baselines3.common.vec_env import DummyVecEnv
from unknown_traffic import UNKNOWN

import evaluation.scenarios  # noqa: F401  (registers environments)
from dynamics.errors import ConfigError, PolicyError
from dynamics.road_networks.simulation.compiled_frames import CompiledFrames
from shield import Shield, ShieldConfig, ShieldedEnv
from shield.config import WORST_CASE

EXACT = ShieldConfig.simulated_traffic()


def faster(observation):
    return 3


def driven(env, predict=faster, seed=0):
    """Observations and rewards, step by step, and the number of frames that the shield changed."""
    observation, _ = env.reset(seed=seed)
    steps, frames, done = [], 0, False
    while not done:
        observation, reward, terminated, truncated, info = env.step(predict(observation))
        steps.append((np.asarray(observation).tobytes(), reward, terminated, truncated, info["crashed"]))
        frames += info.get("shield", {}).get("frames_overridden", 0)
        done = terminated or truncated
    return steps, frames


@pytest.mark.parametrize("env_id", ["merge-v0", "roundabout-v0"])
def test_compiled_frames_do_not_take_the_frames_from_a_shield(env_id):
    plain, frames = driven(ShieldedEnv(gym.make(env_id), WORST_CASE))
    assert frames > 0
    assert driven(ShieldedEnv(CompiledFrames(gym.make(env_id)), WORST_CASE)) == (plain, frames)
    assert driven(CompiledFrames(ShieldedEnv(gym.make(env_id), WORST_CASE))) == (plain, frames)
    env = CompiledFrames(gym.make(env_id))
    shield = Shield(faster, env=env, config=WORST_CASE)
    assert driven(env, lambda observation: int(shield.predict(observation)[0]))[0] == plain


def test_compiled_frames_do_not_take_the_frames_from_throttle_and_steering():
    config = {"action": {"type": "ContinuousAction"}}
    make = lambda: gym.make("intersection-v1", config=config)  # noqa: E731
    full = lambda observation: np.array([1.0, 0.0], np.float32)  # noqa: E731
    plain, frames = driven(ShieldedEnv(make(), EXACT), full)
    assert frames > 0
    assert driven(ShieldedEnv(CompiledFrames(make()), EXACT), full) == (plain, frames)


def test_frames_that_a_shield_supervises_cannot_be_watched():
    inner = CompiledFrames(gym.make("merge-v0"))
    env = ShieldedEnv(inner, WORST_CASE)
    env.reset(seed=0)
    inner.watchers.append(lambda *_: None)
    with pytest.raises(ConfigError, match="nothing to be watched"):
        env.step(3)


def test_frames_are_compiled_again_after_a_supervised_decision():
    env = CompiledFrames(gym.make("merge-v0"))
    env.reset(seed=0)
    Shield(faster, env=env, config=WORST_CASE).predict(np.zeros((5, 5)))
    env.step(3)
    del env.unwrapped.vehicle.act
    seen = []
    env.watchers.append(lambda bodies, rows, on_road: seen.append(len(rows)))
    env.step(1)
    assert seen == [15]


@pytest.mark.parametrize("config", [WORST_CASE, EXACT])
def test_a_wrapper_that_changes_actions_is_refused_inside(config):
    for inside in (
        TransformAction(gym.make("merge-v0"), lambda action: 3, gym.spaces.Discrete(5)),
        StickyAction(gym.make("merge-v0"), 0.25),
    ):
        with pytest.raises(ConfigError, match=f"{type(inside).__name__}.*around a ShieldedEnv"):
            ShieldedEnv(inside, config)
        with pytest.raises(ConfigError, match="changes the actions"):
            Shield(faster, env=inside, config=config)
    around = StickyAction(ShieldedEnv(gym.make("merge-v0"), config), 0.25)
    assert not any(step[-1] for step in driven(around)[0])


class _Stubborn(gym.Wrapper):
    """Changes actions without being an `ActionWrapper`."""

    def step(self, action):
        return self.env.step(3)


@pytest.mark.parametrize("config", [WORST_CASE, EXACT])
def test_another_action_than_the_verified_one_is_detected(config):
    env = ShieldedEnv(_Stubborn(gym.make("merge-v0")), config)
    env.reset(seed=0)
    with pytest.raises(ConfigError, match=r"given action 3 and not 4"):
        env.step(4)


def test_a_decision_that_ends_in_a_crash_has_no_margin():
    """The ego is hit in the first decision by any action; its record once had an infinite margin."""
    env = ShieldedEnv(gym.make("two-way-v0"), EXACT)
    env.reset(seed=250002798)
    *_, info = env.step(3)
    assert info["crashed"]
    assert info["shield"]["tier"] == "largest_margin"
    assert np.isnan(info["shield"]["margin"])
    assert np.isnan(info["shield_episode"]["margin"])


def test_no_margin_is_recorded_before_an_unavoidable_crash():
    """Every action ends in a crash in the third decision; the first two once had a margin of 10.7 m."""
    env = ShieldedEnv(gym.make("intersection-v0", config={"action": {"type": "DiscreteMetaAction"}}), EXACT)
    env.reset(seed=5)
    env.action_space.seed(5)
    done, reports = False, []
    while not done:
        *_, terminated, truncated, info = env.step(env.action_space.sample())
        reports.append(info["shield"])
        done = terminated or truncated
    assert info["crashed"]
    assert [report["tier"] for report in reports[-2:]] == ["largest_margin"] * 2
    assert all(np.isnan(report["margin"]) for report in reports[-2:])


@pytest.mark.parametrize("env_id", ["roundabout-v0", "racetrack-v0", "highway-fast-v0"])
def test_fewer_frames_than_decisions_are_refused(env_id):
    env = gym.make(env_id, config={"simulation_frequency": 10, "policy_frequency": 20})
    for config in (None, EXACT):
        with pytest.raises(ConfigError, match=r"fewer frames \(simulation_frequency 10\)"):
            ShieldedEnv(env, config)


@pytest.mark.parametrize("env_id", ["two-way-v0", "merge-v0"])
def test_traffic_that_is_not_known_on_networks_is_refused_at_once(env_id):
    env = gym.make(env_id, config=UNKNOWN)
    with pytest.raises(ConfigError, match="Dozy has act of its own"):
        ShieldedEnv(env, EXACT)


@pytest.mark.parametrize(
    ("env_id", "config"),
    [
        ("merge-v0", {}),
        ("racetrack-v0", {}),
        ("exit-v0", {"action": {"type": "ContinuousAction"}}),
        ("intersection-multi-agent-v0", {}),
    ],
)
def test_a_shield_that_simulates_can_be_pickled_amid_an_episode(env_id, config):
    env = ShieldedEnv(gym.make(env_id, config=config), EXACT)
    env.reset(seed=3)
    env.action_space.seed(3)
    env.step(env.action_space.sample())
    copy = pickle.loads(pickle.dumps(env))
    for _ in range(3):
        action = env.action_space.sample()
        mine, other = env.step(action), copy.step(action)
        assert np.array_equal(mine[0], other[0])
        assert mine[1:4] == other[1:4]


@pytest.mark.parametrize("action", [2, np.int64(2), np.array(2), None, (2,), (1, 1, 1)])
def test_several_egos_take_a_tuple_of_actions(action):
    env = ShieldedEnv(gym.make("intersection-multi-agent-v0"), EXACT)
    env.reset(seed=0)
    with pytest.raises(ConfigError, match=r"there are 2 egos and . actions; pass a tuple"):
        env.step(action)


def test_a_shield_around_a_shield_is_refused():
    env = gym.make("merge-v0")
    with pytest.raises(PolicyError, match="Shield already"):
        Shield(Shield(faster, env=env), env=env)


def test_shielded_env_refuses_a_vector_environment():
    many = DummyVecEnv([lambda: gym.make("merge-v0")])
    with pytest.raises(ConfigError, match=r"DummyVecEnv.*put the shield inside"):
        ShieldedEnv(many)
