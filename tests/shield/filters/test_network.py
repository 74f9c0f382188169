"""The certificate on road networks, against vehicles that are driven in real highway-env."""

from __future__ import annotations

from copy import copy

import gymnasium as gym
import highway_env  # noqa: F401
import numpy as np
import pytest
from highway_env.vehicle.kinematics import Vehicle
from input_scenes import gap
from placed import Body, placed
from slowly import later
from typer.testing import CliRunner

from evaluation.commands.cli import app
from evaluation.falsification.network_adversaries import install_drivers
from evaluation.falsification.network_attack import attack, record_blameless_crash
from evaluation.settings import Setting
from shield import Shield, ShieldConfig, ShieldedEnv
from shield.certificate.network.monitor import NetworkRule
from shield.decision import Reason, Tier
from shield.errors import ConfigError
from shield.filters.network import _OF_A_DECISION, NetworkFilter

ROADS = ("roundabout-v1", "merge-v1", "exit-v0", "two-way-v0", "u-turn-v1", "intersection-v2")
STEPS = 15


def shielded(env_id, seed=0, wild=0, config="worst-case", drivers="wild"):
    """A reset environment; so many of the others are driven against the certificate."""
    env = ShieldedEnv(gym.make(env_id), config)
    env.reset(seed=seed)
    env.action_space.seed(seed)
    install_drivers(env, drivers, wild, seed)
    return env


def frames(env, action=None):
    """Drive an episode; before each decided frame yield the true clearance [m] and the filter."""
    seen, network_filter, base = [], env._filter, env.unwrapped
    ask = network_filter.frame

    def frame():
        command, decision = ask()
        seen.append((gap(base, env.config.buffer, base.vehicle), decision, copy(network_filter.watch.by_rule)))
        return command, decision

    network_filter.frame = frame
    for _ in range(STEPS):
        *_, terminated, truncated, _ = env.step(env.action_space.sample() if action is None else action)
        if terminated or truncated:
            break
    network_filter.frame = ask
    return seen


@pytest.mark.parametrize("env_id", ROADS)
@pytest.mark.parametrize(
    ("seed", "drivers"),
    [(0, "wild"), *later((1, "wild")), (2, "bold"), (3, "mixed")],
)
def test_any_behaviour_is_a_violation_or_leaves_the_plan_clear(env_id, seed, drivers):
    """A plan verified a frame before stays clear of every vehicle without a violation. No prediction mismatch
    occurs, and the ego is hit only after a violation."""
    env = shielded(env_id, seed, wild=6, drivers=drivers)
    seen = frames(env)
    watch = env._filter.watch
    assert NetworkRule.UNFORESEEN not in watch.by_rule
    assert not env.unwrapped.vehicle.crashed or watch.count > 0
    for _, decision, _ in seen:
        assert decision.tier is not Tier.EMERGENCY
        assert decision.tier.verified == (decision.margin >= -1e-6)


@pytest.mark.parametrize("env_id", ["roundabout-v1", "merge-v1", "intersection-v2"])
@pytest.mark.parametrize("drivers", ["wild", "bold"])
@pytest.mark.parametrize("seed", [0, *later(1, 2)])
def test_any_behaviour_is_a_violation_or_harmless_with_right_of_way(env_id, drivers, seed):
    """A vehicle that breaks the right of way is named; one that waits as late as permitted does not come into the
    way."""
    env = shielded(env_id, seed, 8, ShieldConfig.for_roads(6.0, env_id != "merge-v1", True), drivers)
    frames(env)
    by_rule = env.filter.by_rule
    assert NetworkRule.UNFORESEEN not in by_rule
    assert not env.unwrapped.vehicle.crashed or by_rule
    assert drivers == "wild" or NetworkRule.RIGHT_OF_WAY not in by_rule


@pytest.mark.parametrize("waits", [True, False])
def test_a_vehicle_that_has_to_wait_and_does_not_is_a_violator(waits):
    """The ego drives round the ring; a vehicle approaches, and brakes when it must, or never."""
    env = ShieldedEnv(gym.make("roundabout-v1"), ShieldConfig.for_roads(gives_way=True))
    env.reset(seed=0)
    base = env.unwrapped
    ego, road = base.vehicle, base.road
    ring, entry = road.network.get_lane(("se", "ex", 0)), road.network.get_lane(("eer", "ees", 0))
    ego.position, ego.heading, ego.speed = ring.position(2.0, 0.0), ring.heading_at(2.0), 8.0
    ego.lane_index = ego.target_lane_index = ("se", "ex", 0)
    ego.lane, ego.route = ring, None
    comes = Comes(road, entry.position(112.0, 0.0), entry.heading_at(0.0), 8.0)
    comes.filter, comes.waits = env.filter, waits
    road.vehicles = [ego, comes]
    env.filter.reset()
    for _ in range(4):
        env.step(1)
    assert (env.filter.by_rule.get(NetworkRule.RIGHT_OF_WAY, 0) > 0) != waits
    assert NetworkRule.UNFORESEEN not in env.filter.by_rule
    assert not ego.crashed or not waits


class Comes(Vehicle):
    """Straight on at constant speed, and where it `waits` braking when it must."""

    def act(self, action=None):
        brakes = self.waits and self.filter.counts_on(self)
        super().act({"acceleration": max(-6.0, -15 * self.speed) if brakes else 0.0, "steering": 0.0})


@pytest.mark.parametrize("env_id", ROADS)
@pytest.mark.parametrize("seed", [0, *later(1, 2)])
def test_the_ego_is_hit_or_off_the_road_only_after_a_violation(env_id, seed):
    env = shielded(env_id, seed)
    frames(env)
    ego = env.unwrapped.vehicle
    assert (ego.on_road and not ego.crashed) or env._filter.watch.count > 0


