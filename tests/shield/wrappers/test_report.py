"""Reports of a step: invalid actions, and episodes that an outer wrapper ends."""

from __future__ import annotations

import logging

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from gymnasium.wrappers import TimeLimit
from stable_baselines3.common.vec_env import DummyVecEnv

from shield import Shield, ShieldConfig, ShieldedEnv

META = "0 LANE_LEFT, 1 IDLE, 2 LANE_RIGHT, 3 FASTER, 4 SLOWER"
EXACT = ShieldConfig.simulated_traffic()


@pytest.mark.parametrize(
    ("env_id", "config", "settings", "action", "told"),
    [
        ("highway-fast-v0", {}, None, "FASTER", f"'FASTER' is no action of this environment; have {META}: FASTER is 3"),
        ("highway-fast-v0", {}, EXACT, 17, f"17 is no action of this environment; have {META}. The fallback"),
        ("roundabout-v1", {}, None, "SLOWER", f"'SLOWER' is no action of this environment; have {META}: SLOWER is 4"),
        (
            "highway-fast-v0",
            {"action": {"type": "ContinuousAction"}},
            None,
            [np.nan, 0.0],
            "[nan, 0.0] is no action of this environment; have finite numbers of Box(-1.0, 1.0, (2,), float32)",
        ),
        (
            "intersection-multi-agent-v2",
            {"controlled_vehicles": 2},
            EXACT,
            (1, "FASTER"),
            "'FASTER' is no action of this environment; have 0 SLOWER, 1 IDLE, 2 FASTER: FASTER is 2",
        ),
    ],
)
def test_an_action_that_is_none_is_warned_of_once(env_id, config, settings, action, told, caplog):
    env = ShieldedEnv(gym.make(env_id, config=config), settings)
    env.reset(seed=0)
    for _ in range(3):
        env.step(action)
        assert "bad_action" in {decision.reason for decision in env.last_decisions}
    (record,) = [each for each in caplog.records if each.levelno == logging.WARNING and each.name == "shield"]
    assert record.getMessage().startswith(told)
    assert record.getMessage().endswith("the record says bad_action. Logged once")


def test_the_shield_of_a_policy_warns_of_a_name_as_well_and_names_the_fallback(caplog):
    env = gym.make("highway-fast-v0")
    obs, _ = env.reset(seed=0)
    shield = Shield(lambda _: "FASTER", env=env)
    for _ in range(2):
        assert int(shield.predict(obs)[0]) == 4
    (record,) = [each for each in caplog.records if "is no action of this environment" in each.getMessage()]
    assert "FASTER is 3. The fallback acts instead, here SLOWER" in record.getMessage()


def test_actions_of_the_environment_are_not_warned_of(caplog):
    env = ShieldedEnv(gym.make("highway-fast-v0"))
    env.reset(seed=0)
    for action in range(5):
        env.step(np.int64(action))
    assert not [each for each in caplog.records if each.levelno >= logging.WARNING]


def test_an_episode_that_a_wrapper_outside_ends_is_summed_up():
    """`TimeLimit` outside: the shield's own step cannot say so."""
    env = TimeLimit(ShieldedEnv(gym.make("highway-fast-v0")), 3)
    env.reset(seed=0)
    truncated = False
    while not truncated:
        *_, truncated, info = env.step(3)
    assert "shield_episode" not in info
    summary = env.get_wrapper_attr("statistics").summary()
    assert summary["decisions"] == 3
    assert sum(summary["reasons"].values()) == 3
    _, info = env.reset(seed=1)
    assert info["shield_episode"] == summary
    assert env.get_wrapper_attr("statistics").decisions == 0
    _, info = env.reset(seed=1)
    assert "shield_episode" not in info


def test_an_episode_that_has_ended_by_itself_is_summed_up_once():
    env = ShieldedEnv(TimeLimit(gym.make("highway-fast-v0"), 2))
    env.reset(seed=0)
    env.step(1)
    *_, truncated, info = env.step(1)
    assert truncated
    assert info["shield_episode"] == env.statistics.summary()
    assert info["shield_episode"]["decisions"] == 2
    _, info = env.reset(seed=1)
    assert "shield_episode" not in info


def test_the_summary_of_a_vector_environment_comes_with_the_reset():
    env = DummyVecEnv([lambda: TimeLimit(ShieldedEnv(gym.make("highway-fast-v0")), 2)])
    env.seed(0)
    env.reset()
    for _ in range(2):
        *_, done, _infos = env.step(np.array([1]))
    assert done.all()
    assert env.reset_infos[0]["shield_episode"]["decisions"] == 2
