"""Look-ahead simulates the future: its predicted reward is that of highway-env."""

from copy import deepcopy

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest

from dynamics.errors import ConfigError
from dynamics.highway_simulator.env import CompiledHighwayEnv
from evaluation.running.episodes import run_episode
from evaluation.settings import Setting
from mpc.lookahead_policy import LookaheadPolicy

SHORT = {"duration": 8, "vehicles_count": 10}


@pytest.mark.parametrize("seed", range(3))
def test_the_score_of_one_decision_is_its_reward(seed):
    env = gym.make("highway-fast-v0", config=SHORT)
    env.reset(seed=seed)
    policy = LookaheadPolicy(env, depth=1, beam=1)
    for action in (3, 0, 3, 2):
        scores = policy.action_scores(None)
        for each in range(5):
            _, reward, terminated, _, _ = deepcopy(env).step(each)
            assert scores[each] == reward - 100.0 * terminated
        _, _, terminated, _, _ = env.step(action)
        if terminated:
            break


def test_the_final_score_is_the_return():
    env = CompiledHighwayEnv("highway-fast-v0", {"duration": 5})
    env.reset(seed=4)
    policy = LookaheadPolicy(env, depth=5, beam=64)
    expected, total, done = policy.action_scores(None).max(), 0.0, False
    while not done:
        action, _ = policy.predict(None)
        _, reward, terminated, truncated, _ = env.step(int(action))
        total, done = total + reward, terminated or truncated
    # Towards the end the search covers all that is left; a narrow beam may find more on the way.
    assert total >= expected - 1e-12


def test_both_simulators_are_read_in_the_same_way():
    envs = gym.make("highway-fast-v0", config=SHORT), CompiledHighwayEnv("highway-fast-v0", SHORT)
    policies = [LookaheadPolicy(env, depth=3, beam=6) for env in envs]
    for env in envs:
        env.reset(seed=2)
    for _ in range(6):
        one, two = (policy.action_scores(None) for policy in policies)
        assert np.array_equal(one, two)
        for env in envs:
            env.step(int(one.argmax()))


def test_look_ahead_does_not_change_the_simulator():
    env = CompiledHighwayEnv("highway-fast-v0", SHORT)
    env.reset(seed=2)
    before = [array.copy() for array in env.simulator.worlds]
    LookaheadPolicy(env, depth=3, beam=6).predict(None)
    assert all(np.array_equal(a, b) for a, b in zip(before, env.simulator.worlds, strict=True))


def test_look_ahead_earns_more_than_a_trained_policy():
    setting = Setting("half", "highway-fast-v0", {"duration": 15})
    for seed in range(3):
        mine, ppo = (run_episode(setting, name, seed=seed) for name in ("lookahead", "ppo-highway-fast"))
        assert mine.simulator == "compiled"
        assert not mine.crashed
        assert mine.return_ > ppo.return_


@pytest.mark.parametrize(
    ("env", "options", "message"),
    [
        (lambda: gym.make("merge-v0"), {}, "not merge-v0"),
        (lambda: gym.make("highway-v0", config={"action": {"type": "ContinuousAction"}}), {}, "chooses meta-actions"),
        (lambda: gym.make("highway-v0"), {"depth": 0}, "at least 1, not 0 and 24"),
    ],
)
def test_unsupported_environments_are_refused_by_look_ahead(env, options, message):
    with pytest.raises(ConfigError, match=message):
        LookaheadPolicy(env(), **options)
