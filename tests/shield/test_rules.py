"""The distance rules: the formulas by hand and by simulation, and each rule on scenes built by hand."""

from collections import Counter

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.roads.straight import StraightRoad
from dynamics.scenes.scene import EgoControl, Scene, SceneReader, Target
from dynamics.traffic.assumptions import Assumptions
from shield import Shield, ShieldConfig, ShieldedEnv
from shield.decision import Reason, Tier
from shield.errors import ConfigError
from shield.rules import (
    BufferRule,
    DistanceRule,
    RssRule,
    TtcRule,
    make_rule,
    rss_gap,
    rss_lateral_gap,
)

LIMITS = settings(deadline=None, max_examples=100, derandomize=True)
LEFT, KEEP, RIGHT = Target(0, 25.0), Target(1, 25.0), Target(2, 25.0)
FASTER, SLOWER = Target(1, 30.0), Target(1, 20.0)


def scene_of(*others, speed=25.0, lane=1, lanes=3, heading=0.0):
    """The ego at s = 100 m in `lane`; others as (s ahead of the ego, lane, speed)."""
    road = StraightRoad.from_lanes(lanes)
    ego = np.array([100.0, 4.0 * lane, heading, speed, 5.0, 2.0, 0.0])
    rows = [[100.0 + ds, 4.0 * at, 0.0, v, 5.0, 2.0, 0.0] for ds, at, v in others]
    return Scene(ego, np.array(rows).reshape(-1, 7), road, EgoControl(Target(lane, 25.0)), 1 / 15, 15)


# -- formulas ------------------------------------------------------------------------------------------------


def test_rss_gap_by_hand():
    # 30 * 0.5 + 0.5 * 2 * 0.25 + 31^2 / 12 - 20^2 / 16 = 15 + 0.25 + 80.0833 - 25
    gap = rss_gap(np.array([30.0]), np.array([20.0]), 0.5, 2.0, 6.0, 8.0)
    np.testing.assert_allclose(gap, [70.0 + 1 / 3])
    # No vehicle has to keep a distance to one that drives away.
    np.testing.assert_array_equal(rss_gap(np.array([5.0]), np.array([40.0]), 0.5, 0.0, 8.0, 8.0), [0.0])
    # A reversing vehicle counts as standing.
    np.testing.assert_array_equal(
        rss_gap(np.array([20.0]), np.array([-5.0]), 1.0, 0.0, 8.0, 8.0),
        rss_gap(np.array([20.0]), np.array([0.0]), 1.0, 0.0, 8.0, 8.0),
    )


@LIMITS
@given(
    st.floats(0, 40),
    st.floats(0, 40),
    st.floats(0, 2),
    st.floats(0, 4),
    st.floats(2, 8),
    st.floats(0, 4),
)
def test_rss_gap_is_just_enough_by_simulation(rear, front, response, acceleration, rear_braking, more):
    """With a leader that can brake at least as hard as the follower, as RSS has it."""
    front_braking = rear_braking + more
    gap = float(rss_gap(np.array([rear]), np.array([front]), response, acceleration, rear_braking, front_braking)[0])
    t = np.linspace(0, 60, 20_001)

    def braking(v, rate, since):
        u = np.clip(since, 0, v / rate)
        return v * u - 0.5 * rate * u**2

    early = np.minimum(t, response)
    x_rear = rear * early + 0.5 * acceleration * early**2
    x_rear = x_rear + braking(rear + acceleration * response, rear_braking, t - response)
    left = gap + braking(front, front_braking, t) - x_rear
    assert left.min() >= -1e-6
    if gap > 0:
        assert left.min() <= 1e-6  # one metre less would not have done


def test_rss_lateral_gap_of_vehicles_that_drive_apart_is_the_margin():
    zero = np.array([0.0])
    np.testing.assert_allclose(rss_lateral_gap(zero - 3, zero + 3, 0.5, 1.0, 2.0, 0.3), [0.3])


# -- rules on scenes built by hand ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("others", "target", "objects"),
    [
        ([], LEFT, False),
        ([(0, 0, 25)], LEFT, True),
        ([(0, 0, 25)], RIGHT, False),
        ([(0, 0, 25)], KEEP, False),
        ([(6.9, 0, 25)], LEFT, True),
        ([(7.1, 0, 25)], LEFT, False),
        ([(-6.9, 0, 25)], LEFT, True),
        ([(3, 1, 25)], FASTER, False),
    ],
)
def test_the_buffer_rule_looks_alongside_in_the_lane_that_is_entered(others, target, objects):
    assert BufferRule(2.0).objects(scene_of(*others), target) is objects


