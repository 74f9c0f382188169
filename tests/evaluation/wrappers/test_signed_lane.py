"""Wrappers around highway-env: the ego's signed place on its lane, and its return to the road."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from highway_env.road.lane import CircularLane, SineLane, StraightLane
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.kinematics import Vehicle
from hypothesis import given
from hypothesis import strategies as st
from open_highway import highway

import evaluation.scenarios  # noqa: F401  (registers ComplexRoads-v0)
from evaluation.wrappers import (
    HanoiWorldReward,
    OffRoadWrapper,
    OnLaneReward,
    PerformanceLogger,
    SignedLaneObservation,
)
from evaluation.wrappers.signed_lane import lane_offset
from shield.errors import ConfigError

ENVIRONMENTS = [
    "highway-fast-v0",
    "merge-v0",
    "intersection-v0",
    "roundabout-v0",
    "racetrack-v0",
    "parking-v0",
    "two-way-v0",
    "exit-v0",
    "u-turn-v0",
    "ComplexRoads-v0",
]
LANES = {
    "straight": StraightLane([0.0, 0.0], [100.0, 30.0]),
    "right": CircularLane([10.0, 5.0], 30.0, -1.5, 1.0, clockwise=True),
    "left": CircularLane([10.0, 5.0], 30.0, 1.5, -1.0, clockwise=False),
    "sine": SineLane([0.0, 0.0], [80.0, 0.0], 4.0, np.pi / 80.0, 0.5),
}


def on_lane(lane: Any, along: float, across: float, turned: float) -> Vehicle:
    """A vehicle beside a lane that is alone in the world."""
    network = RoadNetwork()
    network.add_lane("a", "b", lane)
    return Vehicle(Road(network), lane.position(along, across), lane.heading_at(along) + turned, 5.0)


# -- where the ego is on its lane ------------------------------------------------------------------------


@given(st.sampled_from(sorted(LANES)), st.floats(0.1, 0.9), st.floats(-3, 3), st.floats(-10, 10))
def test_the_distance_is_the_lanes_own_and_the_heading_is_wrapped(
    kind: str, part: float, across: float, turned: float
) -> None:
    lane = LANES[kind]
    vehicle = on_lane(lane, part * lane.length, across, turned)
    offset = lane_offset(vehicle)
    assert offset.distance == lane.local_coordinates(vehicle.position)[1]
    assert offset.distance == pytest.approx(across, abs=1e-9)
    assert -np.pi < offset.heading <= np.pi
    assert np.cos(offset.heading - turned) == pytest.approx(1.0)
    assert np.sin(offset.heading - turned) == pytest.approx(0.0, abs=1e-9)


@given(st.floats(0.1, 0.9), st.floats(-3, 3), st.floats(-3, 3))
def test_a_mirrored_world_gives_mirrored_signs(part: float, across: float, turned: float) -> None:
    lane = LANES["right"]
    mirrored = CircularLane(lane.center * [1, -1], lane.radius, -lane.start_phase, -lane.end_phase, clockwise=False)
    here = lane_offset(on_lane(lane, part * lane.length, across, turned))
    there = lane_offset(on_lane(mirrored, part * lane.length, -across, -turned))
    assert there == pytest.approx((-here.distance, -here.heading), abs=1e-9)


@pytest.mark.parametrize("turned", [np.pi, -np.pi])
def test_the_heading_of_wrong_way_driving_is_plus_pi(turned: float) -> None:
    assert lane_offset(on_lane(StraightLane([0, 0], [100, 0]), 5.0, 0.0, turned)).heading == np.pi


def test_offsets_to_the_right_are_positive() -> None:
    env = SignedLaneObservation(highway())
    observation, _ = env.reset(seed=1)
    assert observation[-2:].tolist() == [0.0, 0.0]
    for _ in range(2):
        observation, *_ = env.step(np.array([0.0, 0.1]))
    assert (observation[-2:] > 0).all()


@pytest.mark.parametrize("env_id", ENVIRONMENTS)
def test_every_environment_can_be_wrapped_in_all(env_id: str, tmp_path: Path) -> None:
    plain = gym.make(env_id)
    env: Any = OffRoadWrapper(plain, penalty=1.0)
    env = PerformanceLogger(HanoiWorldReward(OnLaneReward(SignedLaneObservation(env))))
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    env.action_space.seed(0)
    for _ in range(3):
        observation, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        assert env.observation_space.contains(observation)
        assert np.isfinite(reward)
        if terminated or truncated:
            break
    assert len(env.steps()) >= 1
    env.close()


def test_a_picture_and_a_dictionary_have_the_two_beside_them() -> None:
    class Seeing(gym.ObservationWrapper):
        observation_space = gym.spaces.Box(0, 255, (2, 3, 4), np.uint8)

        def observation(self, observation: Any) -> Any:
            return np.zeros((2, 3, 4), np.uint8)

    seeing, parking = SignedLaneObservation(Seeing(highway())), SignedLaneObservation(gym.make("parking-v0"))
    for env, keys in ((seeing, {"observation"}), (parking, {"observation", "achieved_goal", "desired_goal"})):
        observation, _ = env.reset(seed=0)
        assert set(observation) == keys | {"signed_lane"}
        assert env.observation_space.contains(observation)


def test_observations_of_several_agents_are_refused() -> None:
    env = highway()
    env.observation_space = gym.spaces.Tuple([env.observation_space] * 2)
    with pytest.raises(ConfigError, match="Box or a Dict"):
        SignedLaneObservation(env)


# -- off the road ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("env_id", ["highway-fast-v0", "roundabout-v0", "ComplexRoads-v0", "racetrack-v0"])
def test_the_ego_comes_back_to_the_middle_of_its_nearest_lane(env_id: str) -> None:
    ends = {"terminate_off_road": False} if env_id == "racetrack-v0" else {"offroad_terminal": False}
    env, plain = OffRoadWrapper(gym.make(env_id, config=ends), penalty=2.0), gym.make(env_id, config=ends)
    for each in (env, plain):
        each.reset(seed=0)
        each.unwrapped.vehicle.position += [0.0, 300.0]
        each.unwrapped.vehicle.heading += 0.4
        each.action_space.seed(0)
    action = env.action_space.sample()
    seen, reward, *_, info = env.step(action)
    unseen, bare, *_ = plain.step(action)
    ego = env.unwrapped.vehicle
    assert (info["off_road"], info["re_entered"]) == (True, True)
    assert reward == pytest.approx(bare - 2.0)
    assert lane_offset(ego) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert ego.lane_index == plain.unwrapped.vehicle.lane_index
    assert ego.speed == plain.unwrapped.vehicle.speed
    assert np.array_equal(seen, env.unwrapped.observation_type.observe())
    assert not np.array_equal(seen, unseen)


def test_an_ego_without_re_entry_stays_off_the_road_and_is_penalised_again() -> None:
    env = OffRoadWrapper(highway(), penalty=2.0, re_entry=False)
    env.reset(seed=0)
    env.unwrapped.vehicle.position += [0.0, -50.0]
    for _ in range(2):
        *_, info = env.step(np.zeros(2))
        assert (info["off_road"], info["re_entered"]) == (True, False)
    assert not env.unwrapped.vehicle.on_road


def test_an_ego_on_the_road_is_not_penalised() -> None:
    env, plain = OffRoadWrapper(highway(), penalty=2.0), highway()
    env.reset(seed=0)
    plain.reset(seed=0)
    (_, reward, *_, info), (_, bare, *_) = env.step(np.zeros(2)), plain.step(np.zeros(2))
    assert (reward, info["off_road"], info["re_entered"]) == (bare, False, False)


def test_a_parking_lot_has_no_road_to_leave() -> None:
    env = PerformanceLogger(OffRoadWrapper(gym.make("parking-v0")))
    env.reset(seed=0)
    begin = env.unwrapped.vehicle.position.copy()
    *_, info = env.step(np.zeros(2))
    assert not env.unwrapped.vehicle.on_road
    assert (info["off_road"], env.steps()["on_lane_time"].tolist()) == (False, [0.2])
    assert env.unwrapped.vehicle.position == pytest.approx(begin)


def test_an_episode_that_ends_off_the_road_ends_there() -> None:
    env = OffRoadWrapper(highway(offroad_terminal=True), penalty=2.0)
    env.reset(seed=0)
    env.unwrapped.vehicle.position += [0.0, -50.0]
    _, _, terminated, _, info = env.step(np.zeros(2))
    assert (terminated, info["off_road"], info["re_entered"]) == (True, True, False)
    assert not env.unwrapped.vehicle.on_road


def test_invalid_penalties_and_observations_are_refused() -> None:
    for penalty in (-1.0, float("nan"), "1"):
        with pytest.raises(ConfigError, match="penalty"):
            OffRoadWrapper(highway(), penalty=penalty)
    with pytest.raises(ConfigError, match="observations around it"):
        OffRoadWrapper(SignedLaneObservation(highway()))


@pytest.mark.parametrize(
    "wrapper", [SignedLaneObservation, OnLaneReward, OffRoadWrapper, PerformanceLogger, HanoiWorldReward]
)
def test_an_environment_without_a_road_is_refused(wrapper):
    with pytest.raises(ConfigError, match=f"{wrapper.__name__} is for highway-env's environments.*CartPoleEnv"):
        wrapper(gym.make("CartPole-v1"))
