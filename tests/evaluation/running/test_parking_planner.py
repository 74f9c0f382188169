"""Parking by name: the bundled models park, success is counted, and crashes and fast arrivals are distinguished."""

import math

import numpy as np
import pandas as pd
import pytest

from evaluation.measuring.metrics import summarise
from evaluation.report.table import SUMMARY, markdown
from evaluation.running.episodes import run_episode, run_paired
from evaluation.running.named_policies import make_policy
from evaluation.running.parking_planner import PARKING_POLICIES, load, parking_policy
from evaluation.running.records import ShieldVariant
from evaluation.settings import get_setting
from mpc.tasks.notebook import NotebookModel, NotebookPolicy
from shield.errors import ConfigError


@pytest.mark.parametrize("policy", ["cem", "cem-fast", "cem-oracle"])
def test_planners_park_and_the_record_says_so(policy):
    record = run_episode("parking", policy, seed=61)
    assert record.success is True
    assert record.arrival_speed < 1.0
    assert not record.crashed
    assert not record.off_road


def test_records_do_not_depend_on_earlier_episodes():
    seeds = [71, 72]
    together = run_paired("parking", "cem", [ShieldVariant()], seeds)
    alone = run_episode("parking", "cem", seed=72)
    assert together.loc[1, "return"] == alone.return_
    assert together.loc[1, "steps"] == alone.steps


def test_a_throttle_alone_ends_at_the_wall():
    record = run_episode("parking", "throttle", seed=5)
    assert record.crashed
    assert record.success is False
    assert math.isnan(record.arrival_speed)
    assert record.min_gap == 0.0


def test_the_spot_to_be_reached_is_nothing_to_collide_with():
    record = run_episode("parking", "cem-oracle", seed=61)
    assert record.min_gap > 0.2


def test_roads_have_no_success():
    record = run_episode("highway-fast", "slower", seed=5)
    assert record.success is None
    (row,) = summarise(pd.DataFrame([record.row()])).to_dict("records")
    assert math.isnan(row["success_rate"])
    assert math.isnan(row["stopped_rate"])


def test_success_and_stopped_success_are_rates_of_their_own():
    row = run_episode("parking", "throttle", seed=5).row()
    rows = [
        {**row, "seed": seed, "success": success, "arrival_speed": speed}
        for seed, (success, speed) in enumerate([(True, 0.4), (True, 2.5), (True, 0.99), (False, math.nan)])
    ]
    frame = summarise(pd.DataFrame(rows))
    (summary,) = frame.to_dict("records")
    assert summary["success_rate"] == 0.75
    assert summary["stopped_rate"] == 0.5
    assert summary["success_rate_low"] < 0.75 < summary["success_rate_high"]
    assert "| 75.0 [" in markdown(frame, SUMMARY)


def test_the_notebooks_policy_repeats_itself_and_needs_no_graph():
    env = get_setting("parking").make()
    observation, _ = env.reset(seed=81)
    actions = []
    for inference in (False, True, True):
        policy = NotebookPolicy(NotebookModel(seed=3), inference=inference)
        policy.predict(observation, episode_start=np.array([True]))
        actions.append(policy.predict(observation, episode_start=np.array([True]))[0])
    assert np.array_equal(actions[0], actions[1])
    assert np.array_equal(actions[1], actions[2])
    assert env.action_space.contains(actions[0])


def test_names_are_policies_of_the_evaluation():
    env = get_setting("parking").make()
    observation, _ = env.reset(seed=91)
    for name in PARKING_POLICIES:
        action, _ = make_policy(name, env).predict(observation)
        assert env.action_space.contains(action)
    with pytest.raises(ConfigError, match="have cem, cem-fast"):
        parking_policy("parker", env)
    with pytest.raises(ConfigError, match="parking-v0"):
        make_policy("cem-oracle", get_setting("highway-continuous").make())


def test_the_bundled_macro_steps_are_close_to_the_true_model():
    from dynamics.learned.models.bicycle import BicycleModel

    fast, generator = load()[0], np.random.default_rng(0)
    heading, speed = generator.uniform(-np.pi, np.pi, 200), generator.uniform(-5, 5, 200)
    c, s = np.cos(heading), np.sin(heading)
    states = np.stack([generator.uniform(-30, 30, 200), generator.uniform(-15, 15, 200), speed * c, speed * s, c, s], 1)
    actions = generator.uniform(-1, 1, (200, 2, 2))
    error = fast.rollout_held(states, actions, 4) - BicycleModel().rollout_held(states, actions, 4)
    assert np.median(np.hypot(error[..., 0], error[..., 1])) < 0.15
