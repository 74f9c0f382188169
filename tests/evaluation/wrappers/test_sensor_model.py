"""Tails, bias, range, ghosts and a change of noise each have their documented effect, and no other."""

from __future__ import annotations

import math
from itertools import pairwise

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evaluation.names import SENSOR_NAMES
from evaluation.wrappers import SENSORS, SensorModel, SensorNoise
from shield import ShieldedEnv
from shield.errors import ConfigError
from shield.perception.spec import STATE, ObservationSpec

SEEN = {"type": "Kinematics", "vehicles_count": 15, "see_behind": True}
HALF = np.array([1.0, 200.0, 12.0, 80.0, 80.0])
"""Of the ranges of presence, x, y, vx and vy."""


def make(model, observation=SEEN, **config):
    return SensorNoise(gym.make("highway-fast-v0", config={"observation": observation, **config}), model)


def errors(model, times=300, seed=0, steps=None):
    """The error that the sensor adds at one instant, in m and m/s, (times, present rows, 5)."""
    env = make(model)
    env.reset(seed=seed)
    exact = env.unwrapped.observation_type.observe()
    if steps is not None:
        env.unwrapped.steps = steps
    shown = np.stack([env.observation(exact) for _ in range(times)])
    return ((shown - exact) * HALF)[:, np.abs(exact).max(axis=1) > 0]


def metres(env, shown):
    """x ahead of the ego, y, vx and vy in the world of the rows that are not empty but the ego's, (n, 4)."""
    spec = ObservationSpec.of(env)
    rows = shown[np.abs(shown).max(axis=1) > 0]
    half = np.array([spec.ranges[n][1] if n in spec.ranges else 1.0 for n in STATE])
    states = rows[:, [spec.features.index(n) for n in STATE]] * half
    if spec.absolute:
        states[1:, 0] -= states[0, 0]
    else:
        states[1:, 1:] += states[0, 1:]
    return states[1:]


@given(
    tails=st.sampled_from([math.inf, 3.0, 10.0]),
    change=st.none() | st.tuples(st.floats(0, 5), st.floats(0, 9)),
    ego=st.booleans(),
    normalised=st.booleans(),
    name=st.sampled_from(STATE),
    seed=st.integers(0, 50),
)
@settings(max_examples=15, deadline=None)
def test_a_sensor_without_errors_shows_the_exact_observation(tails, change, ego, normalised, name, seed):
    model = SensorModel({name: 0.0}, normalised, ego=ego, tails=tails, bias={name: 0.0}, range=1e3, change=change)
    env = make(model)
    shown, _ = env.reset(seed=seed)
    np.testing.assert_array_equal(shown, env.unwrapped.observation_type.observe())
    shown, *_ = env.step(1)
    np.testing.assert_array_equal(shown, env.unwrapped.observation_type.observe())


def test_normal_noise_is_drawn_as_it_always_was():
    """Figures rest on the draws of the seeds."""
    env = make(SensorModel({"x": 0.5, "vy": 0.25}))
    shown, _ = env.reset(seed=7)
    exact = env.unwrapped.observation_type.observe()
    drawn = np.random.default_rng([7, 1]).standard_normal(exact.shape)
    drawn[0] = 0.0
    there = (np.abs(exact).max(axis=1) > 0)[:, None]
    expected = exact + there * np.array([0.0, 0.5 / 200, 0.0, 0.0, 0.25 / 80]) * drawn
    np.testing.assert_array_equal(shown, expected.astype(np.float32))


def test_heavy_tails_have_the_configured_deviation_and_are_heavy():
    """Student's distribution with 3 degrees: narrower quartiles and more frequent outliers."""
    sigma = 0.5
    found = errors(SensorModel(dict.fromkeys(STATE, sigma), tails=3.0), times=1500)[:, 1:, 1:].ravel() / sigma
    assert len(found) > 4e4
    unit = math.sqrt(1 / 3)
    assert np.quantile(np.abs(found), 0.5) == pytest.approx(0.76489 * unit, rel=0.03)
    assert np.quantile(np.abs(found), 0.99) == pytest.approx(5.84091 * unit, rel=0.05)
    # Without a fourth moment the variance of a sample is no estimate.
    assert found.std() == pytest.approx(1.0, rel=0.15)
    normal = errors(SensorModel(dict.fromkeys(STATE, sigma)), times=1500)[:, 1:, 1:].ravel() / sigma
    assert (np.abs(normal) > 4).mean() < 1e-4 < 5e-3 < (np.abs(found) > 4).mean()


