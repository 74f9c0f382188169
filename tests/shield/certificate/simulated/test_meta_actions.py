"""Verification by simulation: a verified plan is clear in highway-env itself, and no plan exists where none was
found."""

from __future__ import annotations

from copy import deepcopy

import gymnasium as gym
import highway_env  # noqa: F401
import numpy as np
import pytest
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.objects import Obstacle
from plans import least_clearance
from policies import Always
from slowly import later

from dynamics.highway_simulator.env import CompiledHighwayEnv
from dynamics.highway_simulator.simulator import Simulator
from dynamics.highway_simulator.step_kernels import write_rows
from dynamics.traffic.assumptions import Assumptions
from evaluation.measuring.rectangles import separation
from evaluation.running.batch_episodes import Many
from evaluation.running.certify import COLUMNS, FALLBACKS
from evaluation.running.episodes import run_paired
from evaluation.running.records import variant_for
from evaluation.settings import Setting, get_setting
from shield import ConfigError, Reason, Shield, ShieldConfig, ShieldedEnv
from shield.batch.arrays import empty_records
from shield.batch.codes import TIERS
from shield.batch.highways import ShieldedHighways
from shield.certificate.simulated.decision_kernels import empty_plans, has_no_certificate, try_proposal
from shield.certificate.simulated.highways import SimulatedHighways
from shield.certificate.simulated.search import find_sequence, set_root_scene
from shield.certificate.simulated.workspace import new_search
from shield.config import Buffer
from shield.decision import Tier
from shield.rules import RssRule

BOXED = {"vehicles_density": 2.0, "duration": 15}
DENSE = {"vehicles_density": 1.6, "duration": 15}
EXACT = ShieldConfig.simulated_traffic()


def shielded(env, config=EXACT, action=3):
    policy = Always(action)
    return policy, Shield(policy, env, config, frames=False)


@pytest.mark.parametrize("simulator", ["highway-env", "compiled"])
@pytest.mark.parametrize(
    ("setting", "policy", "count"),
    [
        (get_setting("highway-fast"), "faster", 3),
        (get_setting("highway-fast"), "random", 3),
        (get_setting("highway-fast"), "ppo-highway-fast", 3),
        (Setting("dense", "highway-fast-v0", DENSE), "random", 3),
        (get_setting("abz-idm"), "dqn-abz-adversarial", 1),
        *later((get_setting("highway-fast"), "faster", 20), (Setting("dense", "highway-fast-v0", DENSE), "random", 20)),
    ],
)
def test_many_environments_decide_as_one_in_highway_env(setting, policy, count, simulator):
    seeds = range(500, 500 + count)
    alone = run_paired(setting, policy, [variant_for(EXACT)], seeds, simulator=simulator)
    assert alone["violations"].sum() == 0
    alone = alone[list(COLUMNS)].assign(fallbacks=alone[FALLBACKS].sum(axis=1))
    together = Many(setting, policy, EXACT, envs=3).run(seeds)
    for name in ("return", "steps", "crashed", "overridden", "frames_overridden", "min_margin", "fallbacks"):
        assert np.array_equal(alone[name].astype(float), together[name].astype(float), equal_nan=True), name
    assert together["overridden"].sum() > 0


@pytest.mark.parametrize(
    ("policy", "seed"), [("faster", 20_019_938), ("faster", 20_023_701), ("ppo-highway-fast", 22_063_126)]
)
def test_a_vehicle_that_keeps_abreast_is_predicted_in_time(policy, seed):
    """It stays beside the ego at its slowest speed, and the leader is slower than that. A horizon of 20 s predicts
    it too late."""
    short = EXACT.replace(horizon=20.0)
    assert Many(get_setting("highway-fast"), policy, short, envs=1).run([seed])["crashed"].all()
    assert not Many(get_setting("highway-fast"), policy, EXACT, envs=1).run([seed])["crashed"].any()


