"""Reward wrappers around highway-env."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from open_highway import highway

from evaluation.wrappers import HanoiWeights, HanoiWorldReward, LaneOffset, OnLane, OnLaneReward
from evaluation.wrappers.on_lane_reward import on_lane_reward
from shield.errors import ConfigError

OFFSETS = st.builds(LaneOffset, st.floats(-10, 10), st.floats(-3.1, 3.1))


@given(OFFSETS, st.floats(-10, 40))
def test_the_reward_is_the_papers_formula(offset: LaneOffset, speed: float) -> None:
    d, heading = offset
    expected = np.cos(heading) * speed / max(1.0, abs(d)) / 20.0 if speed > 0 else 0.0
    assert on_lane_reward(offset, speed, False) == pytest.approx(expected, rel=1e-12, abs=1e-12)
    assert on_lane_reward(offset, speed, True) == -10.0
    assert on_lane_reward(LaneOffset(-d, -heading), speed, False) == on_lane_reward(offset, speed, False)


@given(OFFSETS, st.floats(0.1, 40), st.sampled_from([0.0, 0.5, 2.0]))
def test_exponents_and_scales_are_options(offset: LaneOffset, speed: float, power: float) -> None:
    plain = on_lane_reward(offset, speed, False)
    assert on_lane_reward(offset, speed, False, OnLane(speed_scale=40.0)) == pytest.approx(plain / 2)
    speedy = on_lane_reward(offset, speed, False, OnLane(speed_exponent=power))
    assert speedy == pytest.approx(plain * (speed / 20.0) ** (power - 1.0))
    near = on_lane_reward(offset, speed, False, OnLane(distance_exponent=power))
    assert near == pytest.approx(plain * max(1.0, abs(offset.distance)) ** (1.0 - power))
    along = on_lane_reward(offset, speed, False, OnLane(heading_exponent=power))
    assert np.sign(along) == np.sign(plain)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"speed_scale": 0.0}, "speed_scale is a finite number above 0"),
        ({"distance_floor": -1.0}, "distance_floor is a finite number above 0"),
        ({"heading_exponent": -1.0}, "heading_exponent is a finite number from 0 on"),
        ({"crash": float("nan")}, "finite"),
        ({"crash": "much"}, "finite"),
        ([1.0], "map crash, speed_scale"),
        ({"crush": 1.0}, "have crash, speed_scale"),
    ],
)
def test_invalid_options_of_the_reward_are_refused(options: Any, told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        OnLane.of(options)


def test_the_wrapper_rewards_speed_and_crashes_of_the_ego() -> None:
    env = OnLaneReward(highway(), OnLane(crash=-3.0))
    env.reset(seed=0)
    ego = env.unwrapped.vehicle
    _, reward, *_ = env.step(np.zeros(2))
    assert reward == pytest.approx(ego.speed / 20.0)
    ego.crashed = True
    assert env.step(np.zeros(2))[1] == -3.0


def test_hanois_terms_have_their_documented_values() -> None:
    env = HanoiWorldReward(highway(vehicles_count=1), HanoiWeights(1.0, 10.0, 100.0, 1000.0, 10_000.0))
    env.reset(seed=0)
    ego, (other,) = env.unwrapped.vehicle, env.unwrapped.road.vehicles[1:]
    other.position = ego.position + np.array([500.0, 0.0])
    _, reward, *_, info = env.step(np.zeros(2))
    terms = {"collision": 0.0, "safe_distance": 0.0, "lane_change": 0.0, "heading": 1.0, "survival": 1.0}
    assert info["hanoi_terms"] == pytest.approx(terms)
    assert reward == pytest.approx(11_000.0)
    # A quarter of the safe gap of 2 m and 1.5 s is there.
    other.speed = ego.speed
    other.target_speed = ego.speed
    other.act = lambda *_: None
    other.action = {"acceleration": 0.0, "steering": 0.0}
    other.lane_index = ego.lane_index
    other.position = ego.position + np.array([5.0 + 0.25 * (2.0 + 1.5 * ego.speed), 0.0])
    other.heading = 0.0
    *_, info = env.step(np.zeros(2))
    assert info["hanoi_terms"]["safe_distance"] == pytest.approx(0.75, abs=1e-3)
    ego.position += [0.0, 4.0 if ego.lane_index[2] == 0 else -4.0]
    *_, info = env.step(np.zeros(2))
    assert info["hanoi_terms"]["lane_change"] == 1.0
    *_, info = env.step(np.zeros(2))
    assert info["hanoi_terms"]["lane_change"] == 0.0
    ego.crashed = True
    *_, info = env.step(np.zeros(2))
    assert (info["hanoi_terms"]["collision"], info["hanoi_terms"]["survival"]) == (1.0, 0.0)


@pytest.mark.parametrize(
    "weights", [{"time_gap": -1.0}, {"standstill": -0.1}, {"heading": float("inf")}, {"survival": "yes"}]
)
def test_invalid_weights_are_refused(weights: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=next(iter(weights))):
        HanoiWeights(**weights)
