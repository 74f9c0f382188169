"""Masks of a batch of shields equal those of `ShieldedEnv` around each environment, and change no decision."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.highway_simulator.env import CompiledHighwayEnv
from dynamics.traffic.assumptions import Assumptions
from shield import ShieldConfig, ShieldedEnv
from shield.batch.highways import ShieldedHighways
from shield.certificate.simulated.batch_choice import batch_for
from shield.certificate.simulated.highways import SimulatedHighways
from shield.certificate.simulated.roads import SimulatedRoads
from shield.config import PROFILES

WEAK = Assumptions(braking=2.0, comfortable_braking=1.0, cut_in=False, turning_action=1.0)
EXACT = ShieldConfig.simulated_traffic()


def drive(env_id, config, shield, seeds):
    """Drive the batch and single environments step by step and compare their masks; returns the masks."""
    one, many, met = ShieldedEnv(CompiledHighwayEnv(env_id, config), shield), batch_for(env_id, shield), []
    many = many(env_id, 1, config, shield)
    for seed in seeds:
        rng, done = np.random.default_rng(seed), False
        one.reset(seed=seed)
        many.reset([seed])
        while not done:
            mask = many.masks()
            assert mask.tolist() == [one.action_masks().tolist()]
            met.append(mask[0])
            action = int(rng.integers(one.action_space.n))
            *_, terminated, truncated, _ = one.step(action)
            many.step([action])
            assert many.records.executed[0] == one.last_decision.executed
            done = terminated or truncated
    return np.array(met)


def remembered(highways):
    return highways.plans if isinstance(highways, SimulatedHighways) else highways.shields


@settings(deadline=None, max_examples=10)
@given(seed=st.integers(0, 9_999), data=st.data())
def test_masks_of_a_batch_are_those_of_single_environments_for_any_settings(seed, data):
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    least = {"visible_distance": 1.0, "braking": 2.0, "follower_braking": 2.0, "max_speed": 10.0}
    drawn = {
        field.name: bool(rng.integers(2))
        if isinstance(field.default, bool)
        else max(float(field.default) * rng.uniform(0.3, 2.0), least.get(field.name, 0.0))
        for field in fields(Assumptions)
        if rng.random() < 0.3 and field.name != "simulated"
    }
    shield = ShieldConfig(assumptions=Assumptions(**drawn), braking=float(rng.choice([5.0, 9.8])))
    config = {
        "duration": 6,
        "lanes_count": int(rng.integers(1, 5)),
        "vehicles_count": int(rng.integers(1, 25)),
        "vehicles_density": float(rng.uniform(0.8, 2.0)),
    }
    drive("highway-fast-v0", config, shield, [seed])


@settings(deadline=None, max_examples=10)
@given(
    seed=st.integers(0, 9_999),
    asked=st.lists(st.integers(0, 3), min_size=8, max_size=8),
    shield=st.sampled_from([ShieldConfig(), ShieldConfig(assumptions=WEAK), EXACT, ShieldConfig(mode="none")]),
)
def test_masks_change_no_record_memory_or_traffic(seed, asked, shield):
    """Any number of requests, with invalid actions among the steps: records, memory and traffic are the same to the
    bit."""
    kind, config = batch_for("highway-fast-v0", shield), {"duration": 5, "vehicles_density": 1.5}
    silent, open_ = (kind("highway-fast-v0", 2, config, shield) for _ in range(2))
    rng = np.random.default_rng(seed)
    for highways in (silent, open_):
        highways.reset([seed, seed + 1])
    for times in asked:
        for _ in range(times):
            before = [array.copy() for array in remembered(open_)]
            open_.masks()
            for a, b in zip(before, remembered(open_), strict=True):
                assert np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
        actions = rng.integers(0 if shield.mode == "none" else -1, 5, size=2)
        for a, b in zip(silent.step(actions, again=True), open_.step(actions, again=True), strict=True):
            assert np.array_equal(a, b)
        for name in ("records", "worlds"):
            for a, b in zip(getattr(silent, name), getattr(open_, name), strict=True):
                assert np.array_equal(a, b, equal_nan=a.dtype.kind == "f")


@pytest.mark.parametrize("name", PROFILES)
def test_masks_exist_for_each_profile(name):
    met = drive("highway-fast-v0", {"duration": 12}, ShieldConfig.profile(name), range(2))
    assert 0 < met.mean() < 1


def test_masks_are_the_same_with_violations():
    met = drive("highway-fast-v0", {"vehicles_density": 1.5, "duration": 15}, ShieldConfig(assumptions=WEAK), range(3))
    assert met.all(axis=1).any()
    assert not met.all()


def test_masks_without_a_shield_allow_every_action():
    drive("highway-fast-v0", {"duration": 8}, ShieldConfig(mode="none"), [5])


@pytest.mark.parametrize("seed", [614, 920])
def test_masks_are_the_same_while_no_plan_keeps_the_buffer(seed):
    config = {"vehicles_density": 2.0, "duration": 15}
    drive("highway-fast-v0", config, EXACT, [seed])


@pytest.mark.parametrize("shield", [ShieldConfig(), EXACT], ids=["certificate", "exact"])
def test_masks_of_a_batch_are_independent(shield):
    kind, config, e = batch_for("highway-fast-v0", shield), {"duration": 8}, 5
    together = kind("highway-fast-v0", e, config, shield, threads=3)
    together.reset(range(20, 20 + e))
    alone = [kind("highway-fast-v0", 1, config, shield) for _ in range(e)]
    for i in range(e):
        alone[i].reset([20 + i])
    actions = np.random.default_rng(0).integers(5, size=(12, e))
    for k in range(12):
        masks = together.masks()
        assert all(np.array_equal(masks[i], alone[i].masks()[0]) for i in range(e))
        together.step(actions[k], again=True)
        for i in range(e):
            alone[i].step(actions[k, i : i + 1], again=True)


def test_a_scene_that_is_not_finite_has_no_mask():
    highways = ShieldedHighways("highway-fast-v0", 2)
    highways.reset([0, 1])
    highways.step([3, 3])
    before = highways.masks()
    assert not before.all(axis=1).any()
    highways.worlds.f[0, 3, 7] = np.nan
    after = highways.masks()
    assert after[0].all()
    assert np.array_equal(after[1], before[1])


def test_masks_exist_on_road_networks():
    roads, rng = SimulatedRoads("merge-v0", 2), np.random.default_rng(0)
    one = ShieldedEnv(roads.one(), EXACT)
    one.reset(seed=8)
    roads.reset([8, 9])
    for _ in range(6):
        assert roads.masks()[0].tolist() == one.action_masks().tolist()
        action = int(rng.integers(5))
        *_, terminated, truncated, _ = one.step(action)
        roads.step([action, 1], again=True)
        if terminated or truncated:
            break
