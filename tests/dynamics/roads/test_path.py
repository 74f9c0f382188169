"""Curved roads: coordinates along arcs are those of highway-env's lanes, and the transformations are inverse."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from highway_env.road.lane import CircularLane, SineLane, StraightLane
from highway_env.road.road import RoadNetwork
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.errors import SceneError
from dynamics.roads.arcs import Arcs, biarc, place, project
from dynamics.roads.path import PathRoad
from dynamics.roads.path_reader import MAX_DEVIATION, SINE_ERROR, read_network
from dynamics.roads.straight import StraightRoad
from dynamics.state import wrap_to_pi

CLOSED = ("racetrack-v0", "racetrack-large-v0", "racetrack-oval-v0")
ROADS = (*CLOSED, "lane-keeping-v0", "u-turn-v0")
EXACT = 1e-6
INVERSE = 1e-9


def network_of(name, **config):
    env = gym.make(name, config=config or None)
    env.reset(seed=0)
    return env.unwrapped.road.network


@pytest.fixture(scope="module")
def maps():
    networks = {name: network_of(name) for name in ROADS}
    return {name: (network, read_network(network)) for name, network in networks.items()}


def sections_of(network):
    return [(a, b, lanes) for a, to in network.graph.items() for b, lanes in to.items()]


def on_road(road, rng, n, margin=0.0):
    """Road states (n, 4) on the lanes, over two laps before and after on a loop."""
    low, high = (-2 * road.length, 2 * road.length) if road.closed else (0.0, road.length)
    edges = road.centers[0] - road.width / 2 + margin, road.centers[-1] + road.width / 2 - margin
    return np.column_stack([rng.uniform(low, high, n), rng.uniform(*edges, n), rng.uniform(-3, 3, n), np.full(n, 9.0)])


@given(
    x=st.floats(-50, 50),
    y=st.floats(-50, 50),
    theta=st.floats(-np.pi, np.pi),
    k=st.one_of(st.just(0.0), st.floats(-0.1, 0.1), st.floats(-1e-10, 1e-10)),
    s=st.floats(-25, 25),
    share=st.floats(-0.9, 0.9),
)
@settings(max_examples=300, deadline=None)
def test_a_point_of_an_arc_is_found_again(x, y, theta, k, s, share):
    pose, r = np.array([x, y, theta]), share * min(20.0, 1 / max(abs(k), 1e-3))
    px, py, heading = place(pose, k, s, r)
    assert heading == pytest.approx(theta + k * s, abs=1e-12)
    assert project(pose, k, px, py) == pytest.approx((s, r), abs=INVERSE)
    # the definition: a circle of radius 1/k about a centre at r = 1/k, or a straight line
    if abs(k) > 1e-4:
        centre = np.array([x - np.sin(theta) / k, y + np.cos(theta) / k])
        assert np.hypot(*(np.array([px, py]) - centre)) == pytest.approx(abs(1 / k - r), rel=1e-9)
    elif k == 0:
        assert (px, py) == pytest.approx(
            (x + s * np.cos(theta) - r * np.sin(theta), y + s * np.sin(theta) + r * np.cos(theta)), abs=1e-12
        )


@given(
    turn=st.floats(-1.2, 1.2),
    bearing=st.floats(-0.8, 0.8),
    chord=st.floats(0.5, 100),
    theta=st.floats(-np.pi, np.pi),
)
@settings(max_examples=200, deadline=None)
def test_a_biarc_leads_from_pose_to_pose_without_a_kink(turn, bearing, chord, theta):
    start = np.array([3.0, -4.0, theta])
    end = np.array([3 + chord * np.cos(theta + bearing), -4 + chord * np.sin(theta + bearing), theta + turn])
    arcs = biarc(start, end)
    ends = place(arcs.poses, arcs.curvatures, arcs.lengths, 0.0)
    wanted = np.stack([arcs.poses[1], end])
    np.testing.assert_allclose(ends[:, :2], wanted[:, :2], rtol=0, atol=1e-9 * max(chord, 1))
    np.testing.assert_allclose(wrap_to_pi(ends[:, 2] - wanted[:, 2] + 1.0), 1.0, rtol=0, atol=1e-9)
    assert (arcs.lengths > 0).all()


@pytest.mark.parametrize("name", ROADS)
def test_to_world_and_to_road_are_inverse_on_curved_roads(maps, name):
    road, rng = maps[name][1], np.random.default_rng(1)
    local = on_road(road, rng, 3000)
    world = road.to_world(local)
    back = road.to_road(world, near=local[:, 0])
    assert np.abs(back - local).max() < INVERSE
    again = road.to_world(road.to_road(world))
    assert np.abs(again[:, :2] - world[:, :2]).max() < INVERSE
    assert np.abs(wrap_to_pi(again[:, 2] - world[:, 2] + 1) - 1).max() < INVERSE
    np.testing.assert_array_equal(again[:, 3], world[:, 3])


@pytest.mark.parametrize("name", ROADS)
def test_batches_of_any_shape_are_their_rows(maps, name):
    road, rng = maps[name][1], np.random.default_rng(2)
    world = road.to_world(on_road(road, rng, 24)).reshape(2, 3, 4, 4)
    together = road.to_road(world)
    assert together.shape == (2, 3, 4, 4)
    np.testing.assert_array_equal(together[1, 2, 3], road.to_road(world[1, 2, 3]))
    np.testing.assert_array_equal(road.to_world(together)[0, 1], road.to_world(together[0, 1]))
    assert road.to_road(np.empty((0, 4))).shape == (0, 4)


def exact_stretches(road, network):
    """(lane, lane index, longitudinal positions) of the places where lane and path share their geometry."""
    for a, b, lanes in sections_of(network):
        for i, lane in enumerate(lanes):
            t = np.linspace(0, lane.length, 400)
            states = np.array([[*lane.position(x, 0.0), lane.heading_at(x), 0.0] for x in t])
            local = road.to_road(states)
            same = (np.abs(local[:, 1] - road.centers[i]) < 1e-7) & (np.abs(local[:, 2]) < 1e-7)
            yield f"{a}->{b}[{i}]", lane, i, t[same]


@pytest.mark.parametrize(
    ("name", "share"), [("racetrack-v0", 0.75), ("racetrack-large-v0", 0.6), ("racetrack-oval-v0", 0.99)]
)
def test_coordinates_are_those_of_the_lanes_where_the_map_is_exact(maps, name, share):
    network, road = maps[name]
    rng, seen, total = np.random.default_rng(3), 0.0, 0.0
    for label, lane, i, t in exact_stretches(road, network):
        total += 400
        seen += len(t)
        if len(t) < 2:
            continue
        lateral = rng.uniform(-road.width / 2, road.width / 2, len(t))
        turn = rng.uniform(-0.5, 0.5, len(t))
        states = np.array(
            [[*lane.position(x, y), lane.heading_at(x) + h, 5.0] for x, y, h in zip(t, lateral, turn, strict=True)]
        )
        wanted = np.array([lane.local_coordinates(p) for p in states[:, :2]])
        near = road.to_road(states[0])[0]
        got = road.to_road(states, near=near)
        middle = (got[1:, 0] + got[:-1, 0]) / 2  # a lane may start exactly on a joint
        scale = 1 - road.curvature(middle) * road.centers[i]  # metres of the lane in one metre of the path
        assert np.abs(got[:, 1] - road.centers[i] - wanted[:, 1]).max() < EXACT, label
        assert np.abs(got[:, 2] - turn).max() < EXACT, label
        along = np.diff(wanted[:, 0]) - np.diff(got[:, 0]) * scale
        within = np.diff(t) < 1.5 * lane.length / 399  # not across a stretch that was left out
        assert np.abs(along[within]).max() < EXACT, label
        headings = np.array([lane.heading_at(x) for x in wanted[:, 0]])
        assert np.abs(wrap_to_pi(road.heading(got[:, 0]) - headings + 1) - 1).max() < EXACT, label
    assert seen / total > share


@pytest.mark.parametrize(
    ("name", "bound"),
    [
        ("racetrack-v0", 0.14),
        ("racetrack-large-v0", 0.18),
        ("racetrack-oval-v0", 0.026),
        ("lane-keeping-v0", 0.3),
        ("u-turn-v0", 1e-9),
    ],
)
def test_no_lane_is_further_from_its_centre_than_the_deviation_says(maps, name, bound):
    network, road = maps[name]
    assert road.deviation <= bound < MAX_DEVIATION
    rng = np.random.default_rng(4)
    for a, b, lanes in sections_of(network):
        for i, lane in enumerate(lanes):
            t = rng.uniform(140.0 if isinstance(lane, SineLane) else 0.0, lane.length, 300)
            states = np.array([[*lane.position(x, 0.0), lane.heading_at(x), 0.0] for x in t])
            local = road.to_road(states)
            assert np.abs(local[:, 1] - road.centers[i]).max() <= road.deviation + 2e-3, (a, b, i)
            assert np.abs(local[:, 2]).max() < 0.2, (a, b, i)


@pytest.mark.parametrize("name", CLOSED)
def test_a_lap_comes_back_to_the_same_place(maps, name):
    road, rng = maps[name][1], np.random.default_rng(5)
    local = on_road(road, rng, 200)
    lap = local + np.array([road.length, 0, 0, 0])
    a, b = road.to_world(local), road.to_world(lap)
    np.testing.assert_allclose(a[:, :2], b[:, :2], rtol=0, atol=INVERSE)
    turn = road.heading(lap[:, 0]) - road.heading(local[:, 0])
    np.testing.assert_allclose(np.abs(turn), 2 * np.pi, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", CLOSED)
@given(at=st.floats(0, 1), ahead=st.floats(-0.49, 0.49), laps=st.integers(-3, 3))
@settings(max_examples=50, deadline=None)
def test_vehicles_ahead_and_behind_have_continuous_s(maps, name, at, ahead, laps):
    road = maps[name][1]
    ego = (at + laps) * road.length
    world = road.to_world(np.array([ego + ahead * road.length, 2.0, 0.1, 3.0]))
    assert road.to_road(world, near=ego)[0] - ego == pytest.approx(ahead * road.length, abs=1e-8)
    assert -1e-9 <= road.to_road(world)[0] <= road.length


@pytest.mark.parametrize("name", ROADS)
def test_coordinates_are_continuous_across_every_joint_and_the_closing_point(maps, name):
    road = maps[name][1]
    joints = np.array(road.profile.breaks if road.closed else road.profile.breaks[1:-1])
    offsets = np.array([-1e-7, 1e-7])
    for r in (road.centers[0] - road.width / 2 + 0.01, road.centers[-1] + road.width / 2 - 0.01):
        states = np.zeros((len(joints), 2, 4))
        states[..., 0], states[..., 1] = joints[:, None] + offsets, r
        world = road.to_world(states)
        assert np.abs(np.diff(world[..., :2], axis=1)).max() < 1e-6
        assert np.abs(wrap_to_pi(np.diff(world[..., 2], axis=1) + 1) - 1).max() < 1e-6
        local = road.to_road(world, near=joints[:, None])
        np.testing.assert_allclose(local[..., :2], states[..., :2], rtol=0, atol=INVERSE)


@pytest.mark.parametrize("name", ROADS)
def test_a_place_inside_a_lane_is_on_the_road_for_the_simulator(maps, name):
    """Except in the slits of up to 0.09 m that the racetracks leave between lanes that are not concentric."""
    network, road = maps[name]
    rng = np.random.default_rng(6)
    local = on_road(road, rng, 400, margin=road.deviation + 0.01)
    between = (road.centers[1:] + road.centers[:-1]) / 2
    slit = np.abs(local[:, 1, None] - between).min(axis=1, initial=np.inf) <= road.deviation
    lanes = [lane for _, _, lanes in sections_of(network) for lane in lanes]
    world = road.to_world(local)
    off = np.array([not any(lane.on_lane(row[:2], margin=1e-6) for lane in lanes) for row in world])
    assert not off[~slit].any()
    assert slit.mean() < 0.1


def test_a_sine_is_within_a_millimetre(maps):
    network, road = maps["lane-keeping-v0"]
    lane = network.graph["a"]["b"][0]
    t = np.random.default_rng(7).uniform(141, 500, 5000)
    states = np.array([[*lane.position(x, 0.0), lane.heading_at(x), 0.0] for x in t])
    local = road.to_road(states)
    assert np.abs(local[:, 1]).max() < SINE_ERROR
    assert np.abs(local[:, 2]).max() < 5e-3
    # across the road on the same side, by no more than the cosine of the slope
    offsets = np.array([[*lane.position(x, 3.0), 0.0, 0.0] for x in t])
    r = road.to_road(offsets)[:, 1]
    assert (r > 3 * 0.95).all()
    assert (r < 3 + 2e-3).all()


def test_a_single_straight_section_is_the_straight_road():
    network = RoadNetwork.straight_road_network(4, length=1_000, angle=0.7)
    road, straight = read_network(network), StraightRoad.from_network(network)
    world = np.random.default_rng(8).uniform(-20, 200, (500, 4)) * np.array([1, 1, 0.01, 0.1])
    got, wanted = road.to_road(world), straight.to_road(world)
    np.testing.assert_allclose(got, wanted, rtol=0, atol=INVERSE)
    np.testing.assert_allclose(road.centers, straight.centers, rtol=0, atol=1e-9)
    assert (road.length, road.width, road.closed, road.deviation < 1e-9) == (
        straight.length,
        straight.width,
        False,
        True,
    )
    assert not road.curvature(got[:, 0]).any()
    for s, r in ((-1.0, 0.0), (3.0, 5.0), (1_004.0, 11.9), (1_006.0, 0.0)):
        assert road.reachable(s, r) == straight.reachable(s, r)
        assert road.lane_at(r) == straight.lane_at(r)


@given(lanes=st.integers(2, 5), length=st.sampled_from([100, 140, 199]))
@settings(max_examples=6, deadline=None)
def test_ovals_of_any_size_are_read(lanes, length):
    road = read_network(network_of("racetrack-oval-v0", no_lanes=lanes, length=length))
    np.testing.assert_allclose(road.centers, 5.0 * np.arange(lanes), rtol=0, atol=1e-9)
    assert road.length == pytest.approx(2 * length + 10 + 60 + np.pi * (20 + 15), abs=1e-9)
    assert road.deviation < 0.026
    assert all(road.reachable(7.0, 5.0)[:2])


@pytest.mark.parametrize(
    "name", ["merge-v0", "roundabout-v0", "intersection-v0", "exit-v0", "two-way-v0", "parking-v0"]
)
def test_other_networks_are_refused_with_the_supported_ones(name):
    with pytest.raises(SceneError, match=r"supported are .*racetrack-v0"):
        read_network(network_of(name))


def two_sections(second, lanes=1):
    network = RoadNetwork()
    for i in range(lanes):
        network.add_lane("a", "b", StraightLane([0, 4 * i], [50, 4 * i]))
    for lane in second:
        network.add_lane("b", "c", lane)
    return network


@pytest.mark.parametrize(
    ("second", "lanes", "words"),
    [
        ([StraightLane([50, 3], [90, 3])], 1, "do not meet"),
        ([StraightLane([50, 0], [50, 90])], 1, "do not meet"),
        ([StraightLane([50, 0], [90, 0], width=5)], 1, "widths"),
        ([StraightLane([50, 0], [90, 0])], 2, "have lanes"),
        ([StraightLane([50, 0], [90, 0]), CircularLane([50, 50], 46, -1.57, 0)], 2, "of kind"),
        ([StraightLane([50, 0], [90, 0]), StraightLane([50, 4], [90, 9])], 2, "from parallel lanes"),
    ],
)
def test_sections_that_make_no_road_are_refused(second, lanes, words):
    with pytest.raises(SceneError, match=words):
        read_network(two_sections(second, lanes))


def test_paths_with_kinks_or_too_tight_bends_are_refused():
    line = Arcs(np.array([[0.0, 0, 0], [10, 0, 0.1]]), np.zeros(2), np.array([10.0, 10]))
    with pytest.raises(SceneError, match="meet in place and direction"):
        PathRoad(line, np.zeros(1))
    bend = Arcs(np.zeros((1, 3)), np.array([0.2]), np.array([10.0]))
    with pytest.raises(SceneError, match="centre of a bend"):
        PathRoad(bend, np.array([0.0, 4.0]))
    with pytest.raises(SceneError, match="half a circle"):
        PathRoad(Arcs(np.zeros((1, 3)), np.array([0.1]), np.array([60.0])), np.zeros(1))
    with pytest.raises(SceneError, match="ascending"):
        PathRoad(Arcs(np.zeros((1, 3)), np.zeros(1), np.array([60.0])), np.array([4.0, 0.0]))