@pytest.mark.parametrize(
    ("others", "target", "objects"),
    [
        ([], LEFT, False),
        ([(14, 1, 25)], LEFT, True),
        ([(-14, 1, 25)], RIGHT, True),
        ([(14.4, 0, 25)], LEFT, True),  # sqrt(14.4^2 + 4^2) = 14.95
        ([(14.6, 0, 25)], LEFT, False),  # 15.14
        ([(10, 1, 25)], KEEP, False),
        ([(10, 1, 25)], FASTER, False),
    ],
)
def test_the_distance_rule_refuses_lane_changes_near_any_vehicle(others, target, objects):
    assert DistanceRule(15.0).objects(scene_of(*others), target) is objects


@pytest.mark.parametrize(
    ("others", "target", "objects"),
    [
        ([], FASTER, False),
        # Ego 25 m/s, leader standing: 0.5 * 25 + 25^2 / 16 = 51.6 m between bumpers.
        ([(56, 1, 0)], KEEP, True),
        ([(57, 1, 0)], KEEP, False),
        ([(57, 1, 0)], FASTER, True),
        ([(56, 0, 0)], KEEP, False),
        ([(56, 0, 0)], LEFT, True),
        ([(56, 0, 0)], RIGHT, False),
        # A follower at 40 m/s in the lane that is entered: 40 * 0.2 + 0.12 + 41.2^2 / 12 - 25^2 / 16 = 110.5 m.
        ([(-115, 0, 40)], LEFT, True),
        ([(-116, 0, 40)], LEFT, False),
        ([(-50, 1, 40)], KEEP, False),
        # Alongside in the lane that is entered.
        ([(0, 2, 25)], RIGHT, True),
        ([(0, 2, 25)], LEFT, False),
    ],
)
def test_the_rss_rule_requires_the_gaps_of_rss(others, target, objects):
    assert RssRule(ShieldConfig(braking=8.0)).objects(scene_of(*others), target) is objects


def test_the_rss_rule_is_stricter_under_worse_assumptions():
    scene = scene_of((-40, 0, 30))
    assert not RssRule(ShieldConfig()).objects(scene_of((-40, 0, 25)), LEFT)
    worst = ShieldConfig(assumptions=Assumptions.rss())
    assert RssRule(worst).objects(scene, LEFT)


@pytest.mark.parametrize(
    ("others", "target", "objects"),
    [
        ([], FASTER, False),
        ([(24, 1, 15)], KEEP, True),  # 19 m at 10 m/s
        ([(26, 1, 15)], KEEP, False),  # 21 m at 10 m/s
        ([(26, 1, 15)], FASTER, True),  # 21 m at 15 m/s
        ([(10, 1, 25)], KEEP, False),
        ([(10, 1, 35)], KEEP, False),
        ([(-14, 0, 30)], LEFT, True),  # 9 m at 5 m/s
        ([(-16, 0, 30)], LEFT, False),
        ([(-14, 1, 30)], KEEP, False),
        ([(3, 0, 25)], LEFT, True),  # alongside
        ([(3, 0, 25)], KEEP, False),
    ],
)
def test_the_ttc_rule_looks_at_the_lane_of_the_target(others, target, objects):
    assert TtcRule(2.0).objects(scene_of(*others), target) is objects


def test_rules_by_name():
    config = ShieldConfig(distance=12.0, time_to_collision=3.0)
    assert make_rule("distance", config) == DistanceRule(12.0)
    assert make_rule("rss", config) == RssRule(config)
    assert make_rule("ttc", config) == TtcRule(3.0)
    assert make_rule("ttc-ranking", config) == TtcRule(3.0)
    with pytest.raises(ConfigError, match="valid are 'distance', 'rss', 'ttc', 'ttc-ranking'"):
        make_rule("full", config)


# -- rules alone, in a real episode ----------------------------------------------------------------------------


class Playing:
    """Repeats a list of actions."""

    def __init__(self, actions):
        self.actions, self.calls = actions, 0

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        self.calls += 1
        return self.actions[(self.calls - 1) % len(self.actions)], state


PROPOSALS = {"distance": [0, 2], "rss": [3], "ttc": [3]}
SLOWER_ACTION = 4


