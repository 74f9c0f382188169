"""Throttle and steering verified by simulation, in highway-env itself."""

from __future__ import annotations

from copy import deepcopy

import gymnasium as gym
import highway_env  # noqa: F401
import numpy as np
import pytest
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.objects import Obstacle
from input_scenes import InputPair, gap, make_inputs, push
from network_pair import wild_scene
from policies import Always
from slowly import later

from shield import ConfigError, Reason, Shield, ShieldConfig, ShieldedEnv
from shield.certificate.simulated.input_verification import advance_backup
from shield.decision import Tier

EXACT = ShieldConfig.simulated_traffic()
ROADS = ["merge-v1", "roundabout-v1", "two-way-v0", "u-turn-v1", "intersection-v1", "highway-fast-v0", "racetrack-v0"]
MORE = [
    pytest.param(each, marks=pytest.mark.slow)
    for each in ("merge-generic-v1", "roundabout-generic-v0", "exit-v1", "intersection-v0", "racetrack-oval-v0")
]
STARTS = {"racetrack-oval-v0": 824}
"""Seeds of episodes in which the shield overrides each policy; 820 on all other roads."""
POLICIES = {
    "throttle": lambda k, rng: [1.0, 0.0],
    "random": lambda k, rng: rng.uniform(-1, 1, 2),
    "weave": lambda k, rng: [0.4, 0.15 * np.sin(k)],
}


def make(env_id):
    return make_inputs(env_id, dynamical=env_id == "intersection-v1")


def watched(env_id, seed, policy, decisions=25):
    """Drive behind the shield; yields, for each frame, the shield, the environment, the decision, and the gap after."""
    env = ShieldedEnv(make(env_id), EXACT)
    env.reset(seed=seed)
    base, rng, done = env.unwrapped, np.random.default_rng(seed), False
    advance = base.road.step
    for k in range(decisions):
        frames = []

        def step(dt, frames=frames):
            advance(dt)
            frames.append((env.frame_decisions[-1], gap(base, EXACT.buffer)))

        base.road.step = step
        *_, terminated, truncated, _ = env.step(np.array(POLICIES[policy](k, rng), np.float32))
        base.road.step = advance
        for decision, least in frames:
            yield env, base, decision, least
        done = terminated or truncated
        if done:
            break
    assert not base.vehicle.crashed


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("env_id", [*ROADS, *MORE])
def test_no_vehicle_comes_into_the_buffer_of_verified_inputs(env_id, policy):
    """For any proposal the ego stays on the road. After each verified frame the true rectangles are apart, and no
    prediction mismatch occurs."""
    tiers, shield = [], None
    for env, base, decision, least in watched(env_id, STARTS.get(env_id, 820), policy):
        tiers.append(decision.tier)
        shield = env
        # The ego included, to the last bit; a float32 error would show after some frames.
        assert not env._filter._scene.mismatched
        assert base.vehicle.on_road
        if decision.tier.verified:
            assert least >= -1e-9
    assert shield._filter.violations == 0
    assert Tier.PASSED in tiers
    assert Tier.GOVERNED in tiers or env_id == "exit-v1"


def test_a_frame_that_ends_inside_the_buffer_is_not_verified():
    """A vehicle just behind falls back: the scene after the frame is clear, the frame itself is not."""
    env = ShieldedEnv(make("highway-fast-v0"), EXACT)
    env.reset(seed=3)
    base, ego, seen = env.unwrapped, env.unwrapped.vehicle, []
    behind = next(vehicle for vehicle in base.road.vehicles if vehicle is not ego)
    base.road.vehicles = [ego, behind]
    behind.position = ego.position - [ego.LENGTH + 0.2, 0.0]
    behind.speed, behind.target_speed, behind.target_lane_index = ego.speed - 1.0, 20.0, ego.lane_index
    advance = base.road.step

    def step(dt):
        advance(dt)
        seen.append((env.frame_decisions[-1].tier.verified, gap(base, EXACT.buffer)))

    base.road.step = step
    for _ in range(2):
        env.step(np.array([0.2, 0.0], np.float32))
    assert seen[0][1] <= 0 < seen[-1][1]
    assert [verified for verified, _ in seen] == [least > 0 for _, least in seen]