@pytest.mark.parametrize("env_id", ROADS)
def test_the_driven_path_is_the_verified_path(env_id):
    """To the bit, whatever other vehicles are there."""
    env = shielded(env_id, 1)
    network_filter, ego, expected, ask = env._filter, env.unwrapped.vehicle, [], env._filter.frame

    def frame():
        now = [*ego.position, ego.heading, ego.speed]
        if expected:
            assert now == expected
        answer = ask()
        expected[:] = network_filter._rollout.path[1].tolist()
        return answer

    network_filter.frame = frame
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


@pytest.mark.parametrize("action", [3, None])
def test_the_ego_reaches_the_end_of_the_road(action):
    """merge-v1 has no time limit: it ends with the road."""
    for seed in (6002, 6012):
        env = shielded("merge-v1", seed)
        ended = (any(env.step(env.action_space.sample() if action is None else action)[2:4]) for _ in range(60))
        assert any(ended)


def test_a_replacement_on_a_network_is_verified():
    tiers = {decision.tier for seed in range(3) for _, decision, _ in frames(shielded("roundabout-v1", seed), 3)}
    assert {Tier.PASSED, Tier.GOVERNED} <= tiers


def test_both_wrappers_decide_alike_on_a_network():
    """`Shield` filters the frames as `ShieldedEnv` does."""
    driven = []
    for placement in ("env", "policy"):
        env = gym.make("roundabout-v1")
        if placement == "env":
            env = ShieldedEnv(env, "worst-case")
        policy = Always(3) if placement == "env" else Shield(Always(3), env, "worst-case")
        obs, _ = env.reset(seed=5)
        for _ in range(5):
            obs, *_ = env.step(policy.predict(obs)[0])
        driven.append(env.unwrapped.vehicle.position.tolist())
    assert driven[0] == driven[1]


@pytest.mark.parametrize(
    ("env_id", "seed", "drivers"),
    [
        ("two-way-v0", 125, "bold"),
        ("u-turn-v1", 111, "bold"),
        ("roundabout-v1", 131, "mixed"),
        ("intersection-v2", 128, "mixed"),
        ("roundabout-v1", 241, "bold"),
    ],
)
def test_loopholes_found_by_attacks_are_closed(env_id, seed, drivers):
    found = attack(Setting(env_id, env_id), seed, drivers)
    assert not found.unforeseen
    assert found.frames > 0


@pytest.mark.parametrize("env_id", ["roundabout-v0", "intersection-v0", "merge-v0"])
def test_a_coming_push_by_highway_env_does_not_change_the_judgement(env_id):
    """highway-env pushes the ego in the coming frame; the judgement of the other vehicles' past motion stays the
    same."""
    kept = []
    for impact in (None, np.array([0.4, -0.5])):
        env = ShieldedEnv(gym.make(env_id), "worst-case")
        env.reset(seed=3)
        for _ in range(2):
            env.step(1)
        env.unwrapped.vehicle.impact = impact
        env.filter.frame()
        kept.append(list(env.filter.kept.values()))
    assert kept[0] == kept[1]
    assert np.isfinite(kept[0]).any()


def test_no_guarantee_is_given_before_a_plan_verifies():
    """Too near to a vehicle at the reset, at more than twice its speed, on a single lane."""
    entry = ("ser", "ses", 0)
    env = placed("roundabout-v1", "worst case", Body(entry, 80.0, 20.0, "nxs"), [Body(entry, 90.0, 8.0, "nxs")])
    blameless, done = record_blameless_crash(env.unwrapped, env.filter), False
    while not done:
        *_, terminated, truncated, info = env.step(1)
        done = terminated or truncated
    del env.filter.frame
    assert info["crashed"]
    assert blameless == [False]


def test_an_attack_refuses_settings_that_it_cannot_drive():
    with pytest.raises(ConfigError, match="have wild, bold, mixed"):
        attack(Setting("merge", "merge-v1"), 0, "tame")
    with pytest.raises(ConfigError, match="no road network with meta-actions"):
        attack(Setting("highway", "highway-fast-v0"), 0, "wild")


def test_the_attack_command_prints_a_row_for_its_setting():
    result = CliRunner().invoke(app, ["attack", "--setting", "merge", "--episodes", "1", "--jobs", "1"])
    assert result.exit_code == 0, result.output
    assert "merge" in result.output


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
    decision = env._filter.decide(1)
    assert decision.reason is Reason.BAD_SCENE
    assert decision.tier is Tier.EMERGENCY
    assert "not finite" in env._filter.cause
    command, decision = env._filter.frame()
    assert command["acceleration"] == -min(9.8, 15 * ego.speed)
    assert decision.tier is Tier.EMERGENCY


def test_an_action_that_is_none_is_replaced():
    env = shielded("roundabout-v1", 0)
    info = env.step(17)[-1]
    assert info["shield"]["reason"] == Reason.BAD_ACTION


def test_masks_on_a_network_hold_the_actions_that_pass():
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


def test_masks_restore_attributes_that_exist():
    env = shielded("roundabout-v1", 2)
    env.step(1)
    assert vars(env.filter).keys() >= set(_OF_A_DECISION)


def test_the_worst_case_has_the_settings_for_its_traffic():
    """Those of intersections accelerate harder, and the settings say so."""
    assert isinstance(shielded("roundabout-v1")._filter, NetworkFilter)
    assert shielded("intersection-v0").config == ShieldConfig.for_roads(6.0)
    assert shielded("roundabout-v1").config.assumptions.considers_connected_lanes
    assert ShieldConfig.profile("roads") == ShieldConfig.for_roads()