@pytest.mark.parametrize("mode", ["distance", "rss", "ttc"])
def test_a_rule_alone_overrides_with_slower_and_says_so(mode):
    env = ShieldedEnv(gym.make("highway-fast-v0"), ShieldConfig(mode=mode))
    policy, reasons = Playing(PROPOSALS[mode]), []
    for seed in range(2):
        obs, _ = env.reset(seed=seed)
        done = False
        while not done:
            proposed, _ = policy.predict(obs)
            obs, _, terminated, truncated, info = env.step(proposed)
            done = terminated or truncated
            decision, record = env.last_decision, info["shield"]
            reasons.append(record["reason"])
            assert record["frames_overridden"] == 0
            assert decision.proposed == proposed
            if decision.overridden:
                assert (decision.executed, decision.tier) == (SLOWER_ACTION, Tier.ALTERNATIVE)
                assert decision.reason == Reason(mode)
            else:
                assert (decision.executed, decision.tier, decision.reason) == (proposed, Tier.PASSED, Reason.NONE)
    assert set(reasons) == {"none", mode}
    env.close()


@pytest.mark.parametrize("mode", ["distance", "rss", "ttc"])
def test_both_wrappers_agree_with_a_rule_alone(mode):
    def drive(shield):
        inner = gym.make("highway-fast-v0", config={"duration": 12})
        env = ShieldedEnv(inner, ShieldConfig(mode=mode)) if shield == "env" else inner
        policy = Playing(PROPOSALS[mode])
        if shield == "predict":
            policy = Shield(policy, env=env, config=ShieldConfig(mode=mode))
        obs, _ = env.reset(seed=4)
        rewards, done = [], False
        while not done:
            obs, reward, terminated, truncated, _ = env.step(policy.predict(obs)[0])
            rewards.append(reward)
            done = terminated or truncated
        env.close()
        return rewards, obs

    (rewards, obs), (others, other_obs) = drive("env"), drive("predict")
    assert rewards == others
    np.testing.assert_array_equal(obs, other_obs)


class Preferring:
    """Always proposes its first preference, and scores actions by its order."""

    def __init__(self, order):
        self.order = order

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return self.order[0], state

    def action_scores(self, observation):
        return np.array([-self.order.index(a) for a in range(5)], float)


@pytest.mark.parametrize("wrapped", ["env", "policy"])
@pytest.mark.parametrize("order", [[3, 2, 0, 1, 4], [3, 1, 4, 2, 0], [3, 4, 1, 2, 0]])
def test_the_first_action_of_the_ranking_that_the_rule_accepts_is_executed(order, wrapped):
    """The rule refuses every action that the policy prefers to the executed one, or SLOWER is executed."""
    config = ShieldConfig(mode="ttc-ranking", time_to_collision=4.0)
    env, policy, rule = gym.make("highway-fast-v0"), Preferring(order), make_rule("ttc", config)
    if wrapped == "env":
        env = ShieldedEnv(env, config, policy=policy)
        acts = lambda obs: policy.predict(obs)[0]  # noqa: E731
    else:
        shield = Shield(policy, env, config)
        acts = lambda obs: int(shield.predict(obs)[0])  # noqa: E731
    executed = Counter()
    for seed in range(4):
        obs, _ = env.reset(seed=seed)
        done = False
        while not done:
            scene = SceneReader(env.unwrapped).read()
            refused = [rule.objects(scene, scene.target_of(a)) for a in order]
            expected = order[refused.index(False)] if False in refused else SLOWER_ACTION
            action = acts(obs)
            obs, _, terminated, truncated, _ = env.step(action)
            done = terminated or truncated
            decision = env.last_decision if wrapped == "env" else shield.last_decision
            assert decision.executed == expected
            assert (decision.tier is Tier.PASSED) == (expected == order[0])
            executed[expected] += 1
    assert executed[order[0]] > 0
    assert executed[order[1]] > 0
    env.close()


def test_slower_replaces_a_refused_action_without_a_ranking():
    plain = ShieldedEnv(gym.make("highway-fast-v0"), ShieldConfig(mode="ttc"))
    ranked = ShieldedEnv(gym.make("highway-fast-v0"), ShieldConfig(mode="ttc-ranking"))
    for env in (plain, ranked):
        env.reset(seed=1)
    overridden, done = 0, False
    while not done:
        (obs, *one), (other, *two) = plain.step(3), ranked.step(3)
        assert np.array_equal(obs, other)
        assert one[:3] == two[:3]
        overridden += one[3]["shield"]["overridden"]
        done = one[1] or one[2]
    assert overridden > 0