@pytest.mark.parametrize("env_id", ["roundabout-v1", "highway-fast-v0", *later("intersection-v1", "two-way-v0")])
def test_the_stored_plan_stays_clear_until_the_horizon(env_id):
    """The plan stored with a frame is driven in a copy of highway-env."""
    tried = 0
    for n, (env, base, decision, _) in enumerate(watched(env_id, 830, "throttle", 8)):
        action_filter = env._filter
        if n % 37 or not decision.tier.verified or base.steps % action_filter._period:
            continue
        copy = deepcopy(base)
        present = action_filter._present._replace(futures=deepcopy(action_filter._present.futures))
        tail, inputs, tried = deepcopy(action_filter._tail), np.zeros(2), tried + 1
        for _ in range(int(tail.counts[0]) * present.rules.numbers[0]):
            advance_backup(present, tail, inputs)
            push(copy, inputs)
            assert copy.vehicle.on_road
            assert gap(copy, EXACT.buffer) >= -1e-9
            if hasattr(copy, "_clear_vehicles") and copy.steps % action_filter._period == 0:
                copy._clear_vehicles()
    assert tried


def driven_in_a_wild_scene(env_id, seed):
    """How many frames are driven from the first that verifies on: in each of them the buffer stays clear."""
    pair, rng = wild_scene(env_id, seed, InputPair)
    base, begun, driven = pair.env, False, 0
    if base.vehicle.crashed:
        return 0
    env, advance = ShieldedEnv(base, EXACT), base.road.step

    def step(dt):
        nonlocal begun, driven
        advance(dt)
        begun = begun or env.frame_decisions[-1].tier.verified
        if begun:
            driven += 1
            assert env.frame_decisions[-1].tier not in (Tier.LARGEST_MARGIN, Tier.EMERGENCY), pair.name
            assert gap(base, EXACT.buffer) >= -1e-9, pair.name

    base.road.step = step
    for _ in range(3):
        env.step(rng.uniform(-1, 1, 2).astype(np.float32))
    assert env._filter.violations == 0
    return driven


@pytest.mark.parametrize("env_id", ["merge-v1", "roundabout-v0", "u-turn-v1"])
def test_a_wild_scene_is_driven_clear(env_id):
    """Vehicles of other sizes and constants anywhere, with routes of their own, wrecks and obstacles."""
    assert sum(driven_in_a_wild_scene(env_id, seed) > 0 for seed in (401, 402)) > 0


@pytest.mark.slow
@pytest.mark.parametrize("env_id", ["merge-v1", "roundabout-v0", "u-turn-v1", "exit-v1", "merge-generic-v0"])
def test_a_hundred_wild_scenes_are_driven_clear(env_id):
    assert sum(driven_in_a_wild_scene(env_id, seed) > 0 for seed in range(6_000, 6_100)) > 10


def test_full_throttle_makes_progress():
    """It is not by standing still that nothing happens: with the wheel straight, as fast as its leader."""
    env = ShieldedEnv(make("highway-fast-v0"), EXACT)
    env.reset(seed=842)
    start = env.unwrapped.vehicle.position[0]
    for _ in range(20):
        *_, terminated, _, _ = env.step(np.array([1.0, 0.0], np.float32))
        assert not terminated
    assert env.unwrapped.vehicle.position[0] - start > 20 * 20


def test_the_wheel_alone_keeps_its_speed():
    """A policy without a throttle is given back the speed that the shield has taken."""
    env = ShieldedEnv(gym.make("racetrack-v0"), EXACT)
    env.reset(seed=3)
    speed, slowest, reasons = env.unwrapped.vehicle.speed, np.inf, set()
    for k in range(150):
        *_, terminated, truncated, _ = env.step(np.array([0.3 * np.sin(k / 3)], np.float32))
        slowest = min(slowest, env.unwrapped.vehicle.speed)
        reasons |= {d.reason for d in env.frame_decisions}
        assert not terminated
        if truncated:
            break
    if slowest < speed - 1.0:
        assert Reason.RESUME in reasons


