"""A refusal names only remedies that work: each is tried in the refused environment."""

from __future__ import annotations

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from gymnasium.wrappers import TransformAction
from policies import Always
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

from shield import Shield, ShieldConfig, ShieldedEnv
from shield.errors import ShieldError

EXACT = ShieldConfig.simulated_traffic()
INPUTS = {"action": {"type": "ContinuousAction"}}
NUMBERS = {"action": {"type": "DiscreteAction"}}
META = {"action": {"type": "DiscreteMetaAction"}}
SLIPPERY = {"action": {"type": "ContinuousAction", "dynamical": True}}


def egos(kind, observation="Kinematics", **config):
    shown = {"type": "MultiAgentObservation", "observation_config": {"type": observation, **config}}
    action = {"type": "MultiAgentAction", "action_config": {"type": kind}}
    return {"controlled_vehicles": 2, "observation": shown, "action": action}


GOAL = {"features": ["x", "y", "vx", "vy", "cos_h", "sin_h"], "scales": [100, 100, 5, 5, 1, 1], "normalize": False}
METAS, GASES = egos("DiscreteMetaAction"), egos("ContinuousAction")
GOALS = egos("ContinuousAction", "KinematicsGoal", **GOAL)


def made(env_id, config=None):
    return gym.make(env_id, config=config or {})


def shielded(env_id, config=None, settings=None, **options):
    """`ShieldedEnv` in the environment, reset once."""
    env = ShieldedEnv(made(env_id, config), settings, **options)
    env.reset(seed=0)
    return env


def policy(env_id, config=None, settings=None, **options):
    """`Shield` around a policy in the environment."""
    env = made(env_id, config)
    env.reset(seed=0)
    kind = env.unwrapped.action_type
    action = np.zeros(2, np.float32) if type(kind).__name__ == "ContinuousAction" else 1
    return Shield(Always(action), env, settings, **options)


def many(env_id, kind=DummyVecEnv):
    return kind([lambda: made(env_id)])


