"""Episodes of a batch equal those driven one after another."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynamics.traffic.assumptions import Assumptions
from evaluation.measuring.rectangles import separation
from evaluation.measuring.tally import distance
from evaluation.running import certify as certifying
from evaluation.running.batch_episodes import UNMEASURED, Many
from evaluation.running.certify import CertifyRun, certify
from evaluation.running.episodes import run_paired
from evaluation.running.named_policies import RandomActions, make_policy
from evaluation.running.records import ShieldVariant
from evaluation.settings import Setting, get_setting
from shield import ConfigError, ShieldConfig
from shield.config import Buffer

# A shield that refuses nothing, so that crashes occur.
CARELESS = ShieldConfig(
    buffer=Buffer(0.0, 0.0),
    assumptions=Assumptions(
        braking=0.1, comfortable_braking=0.1, acceleration=0.1, max_speed=10.0, simultaneous_merge=False, cut_in=False,
        turning_loss=0.0, turning_action=0.0, turning_action_in_one_second=0.0, reversing_speed=0.0,
        visible_distance=1.0,
    ),
)  # fmt: skip
DENSE = Setting("dense", "highway-fast-v0", {"vehicles_density": 2.5, "duration": 12})


@pytest.mark.parametrize(
    ("setting", "policy", "config", "crashes"),
    [
        (get_setting("highway-fast"), "faster", ShieldConfig(), False),
        (get_setting("highway-fast"), "random", ShieldConfig(), False),
        (get_setting("highway-fast"), "weaving", ShieldConfig(), False),
        (get_setting("highway-fast"), "ppo-highway-fast", ShieldConfig(), False),
        (DENSE, "weaving", CARELESS, True),
    ],
)
def test_episodes_of_a_batch_are_those_of_single_runs(setting, policy, config, crashes):
    """Each measured column is equal, and each other column is NaN."""
    seeds = range(300, 312)
    alone = run_paired(setting, policy, [ShieldVariant("env", config)], seeds, simulator="compiled")
    alone = alone[list(certifying.COLUMNS)].assign(fallbacks=alone[certifying.FALLBACKS].sum(axis=1))
    together = Many(setting, policy, config, envs=6).run(seeds)
    pd.testing.assert_series_equal(alone.pop("mean_speed"), together.pop("mean_speed"), rtol=1e-12)
    pd.testing.assert_series_equal(alone.pop("min_gap"), together.pop("min_gap"), rtol=1e-9, atol=1e-9)
    assert together[list(UNMEASURED)].isna().all().all()
    alone = alone.drop(columns=list(UNMEASURED))
    pd.testing.assert_series_equal(alone.pop("mean_reward"), together.pop("mean_reward"), rtol=1e-12)
    speeds = [frame.pop("mean_normalised_speed") for frame in (alone, together)]
    pd.testing.assert_series_equal(*speeds, rtol=1e-12)
    pd.testing.assert_frame_equal(
        alone, together[[each for each in together if each not in UNMEASURED]], check_like=True, check_dtype=False,
        check_exact=True,
    )  # fmt: skip
    assert together["input_distance"].sum() > 0
    assert together["crashed"].any() == crashes
    assert together["overridden"].sum() > 0


@given(st.integers(0, 2**32 - 1))
def test_distances_are_those_of_polygons(seed):
    rng = np.random.default_rng(seed)
    one, other = np.zeros(7), np.zeros(7)
    for row in (one, other):
        row[:3] = rng.uniform([-8, -8, -4], [8, 8, 4])
        row[4:6] = rng.uniform(0.5, 12.0, 2)
    assert distance(one, other) == pytest.approx(float(separation(one[:6], other[:6])), abs=1e-9)


def test_crossed_rectangles_overlap():
    one, other = np.array([0.0, 0, 0, 0, 10, 1, 0]), np.array([0.0, 0, np.pi / 2, 0, 10, 1, 0])
    assert distance(one, other) == 0.0


def test_random_actions_are_known_when_the_episode_begins():
    policy = make_policy("random", get_setting("highway-fast").make())
    assert isinstance(policy, RandomActions)
    policy.reset(11)
    assert policy.plan(11, 40).tolist() == [int(policy.predict(None)[0]) for _ in range(40)]


@pytest.mark.parametrize("policy", ["lookahead", "mpc", "nobody"])
def test_a_policy_that_reads_the_simulator_is_refused_in_a_batch(policy):
    with pytest.raises(ConfigError, match="side by side"):
        Many(get_setting("highway-fast"), policy, ShieldConfig())


def test_certify_uses_the_batch_where_it_is_supported(tmp_path, monkeypatch):
    asked = CertifyRun(get_setting("highway-fast"), "faster", 6, 40, ShieldConfig(), "auto")
    driven = []
    monkeypatch.setattr(certifying, "run_paired", lambda *a, **k: driven.append(a) or pytest.fail("one at a time"))
    found = certify(asked, tmp_path / "fast")
    assert found["seed"].tolist() == list(range(40, 46))
    assert not driven
