"""The wrappers around highway-env: signs, rewards, the way back to the road, and the log."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pandas as pd
import pytest
from highway_env.road.lane import CircularLane, SineLane, StraightLane
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.kinematics import Vehicle
from hypothesis import given
from hypothesis import strategies as st

import evaluation.scenarios  # noqa: F401  (registers ComplexRoads-v0)
from evaluation.measuring.jerk import jerk, normalised_jerk
from evaluation.wrappers import (
    HanoiWeights,
    HanoiWorldReward,
    LaneOffset,
    OffRoadWrapper,
    OnLane,
    OnLaneReward,
    PerformanceLogger,
    SignedLaneObservation,
)
from evaluation.wrappers.on_lane_reward import on_lane_reward
from evaluation.wrappers.performance_logger import MEASURES, UNITS
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
CONTINUOUS = {"action": {"type": "ContinuousAction"}, "vehicles_count": 0, "offroad_terminal": False}


def highway(**config: Any) -> gym.Env[Any, Any]:
    return gym.make("highway-fast-v0", config={**CONTINUOUS, **config})


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
def test_to_drive_the_wrong_way_is_plus_pi(turned: float) -> None:
    assert lane_offset(on_lane(StraightLane([0, 0], [100, 0]), 5.0, 0.0, turned)).heading == np.pi


def test_to_the_right_is_positive() -> None:
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


# -- rewards ---------------------------------------------------------------------------------------------

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
def test_options_of_the_reward_that_cannot_be_are_refused(options: Any, told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        OnLane.of(options)


def test_the_wrapper_rewards_what_the_ego_does() -> None:
    env = OnLaneReward(highway(), OnLane(crash=-3.0))
    env.reset(seed=0)
    ego = env.unwrapped.vehicle
    _, reward, *_ = env.step(np.zeros(2))
    assert reward == pytest.approx(ego.speed / 20.0)
    ego.crashed = True
    assert env.step(np.zeros(2))[1] == -3.0


def test_hanois_terms_are_what_they_say() -> None:
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
def test_weights_that_cannot_be_are_refused(weights: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=next(iter(weights))):
        HanoiWeights(**weights)


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


def test_without_re_entry_it_stays_and_pays_again() -> None:
    env = OffRoadWrapper(highway(), penalty=2.0, re_entry=False)
    env.reset(seed=0)
    env.unwrapped.vehicle.position += [0.0, -50.0]
    for _ in range(2):
        *_, info = env.step(np.zeros(2))
        assert (info["off_road"], info["re_entered"]) == (True, False)
    assert not env.unwrapped.vehicle.on_road


def test_on_the_road_nothing_is_taken() -> None:
    env, plain = OffRoadWrapper(highway(), penalty=2.0), highway()
    env.reset(seed=0)
    plain.reset(seed=0)
    (_, reward, *_, info), (_, bare, *_) = env.step(np.zeros(2)), plain.step(np.zeros(2))
    assert (reward, info["off_road"], info["re_entered"]) == (bare, False, False)


def test_nobody_leaves_a_parking_lot() -> None:
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


def test_what_cannot_be_penalised_or_observed_is_refused() -> None:
    for penalty in (-1.0, float("nan"), "1"):
        with pytest.raises(ConfigError, match="penalty"):
            OffRoadWrapper(highway(), penalty=penalty)
    with pytest.raises(ConfigError, match="observations around it"):
        OffRoadWrapper(SignedLaneObservation(highway()))


# -- the log ---------------------------------------------------------------------------------------------


@given(st.floats(-10, 10), st.floats(0, 40), st.integers(3, 20), st.sampled_from([0.05, 0.2, 1.0]))
def test_constant_acceleration_has_no_jerk(acceleration: float, speed: float, n: int, dt: float) -> None:
    speeds = speed + acceleration * dt * np.arange(n)
    assert jerk(speeds, dt) == pytest.approx(np.zeros(n - 2), abs=1e-9)
    assert normalised_jerk(np.full(n, acceleration), np.zeros(n), 10.0) == pytest.approx(np.zeros(n - 1))


@given(st.lists(st.tuples(st.floats(-5, 5), st.floats(-np.pi / 4, np.pi / 4)), min_size=2, max_size=9))
def test_the_papers_jerk_lies_between_0_and_1(commands: list[tuple[float, float]]) -> None:
    pushes, turns = zip(*commands, strict=True)
    found = normalised_jerk(pushes, turns, 10.0)
    expected = [0.5 * (abs(b[0] - a[0]) / 10.0 + 2 * abs(b[1] - a[1]) / np.pi) for a, b in pairwise(commands)]
    assert found == pytest.approx(expected)
    assert (found >= 0).all()
    assert (found <= 1 + 1e-12).all()


def test_constant_throttle_is_logged_as_that() -> None:
    env = PerformanceLogger(highway(policy_frequency=5))
    env.reset(seed=0)
    begin = env.unwrapped.vehicle.position.copy()
    for _ in range(8):
        env.step(np.array([0.4, 0.0]))
    steps = env.steps()
    assert np.isnan(steps["jerk"][0])
    assert steps["jerk"][1:].to_numpy() == pytest.approx(np.zeros(7), abs=1e-6)
    assert steps["jerk_normalised"][1:].to_numpy() == pytest.approx(np.zeros(7), abs=1e-12)
    assert steps["acceleration"].to_numpy() == pytest.approx(np.full(8, 2.0))
    assert steps["time"].to_numpy() == pytest.approx(0.2 * np.arange(1, 9))
    assert steps["distance"].sum() == pytest.approx(np.hypot(*(env.unwrapped.vehicle.position - begin)))
    assert steps["on_lane_time"].sum() == pytest.approx(1.6)
    assert steps["speed_normalised"].to_numpy() == pytest.approx(steps["speed"].to_numpy() / 40.0)
    env.step(np.array([-1.0, 0.0]))
    assert env.steps()["jerk"].iloc[-1] == pytest.approx(7.0 / 0.2)
    assert env.steps()["jerk_normalised"].iloc[-1] == pytest.approx(0.5 * 7.0 / 10.0)


def drive(seeds: list[int], steps: int = 12) -> PerformanceLogger:
    """Random episodes; the last one is left under way."""
    env = PerformanceLogger(gym.make("ComplexRoads-v0", config={"vehicle_density": 2, "duration": 2.0}))
    for seed in seeds:
        env.reset(seed=seed)
        env.action_space.seed(seed)
        for _ in range(steps):
            _, _, terminated, truncated, _ = env.step(env.action_space.sample())
            if terminated or truncated:
                break
    return env


def test_episodes_add_up_their_steps() -> None:
    env = drive([3, 4, 5])
    steps, episodes = env.steps(), env.episodes()
    assert episodes["seed"].tolist() == [3, 4, 5]
    assert episodes["finished"].all()
    assert not episodes["success"].any()
    for row in episodes.itertuples():
        own = steps[steps["episode"] == row.episode]
        assert row.steps == len(own)
        assert row.duration == pytest.approx(0.2 * len(own))
        assert row.on_lane_rate == pytest.approx(own["on_lane_time"].sum() / row.duration)
        for name in MEASURES:
            values = own[name].dropna().to_numpy()
            assert getattr(row, f"total_{name}") == pytest.approx(values.sum())
            assert getattr(row, f"mean_{name}") == pytest.approx(values.mean())
            assert getattr(row, f"peak_{name}") == pytest.approx(values.max())


def test_an_episode_that_is_given_up_is_closed_by_the_reset() -> None:
    env = drive([3], steps=4)
    assert env.episodes().empty
    env.reset(seed=9)
    (row,) = env.episodes().to_dict("records")
    assert (row["seed"], row["steps"], row["finished"], row["success"]) == (3, 4, False, None)
    env.reset(seed=10)
    assert len(env.episodes()) == 1


def test_a_crash_counts_once() -> None:
    env = PerformanceLogger(gym.make("ComplexRoads-v0", config={"vehicle_density": 0}))
    env.reset(seed=0)
    env.step(22)
    env.unwrapped.vehicle.impact = np.zeros(2)
    for _ in range(3):
        env.step(22)
    assert env.steps()["collisions"].tolist() == [0, 1, 0, 0]
    assert env.episodes()["total_collisions"].tolist() == [1.0]


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    env = drive([3, 4])
    for write, read in ((env.to_csv, pd.read_csv), (env.to_parquet, pd.read_parquet)):
        ending = "csv" if read is pd.read_csv else "parquet"
        paths = write(tmp_path / "logs" / f"mine.{ending}")
        assert [path.name for path in paths] == [f"mine-steps.{ending}", f"mine-episodes.{ending}"]
        for path, table in zip(paths, (env.steps(), env.episodes()), strict=True):
            pd.testing.assert_frame_equal(read(path), table, check_dtype=False)
        with pytest.raises(ConfigError, match=f"must end in .{ending}"):
            write(tmp_path / "mine.txt")


def test_every_unit_is_of_a_column_and_the_log_changes_nothing() -> None:
    env = drive([3])
    assert set(UNITS) <= set(env.steps()) | set(env.episodes())
    plain = gym.make("ComplexRoads-v0", config={"vehicle_density": 2, "duration": 2.0})
    plain.reset(seed=3)
    plain.action_space.seed(3)
    rewards = [plain.step(plain.action_space.sample())[1] for _ in range(len(env.steps()))]
    assert env.steps()["reward"].tolist() == rewards


@pytest.mark.parametrize(
    "options",
    [{"speed_range": (5.0, 5.0)}, {"speed_range": (0.0, np.inf)}, {"speed_range": 5.0}, {"acceleration_range": 0.0}],
)
def test_ranges_that_are_empty_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=next(iter(options))):
        PerformanceLogger(highway(), **options)
