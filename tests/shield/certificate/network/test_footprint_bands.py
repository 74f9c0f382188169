"""Bands of bodies on a lane: the outline of a body is inside the band that the worst case assumes."""

import functools

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from highway_env.road.lane import CircularLane, SineLane, StraightLane
from highway_env.vehicle.kinematics import Vehicle
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from dynamics.road_networks.reachable.strips import BODY_HALF, FAR, HIGH, LOW, NEAR, body_half, centred_half
from shield import ShieldConfig, ShieldedEnv
from shield.certificate.network.manoeuvres import stopping
from shield.filters.network import NetworkFilter

TOLERANCE, SMALL = 1e-6, 0.03


def worst_corner(kind, angles=0.15):
    """How far any corner reaches out of the band of its body across the lane, and along it [m]."""
    env = ShieldedEnv(gym.make("roundabout-v0"), "worst-case")
    env.reset(seed=1)
    base, worst = env.unwrapped, np.array([-np.inf, -np.inf])
    road, rng = base.road, np.random.default_rng(0)
    lanes = {key: lane for key, lane in road.network.lanes_dict().items() if type(lane) is kind}
    assert lanes
    for key, lane in lanes.items():
        for _ in range(8):
            s = rng.uniform(0.2, 0.8) * lane.length
            heading = lane.heading_at(s) + rng.uniform(-angles, angles)
            body = Vehicle(road, lane.position(s, rng.uniform(-1.5, 1.5)), heading, 2.0)
            body.lane_index, body.lane, body.route = key, lane, None
            road.vehicles = [base.vehicle, body]
            env.filter.reset()
            env.filter._read()
            others = env.filter.watch.last.others
            number = next(k for k, name in enumerate(road.network.lanes_dict()) if name == key)
            ours = others.marks[: int(others.found[0]), 1] == number
            row = others.numbers[: int(others.found[0])][ours][0]
            local = np.array([lane.local_coordinates(corner) for corner in body.polygon()[:4]])
            across = max(row[LOW] - local[:, 1].min(), local[:, 1].max() - row[HIGH])
            along = max(-row[FAR] - row[BODY_HALF] - local[:, 0].min(), local[:, 0].max() + row[NEAR] - row[BODY_HALF])
            worst = np.maximum(worst, [across, along])
    return worst


ACROSS, ALONG = 0, 1


@pytest.mark.parametrize(
    ("kind", "side"),
    [
        (StraightLane, ACROSS),
        (StraightLane, ALONG),
        (CircularLane, ACROSS),
        (CircularLane, ALONG),
        (SineLane, ACROSS),
        (SineLane, ALONG),
    ],
)
def test_a_body_is_inside_its_band(kind, side):
    assert worst_corner(kind)[side] <= TOLERANCE


ROADS = ("roundabout-v0", "merge-v0", "exit-v0", "u-turn-v0", "intersection-v0")
SIDE = np.linspace(-0.5, 0.5, 41)
OUTLINE = np.concatenate(
    [np.stack([SIDE, SIDE * 0 + k], axis=1) for k in (-0.5, 0.5)]
    + [np.stack([SIDE * 0 + k, SIDE], axis=1) for k in (-0.5, 0.5)]
)
LENGTHS, WIDTHS = st.floats(0.5, 12.0), st.floats(0.4, 3.0)


@functools.cache
def road_of(env_id):
    """A filter, and one vehicle besides the ego."""
    env = gym.make(env_id)
    env.reset(seed=1)
    base = env.unwrapped
    network_filter, body = NetworkFilter(base, ShieldConfig.for_roads()), Vehicle(base.road, [0.0, 0.0])
    base.road.vehicles, base.road.objects = [base.vehicle, body], []
    return network_filter, body


def outline_on(lane, body):
    """s and r of the outline, and the s of the middle [m]; s of an arc goes on from there."""
    cos, sin = np.cos(body.heading), np.sin(body.heading)
    points = body.position + OUTLINE * [body.LENGTH, body.WIDTH] @ np.array([[cos, sin], [-sin, cos]])
    (s, r), middle = (
        np.array([lane.local_coordinates(point) for point in points]).T,
        lane.local_coordinates(body.position)[0],
    )
    if isinstance(lane, CircularLane):
        s = middle + ((s - middle) / lane.radius + np.pi) % (2 * np.pi) * lane.radius - np.pi * lane.radius
    return s, r, middle


@pytest.mark.parametrize("env_id", ROADS)
@settings(max_examples=60, deadline=None)
@given(
    which=st.floats(0, 1, exclude_max=True),
    share=st.floats(0, 1),
    r=st.floats(-3, 3),
    angle=st.floats(-np.pi, np.pi),
    length=LENGTHS,
    width=WIDTHS,
)
def test_every_strip_of_a_body_encloses_its_outline(env_id, which, share, r, angle, length, width):
    """On any lane, of any length and heading: along the lane and across it."""
    network_filter, body = road_of(env_id)
    lanes = network_filter._base.road.network.lanes_dict()
    index = list(lanes)[int(which * len(lanes))]
    lane = lanes[index]
    body.position, body.heading = lane.position(share * lane.length, r), lane.heading_at(share * lane.length) + angle
    body.LENGTH, body.WIDTH, body.lane_index, body.lane = length, width, index, lane
    others, numbers = network_filter._predict().others, list(lanes)
    now = np.flatnonzero(others.marks[:, 2] == -1)
    assert now.size
    for lane_number, row in zip(others.marks[now, 1], others.numbers[now], strict=True):
        s, across, middle = outline_on(lanes[numbers[lane_number]], body)
        assert middle == pytest.approx(-row[NEAR]) == -row[FAR]
        assert np.abs(s - middle).max() <= row[BODY_HALF] + TOLERANCE
        assert row[LOW] - TOLERANCE <= across.min()
        assert across.max() <= row[HIGH] + TOLERANCE