@pytest.mark.parametrize("seed", [0, *later(1, 2, 3)])
def test_a_verified_plan_is_clear_in_highway_env(seed):
    """The plan of every second such decision is driven in a copy of highway-env; no vehicle comes into the buffer."""
    env = gym.make("highway-fast-v0", config=DENSE).unwrapped
    obs, _ = env.reset(seed=700 + seed)
    policy, shield = shielded(env)
    rng, verified, done = np.random.default_rng(seed), 0, False
    while not done:
        policy.action = int(rng.integers(5))
        action = int(shield.predict(obs)[0])
        decision, plans = shield.last_decision, shield._filters[0]._plans
        verified += decision.tier.verified
        if decision.tier.verified and verified % 2:
            copy = deepcopy(env)
            # The end of the episode is put off: the road goes on.
            copy.config["duration"] = 1000
            then = plans.actions[0, : plans.length[0]].tolist()
            assert least_clearance(copy, [action, *then], EXACT.buffer) >= decision.margin - 1e-9 >= -1e-9
        obs, _, terminated, truncated, _ = env.step(action)
        done = terminated or truncated
    assert verified > 8


@pytest.mark.parametrize(
    ("seed", "buffer"), [(s, b) for s in (0, 16, 17, 38) for b in (Buffer(0.0, 0.0), Buffer(4.0, 0.5))]
)
def test_a_sequence_is_found_where_one_exists(seed, buffer):
    """Against all sequences of four actions. From seeds 16, 17 and 38 the first candidate ends."""
    config = EXACT.replace(horizon=4.0, buffer=buffer)
    simulator = Simulator("highway-fast-v0", 1, {"vehicles_density": 1.6})
    simulator.reset([900 + seed])
    search, plans = new_search(simulator, config), empty_plans(1, 4)
    bodies = np.zeros((simulator.scenario.bodies, 7))
    for _ in range(1 + seed % 4):
        simulator.step([3])
    for first in range(5):
        set_root_scene(search, simulator.worlds, 0)
        margin, exhausted = find_sequence(search, first, plans.actions[0], 0)
        there = goes_on(simulator, first, 4, buffer, bodies)
        assert margin >= 0 or not there or exhausted
        assert margin == -np.inf or (margin >= 0 and there)


def goes_on(simulator, action, decisions, buffer, rows):
    """Whether some sequence of so many decisions that begins with an action keeps the buffer, frame by frame."""
    before = [array.copy() for array in simulator.worlds]
    try:
        if not kept(simulator, action, buffer, rows):
            return False
        return decisions == 1 or any(goes_on(simulator, then, decisions - 1, buffer, rows) for then in range(5))
    finally:
        restore(simulator.worlds, before)


def kept(simulator, action, buffer, rows):
    """Whether a decision keeps the buffer, frame by frame."""
    simulator.begin(action)
    for _ in range(simulator.scenario.rules.numbers[0]):
        simulator.frame(rows)
        ego = rows[0].copy()
        ego[4:6] += 2 * buffer.longitudinal, 2 * buffer.lateral
        near = rows[1:][np.abs(rows[1:, 0] - ego[0]) < 30]
        if ego[6] or any(separation(ego[:6], row[:6]) <= 0 for row in near):
            return False
    return True


def restore(arrays, before):
    for array, saved in zip(arrays, before, strict=True):
        array[:] = saved


@pytest.mark.parametrize("seed", [60, 78, 149, 212, 257, 329, 385])
def test_every_verified_plan_is_clear_until_the_horizon(seed):
    """On these seeds some plans nearest to the proposal for 8 s are not clear, or none exists."""
    highways, tiers, done = SimulatedHighways("highway-fast-v0", 1, DENSE), [], False
    simulator, rows = highways.simulator, np.zeros((highways.simulator.scenario.bodies, 7))
    highways.reset([seed])
    while not done:
        *_, terminated, truncated = highways.step([3])
        done = terminated[0] or truncated[0]
        tiers.append(TIERS[highways.records.tier[0]])
        if tiers[-1].verified and not done:
            before = [array.copy() for array in simulator.worlds]
            then = highways.plans.actions[0, : highways.plans.length[0]]
            assert all(kept(simulator, action, EXACT.buffer, rows) for action in then)
            restore(simulator.worlds, before)
    assert any(tier.verified for tier in tiers) != (seed in (149, 329))


