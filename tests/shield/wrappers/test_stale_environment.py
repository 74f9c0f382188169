"""A shield follows an environment that is reconfigured before a reset."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from policies import Always
from unknown_traffic import UNKNOWN

from shield import Shield, ShieldConfig, ShieldedEnv
from shield.errors import ConfigError

META, INPUTS = {"type": "DiscreteMetaAction"}, {"type": "ContinuousAction"}
FREQUENCIES = [{"simulation_frequency": 10}, {"policy_frequency": 5}]
AGGRESSIVE = {"other_vehicles_type": "highway_env.vehicle.behavior.AggressiveVehicle"}
OF_META = [{"action": {**META, "target_speeds": [0, 8, 16, 24]}}, {"action": {**META, "lateral": False}}]
OF_INPUTS = [
    {"action": {**INPUTS, "acceleration_range": [-3.0, 3.0]}},
    {"action": {**INPUTS, "steering_range": [-0.2, 0.2]}},
    {"action": {**INPUTS, "lateral": False}},
    {"action": {**INPUTS, "longitudinal": False}},
]
SETTINGS = {"worst case": None, "simulated": ShieldConfig.simulated_traffic()}
CASES = [
    *(("highway-fast-v0", META, new) for new in [{"lanes_count": 5}, {"vehicles_count": 7}, {"duration": 9}]),
    *(("highway-fast-v0", META, new) for new in [*FREQUENCIES, *OF_META, AGGRESSIVE]),
    *(("highway-fast-v0", INPUTS, new) for new in [{"lanes_count": 5}, *FREQUENCIES, *OF_INPUTS]),
    *(("merge-v1", META, new) for new in [*FREQUENCIES, *OF_META]),
    *(("parking-v0", INPUTS, new) for new in [{"simulation_frequency": 30}, *OF_INPUTS[:2]]),
]


def drive(env, inputs, decisions):
    rng, found = np.random.default_rng(0), []
    for _ in range(decisions):
        action = rng.uniform(-1, 1, env.action_space.shape) if inputs else int(rng.integers(env.action_space.n))
        *_, terminated, truncated, info = env.step(action.astype(np.float32) if inputs else action)
        told = [info["shield"][key] for key in ("tier", "reason", "margin")]
        found.append(str([told, [(*v.position.tolist(), v.speed) for v in env.unwrapped.road.vehicles[:4]]]))
        if terminated or truncated:
            break
    return found


@pytest.mark.parametrize(
    ("env_id", "action", "new", "settings"),
    [
        (*case, settings)
        for case in CASES
        for settings in SETTINGS
        if not (case[0] == "parking-v0" and settings == "simulated")  # nothing is simulated in parking lots
    ],
)
def test_an_environment_reconfigured_before_a_reset_is_driven_as_a_new_one(env_id, action, new, settings):
    """With simulated meta-actions on straight highways the simulator once kept the old configuration: each decision
    had `bad_scene`."""
    inputs = action["type"] == "ContinuousAction"
    env = ShieldedEnv(gym.make(env_id, config={"action": action}), SETTINGS[settings])
    env.reset(seed=1)
    drive(env, inputs, 2)
    env.unwrapped.configure(new)
    env.reset(seed=3)
    fresh = ShieldedEnv(gym.make(env_id, config={"action": action, **new}), SETTINGS[settings])
    fresh.reset(seed=3)
    assert drive(env, inputs, 6) == drive(fresh, inputs, 6)


@pytest.mark.parametrize("frames", [True, False])
@pytest.mark.parametrize("new", [{"lanes_count": 5}, *FREQUENCIES, OF_META[0]])
def test_the_policy_wrapper_follows_a_reconfigured_environment(new, frames):
    """The same around the policy."""
    env = gym.make("highway-fast-v0")
    env.reset(seed=1)
    shielded = Shield(Always(3), env=env, config=ShieldConfig.simulated_traffic(), frames=frames)
    obs, _ = env.reset(seed=3, options={"config": new})
    for _ in range(4):
        action, _ = shielded.predict(obs)
        assert shielded.last_decision.reason != "bad_scene"
        obs, *_ = env.step(action)


@pytest.mark.parametrize("env_id", ["highway-fast-v0", "merge-v1"])
def test_the_simulator_follows_frequencies_that_change_within_an_episode(env_id):
    """highway-env reads them at each step."""
    env = ShieldedEnv(gym.make(env_id), ShieldConfig.simulated_traffic())
    env.reset(seed=1)
    env.step(1)
    env.unwrapped.config["policy_frequency"] = 5
    *_, info = env.step(1)
    assert info["shield"]["reason"] != "bad_scene"


@pytest.mark.parametrize("settings", SETTINGS)
def test_a_step_whose_action_highway_env_applies_late_is_refused(settings):
    """highway-env applies actions at frames whose number the frames of a decision divide; others would reach the ego
    late."""
    env = ShieldedEnv(gym.make("highway-fast-v0"), SETTINGS[settings])
    env.reset(seed=1)
    env.step(1)
    env.unwrapped.config["simulation_frequency"] = 10
    with pytest.raises(ConfigError, match="changed within an episode"):
        env.step(1)


@pytest.mark.parametrize("env_id", ["merge-v1", "roundabout-v1"])
def test_a_reset_to_traffic_that_cannot_be_simulated_is_refused(env_id):
    """It was `bad_scene` in each decision."""
    env = ShieldedEnv(gym.make(env_id), ShieldConfig.simulated_traffic())
    env.unwrapped.configure(UNKNOWN)
    with pytest.raises(ConfigError, match="Dozy has act of its own"):
        env.reset(seed=0)
