"""Innovations of a sensor give its noise, the width of bounds, and an alarm where it has changed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from observed_roads import ROAD, SEEN, make

from dynamics.scenes.scene import EgoControl, Target
from evaluation.wrappers import SENSORS, SensorNoise
from shield import ConfigError, PerceptionConfig, ShieldedEnv
from shield.decision import Guarantee
from shield.perception.filters import SCORE_LIMIT
from shield.perception.learned import RESOLUTION, WIDEST, Conformal, Learned, Noise
from shield.perception.perceiving import ObservationPerception
from shield.perception.sensor_monitor import SensorMonitor
from shield.perception.spec import ObservationSpec

CONTROL = EgoControl(Target(1, 25.0))


def driven(sensor, decisions, seed=0, **config):
    """An environment driven for a number of decisions, and its perception."""
    env = ShieldedEnv(SensorNoise(make({**SEEN}), SENSORS[sensor]), perception=PerceptionConfig(**config))
    env.reset(seed=seed)
    for _ in range(decisions):
        *_, terminated, truncated, _ = env.step(3)
        if terminated or truncated:
            env.reset(seed=seed + 1)
    return env, env.filter.reader.perception


# -- how noisy it is -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sensor", "sigma"), [("metric-0.5", [0.5] * 4), ("metric-2", [2.0] * 4), ("normalised-0.2", [40, 2.4, 16, 16])]
)
def test_the_noise_is_estimated_from_some_hundred_vehicles_while_the_shield_acts(sensor, sigma):
    _, perception = driven(sensor, 12, seed=5000, noise="estimate")
    assert 100 < perception.learned.noise.count < 600
    np.testing.assert_allclose(perception.noise, sigma, rtol=0.2)


def test_bounds_of_estimated_noise_are_those_of_given_noise():
    """They are equally wide, to 30 percent."""
    widths = []
    for config in ({"noise": "estimate"}, {}):
        env, _ = driven("metric-2", 12, **config)
        scene = env.filter.reader.read()
        widths.append(np.median(scene.others[scene.ids >= 0, 4]) - 5.0)
    assert widths[0] == pytest.approx(widths[1], rel=0.3)


@given(st.integers(0, 10**6), st.integers(1, 400), st.floats(0.05, 20.0))
@settings(max_examples=50, deadline=None)
def test_noise_is_not_underestimated_from_few_observations(seed, n, sigma):
    """The upper end of the interval is above the root mean square, the more so the fewer were seen."""
    rng = np.random.default_rng(seed)
    steps = np.clip(rng.normal(0, sigma * np.sqrt(2), (n, 4)), -100, 100)
    found = Noise().after(steps).sigma
    rough = np.sqrt(0.5 * np.square(steps).mean(axis=0))
    assert (found >= np.minimum(rough, WIDEST) - 1e-9).all()
    assert (found <= WIDEST).all()
    fewer = Noise().after(steps[: n // 2]).after(steps[: n // 2])
    assert fewer.count <= n
    assert (Noise().sigma == WIDEST).all()
    assert (Noise().after(np.zeros((500, 4))).sigma == RESOLUTION).all()


def test_a_sensor_that_gets_worse_is_detected():
    rng, noise = np.random.default_rng(0), Noise()
    for k in range(400):
        sigma = 0.5 if k < 200 else 2.0
        noise = noise.after(rng.normal(0, sigma * np.sqrt(2), (10, 4)))
        if k in (199, 399):
            np.testing.assert_allclose(noise.sigma, sigma, rtol=0.2)


def test_no_noise_estimate_exists_before_an_observation():
    """The first scene of an unknown sensor is as wide as the worst sensor makes it."""
    perception = ObservationPerception(
        ObservationSpec(rows=2, see_behind=True), ROAD, (0.2, 5), PerceptionConfig(noise="estimate")
    )
    seen = np.array([[1, 0.0, 4.0, 21.0, 0.0], [1, 40.0, 0.0, 0.0, 0.0]])
    scene = perception.see(seen, 0, CONTROL)
    assert scene.others[0, 4] > 2 * 2 * 0.9 * WIDEST[0]
    assert scene.blurred
    assert perception.rating[0] is Guarantee.PROBABILISTIC


@pytest.mark.parametrize("carry", [True, False])
def test_the_estimate_is_carried_to_the_next_episode_if_configured(carry):
    env, perception = driven("metric-2", 3, noise="estimate", bounds="conformal", carry=carry)
    learned = perception.learned
    assert learned.noise.count > 20
    env.reset(seed=5)
    again = env.filter.reader
    again.read()
    now = again.perception.learned
    assert (now.noise.count >= learned.noise.count) == carry
    perception.reset()
    assert (perception.learned is learned) == carry


# -- how far away bounds have to be ----------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["normal", "tails", "biased", "jumps", "adversary"])
def test_the_chosen_share_exceeds_conformal_bounds_for_any_distribution(kind):
    """Also for scores whose distribution changes, or depends on the bounds."""
    rng, state, missed, total = np.random.default_rng(3), Conformal.of(2.0), np.zeros((2, 4)), 0
    for k in range(800):
        scores = rng.standard_t(3, (10, 4)) if kind == "tails" else rng.standard_normal((10, 4))
        if kind == "biased":
            scores += 1.0
        elif kind == "jumps":
            scores *= 1.0 + (k // 200) % 2
        elif kind == "adversary":
            scores *= 4.0 / state.bounds[1]
        scores = np.clip(scores, -SCORE_LIMIT, SCORE_LIMIT)
        if k >= 200:
            missed, total = missed + state.missed(scores).sum(axis=1), total + len(scores)
        state = state.after(scores)
    np.testing.assert_allclose(missed / total, state.chosen, atol=0.01)


def test_bounds_begin_as_those_of_a_normal_distribution_and_grow_with_tails():
    state = Conformal.of(2.0)
    np.testing.assert_allclose(state.bounds, 2.0, atol=0.05)
    rng = np.random.default_rng(0)
    for _ in range(300):
        state = state.after(np.clip(1.73 * rng.standard_t(3, (10, 4)), -SCORE_LIMIT, SCORE_LIMIT))
    assert (state.bounds > 3.0).all()


def test_the_widest_bounds_do_not_grow():
    state = Conformal.of(2.0)
    for _ in range(50):
        state = state.after(np.full((10, 4), SCORE_LIMIT))
    assert state.missed(np.full((3, 4), SCORE_LIMIT))[1].all()
    assert (state.bounds[1] == SCORE_LIMIT).all()


def test_bodies_reach_as_far_as_the_conformal_bounds_say():
    spec = ObservationSpec(rows=2, see_behind=True)
    learned = Learned(conformal=Conformal(0.02, np.full((2, 4), -1.0)))
    sizes = []
    for config, before in (({}, None), ({"bounds": "conformal"}, None), ({"bounds": "conformal"}, learned)):
        settled = PerceptionConfig(noise=(1.0,) * 4, **config)
        perception = ObservationPerception(spec, ROAD, (0.2, 5), settled, before)
        seen = np.array([[1, 0.0, 4.0, 21.0, 0.0], [1, 40.0, 0.0, 0.0, 0.0]])
        sizes.append(perception.see(seen, 0, CONTROL).others[0, 4:6])
    np.testing.assert_allclose(sizes[0], sizes[1], rtol=0.02)
    assert (sizes[2] > sizes[1] + 5.0).all()


# -- whether it has changed ------------------------------------------------------------------------------------


@given(st.integers(0, 10**6), st.integers(4, 15))
@settings(max_examples=60, deadline=None)
def test_noise_three_times_as_large_raises_an_alarm_and_expected_noise_does_not(seed, vehicles):
    """The squared distances between prediction and observation are those of four normal numbers each."""
    rng, calm, loud = np.random.default_rng(seed), SensorMonitor(), SensorMonitor()
    for frame in range(5):
        distances = rng.chisquare(4, vehicles)
        calm, loud = calm.after(frame, distances, 5), loud.after(frame, 6.0 * distances, 5)
    assert not calm.alarmed
    assert loud.alarmed


def test_a_single_swerving_vehicle_raises_no_alarm():
    rng, monitor = np.random.default_rng(0), SensorMonitor()
    for frame in range(5):
        monitor = monitor.after(frame, np.concatenate([[1e4], rng.chisquare(4, 7)]), 5)
    assert not monitor.alarmed


def test_observations_older_than_a_decision_do_not_count_for_the_alarm():
    monitor = SensorMonitor()
    for frame in range(5):
        monitor = monitor.after(frame, np.full(10, 30.0), 5)
    assert monitor.alarmed
    for frame in range(5, 10):
        monitor = monitor.after(frame, np.full(10, 2.0), 5)
    assert not monitor.alarmed
    assert not SensorMonitor().alarmed


def test_a_changed_sensor_gets_the_widest_bounds_and_no_guarantee():
    env, perception = driven("metric-2", 3, monitor=True)
    assert not env.last_decision.alarm
    before = env.filter.reader.read()
    env.env._range_shares = 3.0 * env.env._range_shares
    *_, info = env.step(3)
    env.step(3)
    assert perception.alarmed
    assert env.last_decision.alarm
    assert perception.rating == (Guarantee.NONE, 0.0)
    assert env.last_decision.scene_guarantee is env.last_decision.guarantee is Guarantee.NONE
    assert info["shield"]["guarantee"] == "none"
    scene = env.filter.reader.read()
    assert (scene.ids == -1).all()
    assert np.median(scene.others[:, 4]) > np.median(before.others[:, 4]) + 4.0
    env, perception = driven("metric-2", 3)
    env.env._range_shares = 3.0 * env.env._range_shares
    env.step(3)
    assert not env.last_decision.alarm


@pytest.mark.parametrize(
    ("bad", "match"),
    [
        ({"noise": "guess"}, '"estimate"'),
        ({"noise": (1.0, 1.0)}, "four numbers"),
        ({"noise": (1.0, -1.0, 1.0, 1.0)}, "four numbers"),
        ({"bounds": "wide"}, "have gaussian, conformal"),
    ],
)
def test_settings_are_checked(bad, match):
    with pytest.raises(ConfigError, match=match):
        PerceptionConfig(**bad)