@pytest.mark.parametrize("seed", [614, 920, 1442])
def test_the_mask_holds_the_actions_that_pass(seed):
    """At each decision of an episode in which no plan keeps the buffer for a time. The search then requires less; on
    these seeds requiring more would find more."""
    shielded = ShieldedEnv(CompiledHighwayEnv("highway-fast-v0", BOXED), EXACT)
    shielded.reset(seed=seed)
    action_filter, rng, boxes, done = shielded._filter, np.random.default_rng(seed), 0, False
    while not done:
        mask, (simulator, search) = shielded.action_masks(), action_filter._read()
        boxes += has_no_certificate(action_filter._plans, 0)
        found = []
        for action in range(5):
            before = [array.copy() for array in action_filter._plans]
            found.append(try_proposal(search, action_filter._plans, empty_records(1, 1), simulator.worlds, 0, action))
            restore(action_filter._plans, before)
        assert mask.tolist() == (found if any(found) else [True] * 5)
        *_, terminated, truncated, _ = shielded.step(int(rng.integers(5)))
        done = terminated or truncated
    assert boxes


@pytest.mark.parametrize("seed", [436, 586, 890])
def test_a_dead_end_is_not_searched_again(seed):
    """On these seeds the budget would be spent on one dead end if it were entered again and again; no plan that
    keeps the buffer would be found."""
    highways, rng, done = SimulatedHighways("highway-fast-v0", 1, BOXED), np.random.default_rng(seed), False
    highways.reset([seed])
    while not done:
        *_, terminated, truncated = highways.step([int(rng.integers(5))])
        done = terminated[0] or truncated[0]
        assert TIERS[highways.records.tier[0]].verified


def test_the_shielded_ego_drives_and_does_not_crash_in_simulated_traffic():
    found = Many(get_setting("highway-fast"), "faster", EXACT).run(range(100))
    assert found["crashed"].sum() == 0
    assert found["return"].mean() > 28.0


def test_the_policy_s_order_is_followed():
    """Of the alternatives that verify, the policy's preferred one is executed."""
    highways = SimulatedHighways("highway-fast-v0", 1, DENSE)
    taken = {}
    for name, order in (("left", [0, 2, 1, 4, -1]), ("slow", [4, 1, 2, 0, -1])):
        actions = []
        for seed in range(20):
            highways.reset([seed])
            for _ in range(8):
                highways.step([3], np.array([order]))
                if highways.records.tier[0] != 1:
                    actions.append(int(highways.records.executed[0]))
        taken[name] = actions
    assert taken["left"].count(0) > taken["slow"].count(0)
    assert taken["slow"].count(4) > taken["left"].count(4)


def test_an_obstacle_is_seen():
    env = gym.make("highway-fast-v0", config={"vehicles_count": 3}).unwrapped
    obs, _ = env.reset(seed=5)
    ego = env.vehicle
    for lane in range(3):
        at = env.road.network.get_lane(("0", "1", lane)).position(ego.position[0] + 150.0, 0)
        if lane != ego.lane_index[2]:
            env.road.objects.append(Obstacle(env.road, at))
    wall = env.road.network.get_lane(ego.lane_index).position(ego.position[0] + 90.0, 0)
    env.road.objects.append(Obstacle(env.road, wall))
    _, shield = shielded(env)
    executed = []
    for _ in range(3):
        executed.append(int(shield.predict(obs)[0]))
        obs = env.step(executed[-1])[0]
    assert shield.statistics.overridden > 0
    assert not ego.crashed


def test_a_prediction_mismatch_is_counted():
    """Once, and with the step in which it did so: before the next decision, which may never come."""
    env = gym.make("highway-fast-v0").unwrapped
    obs, _ = env.reset(seed=8)
    _, shield = shielded(env)
    obs = env.step(int(shield.predict(obs)[0]))[0]
    shield.predict(obs)
    assert shield.report()["violations"] == 0
    obs = env.step(int(shield.last_decision.executed))[0]
    env.road.vehicles[4].speed += 0.5
    for _ in range(2):
        assert shield.report()["violations"] == 1
    shield.predict(obs)
    assert shield.report()["violations"] == 0
    assert shield.statistics.violations == 1


def test_another_action_than_the_shield_s_is_no_violation_of_the_traffic():
    env = gym.make("highway-fast-v0").unwrapped
    obs, _ = env.reset(seed=8)
    _, shield = shielded(env)
    shield.predict(obs)
    obs = env.step(4)[0]
    shield.predict(obs)
    assert shield.report()["violations"] == 0


