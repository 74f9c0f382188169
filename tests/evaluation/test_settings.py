"""Every named setting makes its environment."""

import re
from functools import partial

import gymnasium as gym
import numpy as np
import pytest

from evaluation.settings import SETTINGS, TRAFFIC, Setting, get_setting
from shield.config import ShieldConfig
from shield.errors import ConfigError, ShieldError


@pytest.mark.parametrize("name", sorted(SETTINGS))
def test_every_setting_makes_an_environment_with_its_configuration(name):
    setting = get_setting(name)
    env = setting.make()
    try:
        obs, _ = env.reset(seed=0)
        config = env.unwrapped.config
        assert env.observation_space.contains(obs)
        assert setting.name == name
        assert setting.description
        for key, value in setting.config.items():
            assert config[key] == value, key
    finally:
        env.close()


@pytest.mark.parametrize("name", ["abz", "abz-adversarial", "abz-idm", "abz-aggressive"])
def test_the_abz_family_shares_road_and_actions(name):
    env = get_setting(name).make()
    try:
        env.reset(seed=0)
        assert env.unwrapped.config["lanes_count"] == 3
        assert isinstance(env.action_space, gym.spaces.Discrete)
        assert list(env.unwrapped.vehicle.target_speeds) == list(range(0, 45, 5))
    finally:
        env.close()


def test_returns_are_comparable_between_training_and_tests():
    keys = ("high_speed_reward", "collision_reward", "reward_speed_range", "lanes_count", "action")
    base, *others = (get_setting(n).config for n in ("abz", "abz-idm", "abz-aggressive"))
    for other in others:
        assert {k: base[k] for k in keys} == {k: other[k] for k in keys}


@pytest.mark.parametrize(("name", "kind"), [("abz-idm", "idm"), ("abz-aggressive", "aggressive")])
def test_the_tests_run_at_15_hz_among_the_traffic_they_name(name, kind):
    env = get_setting(name).make()
    try:
        env.reset(seed=0)
        assert env.unwrapped.config["simulation_frequency"] == 15
        others = env.unwrapped.road.vehicles[1:]
        assert {type(v).__name__ for v in others} == {TRAFFIC[kind].rsplit(".", 1)[1]}
    finally:
        env.close()


def _reward(setting, *, crashed, speed):
    """The reward on the left lane at a speed [m/s]."""
    env = setting.make()
    try:
        env.reset(seed=0)
        vehicle = env.unwrapped.vehicle
        vehicle.crashed, vehicle.speed, vehicle.heading = crashed, speed, 0.0
        vehicle.target_lane_index = (*vehicle.lane_index[:2], 0)
        return env.unwrapped._reward(1)
    finally:
        env.close()


@pytest.mark.parametrize("speed", [0.0, 15.0, 25.0, 40.0])
def test_a_crash_is_rewarded_by_the_adversarial_setting_and_punished_by_the_base(speed):
    adversarial, base = get_setting("abz-adversarial"), get_setting("abz")
    assert _reward(adversarial, crashed=True, speed=speed) > _reward(adversarial, crashed=False, speed=speed)
    assert _reward(base, crashed=True, speed=speed) < _reward(base, crashed=False, speed=speed)


def test_adversarial_driving_below_20_m_per_s_is_a_loss_that_a_crash_ends():
    adversarial = get_setting("abz-adversarial")
    assert _reward(adversarial, crashed=False, speed=20.0) == pytest.approx(0.0)
    assert _reward(adversarial, crashed=False, speed=15.0) < 0
    assert _reward(adversarial, crashed=True, speed=20.0) == pytest.approx(1 / 1.1)


def test_the_lane_change_reward_does_nothing_in_highway_env():
    # If this fails, highway-env has begun to read it: the note beside the setting is outdated.
    env = get_setting("abz-adversarial").make()
    try:
        env.reset(seed=0)
        assert "lane_change_reward" not in env.unwrapped._rewards(0)
    finally:
        env.close()


def _continuous_reward(setting="highway-continuous", **state):
    env = get_setting(setting).override({"vehicles_count": 0}).make()
    try:
        env.reset(seed=0)
        base = env.unwrapped
        vehicle, lane = base.vehicle, base.road.network.get_lane(("0", "1", 0))
        vehicle.position = lane.position(100.0, state.pop("lateral", 0.0))
        vehicle.heading, vehicle.speed, vehicle.crashed = 0.0, 25.0, False
        for name, value in state.items():
            setattr(vehicle, name, value)
        vehicle.on_state_update()
        return base._reward(np.zeros(2)), base._is_terminated()
    finally:
        env.close()


def test_the_continuous_reward_pays_for_speed_along_the_road_and_punishes_crashes_and_leaving_it():
    best, ended = _continuous_reward(speed=30.0)
    assert not ended
    assert _continuous_reward(speed=20.0)[0] < _continuous_reward(speed=25.0)[0] < best <= 1.0
    assert _continuous_reward(speed=30.0, heading=np.pi / 4)[0] < best
    crash, ended = _continuous_reward(speed=30.0, crashed=True)
    assert ended
    assert crash == pytest.approx(best - 1 / 1.5)
    assert _continuous_reward(speed=30.0, lateral=-2.5) == (0.0, True)


