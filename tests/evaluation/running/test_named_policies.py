"""Policies by name act accordingly, and unknown names are refused with the list of valid ones."""

import gymnasium as gym
import numpy as np
import pytest

from evaluation.running.named_policies import BASELINES, make_policy, policy_label, start_episode
from evaluation.settings import get_setting
from evaluation.training.train import train
from shield.errors import ConfigError, PolicyError


@pytest.fixture
def env():
    env = get_setting("highway-fast").make()
    env.reset(seed=0)
    yield env
    env.close()


@pytest.mark.parametrize(("name", "action"), [("faster", 3), ("slower", 4), ("idle", 1)])
def test_constant_policies_find_their_action(env, name, action):
    policy = make_policy(name, env)
    assert env.action_space.contains(int(policy.predict(None)[0]))
    assert int(policy.predict(None, deterministic=True)[0]) == action


def test_constant_policies_find_their_action_without_lane_changes():
    setting = get_setting("abz").override(
        {"action": {"type": "DiscreteMetaAction", "lateral": False}}, name="abz-longitudinal"
    )
    env = setting.make()
    try:
        indexes = env.unwrapped.action_type.actions_indexes
        assert int(make_policy("faster", env).predict(None)[0]) == indexes["FASTER"]
        assert indexes["FASTER"] != 3
    finally:
        env.close()


def continuous(**action):
    env = get_setting("highway-fast").override({"action": {"type": "ContinuousAction", **action}}).make()
    env.reset(seed=0)
    return env


@pytest.mark.parametrize(
    ("action", "throttle", "idle"),
    [
        ({}, [1.0, 0.0], [0.0, 0.0]),
        ({"lateral": False}, [1.0], [0.0]),
        ({"acceleration_range": [-6.0, 2.0]}, [1.0, 0.0], [0.5, 0.0]),
        ({"longitudinal": False}, None, [0.0]),
    ],
)
def test_constant_input_policies_act_by_their_names(action, throttle, idle):
    env = continuous(**action)
    try:
        for name, expected in (("throttle", throttle), ("idle", idle)):
            if expected is None:
                with pytest.raises(ConfigError, match="no throttle; have idle, random"):
                    make_policy(name, env)
                continue
            chosen = make_policy(name, env).predict(None)[0]
            assert env.action_space.contains(chosen)
            np.testing.assert_allclose(chosen, expected, atol=1e-7)
            env.step(chosen)
            inputs = env.unwrapped.vehicle.action
            assert inputs["steering"] == pytest.approx(0.0, abs=1e-7)
            fastest = env.unwrapped.action_type.acceleration_range[1]
            assert inputs["acceleration"] == pytest.approx(fastest if name == "throttle" else 0.0, abs=1e-6)
    finally:
        env.close()


@pytest.mark.parametrize("name", ["faster", "slower"])
def test_meta_action_policies_are_refused_for_continuous_actions(name):
    env = continuous()
    try:
        with pytest.raises(ConfigError, match=r"takes ContinuousAction; have idle, throttle, random"):
            make_policy(name, env)
    finally:
        env.close()


def test_the_throttle_policy_is_refused_for_meta_actions(env):
    with pytest.raises(ConfigError, match=r"takes DiscreteMetaAction; have faster, idle, left, right, slower, random"):
        make_policy("throttle", env)


def test_steps_of_throttle_and_steering_have_constant_policies():
    """Of three steps on each axis, the throttle first: straight on, and with full throttle."""
    env = get_setting("highway-fast").override({"action": {"type": "DiscreteAction"}}).make()
    try:
        assert [int(make_policy(name, env).predict(None)[0]) for name in ("idle", "throttle")] == [4, 7]
    finally:
        env.close()


def test_other_actions_have_no_constant_policy():
    multi_agent = {"type": "MultiAgentAction", "action_config": {"type": "DiscreteMetaAction"}}
    env = get_setting("highway-fast").override({"action": multi_agent}).make()
    try:
        with pytest.raises(ConfigError, match="takes MultiAgentAction; several egos are driven by ShieldedEnv"):
            make_policy("idle", env)
    finally:
        env.close()


def test_a_constant_action_cannot_be_changed_from_outside():
    env = continuous()
    try:
        policy = make_policy("throttle", env)
        policy.predict(None)[0][:] = 0.5
        np.testing.assert_array_equal(policy.predict(None)[0], np.array([1.0, 0.0], dtype=np.float32))
    finally:
        env.close()


def test_random_inputs_depend_on_the_episode_seed_alone():
    env = continuous()
    try:
        policy = make_policy("random", env)

        def actions(seed):
            start_episode(policy, seed)
            return np.array([policy.predict(None, deterministic=True)[0] for _ in range(200)])

        first = actions(7)
        np.testing.assert_array_equal(actions(7), first)
        assert (actions(8) != first).any()
        assert all(env.action_space.contains(action) for action in first)
        assert (first.min(axis=0) < -0.9).all()
        assert (first.max(axis=0) > 0.9).all()
    finally:
        env.close()


def test_random_actions_depend_on_the_episode_seed_alone(env):
    policy = make_policy("random", env)

    def actions(seed):
        start_episode(policy, seed)
        return [int(policy.predict(None, deterministic=True)[0]) for _ in range(40)]

    first = actions(7)
    assert actions(8) != first
    assert actions(7) == first
    assert set(first) == set(range(5))


def test_a_zip_file_is_loaded_by_its_manifest_by_itself_or_by_the_algorithm_given(env, tmp_path):
    path = train("highway-fast", "a2c", 5, 0, output=tmp_path / "tiny", progress=False).path
    obs, _ = env.reset(seed=1)
    by_manifest = make_policy(str(path), env).predict(obs, deterministic=True)[0]
    path.with_suffix(".json").unlink()
    for algorithm in (None, "a2c"):
        again = make_policy(str(path), env, algorithm=algorithm).predict(obs, deterministic=True)[0]
        np.testing.assert_array_equal(by_manifest, again)
    with pytest.raises(PolicyError, match="was trained with a2c"):
        make_policy(str(path), env, algorithm="ppo")
    assert policy_label(str(path)) == "tiny"


def test_unknown_names_list_the_known_ones(env):
    with pytest.raises(ConfigError) as error:
        make_policy("fastest", env)
    for name in BASELINES:
        assert name in str(error.value)
    with pytest.raises(ConfigError, match="no policy file"):
        make_policy("missing.zip", env)


def test_other_action_spaces_have_no_random_policy(env):
    policy = make_policy("random", env)
    policy._space = gym.spaces.MultiBinary(2)
    with pytest.raises(ConfigError, match="Discrete or a Box"):
        policy.predict(None)


def test_the_model_predictive_controller_is_a_policy_by_name():
    env = get_setting("highway-fast-continuous").make()
    policy = make_policy("mpc", env)
    obs, _ = env.reset(seed=0)
    assert env.action_space.contains(policy.predict(obs, deterministic=True)[0])
    with pytest.raises(ConfigError, match="ContinuousAction"):
        make_policy("mpc", get_setting("highway-fast").make())
