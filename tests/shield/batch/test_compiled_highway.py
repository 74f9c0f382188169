"""The shield decides in the compiled highway as in highway-env: the same actions, margins and records, to the bit."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from dynamics.highway_simulator.env import CompiledHighwayEnv
from shield import ShieldConfig, ShieldedEnv

TRAFFIC = "highway_env.vehicle.behavior."
AGGRESSIVE = {"vehicles_count": 12, "duration": 6, "other_vehicles_type": TRAFFIC + "AggressiveVehicle"}
CONTINUOUS = {"action": {"type": "ContinuousAction"}, "policy_frequency": 5, "duration": 6}
HELD = {"action": {"type": "ContinuousAction"}, "simulation_frequency": 20, "policy_frequency": 5, "duration": 6}
ALONE_FAST = {**HELD, "vehicles_count": 0, "action": {"type": "ContinuousAction", "acceleration_range": [-5, 12]}}


def faster(rng):
    return 3


def anything(rng):
    return int(rng.integers(5))


def inputs(rng):
    return rng.uniform(-1, 1, 2).astype(np.float32)


def throttle(rng):
    return np.array([1.0, 0.0], np.float32)


@pytest.mark.parametrize(
    ("env_id", "config", "choose", "settings"),
    [
        ("highway-fast-v0", {"duration": 12}, faster, {}),
        ("highway-fast-v0", {"duration": 12}, anything, {}),
        ("highway-fast-v0", {"duration": 12}, anything, {"mode": "rss"}),
        ("highway-fast-v0", {"duration": 10}, faster, {"repair": "filter"}),
        ("highway-v0", AGGRESSIVE, anything, {}),
        ("highway-fast-v0", CONTINUOUS, inputs, {}),
        ("highway-fast-v0", HELD, inputs, {}),
        ("highway-v0", HELD, throttle, {}),
    ],
)
def test_every_step_is_the_same(env_id, config, choose, settings):
    shield = ShieldConfig(**settings)
    theirs = ShieldedEnv(gym.make(env_id, config=config), shield)
    mine = ShieldedEnv(CompiledHighwayEnv(env_id, config), shield)
    overridden = 0
    for seed in range(2):
        rng, done = np.random.default_rng(seed), False
        assert np.array_equal(theirs.reset(seed=seed)[0], mine.reset(seed=seed)[0])
        while not done:
            action = choose(rng)
            *one, info = theirs.step(action)
            *two, known = mine.step(action)
            assert np.array_equal(one[0], two[0])
            assert one[1:] == two[1:]
            margins = info["shield"].pop("margin"), known["shield"].pop("margin")
            assert np.array_equal(*margins, equal_nan=True)
            assert info["shield"] == known["shield"]
            assert np.array_equal(theirs.last_decision.executed, mine.last_decision.executed)
            for a, b in zip(theirs.frame_decisions, mine.frame_decisions, strict=True):
                assert (a.reason, a.tier, a.margin, a.clause, a.vehicle) == (
                    b.reason,
                    b.tier,
                    b.margin,
                    b.clause,
                    b.vehicle,
                )
                assert np.array_equal(a.executed, b.executed)
            overridden += info["shield"]["overridden"]
            done = one[2] or one[3]
    assert overridden > 0


def test_inputs_held_for_several_frames_pass_unchanged_on_an_empty_road():
    """Each frame of a decision is judged with the throttle that the ego keeps, limited above highway-env's greatest
    speed. An empty road passes, and no stage fails."""
    theirs, mine = (ShieldedEnv(make("highway-fast-v0", config=ALONE_FAST)) for make in (gym.make, CompiledHighwayEnv))
    for env in (theirs, mine):
        env.reset(seed=0)
    passed = 0
    for _ in range(20):
        for env in (theirs, mine):
            info = env.step(throttle(None))[4]["shield"]
            assert info["reason"] != "stage_failed"
        for one, two in zip(theirs.frame_decisions, mine.frame_decisions, strict=True):
            assert np.array_equal(one.proposed, two.proposed)
            assert (one.tier, one.margin) == (two.tier, two.margin)
        passed += not info["overridden"]
    assert passed > 5


def test_the_unshielded_compiled_highway_equals_highway_env():
    theirs, mine = gym.make("highway-fast-v0"), CompiledHighwayEnv("highway-fast-v0")
    assert mine.observation_space == theirs.observation_space
    assert mine.action_space == theirs.action_space
    theirs.reset(seed=3)
    mine.reset(seed=3)
    for seed in (None, 4):
        assert np.array_equal(theirs.reset(seed=seed)[0], mine.reset(seed=seed)[0])
        for action in (3, 0, 2, 4, 1):
            *one, info = theirs.step(action)
            *two, known = mine.step(action)
            assert np.array_equal(one[0], two[0])
            assert one[1:] == two[1:]
            assert info == known


def test_gymnasium_accepts_it():
    check_env(CompiledHighwayEnv("highway-fast-v0"), skip_render_check=True)
