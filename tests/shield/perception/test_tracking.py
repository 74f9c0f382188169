"""Identity of vehicles from one observation to the next."""

from __future__ import annotations

import math
from dataclasses import replace

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from observed_roads import ANY, SEEN, make

from dynamics.scenes.scene import SceneReader
from shield import ShieldConfig
from shield.perception.perceiving import ObservationPerception
from shield.perception.spec import ObservationSpec
from shield.perception.tracking import MotionModels, Tracks, bounds_of, update_tracks
from shield.pipelines.decide import DecisionCore
from shield.pipelines.meta_actions import MetaActionPipeline
from shield.pipelines.screen import MetaActionProposal


def test_shuffled_rows_lose_no_vehicle():
    """A vehicle keeps its number, and the scene equals that of sorted rows."""
    observation = {**SEEN, "vehicles_count": 30, "order": "shuffled"}
    env = make(observation)
    for seed in range(4):
        obs, _ = env.reset(seed=seed)
        base, known = env.unwrapped, {}
        reader = SceneReader(base)
        reader.check()
        perception = ObservationPerception(ObservationSpec.of(env), reader.map, (0.2, 5))
        for _ in range(8):
            scene = perception.see(obs, base.steps, reader.control)
            real = [v for v in base.road.vehicles if v is not base.vehicle]
            places = np.array([v.position for v in real]) - base.vehicle.position + scene.ego[:2]
            for row, who in zip(scene.others, scene.ids.tolist(), strict=True):
                if who < 0:
                    continue
                apart = np.hypot(*(places - row[:2]).T)
                assert apart.min() < 1e-3
                assert known.setdefault(who, real[int(apart.argmin())]) is real[int(apart.argmin())]
            obs, _, over, _, _ = env.step(int(base.np_random.integers(5)))
            if over:
                break
        assert len(known) >= 5


@pytest.mark.parametrize("seed", range(3))
def test_the_order_of_the_rows_changes_nothing(seed):
    """A number means the same vehicle in every scene, wherever its row is."""
    rng, base = np.random.default_rng(seed), gym.make("highway-fast-v0").unwrapped
    base.reset(seed=seed)
    reader, config = SceneReader(base), ShieldConfig()
    cores = [DecisionCore(MetaActionPipeline(config)), DecisionCore(MetaActionPipeline(config))]
    lost = 0
    for k in range(40):
        scene = reader.read()
        many = len(scene.others)
        # A vehicle is out of sight now and then.
        seen = np.sort(rng.permutation(many)[: many - (k % 7 == 3)])
        mixed = rng.permutation(seen)
        scenes = [replace(scene, others=scene.others[rows], ids=rows) for rows in (seen, mixed)]
        wish = MetaActionProposal(3 if k % 9 else 0, reader.actions, None)
        one, other = (core.decide(each, wish) for core, each in zip(cores, scenes, strict=True))
        assert (one.executed, one.tier, one.reason) == (other.executed, other.tier, other.reason)
        assert one.margin == pytest.approx(other.margin, abs=1e-9, nan_ok=True)
        left, right = (core.memory.verifier for core in cores)
        back = np.argsort(mixed)
        np.testing.assert_allclose(left.around.tables.numbers, right.around.tables.numbers[:, back])
        np.testing.assert_array_equal(left.comes, right.comes[:, back])
        np.testing.assert_array_equal(left.in_owned_lane, right.in_owned_lane[back])
        lost += many - len(seen)
        if k % 5 == 0:
            base.action_type.act(one.executed)
        base.road.act()
        base.road.step(0.2)
        base.steps += 1
    assert lost


def test_the_filter_is_calibrated():
    """The mean squared distance between prediction and observation is the dimension of its covariance: 4."""
    rng, noise = np.random.default_rng(0), np.diag(np.square([0.5, 0.4, 0.6, 0.3]))
    a, dt, n = (2.0, 1.0), 0.2, 40
    truth = rng.normal(0, 50, (n, 4)) + np.array([0, 0, 25, 0])
    truth[:, 0] += 1_000 * np.arange(n)  # so far apart that vehicles cannot be confused
    tracks, found, outside = Tracks(), [], 0
    for k in range(60):
        seen = truth + rng.multivariate_normal(np.zeros(4), noise, n)
        tracks = update_tracks(tracks, seen, noise, dt, MotionModels(a, a, a, usual_speed=ANY, sideways=1e3))
        if k > 20:
            found.append(tracks.innovation)
            spread = np.sqrt(np.einsum("nii->ni", tracks.covariance))
            outside += int((np.abs(tracks.mean - truth) > 3 * spread).sum())
        push = rng.normal(0, a, (n, 2))
        extra = rng.normal(0, np.array(a) * dt * dt / 4, (n, 2))
        truth[:, :2] += truth[:, 2:] * dt + push * dt * dt / 2 + extra
        truth[:, 2:] += push * dt
    values = np.concatenate(found)
    # chi^2 with 4 degrees of freedom is between these in 95 % of the cases.
    inside = ((values > 0.484) & (values < 11.143)).mean()
    assert abs(inside - 0.95) < 1.5 * 1.96 * math.sqrt(0.95 * 0.05 / len(values))
    assert len(tracks.ids) == n
    assert not np.isnan(values).any()
    # The mean of so many chi^2 with 4 degrees is within this of 4 in 95 % of the cases; 1.5 times as wide.
    assert abs(values.mean() - 4) < 1.5 * 1.96 * math.sqrt(8 / len(values))
    assert outside <= 0.01 * 4 * len(values)