@pytest.mark.parametrize("planned", [True, False])
def test_a_scene_that_cannot_be_read_is_answered_with_the_stored_plan(planned):
    env = gym.make("highway-fast-v0").unwrapped
    obs, _ = env.reset(seed=9)
    _, shield = shielded(env)
    if planned:
        obs = env.step(int(shield.predict(obs)[0]))[0]
        stored = int(shield._filters[0]._plans.actions[0, 0])
    env.road.vehicles[3].position[0] = np.nan
    executed = int(shield.predict(obs)[0])
    assert shield.last_decision.reason is Reason.BAD_SCENE
    assert shield.last_decision.tier is (Tier.STORED_PLAN if planned else Tier.EMERGENCY)
    assert executed == (stored if planned else 4)


@pytest.mark.parametrize("action", [7, -1, float("nan")])
def test_an_invalid_action_is_answered_with_the_stored_plan(action):
    env = CompiledHighwayEnv("highway-fast-v0")
    obs, _ = env.reset(seed=9)
    policy, shield = shielded(env)
    obs = env.step(int(shield.predict(obs)[0]))[0]
    policy.action = action
    shield.predict(obs)
    assert shield.last_decision.tier is Tier.STORED_PLAN
    assert shield.last_decision.reason in (Reason.BAD_ACTION, Reason.POLICY_FAILED)


LIDAR = {"type": "LidarObservation"}
IMAGES = {"type": "GrayscaleObservation", "observation_shape": (32, 16), "stack_size": 2, "weights": [0.3, 0.6, 0.1]}


@pytest.mark.parametrize("observation", [LIDAR, IMAGES], ids=["lidar", "images"])
@pytest.mark.parametrize("env_id", ["highway-fast-v0", "roundabout-v1"])
def test_the_observation_type_changes_no_decision(observation, env_id):
    seen = []
    for config in ({}, {"observation": observation, "offscreen_rendering": True}):
        env = ShieldedEnv(gym.make(env_id, config=config), EXACT)
        env.reset(seed=4)
        seen.append([])
        for _ in range(10):
            *_, terminated, _, _ = env.step(3)
            decision = env.last_decision
            assert decision.reason in (Reason.NONE, Reason.UNVERIFIED)
            seen[-1].append((decision.executed, decision.margin, decision.tier, terminated))
            if terminated:
                break
    assert seen[0] == seen[1]


class Stranger(IDMVehicle):
    """Drives in a way of its own."""

    def act(self, action=None):
        super().act(action)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ShieldedEnv(gym.make("highway-fast-v0"), EXACT, rule=RssRule(EXACT)), "leave rule and model out"),
        (lambda: ShieldedHighways("highway-fast-v0", 1, None, EXACT), "by simulation"),
        (lambda: shielded(gym.make("highway-fast-v0"), EXACT.replace(mode="rss")), "mode = 'full'"),
        (
            lambda: shielded(gym.make("parking-v0", config={"action": {"type": "DiscreteMetaAction"}})),
            "in a parking lot the shield filters ContinuousAction only",
        ),
        (lambda: SimulatedHighways("highway-fast-v0", 1, None, ShieldConfig()), "Assumptions.simulated_traffic"),
        (
            lambda: shielded(gym.make("highway-v0", config={"other_vehicles_type": f"{__name__}.Stranger"})),
            "Stranger",
        ),
        (
            lambda: Shield(
                Always(3), gym.make("highway-fast-v0", config={"action": {"type": "ContinuousAction"}}), EXACT, False
            ),
            "at every frame",
        ),
    ],
)
def test_an_environment_that_cannot_be_simulated_is_refused(make, message):
    with pytest.raises(ConfigError, match=message):
        make()


def test_settings_go_through_toml():
    assert ShieldConfig.from_toml(EXACT.to_toml()) == EXACT
    assert ShieldConfig.from_toml('assumptions = "simulated"').assumptions == Assumptions.simulated_traffic()


def test_the_search_does_not_change_the_present_state():
    highways = SimulatedHighways("highway-fast-v0", 1)
    highways.reset([3])
    rows = np.zeros((highways.simulator.scenario.bodies, 7))
    write_rows(highways.worlds, highways.simulator.scenario.rules, 0, rows)
    search, plans = new_search(highways.simulator, EXACT), empty_plans(1, 20)
    set_root_scene(search, highways.worlds, 0)
    find_sequence(search, 3, plans.actions[0], 0)
    after = rows.copy()
    write_rows(highways.worlds, highways.simulator.scenario.rules, 0, after)
    assert np.array_equal(rows, after)
