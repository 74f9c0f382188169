"""Predicted lanes of a vehicle, as calibrated probabilities."""

from __future__ import annotations

from collections import Counter

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shield.errors import ConfigError
from shield.perception.certainty import probability_within
from shield.perception.intent import LANE_CHANGE_MODEL, lane_chances, lane_change_gains
from shield.perception.tracking import Tracks

CENTERS = np.array([0.0, 4.0, 8.0])
CALM, FREE, BRISK = np.eye(3)
NOBODY = np.array([-500.0, 0.0, 20.0, 0.0])
"""An ego that is in no vehicle's way."""


def known(states, spread=1e-4, chances=CALM):
    """Tracks of vehicles whose state (n, 4) is known with this spread."""
    states = np.asarray(states, float).reshape(-1, 4)
    n = len(states)
    return Tracks(
        ids=np.arange(n),
        means=np.repeat(states[:, None], 3, axis=1),
        covariances=np.broadcast_to(np.square(spread) * np.eye(4), (n, 3, 4, 4)),
        chances=np.tile(np.asarray(chances, float), (n, 1)),
    )


@given(
    states=st.lists(st.tuples(st.floats(-100, 100), st.floats(-3, 11), st.floats(0, 35), st.floats(-8, 8)), max_size=8),
    spread=st.floats(1e-4, 50),
    chances=st.tuples(st.floats(0.01, 1), st.floats(0.01, 1), st.floats(0.01, 1)),
    lanes=st.integers(1, 5),
)
def test_predicted_lanes_are_probabilities(states, spread, chances, lanes):
    tracks, centers = known(states, spread, np.array(chances) / sum(chances)), 4.0 * np.arange(lanes)
    wished = lane_change_gains(tracks, NOBODY, centers)
    said = lane_chances(tracks, wished, centers)
    assert wished.shape == (len(states), 2)
    assert said.shape == (len(states), lanes)
    assert ((wished >= 0) & (wished <= 1)).all()
    assert (said >= -1e-12).all()
    np.testing.assert_allclose(said.sum(axis=1), 1.0)


@given(y=st.floats(-2, 10), lane=st.integers(0, 2))
def test_a_calm_vehicle_without_incentive_is_predicted_to_stay(y, lane):
    state = [0.0, CENTERS[lane] + 0.1 * np.sin(y), 20.0, 0.0]
    tracks = known([state])
    assert not lane_change_gains(tracks, NOBODY, CENTERS).any()
    assert lane_chances(tracks, np.zeros((1, 2)), CENTERS)[0, lane] >= 1 - 2.1 * LANE_CHANGE_MODEL.idle


@pytest.mark.parametrize("vy", [-3.0, 3.0])
def test_a_vehicle_that_moves_across_is_predicted_in_the_lane_ahead_of_its_motion(vy):
    state = [0.0, 4.0 + 0.4 * np.sign(vy), 20.0, vy]
    towards = 1 + int(np.sign(vy))
    moving = lane_chances(known([state], chances=BRISK), np.zeros((1, 2)), CENTERS)[0]
    assert moving[towards] > 0.2 > 0.01 > lane_chances(known([state]), np.zeros((1, 2)), CENTERS)[0, towards]
    # The further it has moved, the higher the probability.
    later = [0.0, 4.0 + 1.8 * np.sign(vy), 20.0, vy]
    assert lane_chances(known([later], chances=BRISK), np.zeros((1, 2)), CENTERS)[0, towards] > moving[towards]


@given(spread=st.floats(0.01, 20))
def test_a_wider_spread_makes_the_prediction_less_certain(spread):
    """For a vehicle in the middle of its lane, without lateral motion."""
    state, none = [0.0, 4.0, 20.0, 0.0], np.zeros((1, 2))
    for chances in (CALM, BRISK):
        one, other = (lane_chances(known([state], s, chances), none, CENTERS)[0, 1] for s in (spread, 1.5 * spread))
        assert other <= one + 1e-12