REFUSED = {
    "two egos": (
        lambda: shielded("intersection-multi-agent-v2", {"controlled_vehicles": 2}, ShieldConfig.for_roads()),
        "ShieldedEnv(env, ShieldConfig.simulated_traffic())",
        [lambda: shielded("intersection-multi-agent-v2", {"controlled_vehicles": 2}, EXACT)],
    ),
    "two egos, a policy": (
        lambda: policy("intersection-multi-agent-v2", {"controlled_vehicles": 2}),
        "ShieldedEnv(env, ShieldConfig.simulated_traffic())",
        [lambda: shielded("intersection-multi-agent-v2", {"controlled_vehicles": 2}, EXACT)],
    ),
    "two egos with a throttle": (
        lambda: shielded("roundabout-v1", GASES),
        'config={"action": {"type": "MultiAgentAction", "action_config": {"type": "DiscreteMetaAction"}}}',
        [lambda: shielded("roundabout-v1", METAS, EXACT)],
    ),
    "frames=False on a network": (
        lambda: policy("roundabout-v1", frames=False, settings=ShieldConfig.for_meta_actions()),
        "by default ShieldedEnv(env) and Shield(policy, env=env) filter meta-actions here",
        [
            lambda: shielded("roundabout-v1"),
            lambda: policy("roundabout-v1"),
            lambda: shielded("roundabout-v1", None, EXACT),
            lambda: policy("roundabout-v1", None, EXACT),
        ],
    ),
    "a rule on a network": (
        lambda: shielded("roundabout-v1", None, ShieldConfig(mode="rss")),
        "pass ShieldConfig.simulated_traffic(), which simulates the traffic here",
        [lambda: shielded("roundabout-v1"), lambda: shielded("roundabout-v1", None, EXACT)],
    ),
    "a throttle on a network": (
        lambda: shielded("exit-v1", INPUTS, ShieldConfig()),
        "pass ShieldConfig.simulated_traffic(), which simulates the traffic here",
        [lambda: shielded("exit-v1", INPUTS, EXACT), lambda: policy("exit-v1", INPUTS, EXACT)],
    ),
    "numbered inputs on a network": (
        lambda: policy("exit-v1", NUMBERS, ShieldConfig(), frames=False),
        "pass ShieldConfig.simulated_traffic(), which simulates the traffic here",
        [lambda: shielded("exit-v1", NUMBERS, EXACT), lambda: policy("exit-v1", NUMBERS, EXACT)],
    ),
    "numbered inputs": (
        lambda: policy("highway-fast-v0", NUMBERS, frames=False),
        "take Shield(policy, env=env), ShieldedEnv(env), or ContinuousAction",
        [
            lambda: policy("highway-fast-v0", NUMBERS),
            lambda: shielded("highway-fast-v0", NUMBERS),
            lambda: policy("highway-fast-v0", INPUTS, frames=False),
        ],
    ),
    "tyres that slip": (
        lambda: shielded("highway-fast-v0", SLIPPERY, ShieldConfig()),
        '"dynamical": False}} to gym.make',
        [lambda: shielded("highway-fast-v0", {"action": {"type": "ContinuousAction", "dynamical": False}})],
    ),
    "throttle by simulation, without frames": (
        lambda: policy("highway-fast-v0", INPUTS, EXACT, frames=False),
        "frames=True",
        [lambda: policy("highway-fast-v0", INPUTS, EXACT, frames=True)],
    ),
    "a parking lot by simulation": (
        lambda: shielded("parking-v0", None, EXACT),
        "leave ShieldConfig.simulated_traffic() out; "
        "ShieldedEnv(env) and Shield(policy, env) filter ContinuousAction there",
        [lambda: shielded("parking-v0"), lambda: policy("parking-v0")],
    ),
    "a parking lot by simulation, without frames": (
        lambda: policy("parking-v0", None, EXACT, frames=False),
        "leave ShieldConfig.simulated_traffic() out; "
        "ShieldedEnv(env) and Shield(policy, env) filter ContinuousAction there",
        [lambda: shielded("parking-v0"), lambda: policy("parking-v0"), lambda: policy("parking-v0", frames=False)],
    ),
    "a parking lot without a brake": (
        lambda: policy("parking-v0", {"action": {"type": "ContinuousAction", "longitudinal": False}}, frames=False),
        "Use ShieldedEnv, or a throttle with a range such as (-5, 5)",
        [
            lambda: shielded("parking-v0", {"action": {"type": "ContinuousAction", "longitudinal": False}}),
            lambda: policy(
                "parking-v0",
                {"action": {"type": "ContinuousAction", "acceleration_range": (-5, 5)}},
                frames=False,
            ),
        ],
    ),
    "a rule by simulation": (
        lambda: shielded("highway-fast-v0", None, EXACT, rule=object()),
        "leave rule and model out",
        [lambda: shielded("highway-fast-v0", None, EXACT)],
    ),
    "a model for meta-actions": (
        lambda: shielded("highway-fast-v0", model=object()),
        "with meta-actions leave it out",
        [lambda: shielded("highway-fast-v0")],
    ),
    "observations on a network": (
        lambda: shielded("roundabout-v1", perception="observation"),
        "elsewhere take perception='simulator'",
        [lambda: shielded("roundabout-v1", perception="simulator")],
    ),
    "observations on a network, without frames": (
        lambda: policy("roundabout-v1", None, ShieldConfig.for_meta_actions(), frames=False, perception="observation"),
        "by default ShieldedEnv(env) and Shield(policy, env=env) filter meta-actions here",
        [lambda: shielded("roundabout-v1"), lambda: policy("roundabout-v1")],
    ),
    "several environments": (
        lambda: ShieldedEnv(many("highway-fast-v0")),
        "DummyVecEnv([lambda: ShieldedEnv(gym.make(...))]), or take Shield(policy, env)",
        [
            lambda: DummyVecEnv([lambda: ShieldedEnv(made("highway-fast-v0"))]).reset(),
            lambda: Shield(Always(1), many("highway-fast-v0")),
        ],
    ),
    "a wrapper that changes actions": (
        lambda: ShieldedEnv(TransformAction(made("highway-fast-v0"), int, None)),
        "TransformAction(ShieldedEnv(gym.make(...)), ...)",
        [lambda: TransformAction(ShieldedEnv(made("highway-fast-v0")), int, None).reset(seed=0)],
    ),
    "a speed range": (
        lambda: shielded("highway-fast-v0", {"action": {"type": "ContinuousAction", "speed_range": (0, 30)}}),
        "Leave speed_range out of the action's config",
        [lambda: shielded("highway-fast-v0", INPUTS)],
    ),
    "a rule for a throttle": (
        lambda: shielded("highway-fast-v0", INPUTS, ShieldConfig(mode="rss")),
        "for ContinuousAction use none or full",
        [
            lambda: shielded("highway-fast-v0", INPUTS, ShieldConfig(mode="none")),
            lambda: shielded("highway-fast-v0", INPUTS, ShieldConfig(mode="full")),
        ],
    ),
    "reversing": (
        lambda: shielded("highway-fast-v0", {"action": {**META["action"], "target_speeds": [-5, 0, 20]}}),
        "leave out the speeds below 0",
        [lambda: shielded("highway-fast-v0", {"action": {**META["action"], "target_speeds": [0, 20]}})],
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_the_remedies_of_a_refusal_are_accepted(case):
    refused, named, remedies = REFUSED[case]
    with pytest.raises(ShieldError) as caught:
        refused()
    assert named in str(caught.value)
    for remedy in remedies:
        remedy()


@pytest.mark.parametrize("settings", [ShieldConfig(), EXACT], ids=["default", "exact"])
@pytest.mark.parametrize(
    ("env_id", "config"),
    [("highway-fast-v0", METAS), ("highway-fast-v0", GASES), ("racetrack-v1", GASES), ("parking-v0", GOALS)],
    ids=["highway, meta", "highway, throttle", "racetrack", "parking"],
)
def test_no_remedy_is_named_for_several_egos_that_are_always_refused(env_id, config, settings):
    """The message for two egos on a highway once named `ShieldConfig.simulated_traffic()`, which was refused as
    well."""
    for refused in (lambda: shielded(env_id, config, settings), lambda: policy(env_id, config, settings)):
        with pytest.raises(ShieldError) as caught:
            refused()
        assert "exact()" not in str(caught.value)
        assert "Pass config" not in str(caught.value)


@pytest.mark.parametrize(("env_id", "known"), [("highway-fast-v0", True), ("roundabout-v1", False)])
def test_observations_are_a_remedy_for_other_processes_only_if_they_can_be_read(env_id, known):
    env = many(env_id, SubprocVecEnv)
    try:
        env.reset()
        with pytest.raises(ShieldError, match="put the shield inside, SubprocVecEnv") as caught:
            Shield(Always(1), env)
        assert ('Shield(..., frames=False, perception="observation")' in str(caught.value)) is known
        with pytest.raises(ShieldError, match="put the shield inside, SubprocVecEnv") as caught:
            Shield(Always(1), env, perception="observation")
        assert ("pass frames=False" in str(caught.value)) is known
        with pytest.raises(ShieldError) as caught:
            ShieldedEnv(env)
        assert "take Shield(policy, env)" not in str(caught.value)
        if known:
            Shield(Always(1), env, frames=False, perception="observation")
    finally:
        env.close()
