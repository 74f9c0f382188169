"""Intervals contain their estimates and shrink with more samples; an invalid sample is refused."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evaluation.measuring.statistics import (
    Interval,
    bootstrap_mean,
    interquartile_mean,
    mcnemar,
    nested_bootstrap,
    paired_difference,
    paired_rate_difference,
    quantiles,
    wilson,
)
from shield.errors import ConfigError

counts = st.integers(1, 2000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n)))
samples = st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=30)


@given(counts)
def test_a_wilson_interval_contains_its_rate_and_stays_within_0_and_1(pair):
    interval = wilson(*pair)
    assert interval.estimate == pair[0] / pair[1]
    assert -1e-12 <= interval.low <= interval.estimate + 1e-12
    assert interval.estimate - 1e-12 <= interval.high <= 1 + 1e-12
    assert interval.n == pair[1]


@given(counts)
def test_a_wilson_interval_mirrors_when_successes_and_failures_swap(pair):
    k, n = pair
    a, b = wilson(k, n), wilson(n - k, n)
    assert a.low == pytest.approx(1 - b.high, abs=1e-9)


@given(counts, st.integers(2, 20))
def test_more_episodes_at_the_same_rate_narrow_the_interval(pair, factor):
    k, n = pair
    few, many = wilson(k, n), wilson(k * factor, n * factor)
    assert many.high - many.low < few.high - few.low


def test_no_crash_in_ten_is_a_wide_interval():
    assert wilson(0, 10).high == pytest.approx(0.2775, abs=1e-4)


@settings(max_examples=40, deadline=None)
@given(samples)
def test_a_bootstrap_interval_is_ordered_and_reproducible(values):
    interval = bootstrap_mean(values)
    assert interval == bootstrap_mean(values)
    assert interval.estimate == pytest.approx(np.mean(values))
    assert min(values) - 1e-9 <= interval.low <= interval.high <= max(values) + 1e-9


def test_a_bootstrap_interval_covers_the_true_mean_about_as_often_as_it_says():
    rng = np.random.default_rng(1)
    inside = 0
    for _ in range(60):
        interval = bootstrap_mean(rng.normal(3.0, 1.0, 40))
        inside += interval.low <= 3.0 <= interval.high
    assert inside >= 50


def test_samples_without_spread_and_single_samples():
    assert bootstrap_mean([2.0, 2.0, 2.0]) == Interval(2.0, 2.0, 2.0, 3)
    single = bootstrap_mean([2.0])
    assert single.estimate == 2.0
    assert math.isnan(single.low)


@settings(max_examples=15, deadline=None)
@given(samples, st.floats(-50, 50))
def test_a_paired_difference_of_a_shift_is_the_shift(values, shift):
    first = np.asarray(values) + shift
    interval = paired_difference(first, values)
    assert interval.estimate == pytest.approx(shift, abs=1e-9)


@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=60))
def test_a_paired_rate_difference_contains_its_estimate_and_is_never_certain(pairs):
    first, second = (np.array(side) for side in zip(*pairs, strict=True))
    interval = paired_rate_difference(first, second)
    assert interval.estimate == pytest.approx(first.mean() - second.mean())
    assert -1 <= interval.low <= interval.estimate <= interval.high <= 1
    assert interval.low < interval.high
    mirrored = paired_rate_difference(second, first)
    assert mirrored.low == pytest.approx(-interval.high)


@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=60))
def test_mcnemar_is_symmetric_and_only_looks_at_discordant_pairs(pairs):
    first, second = (np.array(side) for side in zip(*pairs, strict=True))
    forward, backward = mcnemar(first, second), mcnemar(second, first)
    assert forward.p_value == pytest.approx(backward.p_value)
    assert forward.only_first == backward.only_second
    padded = mcnemar(np.append(first, True), np.append(second, True))
    assert padded.p_value == pytest.approx(forward.p_value)
    assert 0 < forward.p_value <= 1


def test_quantiles():
    assert quantiles([1.0, 2.0, 3.0], (0.5,)) == (2.0,)
    assert all(math.isnan(q) for q in quantiles([]))


@pytest.mark.parametrize("bad", [[], [1.0, float("nan")], [[1.0]]])
def test_an_invalid_sample_is_refused(bad):
    with pytest.raises(ConfigError):
        bootstrap_mean(bad)


def test_unequal_pairs_and_impossible_counts_are_refused():
    with pytest.raises(ConfigError, match="equal lengths"):
        paired_difference([1.0], [1.0, 2.0])
    with pytest.raises(ConfigError, match="5 of 3"):
        wilson(5, 3)


def test_a_nested_bootstrap_includes_the_variance_between_groups():
    """Two groups with crash rates 0 and 1 say little of a third; the pooled interval is far too narrow."""
    groups = [np.zeros(500), np.ones(500)]
    nested, pooled = nested_bootstrap(groups), bootstrap_mean(np.concatenate(groups))
    assert (nested.low, nested.high) == (0.0, 1.0)
    assert pooled.high - pooled.low < 0.1
    assert nested.estimate == pooled.estimate == 0.5
    assert nested == nested_bootstrap(groups)


def test_a_nested_bootstrap_of_one_group_is_the_bootstrap():
    samples = np.random.default_rng(1).normal(size=400)
    one, other = nested_bootstrap([samples]), bootstrap_mean(samples)
    assert one.estimate == pytest.approx(other.estimate)
    assert (one.low, one.high) == pytest.approx((other.low, other.high), abs=0.02)


def test_a_nested_bootstrap_takes_another_statistic():
    groups = [np.array([0.0, 1.0, 3.0, 100.0])] * 3
    assert nested_bootstrap(groups, interquartile_mean).estimate == pytest.approx(2.0)
    with pytest.raises(ConfigError, match="at least one group"):
        nested_bootstrap([])