@pytest.mark.parametrize("env_id", ROADS)
@settings(max_examples=60, deadline=None)
@given(
    which=st.floats(0, 1, exclude_max=True),
    share=st.floats(0, 1),
    r=st.floats(-0.6, 0.6),
    angle=st.floats(-0.2, 0.2),
    length=LENGTHS,
    width=WIDTHS,
)
def test_a_body_that_keeps_to_its_lane_stays_inside_the_predicted_band(env_id, which, share, r, angle, length, width):
    """The predicted band of a body elsewhere on the lane, as far across and as much at an angle as the rules permit."""
    network_filter, body = road_of(env_id)
    road, lanes = network_filter._road, network_filter._base.road.network.lanes_dict()
    number = int(which * len(lanes))
    index = list(lanes)[number]
    lane = lanes[index]
    aside = 0.5 * (length * abs(np.sin(angle)) + width * np.cos(angle))
    assume(abs(r) + aside <= 0.5 * width + road.bounds.lateral_deviation)
    body.position, body.heading = lane.position(share * lane.length, r), lane.heading_at(share * lane.length) + angle
    body.LENGTH, body.WIDTH = length, width
    row = np.array([*body.position, body.heading, 5.0, length, width, 0.0])
    s, across, middle = outline_on(lane, body)
    assert np.abs(s - middle).max() <= body_half(road.lanes, number, row, road.bounds) + TOLERANCE
    assert np.abs(across).max() <= centred_half(road.lanes, number, row, road.bounds) + SMALL


def decided(env_id, ego, other):
    """The decision for a standing ego that proposes to drive on, with one standing vehicle. Both are given as lane,
    s and r [m], angle to the lane [rad] and length [m]."""
    env = gym.make(env_id)
    env.reset(seed=1)
    base = env.unwrapped
    road = base.road
    body = Vehicle(road, [0.0, 0.0], 0.0, 0.0)
    for vehicle, (index, s, r, angle, length) in ((base.vehicle, ego), (body, other)):
        lane = road.network.get_lane(index)
        vehicle.position, vehicle.heading, vehicle.speed = lane.position(s, r), lane.heading_at(s) + angle, 0.0
        vehicle.lane_index, vehicle.lane, vehicle.LENGTH, vehicle.route = index, lane, length, None
    base.vehicle.target_lane_index = ego[0]
    road.vehicles, road.objects = [base.vehicle, body], []
    network_filter = NetworkFilter(base, ShieldConfig.for_roads())
    network_filter.reset()
    network_filter.decide(1)
    return network_filter.frame()[1]


@pytest.mark.parametrize(("s", "clear"), [(5.0, False), (9.0, True)])
def test_a_body_reaches_past_the_end_of_half_a_circle(s, clear):
    """The lane of a u-turn ends where highway-env's s leaps back by a circle; a body of 12 m ends 1.5 m further on."""
    end = np.pi * 20.0
    found = decided("u-turn-v0", (("c", "d", 0), s, 0.0, 0.0, 5.0), (("b", "c", 0), end - 4.5, 0.0, 0.0, 12.0))
    assert found.tier.verified == clear


@pytest.mark.parametrize(("length", "clear"), [(12.0, True), (40.0, False)])
def test_a_body_across_another_lane_blocks_the_ego_if_it_is_long(length, clear):
    """A vehicle stands across merge's ramp, 14 m beside the ego's lane; a long one reaches into that lane."""
    ego, other = (("a", "b", 0), 60.0, 0.0, 0.0, 5.0), (("j", "k", 0), 62.0, 0.0, np.pi / 2, length)
    assert decided("merge-v0", ego, other).tier.verified == clear


def test_the_margin_to_a_vehicle_does_not_depend_on_another():
    """A long body turns across a lane to which the lane of another vehicle leads, so the ego is looked up there from
    further away. The result for the other vehicle stays the same."""
    margins = []
    for angle in (0.0, -1.7):
        env = gym.make("u-turn-v0")
        env.reset(seed=1)
        base = env.unwrapped
        road, ego, lane = base.road, base.vehicle, ("a", "b", 0)
        ego.position, ego.heading, ego.speed = road.network.get_lane(lane).position(90.2, 0.0), 0.0, 23.0
        ego.lane_index = ego.target_lane_index = lane
        ego.lane, ego.route = road.network.get_lane(lane), None
        road.vehicles, road.objects = [ego], []
        for index, s, turned, length in ((("a", "b", 1), 78.5, 0.0, 10.0), (("b", "c", 0), 2.7, angle, 8.5)):
            at = road.network.get_lane(index)
            body = Vehicle(road, at.position(s, 0.0), at.heading_at(s) + turned, 0.8)
            body.LENGTH, body.WIDTH, body.route = length, 0.5, None
            road.vehicles.append(body)
        network_filter = NetworkFilter(base, ShieldConfig.for_roads())
        network_filter.reset()
        network_filter._read()
        network_filter._try(stopping(network_filter._bound, 9.8))
        margins.append(network_filter._rollout.margins[0])
    assert margins[0] == margins[1]
