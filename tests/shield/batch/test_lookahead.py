"""Look-ahead behind the shield: what it expects is what the shielded environment then does."""

from __future__ import annotations

import numpy as np
import pytest

from dynamics.highway_simulator.env import CompiledHighwayEnv
from evaluation.running.episodes import run_paired
from evaluation.running.records import Variant
from evaluation.settings import Setting
from shield import ShieldedEnv
from shield.batch.lookahead import ShieldedLookaheadPolicy

SHORT = {"duration": 6}


def test_in_the_first_decision_it_expects_what_comes():
    """Later its memory of the others is shorter than that of the shield which acts."""
    for seed in range(3):
        env = CompiledHighwayEnv("highway-fast-v0", SHORT)
        policy, shielded = ShieldedLookaheadPolicy(env, depth=1, beam=1), ShieldedEnv(env)
        for action in range(5):
            shielded.reset(seed=seed)
            scores = policy.action_scores(None)
            _, reward, terminated, _, _ = shielded.step(action)
            assert scores[action] == reward - 100.0 * terminated


def test_looking_does_not_move_anything():
    env = CompiledHighwayEnv("highway-fast-v0", SHORT)
    policy = ShieldedLookaheadPolicy(env, depth=3, beam=4)
    env.reset(seed=1)
    before = [x.copy() for x in env.simulator.worlds]
    first = policy.action_scores(None)
    assert all(np.array_equal(a, b) for a, b in zip(before, env.simulator.worlds, strict=True))
    assert np.array_equal(first, policy.action_scores(None))


def test_it_is_worth_more_than_going_fast():
    setting, config = Setting("some", "highway-fast-v0", {"duration": 15}), Variant("env")
    found = {
        name: run_paired(setting, name, [config], range(4), simulator="compiled")
        for name in ("faster", "lookahead-shielded")
    }
    assert not found["lookahead-shielded"]["crashed"].any()
    assert found["lookahead-shielded"]["return"].mean() > found["faster"]["return"].mean()


def test_it_looks_from_highway_env_too():
    setting = Setting("some", "highway-fast-v0", {"duration": 3})
    rows = [
        run_paired(setting, "lookahead-shielded", [Variant("env")], [2], simulator=s)
        for s in ("compiled", "highway-env")
    ]
    assert rows[0]["return"].tolist() == pytest.approx(rows[1]["return"].tolist(), abs=0)
