"""Look-ahead behind the shield: the predicted reward is that of the shielded environment."""

from __future__ import annotations

import numpy as np
import pytest

from dynamics.highway_simulator.env import CompiledHighwayEnv
from evaluation.running.episodes import run_paired
from evaluation.running.records import ShieldVariant
from evaluation.settings import Setting
from shield import ShieldedEnv
from shield.batch.lookahead import ShieldedLookaheadPolicy

SHORT = {"duration": 6}


def test_the_score_of_a_first_action_is_its_reward():
    """In later decisions the look-ahead has a shorter memory of the other vehicles than the shield that acts."""
    for seed in range(3):
        env = CompiledHighwayEnv("highway-fast-v0", SHORT)
        policy, shielded = ShieldedLookaheadPolicy(env, depth=1, beam=1), ShieldedEnv(env)
        for action in range(5):
            shielded.reset(seed=seed)
            scores = policy.action_scores(None)
            _, reward, terminated, _, _ = shielded.step(action)
            assert scores[action] == reward - 100.0 * terminated


def test_scoring_does_not_change_the_simulator():
    env = CompiledHighwayEnv("highway-fast-v0", SHORT)
    policy = ShieldedLookaheadPolicy(env, depth=3, beam=4)
    env.reset(seed=1)
    before = [x.copy() for x in env.simulator.worlds]
    first = policy.action_scores(None)
    assert all(np.array_equal(a, b) for a, b in zip(before, env.simulator.worlds, strict=True))
    assert np.array_equal(first, policy.action_scores(None))


def test_shielded_lookahead_earns_more_than_always_faster():
    setting, config = Setting("some", "highway-fast-v0", {"duration": 15}), ShieldVariant("env")
    found = {
        name: run_paired(setting, name, [config], range(4), simulator="compiled")
        for name in ("faster", "lookahead-shielded")
    }
    assert not found["lookahead-shielded"]["crashed"].any()
    assert found["lookahead-shielded"]["return"].mean() > found["faster"]["return"].mean()


def test_shielded_lookahead_gives_the_same_returns_in_highway_env():
    setting = Setting("some", "highway-fast-v0", {"duration": 3})
    rows = [
        run_paired(setting, "lookahead-shielded", [ShieldVariant("env")], [2], simulator=s)
        for s in ("compiled", "highway-env")
    ]
    assert rows[0]["return"].tolist() == pytest.approx(rows[1]["return"].tolist(), abs=0)