def test_shield_and_shielded_env_drive_the_same():
    one, other = ShieldedEnv(make("roundabout-v1"), EXACT), make("roundabout-v1")
    shield = Shield(Always(np.array([1.0, 0.0], np.float32)), other, EXACT)
    one.reset(seed=5)
    obs, _ = other.reset(seed=5)
    for _ in range(6):
        one.step(np.array([1.0, 0.0], np.float32))
        other.step(shield.predict(obs)[0])
        assert np.array_equal(one.unwrapped.vehicle.position, other.unwrapped.vehicle.position)
        assert [d.tier for d in one.frame_decisions] == [d.tier for d in shield.frame_decisions[0]]


@pytest.mark.parametrize("action", [[np.nan, 0.0], [np.inf, 1.0], [0.1], "left", None, [[0.0, 0.0]], [1e300, 0.0]])
def test_an_invalid_input_is_replaced_in_simulated_traffic(action):
    env = ShieldedEnv(make("merge-v1"), EXACT)
    env.reset(seed=1)
    env.step(np.array([0.5, 0.0], np.float32))
    *_, info = env.step(action)
    read = env._filter.actuators.read(action)
    assert (info["shield"]["reason"] == "bad_action") == (read is None)
    assert not env.unwrapped.vehicle.crashed


def test_a_scene_that_cannot_be_read_is_braked_in():
    """A vehicle that drives in a way of its own comes, before there is a plan: brake; and after: play the plan on."""
    for first in (True, False):
        env = ShieldedEnv(make("merge-v1"), EXACT)
        env.reset(seed=1)
        base = env.unwrapped
        if not first:
            env.step(np.array([0.5, 0.0], np.float32))
        stranger = type("Stranger", (IDMVehicle,), {"act": lambda self, action=None: None})
        base.road.vehicles.append(stranger(base.road, [10.0, 0.0], 0.0, 10.0))
        speed = base.vehicle.speed
        *_, info = env.step(np.array([1.0, 0.0], np.float32))
        assert info["shield"]["reason"] == "bad_scene"
        assert env.frame_decisions[0].tier is (Tier.EMERGENCY if first else Tier.STORED_PLAN)
        assert "Stranger" in env._filter.cause
        assert base.vehicle.speed < speed
        # The plan stored for an earlier scene is not the fallback in a scene not seen since.
        base.road.vehicles.pop()
        env.step(np.array([np.nan, 0.0], np.float32))
        assert env.frame_decisions[0].tier is Tier.ALTERNATIVE


def test_a_prediction_mismatch_between_two_frames_is_counted():
    env = ShieldedEnv(make("roundabout-v1"), EXACT)
    env.reset(seed=2)
    base = env.unwrapped
    env.step(np.array([0.3, 0.0], np.float32))
    assert env._filter.violations == 0
    advance, frames = base.road.step, []

    def step(dt):
        advance(dt)
        frames.append(dt)
        if len(frames) == 4:
            base.road.vehicles[1].position = base.road.vehicles[1].position + 0.3

    base.road.step = step
    *_, info = env.step(np.array([0.3, 0.0], np.float32))
    assert info["shield"]["violations"] == env._filter.violations == 1


def test_a_stored_plan_is_dropped_after_a_prediction_mismatch():
    """A plan for another scene is not the fallback."""
    for moved in (False, True):
        env = ShieldedEnv(make("roundabout-v1"), EXACT)
        env.reset(seed=2)
        env.step(np.array([0.3, 0.0], np.float32))
        if moved:
            env.unwrapped.road.vehicles[1].position = env.unwrapped.road.vehicles[1].position + 0.3
        env.step(np.array([np.nan, 0.0], np.float32))
        assert (env.frame_decisions[0].tier is Tier.STORED_PLAN) == (not moved)
        assert env.frame_decisions[0].reason is Reason.BAD_ACTION


