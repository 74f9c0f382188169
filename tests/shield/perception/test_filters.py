"""The compiled filters equal the formulas."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from observed_roads import SEEN, make
from scipy.special import ndtr

from evaluation.wrappers import SENSORS, SensorNoise
from shield import ShieldedEnv
from shield.perception import filter_kernels, filters, tracking
from shield.perception.tracking import MotionModels

CENTERS = np.array([0.0, 4.0, 8.0, 12.0])


def agree(one, other):
    """To nine digits of the largest number."""
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-9 * max(np.abs(other).max(initial=0.0), 1.0))


@st.composite
def followed(draw):
    """A few vehicles, their observation and its noise. A seed draws the numbers, in realistic sizes."""
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    n, m, sigma = draw(st.integers(0, 6)), draw(st.integers(0, 6)), draw(st.sampled_from([0.03, 0.5, 2.0, 40.0]))
    chances = rng.dirichlet(np.ones(3), n).reshape(n, 3) + 1e-12
    means = rng.normal(0, [30.0, 4.0, 3.0, 1.0], (n, 1, 4)) + rng.normal(0, sigma, (n, 3, 4))
    half = rng.normal(0, sigma, (n, 3, 4, 4))
    covariances = half @ np.swapaxes(half, 2, 3) + 0.1 * sigma**2 * np.eye(4)
    noise = np.diag(np.square(sigma * rng.uniform(0.5, 2.0, 4)))
    seen = rng.normal(0, [30.0, 4.0, 3.0, 1.0], (m, 4))
    return chances, means, covariances, seen, noise, rng


@given(followed(), st.sampled_from([0.05, 0.2, 1.0]), st.booleans())
@settings(max_examples=40, deadline=None)
def test_the_compiled_filters_are_the_formulas(case, dt, lanes):
    chances, means, covariances, seen, noise, rng = case
    changes, course, pushed, centers = tracking._prediction_parameters(
        dt, MotionModels(centers=CENTERS if lanes else None)
    )
    step = course, pushed, centers
    both = filters, filter_kernels
    for one, other in zip(*(each.predict_state(means, covariances, *step) for each in both), strict=True):
        agree(other, one)
    for one, other in zip(*(each.mixture(chances, means, covariances) for each in both), strict=True):
        agree(other, one)
    ahead = filters.predict(chances, means, covariances, changes, *step)
    for one, other in zip(ahead, filter_kernels.predict(chances, means, covariances, changes, *step), strict=True):
        agree(other, one)
    for one, other in zip(*(each.distances(*ahead[1:], seen, noise) for each in both), strict=True):
        agree(other, one)
    places = rng.integers(0, 15, len(means)).astype(float), rng.integers(0, 15, len(seen)).astype(float)
    places[0][:1] = np.nan
    away = filters.distances(*ahead[1:], seen, noise)[0]
    for one, other in zip(*(each.costs(away, *places) for each in both), strict=True):
        agree(other, one)
    k = min(len(means), len(seen))
    rows, columns = rng.permutation(len(means))[:k], rng.permutation(len(seen))[:k]
    apart, pairs = filters.distances(*ahead[1:], seen, noise), filters.Matches(rows, columns)
    given = filters.Mixtures(*ahead), seen, noise, apart, pairs
    for one, other in zip(*(each.measurement_update(*given) for each in both), strict=True):
        agree(other, one)
    for one, other in zip(*(each.scores(*ahead, seen, noise, rows, columns) for each in both), strict=True):
        agree(other, one)
    bounds = rng.uniform(0.0, 5.0, (2, 4))
    for one, other in zip(*(each.quantiles(*ahead, bounds) for each in both), strict=True):
        agree(other, one)


@given(followed())
@settings(max_examples=30, deadline=None)
def test_the_quantile_that_is_found_is_exceeded_no_more_often_than_stated(case):
    """Not even by a rounding error."""
    chances, means, covariances, *_, rng = case
    chances = chances / chances.sum(axis=1, keepdims=True)
    bounds = rng.uniform(0.0, 6.0, (2, 4))
    spread = np.sqrt(np.einsum("njii->nji", covariances))
    low, high = filter_kernels.quantiles(chances, means, covariances, bounds)
    for sign, edge, bound in ((-1.0, low, bounds[0]), (1.0, high, bounds[1])):
        beyond = (chances[:, :, None] * ndtr(sign * (means - edge[:, None]) / spread)).sum(axis=1)
        assert (beyond <= ndtr(-bound) * (1 + 1e-9) + 1e-15).all()


@given(followed(), st.floats(0.1, 4.0))
@settings(max_examples=30, deadline=None)
def test_a_score_exceeds_a_bound_where_the_observation_exceeds_its_quantile(case, bound):
    chances, means, covariances, seen, noise, _ = case
    chances = chances / chances.sum(axis=1, keepdims=True)
    k = min(len(means), len(seen))
    rows = columns = np.arange(k)
    found = filter_kernels.scores(chances, means, covariances, seen, noise, rows, columns)
    low, high = filters.quantiles(chances, means, covariances + noise, np.full((2, 4), bound))
    clear = np.abs(np.abs(found) - bound) > 1e-6
    assert ((found > bound) == (seen[:k] > high[:k]))[clear].all()
    assert ((found < -bound) == (seen[:k] < low[:k]))[clear].all()


@pytest.mark.parametrize("sensor", ["exact", "metric-0.5", "metric-2-late"])
def test_an_episode_is_the_same_with_the_formulas(sensor, monkeypatch):
    found = []
    for each in (filter_kernels, filters):
        monkeypatch.setattr(tracking, "filters", each)
        inner = make(SEEN)
        env = ShieldedEnv(inner if sensor == "exact" else SensorNoise(inner, SENSORS[sensor]), perception="observation")
        env.reset(seed=7)
        seen = []
        for _ in range(6):
            env.step(3)
            scene = env.filter.reader.read()
            seen.append((env.last_decision.executed, scene.others))
        found.append(seen)
    for (one, others), (other, same) in zip(*found, strict=True):
        assert one == other
        np.testing.assert_allclose(others, same, rtol=1e-6, atol=1e-6)