def test_standing_still_is_worthless_in_training():
    reward = partial(_continuous_reward, "highway-continuous-training")
    assert reward(speed=0.0)[0] == pytest.approx(0.0)
    assert reward(speed=0.0)[0] < reward(speed=15.0)[0] < reward(speed=25.0)[0]
    assert reward(speed=25.0, crashed=True)[0] < 0
    # the note beside the setting:
    assert _continuous_reward(speed=0.0)[0] == pytest.approx(1 / 1.5)


def test_continuous_settings_differ_from_highway_env_as_documented():
    env = get_setting("highway-continuous").make()
    default = gym.make("highway-v0")
    try:
        config, base = env.unwrapped.config, default.unwrapped.config
        differ = {key for key in config if config[key] != base.get(key)}
        assert differ == {"action", "simulation_frequency", "policy_frequency", "offroad_terminal"}
        assert env.action_space.shape == (2,)
        assert get_setting("racetrack").make().action_space.shape == (1,)
    finally:
        env.close()
        default.close()


def test_the_same_seed_gives_the_same_traffic():
    setting = get_setting("abz-idm")
    first, second = setting.make(), setting.make()
    try:
        np.testing.assert_array_equal(first.reset(seed=3)[0], second.reset(seed=3)[0])
    finally:
        first.close()
        second.close()


def test_an_unknown_name_is_answered_with_the_valid_ones():
    with pytest.raises(ConfigError, match=r"abz-aggressive.*highway-fast") as error:
        get_setting("motorway")
    assert isinstance(error.value, ShieldError)


def test_traffic_can_be_replaced_without_touching_the_setting():
    setting = get_setting("highway-fast")
    other = setting.with_traffic("aggressive", vehicles=5, density=1.5)
    assert other.config == {
        "other_vehicles_type": TRAFFIC["aggressive"],
        "vehicles_count": 5,
        "vehicles_density": 1.5,
    }
    assert other.name == "highway-fast+aggressive+vehicles=5+density=1.5"
    assert setting.config == {}
    env = other.make()
    try:
        env.reset(seed=0)
        assert len(env.unwrapped.road.vehicles) == 6
    finally:
        env.close()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"kind": "polite"}, "aggressive"),
        ({"vehicles": -1}, "0 or more"),
        ({"density": 0.0}, "positive"),
    ],
)
def test_bad_traffic_is_refused(arguments, message):
    with pytest.raises(ConfigError, match=message):
        get_setting("abz").with_traffic(**arguments)


@pytest.mark.parametrize(
    "road", ["merge-v0", "merge-generic-v1", "roundabout-v1", "two-way-v0", "highway_env:u-turn-v1"]
)
def test_an_environment_that_highway_env_cannot_make_is_answered_with_a_replacement(road):
    inputs = {"action": {"type": "ContinuousAction"}}
    with pytest.raises(ConfigError, match=r"highway-env itself does not make .*ThrottleAndSteering\(") as error:
        Setting("mine", road, inputs).make()
    (first, *others) = re.findall(r"[\w-]+-continuous-v\d", str(error.value))
    assert first == road.split(":")[-1].replace("-v", "-continuous-v")
    assert len(set(others)) == 6
    for each in (first, *others):
        env = Setting("mine", f"evaluation.wrappers:{each}", inputs).make()
        assert env.action_space.shape == (2,)
        env.close()


@pytest.mark.parametrize(
    "config",
    [
        {"action": {"type": "NoAction"}},
        {"action": "ContinuousAction"},
        {"action": {"type": "DiscreteMetaAction"}, "observation": {"type": "None"}},
    ],
)
def test_other_errors_on_such_a_road_are_reported_unchanged(config):
    with pytest.raises(ConfigError, match="merge-v1 cannot be made with"):
        Setting("mine", "merge-v1", config).make()


def test_a_setting_owns_its_configuration():
    nested = {"action": {"type": "DiscreteMetaAction"}}
    setting = Setting("mine", "highway-fast-v0", nested)
    nested["action"]["type"] = "ContinuousAction"
    assert setting.config["action"]["type"] == "DiscreteMetaAction"
    with pytest.raises(TypeError):
        setting.config["lanes_count"] = 1


def test_an_unknown_name_is_answered_with_the_nearest():
    for name, nearest in (("highway-fats", "highway-fast"), ("abz-idmm", "abz-idm"), ("round-about", "roundabout")):
        with pytest.raises(ConfigError, match=f"perhaps '{nearest}' is meant"):
            get_setting(name)
    with pytest.raises(ConfigError, match=r"unknown setting 'boat'; have abz"):
        get_setting("boat")


def test_a_misspelt_setting_of_the_shield_is_answered_with_the_nearest():
    with pytest.raises(ConfigError, match=r"unknown key 'brakng' in .*; perhaps 'braking' is meant; valid are"):
        ShieldConfig.from_toml("brakng = 7.0\n")
    with pytest.raises(ConfigError, match="perhaps 'full' is meant"):
        ShieldConfig(mode="ful")
