"""The log of the ego's driving, and its jerk."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from open_highway import highway

from evaluation.measuring.jerk import jerk, normalised_jerk
from evaluation.wrappers import PerformanceLogger
from evaluation.wrappers.performance_logger import MEASURES, UNITS
from shield.errors import ConfigError


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


def test_written_logs_are_read_back(tmp_path: Path) -> None:
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
