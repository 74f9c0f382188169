"""Inexact sensors: their errors have the documented size, and no other effect."""

from __future__ import annotations

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest

from evaluation.names import SENSOR_NAMES
from evaluation.running.episodes import run_episode
from evaluation.running.records import ShieldVariant
from evaluation.wrappers import SENSORS, SensorModel, SensorNoise
from evaluation.wrappers.sensor_noise import get_sensor
from shield import ShieldedEnv
from shield.errors import ConfigError

SEEN = {"type": "Kinematics", "vehicles_count": 15, "see_behind": True}


def make(model, observation=SEEN):
    return SensorNoise(gym.make("highway-fast-v0", config={"observation": observation}), model)


def drawn(model, episodes=20, observation=SEEN):
    """The error that the sensor adds, row by row, in the observation's own units."""
    env, found = make(model, observation), []
    for seed in range(episodes):
        shown, _ = env.reset(seed=seed)
        exact = env.unwrapped.observation_type.observe()
        found.append((shown - exact)[np.abs(exact).max(axis=1) > 0])
    return env, found


def test_noise_has_the_configured_size_for_each_feature():
    observation = {**SEEN, "features": ["vy", "presence", "x", "vx", "y"]}
    env, found = drawn(SensorModel({"x": 4.0, "vy": 0.5}), observation=observation)
    others = np.concatenate([rows[1:] for rows in found])
    # Ranges of 200 m and 80 m/s.
    assert others[:, 2].std() == pytest.approx(4.0 / 200, rel=0.1)
    assert others[:, 0].std() == pytest.approx(0.5 / 80, rel=0.1)
    assert not others[:, [1, 3, 4]].any()
    assert not any(rows[0].any() for rows in found)
    np.testing.assert_allclose(env.sensor_noise, [4.0, 0.0, 0.0, 0.5])


def test_normalised_noise_is_a_share_of_half_the_range_and_may_be_on_the_ego_too():
    env, found = drawn(SensorModel({"x": 0.2, "y": 0.2}, normalised=True, ego=True))
    others = np.concatenate([rows[1:] for rows in found])
    assert others[:, 1].std() == pytest.approx(0.2, rel=0.1)
    assert np.array([rows[0, 1] for rows in found]).std() == pytest.approx(0.2, rel=0.4)
    np.testing.assert_allclose(env.sensor_noise[:2], [40.0, 0.2 * 12])


def test_a_seed_makes_the_same_noise_and_another_another():
    env, actions = make(SENSORS["metric-2"]), (3, 1)

    def driven(seed):
        return [env.reset(seed=seed)[0], *(env.step(a)[0] for a in actions)]

    np.testing.assert_array_equal(driven(4), driven(4))
    assert np.abs(driven(4)[0] - driven(5)[0]).max() > 0


def test_rows_are_missing_at_the_configured_rate_but_never_the_ego_s():
    env, gone = make(SensorModel(dropout=0.3)), []
    for seed in range(40):
        shown, _ = env.reset(seed=seed)
        there = env.unwrapped.observation_type.observe()[:, 0] > 0
        assert shown[0].any()
        gone += (~shown[there].any(axis=1))[1:].tolist()
    assert np.mean(gone) == pytest.approx(0.3, abs=0.08)


def test_a_delayed_observation_is_that_of_so_many_decisions_ago():
    late, exact = make(SensorModel(delay=2)), gym.make("highway-fast-v0", config={"observation": SEEN})
    shown, past = [late.reset(seed=3)[0]], [exact.reset(seed=3)[0]]
    for _ in range(5):
        shown.append(late.step(1)[0])
        past.append(exact.step(1)[0])
    assert late.sensor_delay == 10
    for k in range(6):
        np.testing.assert_array_equal(shown[k][1:], past[max(k - 2, 0)][1:])
        np.testing.assert_array_equal(shown[k][0], past[k][0])


def test_supervised_frames_are_observed_through_the_sensor():
    """At each frame anew, and never from the simulator's state."""
    env, asked = make(SENSORS["metric-0.5"]), []
    inner = env.observation
    env.observation = lambda observation: asked.append(env.unwrapped.steps) or inner(observation)
    shielded = ShieldedEnv(env, perception="observation")
    shielded.reset(seed=0)
    asked.clear()
    shielded.step(3)
    assert set(asked) >= {1, 2, 3, 4, 5}
    assert shielded.filter.reader.perception.config.noise == (0.5, 0.5, 0.5, 0.5)


@pytest.mark.parametrize("seed", range(500, 502))
def test_the_shielded_ego_does_not_crash_with_half_a_metre_of_noise(seed):
    variant = ShieldVariant(placement="env", perception="observation")
    record = run_episode("highway-fast-seen", "faster", variant, seed, sensor="metric-0.5")
    assert not record.crashed
    assert record.placement == "env, observation"


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"sigma": {"heading": 0.1}}, "x, y, vx, vy"),
        ({"sigma": {"x": -1.0}}, "from 0 on"),
        ({"dropout": 1.0}, "dropout"),
        ({"delay": -1}, "delay"),
    ],
)
def test_invalid_noise_settings_are_refused(options, match):
    with pytest.raises(ConfigError, match=match):
        SensorModel(**options)


def test_the_command_line_names_every_sensor():
    assert tuple(SENSORS) == SENSOR_NAMES


def test_an_unknown_sensor_is_answered_with_the_valid_ones():
    with pytest.raises(ConfigError, match=r"unknown sensor 'radar'; have exact, metric-0\.5"):
        get_sensor("radar")


def test_noise_of_any_size_has_a_name():
    sensor = get_sensor("normalised-0.35")
    assert sensor.normalised
    assert dict(sensor.sigma) == dict.fromkeys(("x", "y", "vx", "vy"), 0.35)
    assert get_sensor("metric-0.5") == get_sensor("metric-0.50")


@pytest.mark.parametrize(
    "name", ["metric-", "metric--1", "normalised-inf", "normalised-1e", "heavy-1", "metric-0.5-late"]
)
def test_noise_of_no_size_has_none(name):
    with pytest.raises(ConfigError, match="metric-S"):
        get_sensor(name)
