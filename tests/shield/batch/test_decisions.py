"""A batch of shields decides as single ones do: every action, margin, clause and record, to the bit."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.highway_simulator.env import CompiledHighwayEnv
from dynamics.traffic.assumptions import Assumptions
from shield import ConfigError, ShieldConfig, ShieldedEnv
from shield.batch.codes import CLAUSES, REASONS, TIERS, rules_in
from shield.batch.highways import ShieldedHighways
from shield.config import Buffer

TRAFFIC = "highway_env.vehicle.behavior."
AGGRESSIVE = {"vehicles_count": 25, "duration": 12, "other_vehicles_type": TRAFFIC + "AggressiveVehicle"}
LINEAR = {"lanes_count": 2, "vehicles_count": 8, "other_vehicles_type": TRAFFIC + "LinearVehicle"}
SPEEDS = {"action": {"type": "DiscreteMetaAction", "target_speeds": [0, 5, 10, 15, 20, 25, 30]}}
# Vehicles that violate these rules are in the way, so the stored plan, evasion and the largest margin are tried as
# well.
WEAK = Assumptions(braking=2.0, comfortable_braking=1.0, cut_in=False, turning_action=1.0)
WEAKER = Assumptions(
    braking=1.0, comfortable_braking=0.3, acceleration=0.5, simultaneous_merge=False, cut_in=False, reversing_speed=0.0
)


class Ranked:
    """A policy with an order of preference, drawn anew at each decision."""

    def __init__(self, count):
        self.scores = np.arange(count, dtype=float)

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return int(self.scores.argmax()), state

    def action_scores(self, observation):
        return self.scores[None]


def faster(rng, k, n):
    return 3


def anything(rng, k, n):
    return int(rng.integers(n))


def weaving(rng, k, n):
    return (0, 3, 2, 3)[k % 4]


def alike(*pairs):
    """Whether all are the same, or both NaN."""
    return all(a == b or (a != a and b != b) for a, b in pairs)


def decisions_are_the_same(one, records, e=0):
    decision = one.decisions[0]
    assert alike(
        (REASONS[records.reason[e]], decision.reason),
        (TIERS[records.tier[e]], decision.tier),
        (records.executed[e], decision.executed),
        (records.margin[e], decision.margin),
        (CLAUSES[records.clause[e]], decision.clause),
        (records.vehicle[e], decision.vehicle),
    )
    for k, frame in enumerate(one.frame_decisions):
        assert alike(
            (REASONS[records.reasons[e, k]], frame.reason),
            (TIERS[records.tiers[e, k]], frame.tier),
            (records.margins[e, k], frame.margin),
            (CLAUSES[records.clauses[e, k]], frame.clause),
            (records.vehicles[e, k], frame.vehicle),
        )
        if frame.overridden:
            assert (records.lanes[e, k], records.accelerations[e, k]) == (
                frame.executed.lane,
                frame.executed.acceleration,
            )


def drive(env_id, config, shield, choose, seeds, ranked=False):
    """Both, step by step; the tiers that were met."""
    one = CompiledHighwayEnv(env_id, config)
    actions, met = one.action_space.n, set()
    policy = Ranked(actions) if ranked else None
    one, many = ShieldedEnv(one, shield, policy=policy), ShieldedHighways(env_id, 1, config, shield)
    for seed in seeds:
        rng, done, k = np.random.default_rng(seed), False, 0
        assert np.array_equal(one.reset(seed=seed)[0], many.reset([seed])[0])
        while not done:
            action, order = choose(rng, k, actions), None
            if ranked:
                policy.scores = rng.random(actions)
                order = np.argsort(-policy.scores, kind="stable")
                order = np.append(order[order != action], -1)[None]
            obs, reward, terminated, truncated, info = one.step(action)
            seen = many.step([action], order)
            decisions_are_the_same(one, many.records)
            assert np.array_equal(obs, seen[0][0])
            assert (reward, terminated, truncated) == (seen[1][0], seen[2][0], seen[3][0])
            assert info["shield"]["violations"] == many.records.violations[0]
            assert info["shield"]["rules"] == rules_in(many.records.broken[0])
            met |= {d.tier for d in (one.decisions[0], *one.frame_decisions)}
            done, k = terminated or truncated, k + 1
    return {str(tier) for tier in met}


@pytest.mark.parametrize(
    ("env_id", "config", "settings", "choose", "seeds"),
    [
        ("highway-fast-v0", {}, {}, faster, 3),
        ("highway-fast-v0", {}, {}, anything, 3),
        ("highway-fast-v0", {}, {}, weaving, 3),
        ("highway-fast-v0", {}, {"assumptions": Assumptions.rss()}, anything, 2),
        ("highway-v0", AGGRESSIVE, {}, anything, 1),
        ("highway-fast-v0", LINEAR, {}, anything, 2),
        ("highway-fast-v0", SPEEDS, {}, anything, 2),
        ("highway-fast-v0", {"action": {"type": "DiscreteMetaAction", "lateral": False}}, {}, anything, 2),
        ("highway-fast-v0", {"lanes_count": 1, "vehicles_count": 3}, {}, anything, 2),
        ("highway-fast-v0", {"vehicles_count": 0}, {}, anything, 1),
        ("highway-fast-v0", {"vehicles_density": 2.5, "simulation_frequency": 10}, {}, weaving, 1),
        ("highway-fast-v0", {}, {"buffer": Buffer(0.5, 0.0), "braking": 6.0, "perception_range": 80.0}, anything, 2),
    ],
)  # fmt: skip
def test_every_decision_is_the_same(env_id, config, settings, choose, seeds):
    met = drive(env_id, config, ShieldConfig(**settings), choose, range(seeds))
    assert "passed" in met


@pytest.mark.parametrize(
    ("weak", "density", "seeds", "tiers"),
    [
        (WEAK, 1.5, 4, {"governed", "alternative", "stored_plan"}),
        (WEAKER, 1.5, 6, {"stored_plan", "evaded"}),
        (WEAKER, 5.0, 4, {"emergency", "largest_margin"}),
    ],
)
def test_decisions_are_the_same_with_violations(weak, density, seeds, tiers):
    config = {"vehicles_density": density, "duration": 20}
    met = drive("highway-fast-v0", config, ShieldConfig(assumptions=weak), weaving, range(seeds))
    assert tiers <= met


def test_decisions_of_a_batch_follow_the_order_of_a_policy():
    met = drive("highway-fast-v0", {}, ShieldConfig(), anything, range(4), ranked=True)
    assert "alternative" in met


@settings(deadline=None, max_examples=8)
@given(seed=st.integers(0, 9_999), data=st.data())
def test_decisions_are_the_same_for_any_settings(seed, data):
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    least = {"visible_distance": 1.0, "braking": 2.0, "follower_braking": 2.0, "max_speed": 10.0}
    drawn = {}
    for field in fields(Assumptions):
        if rng.random() < 0.3 and field.name != "simulated":
            drawn[field.name] = (
                bool(rng.integers(2))
                if isinstance(field.default, bool)
                else max(float(field.default) * rng.uniform(0.3, 2.0), least.get(field.name, 0.0))
            )
    shield = ShieldConfig(assumptions=Assumptions(**drawn), braking=float(rng.choice([5.0, 9.8])))
    config = {
        "duration": 6,
        "lanes_count": int(rng.integers(2, 6)),
        "vehicles_count": int(rng.integers(1, 25)),
        "vehicles_density": float(rng.uniform(0.8, 2.0)),
    }
    drive("highway-fast-v0", config, shield, anything, [seed])


def test_environments_of_a_batch_are_independent():
    """In one batch, on threads, and with new episodes in between: the same as each alone."""
    config, steps, e = {"duration": 9}, 24, 5
    actions = np.random.default_rng(0).integers(5, size=(steps, e))
    together = ShieldedHighways("highway-fast-v0", e, config, threads=3)
    together.reset(range(20, 20 + e))
    alone = [ShieldedHighways("highway-fast-v0", 1, config) for _ in range(e)]
    for i in range(e):
        alone[i].reset([20 + i])
    for k in range(steps):
        seen = [x.copy() for x in together.step(actions[k], again=True)]
        for i in range(e):
            mine = alone[i].step(actions[k, i : i + 1], again=True)
            assert all(np.array_equal(a[i], b[0]) for a, b in zip(seen, mine, strict=True))
            for a, b in zip(together.records, alone[i].records, strict=True):
                assert np.array_equal(a[i], b[0], equal_nan=a.dtype.kind == "f")


def test_an_invalid_action_in_a_batch_is_replaced():
    one, many = ShieldedEnv(CompiledHighwayEnv("highway-fast-v0")), ShieldedHighways("highway-fast-v0", 1)
    one.reset(seed=3)
    many.reset([3])
    for action in (3, -1, 1, 7):
        one.step(action)
        many.step([action])
        decisions_are_the_same(one, many.records)
    assert REASONS[many.records.reason[0]] == "bad_action"


def test_a_scene_that_is_not_finite_is_not_judged():
    one, many = ShieldedEnv(CompiledHighwayEnv("highway-fast-v0")), ShieldedHighways("highway-fast-v0", 1)
    one.reset(seed=3)
    many.reset([3])
    for k in range(4):
        for worlds in (one.unwrapped.simulator.worlds, many.simulator.worlds):
            worlds.f[0, 3, 7] = np.nan if k == 1 else 21.0
        one.unwrapped.simulator.write_rows(one.unwrapped.frames[-1])
        one.step(3)
        many.step([3])
        if k == 0:
            decisions_are_the_same(one, many.records)
        if k == 1:
            assert REASONS[many.records.reason[0]] == "bad_scene"
            assert TIERS[many.records.tier[0]] == "stored_plan"
            assert all(TIERS[tier].fallback for tier in many.records.tiers[0])


@pytest.mark.parametrize(
    ("config", "shield", "named"),
    [
        ({}, ShieldConfig(mode="rss"), "mode"),
        ({}, ShieldConfig(repair="filter"), "repair"),
        ({}, ShieldConfig(record=True), "record"),
        ({"action": {"type": "ContinuousAction"}}, ShieldConfig(), "ContinuousAction"),
    ],
)
def test_a_batch_refuses_settings_that_are_not_compiled(config, shield, named):
    with pytest.raises(ConfigError, match=named):
        ShieldedHighways("highway-fast-v0", 1, config, shield)


@pytest.mark.parametrize("actions", [[3], [3.0, 1.0], [[3, 1]]])
def test_a_batch_needs_one_action_for_each_environment(actions):
    highways = ShieldedHighways("highway-fast-v0", 2)
    with pytest.raises(ConfigError, match="each of 2"):
        highways.step(actions)
    with pytest.raises(ConfigError, match="orders"):
        highways.step([3, 3], np.zeros((1, 5), dtype=int))