def test_a_vehicle_that_leaves_is_dropped_and_a_new_one_gets_a_new_number():
    noise = np.eye(4) * 1e-4
    one, two = [0.0, 0.0, 20.0, 0.0], [30.0, 4.0, 20.0, 0.0]
    tracks = update_tracks(Tracks(), np.array([one, two]), noise, 0.1, MotionModels())
    assert tracks.ids.tolist() == [1, 2]
    tracks = update_tracks(tracks, np.array([[33.0, 4.0, 20.0, 0.0]]) - [1.0, 0, 0, 0], noise, 0.1, MotionModels())
    assert tracks.ids.tolist() == [2]
    tracks = update_tracks(
        tracks, np.array([[34.0, 4.0, 20.0, 0.0], [2.0, 0.0, 20.0, 0.0]]), noise, 0.1, MotionModels()
    )
    assert tracks.ids.tolist() == [2, 3]


@given(missed_limit=st.integers(0, 4), gone=st.integers(1, 6))
def test_a_vehicle_may_be_missing_up_to_the_limit(missed_limit, gone):
    noise, state = np.eye(4) * 0.01, np.array([[0.0, 0.0, 20.0, 0.0]])
    motions = MotionModels(usual_speed=ANY)
    tracks = update_tracks(Tracks(), state, noise, 0.1, motions, missed_limit)
    for _ in range(gone):
        tracks = update_tracks(tracks, np.zeros((0, 4)), noise, 0.1, motions, missed_limit)
    assert len(tracks.ids) == (gone <= missed_limit)
    if gone <= missed_limit:
        assert tracks.mean[0, 0] == pytest.approx(2.0 * gone)


def test_the_memory_of_recognised_vehicles_is_that_of_exact_scenes():
    base = gym.make("highway-fast-v0").unwrapped
    base.reset(seed=4)
    reader = SceneReader(base)
    exact, known = (DecisionCore(MetaActionPipeline(ShieldConfig())) for _ in range(2))
    spent = 0.0
    for k in range(30):
        scene = reader.read()
        mixed = np.random.default_rng(k).permutation(len(scene.others))
        wish = MetaActionProposal(1, reader.actions, None)
        exact.decide(scene, wish)
        known.decide(replace(scene, others=scene.others[mixed], ids=mixed), wish)
        one, other = exact.memory.verifier.around.tables, known.memory.verifier.around.tables
        np.testing.assert_allclose(one.numbers[:, mixed], other.numbers, atol=1e-9)
        np.testing.assert_allclose(one.recent[mixed], other.recent, atol=1e-9)
        spent = max(spent, float(one.recent.max(initial=0.0)))
        base.road.act()
        base.road.step(0.2)
        base.steps += 1
    assert spent > 0.1


def _mistakes(places):
    """Position error of two vehicles 25 m apart in one lane, through noise of 40 m."""
    rng, sigma, dt, found = np.random.default_rng(5), np.array([40.0, 2.4, 16.0, 16.0]), 0.2, []
    noise, motions = np.diag(sigma**2), MotionModels(centers=np.array([0.0, 4.0, 8.0]))
    for _ in range(20):
        tracks = Tracks()
        for k in range(50):
            truth = np.array([[30.0, 4.0, 21.0, 0.0], [55.0, 4.0, 21.0, 0.0]])
            truth[:, 0] += 21.0 * k * dt
            seen = truth + rng.normal(0, sigma, (2, 4))
            tracks = update_tracks(tracks, seen, noise, dt, motions, 3, np.arange(2) if places else None)
        if len(tracks.ids) == 2:
            found.append(np.diff(np.sort(tracks.mean[:, 0]))[0] - 25.0)
    return np.sqrt(np.mean(np.square(found)))


def test_the_order_of_sorted_rows_identifies_vehicles_under_large_noise():
    assert _mistakes(places=True) < 0.7 * _mistakes(places=False)


def test_the_speed_of_a_bad_sensor_is_weighed_against_the_prior():
    """A velocity with noise of 16 m/s is less informative than the prior of driving speeds."""
    noise = np.diag(np.square([40.0, 2.4, 16.0, 16.0]))
    seen = np.array([[50.0, 4.0, 40.0, -12.0]])
    tracks = update_tracks(Tracks(), seen, noise, 0.2, MotionModels())
    assert abs(tracks.mean[0, 2] - 21.0) < 1.0
    assert abs(tracks.mean[0, 3]) < 0.2
    exact = update_tracks(Tracks(), seen, np.eye(4) * 1e-8, 0.2, MotionModels())
    np.testing.assert_allclose(exact.mean, seen, atol=1e-6)


@given(
    chances=st.tuples(st.floats(0.01, 1), st.floats(0.01, 1), st.floats(0.01, 1)),
    means=st.tuples(*[st.floats(-5, 5)] * 3),
    spread=st.tuples(*[st.floats(0.1, 4)] * 3),
    bound=st.floats(0.5, 3),
)
@settings(max_examples=40, deadline=None)
def test_the_sides_of_a_mixture_are_exceeded_as_often_as_they_say(chances, means, spread, bound):
    weights = np.array(chances) / sum(chances)
    tracks = Tracks(
        ids=np.array([1]),
        means=np.repeat(np.array(means)[None, :, None], 4, axis=2),
        covariances=(np.array(spread) ** 2)[None, :, None, None] * np.eye(4),
        chances=weights[None],
        missed=np.array([0]),
    )
    low, high = bounds_of(tracks, bound)
    for edge, sign in ((low[0, 0], -1), (high[0, 0], 1)):
        beyond = [0.5 * math.erfc(sign * (edge - m) / s / math.sqrt(2)) for m, s in zip(means, spread, strict=True)]
        wanted = 0.5 * math.erfc(bound / math.sqrt(2))
        assert weights @ beyond == pytest.approx(wanted, rel=0.02)
        assert weights @ beyond <= wanted + 1e-12
