"""Road coordinates are a rigid motion of the world's, and unsupported roads are refused by name."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from highway_env.road.lane import StraightLane
from highway_env.road.road import RoadNetwork
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.errors import SceneError
from dynamics.roads.straight import StraightRoad
from dynamics.scenes.scene import Scene

LIMITS = settings(deadline=None, max_examples=100, derandomize=True)
angles = st.floats(-3.2, 3.2)
metres = st.floats(-1000, 1000)
states = st.lists(st.tuples(metres, metres, angles, st.floats(-40, 40)), min_size=1, max_size=5)


@LIMITS
@given(states, st.tuples(metres, metres), angles)
def test_to_world_and_to_road_are_inverse(rows, origin, heading):
    road = StraightRoad.from_lanes(3, origin=origin, heading=heading)
    world = np.array(rows)
    np.testing.assert_allclose(road.to_world(road.to_road(world)), world, rtol=0, atol=1e-9)
    np.testing.assert_allclose(road.to_road(road.to_world(world)), world, rtol=0, atol=1e-9)


@LIMITS
@given(states, st.tuples(metres, metres), angles)
def test_distances_and_speeds_are_those_of_the_world(rows, origin, heading):
    road = StraightRoad.from_lanes(3, origin=origin, heading=heading)
    world = np.array(rows)
    local = road.to_road(world)
    np.testing.assert_allclose(
        np.hypot(*(local[:, :2] - local[0, :2]).T), np.hypot(*(world[:, :2] - world[0, :2]).T), rtol=0, atol=1e-9
    )
    np.testing.assert_array_equal(local[:, 3], world[:, 3])


@LIMITS
@given(angles, st.floats(0, 5000), st.floats(-2, 2), st.integers(0, 3))
def test_the_coordinates_are_those_of_the_simulators_lanes(angle, s, offset, lane):
    network = RoadNetwork.straight_road_network(4, angle=angle)
    road = StraightRoad.from_network(network)
    reference = network.get_lane(("0", "1", lane))
    x, y = reference.position(s, offset)
    got = road.to_road(np.array([x, y, reference.heading_at(s), 20.0]))
    np.testing.assert_allclose(got, [s, road.centers[lane] + offset, 0.0, 20.0], rtol=0, atol=1e-8)
    assert road.lane_at(float(got[1])) == network.get_closest_lane_index(np.array([x, y]))[2] or abs(offset) == 2


@LIMITS
@given(st.floats(-20, 10_020), st.floats(-20, 30), st.floats(-3, 3))
def test_reachable_lanes_are_those_of_the_simulator(s, r, angle):
    network = RoadNetwork.straight_road_network(4, angle=angle)
    road = StraightRoad.from_network(network)
    x, y, *_ = road.to_world(np.array([s, r, 0.0, 0.0]))
    local = road.to_road(np.array([x, y, 0.0, 0.0]))
    if min(abs(local[0]), abs(local[0] - 10_005), *abs(abs(local[1] - road.centers) - 8)) < 1e-6:
        return  # on the edge rounding decides, in the simulator too
    got = road.reachable(float(local[0]), float(local[1]))
    lanes = [network.get_lane(("0", "1", i)) for i in range(4)]
    assert got == [bool(lane.is_reachable_from(np.array([x, y]))) for lane in lanes]


def test_curvature_is_zero_and_batches_keep_their_shape():
    road = StraightRoad.from_lanes(2)
    assert road.to_road(np.zeros((2, 3, 4))).shape == (2, 3, 4)
    assert road.to_world(np.zeros((2, 3, 4))).shape == (2, 3, 4)
    np.testing.assert_array_equal(road.curvature(np.arange(3.0)), np.zeros(3))


def test_an_empty_batch_is_a_batch():
    assert StraightRoad.from_lanes(2).to_road(np.zeros((0, 7))).shape == (0, 4)


@pytest.mark.parametrize(
    ("kwargs", "word"),
    [
        ({"centers": []}, "non-empty"),
        ({"centers": [0.0, np.nan]}, "finite"),
        ({"centers": [[0.0, 4.0]]}, "vector"),
        ({"centers": [4.0, 0.0]}, "ascend"),
        ({"centers": [0.0, 0.0]}, "ascend"),
        ({"centers": [0.0], "width": 0.0}, "positive"),
        ({"centers": [0.0], "width": np.nan}, "positive"),
        ({"centers": [0.0], "length": -1.0}, "positive"),
    ],
)
def test_impossible_roads_are_refused(kwargs, word):
    with pytest.raises(SceneError, match=word):
        StraightRoad(**kwargs)


UNSUPPORTED = (
    "merge-v0",
    "roundabout-v0",
    "racetrack-v0",
    "intersection-v0",
    "exit-v0",
    "two-way-v0",
    "u-turn-v0",
    "parking-v0",
    "lane-keeping-v0",
)


@pytest.mark.parametrize("env_id", UNSUPPORTED)
def test_unsupported_environments_are_refused_with_the_supported_ones(env_id):
    env = gym.make(env_id)
    env.reset(seed=0)
    with pytest.raises(SceneError, match="supports"):
        Scene.from_env(env)
    env.close()


def network_of(*lanes):
    network = RoadNetwork()
    for lane in lanes:
        network.add_lane("a", "b", lane)
    return network


@pytest.mark.parametrize(
    "network",
    [
        network_of(StraightLane([0, 0], [100, 0]), StraightLane([0, 4], [100, 8])),
        network_of(StraightLane([0, 0], [100, 0]), StraightLane([5, 4], [100, 4])),
        network_of(StraightLane([0, 0], [100, 0]), StraightLane([0, 4], [100, 4], width=3.0)),
    ],
    ids=["not parallel", "not aligned", "two widths"],
)
def test_lanes_have_to_be_parallel_aligned_and_of_equal_width(network):
    with pytest.raises(SceneError, match="parallel, aligned and of one width"):
        StraightRoad.from_network(network)


def test_lanes_of_unequal_length_are_not_silently_taken_for_equal():
    network = network_of(StraightLane([0, 0], [100, 0]), StraightLane([0, 4], [100, 4]))
    assert StraightRoad.from_network(network).length == 100


def test_a_forbidden_lane_is_not_reachable():
    network = network_of(StraightLane([0, 0], [100, 0]), StraightLane([0, 4], [100, 4], forbidden=True))
    road = StraightRoad.from_network(network)
    assert road.forbidden == (False, True)
    assert road.reachable(10.0, 0.0) == [True, False]