def test_a_blocked_vehicle_has_an_incentive_to_change_where_there_is_room():
    slow, fast = [20.0, 4.0, 15.0, 0.0], [0.0, 4.0, 25.0, 0.0]
    beside_below, behind_above = [5.0, 0.0, 20.0, 0.0], [-8.0, 8.0, 25.0, 0.0]
    np.testing.assert_array_equal(lane_change_gains(known([fast, slow]), NOBODY, CENTERS)[0], [1.0, 1.0])
    np.testing.assert_array_equal(lane_change_gains(known([fast, slow, beside_below]), NOBODY, CENTERS)[0], [0.0, 1.0])
    np.testing.assert_array_equal(
        lane_change_gains(known([fast, slow, beside_below, behind_above]), NOBODY, CENTERS)[0], [0, 0]
    )
    # The ego blocks a lane like any other vehicle.
    np.testing.assert_array_equal(
        lane_change_gains(known([fast, slow]), np.array(behind_above), CENTERS)[0], [1.0, 0.0]
    )
    said = lane_chances(known([fast]), np.array([[0.0, 1.0]]), CENTERS)[0]
    assert said[2] == pytest.approx(LANE_CHANGE_MODEL.eager, abs=0.01)
    assert said[1] == pytest.approx(1 - LANE_CHANGE_MODEL.eager, abs=0.01)


def test_lane_change_incentives_are_those_of_highway_env():
    """MOBIL as highway-env evaluates it, for known states."""
    base, found = gym.make("highway-fast-v0").unwrapped, Counter()
    for seed in range(3):
        base.reset(seed=seed)
        for k in range(40):
            cars = [v for v in base.road.vehicles if v is not base.vehicle]
            states = np.array([[*v.position, *v.velocity] for v in cars])
            ego = np.array([*base.vehicle.position, *base.vehicle.velocity])
            wished = lane_change_gains(known(states), ego, CENTERS) if k % 2 == 0 else []
            for row, car in zip(wished, cars, strict=False):
                lane = car.lane_index
                for j, beside in enumerate((lane[2] - 1, lane[2] + 1)):
                    if lane == car.target_lane_index and beside in (0, 1, 2):
                        found[bool(car.mobil((*lane[:2], beside))), bool(row[j] > 0.5)] += 1
            if k % 5 == 0:
                base.action_type.act(4)
            base.road.act()
            base.road.step(0.2)
            base.steps += 1
    assert found[True, True] > 40
    # The desired speed of a vehicle is not known, so a follower that would yield is not always recognised.
    assert found[True, False] <= 0.25 * found[True, True]
    assert found[False, True] <= 0.05 * found[True, True]


@pytest.mark.parametrize("centers", [[], [0.0, 0.0], [4.0, 0.0]])
def test_lanes_that_do_not_ascend_are_refused(centers):
    tracks = known([[0.0, 0.0, 20.0, 0.0]])
    with pytest.raises(ConfigError, match="ascend"):
        lane_chances(tracks, np.zeros((1, 2)), np.array(centers))
    with pytest.raises(ConfigError, match="ascend"):
        lane_change_gains(tracks, NOBODY, np.array(centers))


# -- probability of a position --------------------------------------------------------------------------------------


@given(
    spreads=st.tuples(*[st.floats(0.01, 5)] * 2),
    turn=st.floats(0, 3.1),
    apart=st.floats(0, 4),
    chance=st.floats(0, 1),
    distance=st.floats(0.1, 6),
)
def test_the_probability_of_being_near_is_the_share_of_the_mixture(spreads, turn, apart, chance, distance):
    c, s = np.cos(turn), np.sin(turn)
    turned = np.array([[c, -s], [s, c]])
    covariance = np.eye(4)
    covariance[:2, :2] = turned @ np.diag(np.square(spreads)) @ turned.T
    tracks = known([[3.0, 4.0, 20.0, 0.0]], chances=[chance, 1 - chance, 0.0])
    tracks.means[:, 1, 1] += apart
    tracks = Tracks(
        ids=tracks.ids,
        means=tracks.means,
        covariances=np.broadcast_to(covariance, (1, 3, 4, 4)),
        chances=tracks.chances,
    )
    rng = np.random.default_rng(0)
    which = (rng.random(20_000) >= chance).astype(int)
    drawn = tracks.means[0, which, :2] + rng.multivariate_normal(np.zeros(2), covariance[:2, :2], 20_000)
    share = (np.hypot(*(drawn - tracks.mean[0, :2]).T) <= distance).mean()
    assert abs(probability_within(tracks, distance)[0] - share) < 0.05
