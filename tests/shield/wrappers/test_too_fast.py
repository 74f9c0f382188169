"""An ego whose meta-actions cannot stop it before a crossing leads to a warning at construction, with a remedy that
works."""

from __future__ import annotations

import ast
import logging

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import pytest
from policies import Always

from shield import Shield, ShieldConfig, ShieldedEnv

META = {"action": {"type": "DiscreteMetaAction"}}
FAST = {"action": {"type": "DiscreteMetaAction", "target_speeds": [20, 25, 30]}}
TEAM = {
    "controlled_vehicles": 2,
    "action": {"type": "MultiAgentAction", "action_config": {"type": "DiscreteMetaAction", "lateral": False}},
}
CROSSING = {
    "intersection-v1": META,
    "intersection-v2": FAST,
    "roundabout-v1": FAST,
    "intersection-multi-agent-v2": TEAM,
}


def warnings(caplog, env_id, config, placement, settings=None):
    """The warnings about an ego that cannot stop, and the environment."""
    env = gym.make(env_id, config=config)
    caplog.clear()
    with caplog.at_level(logging.INFO, "shield"):
        wrapped = ShieldedEnv(env, settings) if placement == "env" else Shield(Always(1), env, settings)
    messages = [each.getMessage() for each in caplog.records if each.levelno == logging.WARNING]
    return [message for message in messages if "cannot stop" in message], wrapped


@pytest.mark.parametrize(
    ("env_id", "placement"),
    [
        (each, placement)
        for each in CROSSING
        for placement in ("env", "policy")
        if placement == "env" or "multi" not in each
    ],
)
def test_an_ego_that_cannot_stop_is_warned_of_once_and_the_remedy_helps(env_id, placement, caplog):
    """The configuration that the warning names is built from its text; with it there is no warning and no crash."""
    (said,), _ = warnings(caplog, env_id, CROSSING[env_id], placement)
    assert "slowest target speed is 20 m/s" in said
    remedy = ast.literal_eval(said.split("config=")[1].removesuffix(" to gym.make"))
    quiet, _ = warnings(caplog, env_id, {**CROSSING[env_id], **remedy}, placement)
    assert not quiet
    env = ShieldedEnv(gym.make(env_id, config={**CROSSING[env_id], **remedy}))
    for seed in range(3):
        env.reset(seed=seed)
        base, over = env.unwrapped, False
        faster = base.action_type.agents_action_types[0] if "multi" in env_id else base.action_type
        action = faster.actions_indexes["FASTER"]
        for _ in range(15):
            *_, terminated, truncated, _ = env.step((action, action) if "multi" in env_id else action)
            over = truncated or base._is_terminated() or terminated is True
            if over:
                break
        assert not any(ego.crashed for ego in base.controlled_vehicles)


@pytest.mark.parametrize("placement", ["env", "policy"])
@pytest.mark.parametrize(
    ("env_id", "config", "settings"),
    [
        ("highway-fast-v0", {}, None),
        ("merge-v1", {}, None),
        ("two-way-v0", {}, None),
        ("u-turn-v1", {}, None),
        ("exit-v1", {**META}, None),
        ("roundabout-v1", {}, None),
        ("intersection-v1", {}, None),
        ("intersection-v1", META, ShieldConfig(mode="none")),
    ],
)
def test_an_ego_that_can_stop_or_meets_no_crossing_is_not_warned_of(env_id, config, settings, placement, caplog):
    """No lanes cross there, or the ego can stop, or nothing is verified."""
    said, _ = warnings(caplog, env_id, config, placement, settings)
    assert not said
