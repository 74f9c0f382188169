"""Verification by simulation on roads other than a straight highway, in highway-env itself."""

from __future__ import annotations

from copy import deepcopy

import gymnasium as gym
import highway_env  # noqa: F401
import numpy as np
import pytest
from network_pair import wild_scene
from plans import least_clearance
from policies import Always

from shield import Shield, ShieldConfig
from shield.decision import Tier

EXACT = ShieldConfig.simulated_traffic()
UNSEEN = np.zeros((5, 5))
"""A placeholder observation that no code reads."""
ROADS = ["merge-v1", "roundabout-v1", "two-way-v0", "u-turn-v1", "intersection-v2"]
MORE = [
    pytest.param(each, marks=pytest.mark.slow)
    for each in ("merge-generic-v1", "roundabout-generic-v0", "exit-v1", "intersection-v0")
]


def episode(env_id, seed, name=None):
    """Drive behind the shield; yields each decision's environment, and the shield."""
    wrapped, policy, rng = gym.make(env_id), Always(0), np.random.default_rng(seed)
    wrapped.reset(seed=seed)
    env = wrapped.unwrapped
    actions = env.action_type.actions_indexes
    shield, done = Shield(policy, env, EXACT, frames=False), False
    while not done:
        policy.action = int(rng.integers(len(actions))) if name is None else actions[name]
        taken = int(shield.predict(UNSEEN)[0])
        yield env, shield, taken
        _, _, terminated, truncated, _ = wrapped.step(taken)
        done = terminated or truncated
    assert not env.vehicle.crashed


@pytest.mark.parametrize("env_id", [*ROADS, *MORE])
def test_a_verified_plan_on_a_network_is_clear_in_highway_env(env_id):
    """The plan of every sixth decision is driven in a copy of highway-env; no vehicle comes into the buffer."""
    verified = 0
    for k, (env, shield, taken) in enumerate(episode(env_id, 800)):
        decision, plans = shield.last_decision, shield._filters[0]._plans
        if decision.tier.verified and k % 6 == 0:
            copy, verified = deepcopy(env), verified + 1
            then = plans.actions[0, : plans.length[0]].tolist()
            assert least_clearance(copy, [taken, *then], EXACT.buffer) >= decision.margin - 1e-9 >= -1e-9
    assert verified > 1


@pytest.mark.parametrize("env_id", [*ROADS, *MORE])
def test_always_faster_drives_as_predicted_and_without_contact(env_id):
    overridden = 0
    for seed in (810, 811):
        for _, shield, _ in episode(env_id, seed, "FASTER"):
            overridden += shield.last_decision.overridden
        assert shield.report()["violations"] == 0
        assert shield._filters[0].violations == 0
    assert overridden > 0 or "exit" in env_id or "generic" in env_id


def test_the_horizon_ends_where_the_road_does():
    """Behind the last of the traffic, 60 m before the end: FASTER passes, though highway-env has the ego turn back."""
    env = gym.make("two-way-v0").unwrapped
    env.reset(seed=3)
    env.vehicle.position = env.vehicle.lane.position(env.vehicle.lane.length - 60, 0)
    env.vehicle.on_state_update()
    shield = Shield(Always(3), env, EXACT, frames=False)
    shield.predict(UNSEEN)
    assert shield.last_decision.tier is Tier.PASSED


def test_a_prediction_mismatch_on_a_network_is_counted():
    for k, (env, shield, _) in enumerate(episode("roundabout-v1", 820, "IDLE")):
        if k == 2:
            assert shield._filters[0].violations == 0
            env.road.vehicles[-1].speed += 0.5
        if k == 3:
            assert shield._filters[0].violations >= 1
            return


def test_vehicles_that_enter_or_leave_an_intersection_are_no_violators():
    """Spawned and removed vehicles are in no predicted scene; a vehicle that moves otherwise than predicted is
    counted."""
    first, offended = None, False
    for k, (env, shield, _) in enumerate(episode("intersection-v0", 837, "SLOWER")):
        first = first or list(env.road.vehicles)
        if offended:
            assert shield._filters[0].violations >= 1
            assert any(v not in first for v in env.road.vehicles)
            assert any(v not in env.road.vehicles for v in first)
            return
        assert shield._filters[0].violations == 0
        env.config["duration"] = 40
        if k == 20:
            env.road.vehicles[0].position = env.road.vehicles[0].position + 0.01
            offended = env.road.vehicles[0] is not env.vehicle
    raise AssertionError("the episode was over before")


@pytest.mark.parametrize("env_id", ["intersection-v0", "merge-v1"])
def test_the_recorded_plan_and_areas_match_the_drive(env_id):
    """The ego drives the recorded path, and the recorded boxes contain the other vehicles, frame by frame."""
    env, rng = gym.make(env_id).unwrapped, np.random.default_rng(0)
    env.reset(seed=840)
    policy = Always(0)
    shield = Shield(policy, env, EXACT.replace(record=True), frames=False)
    for _ in range(4):
        policy.action = int(rng.integers(env.action_space.n))
        taken, decision = int(shield.predict(UNSEEN)[0]), shield.last_decision
        others, frame, advance = [v for v in env.road.vehicles if v is not env.vehicle], 0, env.road.step

        def step(dt, advance=advance, others=others, plan=decision.plan, areas=decision.occupancy):
            nonlocal frame
            advance(dt)
            frame += 1
            ego = env.vehicle
            assert np.allclose(plan[frame], [*ego.position, ego.heading, ego.speed], atol=1e-9)
            corners = np.array([v.polygon() for v in others])
            low, high = corners.min(axis=1), corners.max(axis=1)
            found = np.stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]], axis=1)
            assert np.allclose(areas[frame, : len(others)], found, atol=1e-9)

        env.road.step = step
        env.step(taken)
        env.road.step = advance
        assert frame == 15


def verified_in_a_wild_scene(env_id, seed):
    """Whether a proposal in a random scene, or its replacement, verifies; a verified one is checked in highway-env."""
    pair, rng = wild_scene(env_id, seed)
    shield = Shield(Always(int(rng.integers(pair.env.action_space.n))), pair.env, EXACT, frames=False)
    taken = int(shield.predict(UNSEEN)[0])
    decision, plans = shield.last_decision, shield._filters[0]._plans
    if not decision.tier.verified or pair.env.vehicle.crashed:
        return False
    then = plans.actions[0, : plans.length[0]].tolist()
    assert least_clearance(deepcopy(pair.env), [taken, *then], EXACT.buffer) >= decision.margin - 1e-9 >= -1e-9
    return True


@pytest.mark.parametrize("env_id", ["merge-v1", "intersection-v2"])
def test_a_verified_plan_in_a_random_scene_is_clear(env_id):
    """Vehicles of other sizes and constants anywhere, with their own routes, wrecks and obstacles."""
    assert sum(verified_in_a_wild_scene(env_id, seed) for seed in (303, 304)) == 2


@pytest.mark.slow
@pytest.mark.parametrize("env_id", [*ROADS, "exit-v1"])
def test_a_verified_plan_in_a_hundred_random_scenes_is_clear(env_id):
    assert sum(verified_in_a_wild_scene(env_id, seed) for seed in range(1000, 1100)) > 10
