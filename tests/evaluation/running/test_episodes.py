"""Episodes are reproducible, paired, and the same for any number of jobs."""

import math

import numpy as np
import pandas as pd
import pytest

from evaluation.running.episodes import RunOptions, run_episode, run_paired
from evaluation.running.records import ShieldVariant, make_variants
from evaluation.settings import get_setting
from shield import ShieldConfig
from shield.errors import ConfigError

SHORT = get_setting("highway-fast").override({"duration": 5}, name="highway-short")
SEEDS = range(100_000, 100_003)


@pytest.fixture(scope="module")
def episodes():
    variants = make_variants(["none", "rss", "full"], ["env"])
    return run_paired(SHORT, "faster", variants, SEEDS)


def _without_latencies(frame):
    return frame.drop(columns=[each for each in frame if each.startswith("latenc")])


def test_every_variant_drives_every_seed(episodes):
    assert len(episodes) == 9
    assert list(episodes["mode"]) == ["none"] * 3 + ["rss"] * 3 + ["full"] * 3
    assert list(episodes["seed"]) == [*SEEDS] * 3


def test_two_jobs_give_the_rows_of_a_single_job(episodes):
    variants = make_variants(["none", "rss", "full"], ["env"])
    again = run_paired(SHORT, "faster", variants, SEEDS, jobs=2)
    pd.testing.assert_frame_equal(_without_latencies(again), _without_latencies(episodes))


def test_a_single_episode_is_the_row_of_the_table(episodes):
    record = run_episode(SHORT, "faster", ShieldVariant("env", ShieldConfig()), seed=100_001).row()
    row = episodes[(episodes["mode"] == "full") & (episodes["seed"] == 100_001)].iloc[0]
    for key, value in record.items():
        if not key.startswith("latenc"):
            assert value == row[key] or (value != value and row[key] != row[key]), key


def test_the_columns_add_up(episodes):
    reasons = [c for c in episodes if c.startswith("reason_")]
    tiers = [c for c in episodes if c.startswith("tier_")]
    assert (episodes[reasons].sum(axis=1) == episodes["steps"]).all()
    assert (episodes[tiers].sum(axis=1) == episodes["steps"]).all()
    assert (episodes["overridden"] <= episodes["steps"]).all()
    assert (episodes["frames_overridden"] <= episodes["frames"]).all()
    assert ((episodes["attribution"] == "none") == ~episodes["crashed"]).all()
    np.testing.assert_allclose(episodes["distance"] / episodes["duration"], 28, atol=9)


def test_latencies_are_kept_for_each_decision_of_the_shield(episodes):
    for row in episodes.itertuples():
        expected = 0 if row.placement == "none" else row.steps
        assert len(row.latencies_ms) == expected
        assert all(x >= 0 for x in row.latencies_ms)


def test_unshielded_rows_have_no_margin_and_no_override(episodes):
    bare = episodes[episodes["placement"] == "none"]
    assert bare["min_margin"].isna().all()
    assert (bare["overridden"] == 0).all()
    assert (bare["tier_off"] == bare["steps"]).all()


WHEEL = get_setting("highway-continuous").override({"duration": 10, "vehicles_count": 12}, name="wheel-short")


@pytest.mark.parametrize("policy", ["throttle", "random"])
def test_throttle_and_steering_are_driven_with_and_without_a_shield(policy):
    frame = run_paired(WHEEL, policy, make_variants(["none", "full"], ["env"]), range(3, 5))
    bare, shielded = frame[frame["placement"] == "none"], frame[frame["placement"] == "env"]
    assert (bare["off_road"] | bare["crashed"]).any(), "the policy is a bad driver"
    assert not (shielded["off_road"] | shielded["crashed"]).any()
    assert (shielded["steps"] >= 100).all()
    assert (shielded["frames"] == 2 * shielded["steps"]).all()
    assert (shielded["overridden"] > 0).all()
    assert (shielded["mean_jerk"] > 0).all()
    assert shielded["laps"].isna().all()
    assert [len(row) for row in shielded["latencies_ms"]] == list(shielded["steps"])


def test_recording_does_not_depend_on_the_shield():
    alone = run_episode(WHEEL, "throttle", seed=4)
    watched = run_episode(WHEEL, "throttle", ShieldVariant("env", ShieldConfig(mode="none")), seed=4)
    for name in ("return_", "crashed", "off_road", "distance", "mean_jerk", "mean_lateral_acceleration", "attribution"):
        assert getattr(alone, name) == getattr(watched, name), name


def test_random_policies_are_paired_too():
    first = run_episode(SHORT, "random", seed=5)
    second = run_episode(SHORT, "random", seed=5)
    assert first == second
    assert not math.isnan(first.return_)


def test_variants_name_each_combination_once():
    variants = make_variants(["none", "full", "none", "ttc"], ["env", "policy"])
    assert [(v.placement, v.mode) for v in variants] == [
        ("none", "none"),
        ("env", "full"),
        ("policy", "full"),
        ("env", "ttc"),
        ("policy", "ttc"),
    ]


def test_nothing_to_run_and_unknown_names_are_refused():
    with pytest.raises(ConfigError, match="nothing to run"):
        run_paired(SHORT, "faster", [], SEEDS)
    with pytest.raises(ConfigError, match="jobs"):
        run_paired(SHORT, "faster", [ShieldVariant()], SEEDS, jobs=0)
    with pytest.raises(ConfigError, match="valid are none, env, policy"):
        ShieldVariant("window")
    with pytest.raises(ConfigError, match="unknown shield mode"):
        make_variants(["fulll"], ["env"])


def test_keywords_that_moved_to_the_run_options_work_and_warn():
    drive = ("highway", "idle", [ShieldVariant()], [0])
    with pytest.warns(DeprecationWarning, match=r"pass run=RunOptions\(steps=...\)"):
        rows = run_paired(*drive, steps=True)
    assert rows["decisions"].equals(run_paired(*drive, run=RunOptions(steps=True))["decisions"])
    with pytest.raises(TypeError, match="no keyword stepz; run=RunOptions"):
        run_paired(*drive, stepz=True)