@pytest.mark.parametrize("normalised", [False, True])
def test_a_bias_affects_the_named_features_and_the_ego_if_configured(normalised):
    unit = 200.0 if normalised else 1.0
    for ego in (False, True):
        found = errors(SensorModel({"x": 1.0 / unit}, normalised, bias={"x": 2.0 / unit}, ego=ego), times=400)
        others, own = found[:, 1:], found[:, 0]
        assert others[:, :, 1].mean() == pytest.approx(2.0, abs=0.1)
        assert others[:, :, 1].std() == pytest.approx(1.0, rel=0.1)
        assert not others[:, :, [0, 2, 3, 4]].any()
        assert own[:, 1].mean() == pytest.approx(2.0 * ego, abs=0.2)


@pytest.mark.parametrize("absolute", [False, True])
def test_vehicles_are_shown_exactly_within_the_range(absolute):
    observation = {**SEEN, "absolute": absolute, "normalize": not absolute, "vehicles_count": 30}
    env, left_out = make(SensorModel(range=60.0), observation), 0
    for seed in range(6):
        shown, _ = env.reset(seed=seed)
        for _ in range(3):
            ego = env.unwrapped.vehicle
            ahead = [v.position[0] - ego.position[0] for v in env.unwrapped.road.vehicles if v is not ego]
            near = sorted(a for a in ahead if abs(a) <= 60)
            left_out += len(ahead) - len(near)
            np.testing.assert_allclose(np.sort(metres(env, shown)[:, 0]), near, atol=1e-3)
            shown, *_ = env.step(4)
    assert left_out > 30


def test_an_unseen_vehicle_is_assumed_beyond_the_range():
    """The shield assumes a slow vehicle right beyond the range, and its guarantee is reduced."""
    env = ShieldedEnv(make(SENSORS["range-60"]), perception="observation")
    env.reset(seed=0)
    reader = env.filter.reader
    scene = reader.read()
    assert reader.perception.edges == (60.0, 60.0)
    phantoms = scene.others_road[scene.ids < 0]
    assert (phantoms[:, 0] - scene.ego_road[0]).max() == pytest.approx(60.0, abs=6.0)
    *_, info = env.step(3)
    assert info["shield"]["guarantee"] != "all vehicles seen"


def test_ghosts_have_the_configured_rate_and_duration():
    rate, lasting, born, frames = 0.8, 3, 0, 0
    env = make(SensorModel(ghosts=rate, lasting=lasting), {**SEEN, "vehicles_count": 40})
    for seed in range(8):
        env.reset(seed=seed)
        exact = env.unwrapped.observation_type.observe()
        full = int((np.abs(exact).max(axis=1) > 0).sum())
        seen = []
        for k in range(1, 80):
            env.unwrapped.steps = k
            shown = env.observation(exact)
            np.testing.assert_array_equal(shown[:full], exact[:full])
            ghosts = metres(env, shown)[full - 1 :]
            assert (np.abs(ghosts[:, 0]) <= 200).all()
            assert ((ghosts[:, 1] >= -2.001) & (ghosts[:, 1] <= 10.001)).all()
            assert ((ghosts[:, 2] >= 14.999) & (ghosts[:, 2] <= 30.001)).all()
            seen.append({round(float(v), 3) for v in ghosts[:, 2]})
        for before, now in pairwise(seen):
            born += len(now - before)
            frames += 1
        lives = [sum(v in each for each in seen) for v in set().union(*seen[:60])]
        assert max(lives, default=0) <= lasting
        assert not lives or np.mean(lives) > 0.8 * lasting  # except ghosts that leave the range
    # 5 frames in a decision.
    expected = rate * frames / 5
    assert abs(born - expected) < 4 * math.sqrt(expected)


