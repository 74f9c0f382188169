"""The certificate on road networks, against vehicles that are driven in real highway-env."""

from __future__ import annotations

from copy import copy

import gymnasium as gym
import highway_env  # noqa: F401
import numpy as np
import pytest
from highway_env.vehicle.kinematics import Vehicle
from input_scenes import gap

from shield import Shield, ShieldConfig, ShieldedEnv
from shield.decision import Reason, Tier
from shield.doors.road_door import RoadDoor
from shield.roads.watch import Breach

ROADS = ("roundabout-v1", "merge-v1", "exit-v0", "two-way-v0", "u-turn-v1", "intersection-v2")
STEPS = 15


class Wild(Vehicle):
    """Throttle and steering at random, held for a while; nothing else decides what it does."""

    draw = None

    @classmethod
    def instead_of(cls, body, seed):
        wild = cls(body.road, body.position.copy(), body.heading, body.speed)
        wild.draw, wild.left = np.random.default_rng(seed), 0
        wild.crashed, wild.route = body.crashed, ()
        return wild

    def act(self, action=None):
        if self.left == 0:
            self.left = int(self.draw.integers(2, 20))
            hard = self.draw.random() < 0.2
            self.held = {
                "acceleration": self.draw.uniform(-8, 8) if hard else self.draw.uniform(-3, 3),
                "steering": self.draw.normal(0, 0.3 if hard else 0.03),
            }
        self.left -= 1
        super().act(self.held)


def shielded(env_id, seed=0, wild=0, config=None):
    """A reset environment; the first so many of the others are wild."""
    env = ShieldedEnv(gym.make(env_id), config)
    env.reset(seed=seed)
    env.action_space.seed(seed)
    road, left = env.unwrapped.road, wild
    for k, body in enumerate(road.vehicles):
        if body is not env.unwrapped.vehicle and left > 0:
            road.vehicles[k], left = Wild.instead_of(body, 100 * seed + k), left - 1
    return env


def frames(env, action=None):
    """Drives an episode, and yields before each frame that is decided the true clearance [m] and the door."""
    seen, door, base = [], env._door, env.unwrapped
    ask = door.frame

    def frame():
        command, decision = ask()
        seen.append((gap(base, env.config.buffer, base.vehicle), decision, copy(door.watch.by_rule)))
        return command, decision

    door.frame = frame
    for _ in range(STEPS):
        *_, terminated, truncated, _ = env.step(env.action_space.sample() if action is None else action)
        if terminated or truncated:
            break
    door.frame = ask
    return seen


@pytest.mark.parametrize("env_id", ROADS)
@pytest.mark.parametrize("seed", range(2))
def test_any_behaviour_is_flagged_or_leaves_the_plan_clear(env_id, seed):
    """What was verified a frame before stays clear of whoever has broken no rule, whatever the others do: nothing is
    unforeseen, and the ego is hit only where somebody has broken one."""
    env = shielded(env_id, seed, wild=6)
    seen = frames(env)
    watch = env._door.watch
    assert Breach.UNFORESEEN not in watch.by_rule
    assert not env.unwrapped.vehicle.crashed or watch.count > 0
    for _, decision, _ in seen:
        assert decision.tier is not Tier.EMERGENCY
        assert decision.tier.verified == (decision.margin >= -1e-6)


@pytest.mark.parametrize("env_id", ROADS)
def test_it_is_hit_and_off_the_road_only_where_somebody_has_broken_a_rule(env_id):
    for seed in range(3):
        env = shielded(env_id, seed)
        frames(env)
        ego = env.unwrapped.vehicle
        assert (ego.on_road and not ego.crashed) or env._door.watch.count > 0


@pytest.mark.parametrize("env_id", ROADS)
def test_the_ego_does_what_was_verified(env_id):
    """The path that was judged is the one that is driven, to the bit: alone in its road, whoever else is there."""
    env = shielded(env_id, 1)
    door, ego, expected, ask = env._door, env.unwrapped.vehicle, [], env._door.frame

    def frame():
        now = [*ego.position, ego.heading, ego.speed]
        if expected:
            assert now == expected
        answer = ask()
        expected[:] = door._trial.path[1].tolist()
        return answer

    door.frame = frame
    for _ in range(6):
        if any(env.step(env.action_space.sample())[2:4]):
            break
    assert expected


def test_the_ego_drives():
    """Safety alone is easy: it gets into the roundabout, and past the merge."""
    env = shielded("roundabout-v1", 3)
    start = env.unwrapped.vehicle.position.copy()
    frames(env, 3)
    assert np.hypot(*(env.unwrapped.vehicle.position - start)) > 20
    env = shielded("merge-v1", 3)
    frames(env, 3)
    assert env.unwrapped.vehicle.position[0] > 250


def test_what_is_taken_instead_is_verified_too():
    tiers = {decision.tier for seed in range(3) for _, decision, _ in frames(shielded("roundabout-v1", seed), 3)}
    assert {Tier.PASSED, Tier.GOVERNED} <= tiers


def test_both_doors_decide_alike():
    """`Shield` filters the frames as `ShieldedEnv` does."""
    driven = []
    for door in ("env", "policy"):
        env = gym.make("roundabout-v1")
        if door == "env":
            env = ShieldedEnv(env)
        policy = Always(3) if door == "env" else Shield(Always(3), env)
        obs, _ = env.reset(seed=5)
        for _ in range(5):
            obs, *_ = env.step(policy.predict(obs)[0])
        driven.append(env.unwrapped.vehicle.position.tolist())
    assert driven[0] == driven[1]


class Always:
    """A policy of one action."""

    def __init__(self, action):
        self.action = action

    def predict(self, obs, *_, **__):
        return self.action, None


def test_a_scene_that_cannot_be_read_is_braked_in():
    env = shielded("roundabout-v1", 0)
    env.step(1)
    env.unwrapped.road.vehicles[-1].speed, ego = np.nan, env.unwrapped.vehicle
    decision = env._door.decide(1)
    assert decision.reason is Reason.BAD_SCENE
    assert decision.tier is Tier.EMERGENCY
    assert "not finite" in env._door.cause
    command, decision = env._door.frame()
    assert command["acceleration"] == -min(9.8, 15 * ego.speed)
    assert decision.tier is Tier.EMERGENCY


def test_an_action_that_is_none_is_replaced():
    env = shielded("roundabout-v1", 0)
    info = env.step(17)[-1]
    assert info["shield"]["reason"] == Reason.BAD_ACTION


def test_masks_are_what_passes():
    env = shielded("roundabout-v1", 2)
    for _ in range(4):
        mask = env.action_masks()
        assert mask.shape == (5,)
        assert mask.any()
        wanted = int(np.flatnonzero(mask)[0])
        *_, terminated, truncated, info = env.step(wanted)
        if mask.sum() < 5:
            assert info["shield"]["tier"] == Tier.PASSED
        if terminated or truncated:
            break


def test_settings_for_its_traffic_are_the_default():
    """Those of intersections accelerate harder, and the settings say so."""
    assert isinstance(shielded("roundabout-v1")._door, RoadDoor)
    assert shielded("intersection-v0").config == ShieldConfig.for_roads(6.0)
    assert shielded("roundabout-v1").config.assumptions.looks_ahead
    assert ShieldConfig.profile("roads") == ShieldConfig.for_roads()
