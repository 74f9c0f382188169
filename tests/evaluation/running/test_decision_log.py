"""The columns of an episode that summarise its decisions, and the columns of a decision."""

from __future__ import annotations

import math

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluation import settings as named
from evaluation.running.decision_log import MEASURED, DecisionLog, action_steps
from evaluation.running.driver import Driver, DriverSpec
from evaluation.running.episodes import run_episode
from evaluation.running.records import ShieldVariant
from evaluation.settings import Setting, get_setting
from evaluation.wrappers import PerformanceLogger
from shield import ShieldedEnv
from shield.decision import Decision, Reason, Tier

LABELS = {0: "LANE_LEFT", 1: "IDLE", 2: "LANE_RIGHT", 3: "FASTER", 4: "SLOWER"}


def distances(env, proposed, executed):
    """The three distances of one decision, as columns."""
    log = DecisionLog(env)
    decision = Decision(proposed, executed, Reason.NONE, Tier.PASSED, math.nan, 0.0)
    log.add(None, proposed, 0.0, {}, decision)
    return log.distances()[0].tolist()


@given(st.sampled_from(sorted(LABELS)), st.sampled_from(sorted(LABELS)))
def test_the_distance_of_meta_actions_is_that_of_their_targets(one, other):
    """Symmetric, 0 for the same action alone, and lanes plus steps of speed: LANE_LEFT to SLOWER is 2."""
    steps = action_steps(LABELS)
    distance = np.abs(steps[one] - steps[other]).sum()
    assert (distance == 0) == (one == other)
    assert np.abs(action_steps({0: "LANE_LEFT", 1: "SLOWER"})[0] - action_steps(LABELS)[4]).sum() == 2
    assert distance <= 2


def test_the_distance_of_inputs_is_in_their_units():
    """Full braking instead of full throttle is 10 m/s² and one whole range; an invalid action has no distance."""
    env = gym.make("racetrack-v0", config={"action": {"type": "ContinuousAction"}})
    env.reset(seed=0)
    apart = distances(env, np.array([1.0, 0.0]), np.array([-1.0, 0.0]))
    assert apart == pytest.approx([1.0, 10.0, 0.0])
    apart = distances(env, np.array([0.0, 0.0]), np.array([0.0, 1.0]))
    assert apart == pytest.approx([0.5, 0.0, np.pi / 4])
    assert np.isnan(distances(env, np.array([np.nan, 0.0]), np.array([0.0, 1.0]))).all()
    env.close()
    env = get_setting("highway-fast").make()
    env.reset(seed=0)
    assert distances(env, 0, 4)[0] == 2.0
    assert np.isnan(distances(env, 0, 4)[1:]).all()
    assert np.isnan(distances(env, 9, 4)).all()
    env.close()


@pytest.mark.parametrize("simulator", ["highway-env", "compiled"])
def test_the_columns_are_the_metrics_of_the_performance_logger(simulator):
    """The same episode through `PerformanceLogger`; the compiled copy gives the columns of highway-env itself."""
    setting = Setting("short", "highway-fast-v0", {"duration": 12})
    record = run_episode(setting, "random", ShieldVariant("env"), 100_003, simulator=simulator)
    env = PerformanceLogger(setting.make())
    driver = Driver(DriverSpec(setting, "random", ShieldVariant("env"), simulator="highway-env"))
    driver.env = ShieldedEnv(env, ShieldVariant("env").config, policy=driver.policy)
    assert driver.run(100_003).return_ == record.return_
    logged = env.episodes().iloc[0]
    assert record.mean_reward == pytest.approx(logged["mean_reward"], rel=1e-12)
    assert record.peak_reward == logged["peak_reward"]
    assert record.mean_normalised_speed == pytest.approx(logged["mean_speed_normalised"], rel=1e-12)
    assert record.on_lane_share == logged["on_lane_rate"]
    assert record.mean_normalised_jerk == pytest.approx(logged["mean_jerk_normalised"], rel=1e-6)
    assert record.peak_normalised_jerk == pytest.approx(logged["peak_jerk_normalised"], rel=1e-6)
    assert record.peak_speed >= logged["peak_speed"]


def test_latencies_and_overrides_of_an_episode_are_those_of_its_decisions():
    record = run_episode("highway-fast", "random", ShieldVariant("env"), 100_005)
    assert record.latency_p50_ms == np.quantile(record.latencies, 0.5)
    assert record.latency_p99_ms == np.quantile(record.latencies, 0.99)
    assert record.latency_max_ms == max(record.latencies)
    assert 0 < record.frame_override_share == record.frames_overridden / record.frames
    bare = run_episode("highway-fast", "random", ShieldVariant(), 100_005)
    assert math.isnan(bare.latency_p50_ms)
    assert bare.input_distance == bare.frame_override_share == 0.0


@pytest.mark.parametrize(("sensor", "there"), [("exact", False), ("normalised-0.5+confidence+intent", True)])
def test_the_mean_confidence_is_that_of_the_rows_shown(sensor, there):
    """The mean of the column "confidence", whatever channel follows it; NaN without that column."""
    driver = Driver(DriverSpec(get_setting("highway-fast"), "idle", ShieldVariant(), sensor=sensor))
    seen = []
    predict = driver.driver.predict
    driver.driver.predict = lambda obs, *a, **k: seen.append(obs) or predict(obs, *a, **k)
    record = driver.run(100_007)
    driver.env.close()
    if not there:
        assert math.isnan(record.mean_confidence)
        return
    means = [rows[np.abs(rows[:, :5]).max(axis=1) > 0, 5].mean(dtype=float) for rows in seen]
    assert record.mean_confidence == pytest.approx(np.mean(means))
    assert 0 < record.mean_confidence < 1


def test_every_road_has_the_columns():
    """A number in each column that its definition names for that road."""
    for name in ("roundabout", "parking", "racetrack"):
        assert name in named.SETTINGS
        row = run_episode(name, "random", ShieldVariant(), 100_001).row()
        assert set(MEASURED) <= row.keys()
        assert math.isfinite(row["mean_reward"])
        assert 0 <= row["on_lane_share"] <= 1
        assert math.isfinite(row["acceleration_distance"]) == (name != "roundabout")