def test_the_braking_law_continues_after_highway_env_is_read_again():
    """Between any two decisions, also where one of its actions has just ended: the same lane and the same speed."""
    env = ShieldedEnv(
        gym.make("highway-v0", config={"action": {"type": "ContinuousAction"}, "policy_frequency": 5}), EXACT
    )
    env.reset(seed=3)
    action_filter, ended = env._filter, 0
    env.step(np.array([0.3, 0.0], np.float32))
    for _ in range(25):
        env.step(np.array([np.nan, 0.0], np.float32))
        before = action_filter._controller_state()
        ended += action_filter._tail.counts[1] == 0
        search, present = action_filter._read(True)
        assert search is action_filter._search
        assert present is action_filter._present
        assert action_filter._controller_state() == before
        assert before[0] == 1
    assert ended > 1


def test_an_obstacle_is_stopped_for():
    """On a single lane there is no way around it."""
    env = make("two-way-v0")
    shielded = ShieldedEnv(env, EXACT)
    shielded.reset(seed=0)
    base = shielded.unwrapped
    base.road.vehicles = [base.vehicle]
    for lane in (("a", "b", 1), ("b", "a", 0)):
        road = base.road.network.get_lane(lane)
        s = road.local_coordinates(base.vehicle.position)[0] + (120 if lane[0] == "a" else -120)
        base.road.objects.append(Obstacle(base.road, road.position(s, 0)))
    for _ in range(14):
        *_, terminated, _, _ = shielded.step(np.array([1.0, 0.0], np.float32))
        assert not terminated
    assert abs(base.vehicle.speed) < 3.0
    assert gap(base, EXACT.buffer) >= -1e-9


def test_the_recorded_plan_of_inputs_is_driven():
    env = ShieldedEnv(make("roundabout-v1"), EXACT.replace(record=True))
    env.reset(seed=7)
    base = env.unwrapped
    env.step(np.array([0.5, 0.02], np.float32))
    for _ in range(5):
        env.step(np.array([0.5, 0.02], np.float32))
        decision = env.frame_decisions[-1]
        if decision.plan is not None:
            ego = base.vehicle
            assert np.allclose(decision.plan[0], [*ego.position, ego.heading, ego.speed], atol=1e-9)
            return
    raise AssertionError("nothing was recorded")


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Shield(Always(np.zeros(2)), make("merge-v1"), EXACT, frames=False), "at every frame"),
        (
            lambda: ShieldedEnv(gym.make("parking-v0"), EXACT),
            r"ParkingEnv: leave ShieldConfig\.simulated_traffic",
        ),
        (
            lambda: Shield(Always(np.zeros(2)), gym.make("parking-v0"), EXACT),
            r"leave ShieldConfig\.simulated_traffic",
        ),
    ],
)
def test_inputs_that_cannot_be_simulated_are_refused(build, message):
    with pytest.raises(ConfigError, match=message):
        build()


@pytest.mark.parametrize("env_id", ["roundabout-v1", "highway-fast-v0"])
def test_meta_actions_pass_both_wrappers_alike(env_id):
    """`ShieldedEnv`, `Shield`, and `Shield` without frames make the same decisions; the mask holds the actions that
    pass."""
    one, two, three = (gym.make(env_id) for _ in range(3))
    shielded = ShieldedEnv(one, EXACT)
    shields = [Shield(Always(3), two, EXACT), Shield(Always(3), three, EXACT, frames=False)]
    shielded.reset(seed=4)
    observations = [env.reset(seed=4)[0] for env in (two, three)]
    for _ in range(8):
        mask = shielded.action_masks()
        _, _, terminated, _, info = shielded.step(3)
        assert mask[3] == (info["shield"]["tier"] == "passed") or not mask[:].any()
        for shield, env, obs in zip(shields, (two, three), observations, strict=True):
            env.step(shield.predict(obs)[0])
            assert np.array_equal(one.unwrapped.vehicle.position, env.unwrapped.vehicle.position)
        assert not terminated
    assert shielded._filter.violations == 0
    with pytest.raises(AttributeError, match="core"):
        _ = shielded.core
