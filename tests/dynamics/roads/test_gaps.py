"""Gaps of a map: places between two lanes at which highway-env's vehicle is off the road."""

from __future__ import annotations

from functools import cache
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from highway_env.vehicle.kinematics import Vehicle
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.roads.path import PathRoad
from dynamics.roads.path_reader import read_network
from dynamics.roads.straight import StraightRoad
from shield.wrappers.shielded_env import ShieldedEnv

GAPPED = ("racetrack-v0", "racetrack-large-v0")


@cache
def read(name: str) -> tuple[Any, PathRoad]:
    env = gym.make(name)
    env.reset(seed=0)
    road = env.unwrapped.road  # type: ignore[attr-defined]
    return road, read_network(road.network)


def off_road(name: str, s: float, r: float, angle: float = 0.0) -> bool:
    """Whether highway-env says so of a vehicle at (s, r) [m] along the road, at an angle to it [rad]."""
    world, road = read(name)
    x, y, heading, _ = road.to_world(np.array([s, r, angle, 0.0]))
    return not Vehicle(world, [x, y], heading).on_road


def in_gap(name: str, s: float, r: float) -> bool:
    gaps = read(name)[1].gaps
    assert gaps is not None
    return bool(gaps.met(np.array([[[s, r, 0.0, 0.0]]]))[0])


@pytest.mark.parametrize("name", GAPPED)
@settings(deadline=None, max_examples=600)
@given(
    share=st.floats(0, 1, exclude_max=True),
    edge=st.integers(1, 2),
    offset=st.floats(-0.3, 0.3),
    angle=st.floats(-0.8, 0.8),
)
def test_a_vehicle_off_the_road_between_two_lanes_is_in_a_gap(
    name: str, share: float, edge: int, offset: float, angle: float
) -> None:
    road = read(name)[1]
    s, r = share * road.length, min(5.0 * edge, road.centers[-1]) - 2.5 + offset
    assert in_gap(name, s, r) or not off_road(name, s, r, angle)


@pytest.mark.parametrize(("name", "joint"), [("racetrack-v0", 328.5), ("racetrack-large-v0", 443.0)])
def test_a_vehicle_off_the_road_at_a_joint_is_in_a_gap(name: str, joint: float) -> None:
    """The nearest lane may have ended, where another lane contains the place."""
    found = 0
    for s in joint + np.arange(-1.0, 1.0, 0.07):
        for r in np.arange(2.3, 2.7, 0.013):
            for angle in (-0.26, 0.5):
                if off_road(name, s, r, angle):
                    found += 1
                    assert in_gap(name, s, r), f"s {s:.2f} m, r {r:.3f} m"
    assert found > 5


def test_vehicles_off_the_road_between_two_lanes_exist() -> None:
    """racetrack-v0 has a strip of 8 cm around s = 200 m."""
    assert off_road("racetrack-v0", 200.0, 2.54)
    assert in_gap("racetrack-v0", 200.0, 2.54)


@pytest.mark.parametrize("name", GAPPED)
def test_a_gap_is_not_much_wider_than_it_is(name: str) -> None:
    for s in np.arange(195.0, 205.0, 0.7) + (150.0 if "large" in name else 0.0):
        for r in (2.40, 2.46, 2.63, 2.70):
            assert not in_gap(name, s, r)
            assert not off_road(name, s, r)


def test_a_gap_exists_on_every_lap() -> None:
    length = read("racetrack-v0")[1].length
    for laps in (-2, -1, 0, 1, 3):
        assert in_gap("racetrack-v0", 200.0 + laps * length, 2.54)
        assert not in_gap("racetrack-v0", 200.0 + laps * length, 2.0)


def test_a_path_meets_a_gap_if_one_state_does() -> None:
    gaps = read("racetrack-v0")[1].gaps
    assert gaps is not None
    across = np.array([[200.0, 2.0, 0, 9.0], [200.6, 2.54, 0, 9.0], [201.2, 3.0, 0, 9.0]])
    stepped = across.copy()
    stepped[1, 1] = 2.4
    unknown = np.full((3, 4), np.nan)
    np.testing.assert_array_equal(gaps.met(np.stack([across, stepped, unknown])), [True, False, False])


@pytest.mark.parametrize("name", ["racetrack-oval-v0", "u-turn-v0", "lane-keeping-v0"])
def test_other_roads_have_no_gaps(name: str) -> None:
    assert read(name)[1].gaps is None
    assert StraightRoad.from_lanes(3).gaps is None


@pytest.mark.parametrize("shielded", [False, True])
def test_the_shield_keeps_the_ego_out_of_a_gap(shielded: bool) -> None:
    """From the lane below the gap, straight on towards it: the end of the frame would be off the road."""
    env: gym.Env = gym.make("racetrack-v0", config={"other_vehicles": 0, "policy_frequency": 15})
    env = ShieldedEnv(env) if shielded else env
    env.reset(seed=0)
    base: Any = env.unwrapped
    road = read_network(base.road.network)
    v, angle = 8.0, 0.3
    ego = base.vehicle
    x, y, heading, _ = road.to_world(np.array([200.0, 2.54 - v / 15 * np.sin(angle), angle, v]))
    ego.position, ego.heading, ego.speed = np.array([x, y]), heading, v
    ego.on_state_update()
    assert ego.on_road
    _, _, terminated, _, info = env.step(np.zeros(base.action_space.shape))
    assert ego.on_road == shielded
    assert terminated != shielded
    assert not shielded or info["shield"]["overridden"]
    env.close()