def test_a_ghost_moves_as_it_seems_to_and_is_the_same_by_the_same_seed():
    env = make(SensorModel(ghosts=3.0, lasting=4), {**SEEN, "vehicles_count": 40})

    def driven(seed):
        env.reset(seed=seed)
        exact = env.unwrapped.observation_type.observe()
        full, ego = int((np.abs(exact).max(axis=1) > 0).sum()), env.unwrapped.vehicle.velocity[0]
        found = []
        for k in (1, 2):
            env.unwrapped.steps = k
            found.append(metres(env, env.observation(exact))[full - 1 :])
        return found, ego

    (first, second), ego = driven(3)
    np.testing.assert_array_equal(first, driven(3)[0][0])
    assert len(driven(4)[0][0]) != len(first) or np.abs(driven(4)[0][0] - first).max() > 0
    moved = [(a, b) for a in first for b in second if abs(a[2] - b[2]) < 1e-4]
    assert moved
    for a, b in moved:
        assert b[0] - a[0] == pytest.approx(0.2 * (a[2] - ego), abs=1e-3)


@pytest.mark.parametrize("behind", [True, False])
def test_a_ghost_in_a_full_observation_replaces_the_last_row(behind):
    env, taken = make(SensorModel(ghosts=4.0), {**SEEN, "vehicles_count": 5, "see_behind": behind}), 0
    for seed in range(20):
        shown, _ = env.reset(seed=seed)
        exact = env.unwrapped.observation_type.observe()
        assert (np.abs(exact).max(axis=1) > 0).all()
        np.testing.assert_array_equal(shown[:4], exact[:4])
        assert abs(shown[4, 1]) <= abs(exact[4, 1])
        assert behind or shown[4, 1] * 200 >= -10.001
        taken += bool((shown[4] != exact[4]).any())
    assert taken >= 3


def test_noise_grows_by_the_configured_factor_at_the_configured_time():
    model = SensorModel({"x": 0.5, "vx": 0.2}, change=(2.0, 3.0))
    before, after = errors(model, steps=9), errors(model, steps=10)
    assert before[:, 1:, 1].std() == pytest.approx(0.5, rel=0.05)
    assert after[:, 1:, 1].std() == pytest.approx(1.5, rel=0.05)
    assert after[:, 1:, 3].std() == pytest.approx(0.6, rel=0.05)
    env = make(model)
    env.reset(seed=0)
    np.testing.assert_allclose(env.sensor_noise, [0.5, 0, 0.2, 0])


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"tails": 2.0}, "above 2"),
        ({"tails": math.nan}, "above 2"),
        ({"bias": {"heading": 0.1}}, "x, y, vx, vy"),
        ({"bias": {"x": math.inf}}, "finite"),
        ({"range": 0.0}, "range is above 0"),
        ({"range": math.nan}, "range is above 0"),
        ({"ghosts": -0.1}, "ghosts is a finite number from 0 on"),
        ({"ghosts": math.inf}, "ghosts is a finite number from 0 on"),
        ({"lasting": 0}, "lasting"),
        ({"lasting": 1.5}, "lasting"),
        ({"change": (-1.0, 2.0)}, "the time of a change"),
        ({"change": (1.0, -2.0)}, "its factor"),
        ({"change": (1.0,)}, "a time and a factor"),
    ],
)
def test_invalid_sensor_models_are_refused(options, match):
    with pytest.raises(ConfigError, match=match):
        SensorModel(**options)


def test_ghosts_are_refused_on_roads_other_than_straight_highways():
    env = gym.make("roundabout-v0", config={"observation": SEEN})
    with pytest.raises(ConfigError, match="lanes_count"):
        SensorNoise(env, SENSORS["ghosts"])


def test_the_command_line_names_the_sensors_of_the_registry():
    assert tuple(SENSORS) == SENSOR_NAMES


@pytest.mark.parametrize("name", SENSOR_NAMES)
def test_every_sensor_by_name_is_seeded(name):
    env = make(SENSORS[name])
    one, two = ([env.reset(seed=2)[0], env.step(1)[0]] for _ in range(2))
    np.testing.assert_array_equal(one, two)
