"""Loopholes of the worst case on road networks, found by hand: a vehicle that takes the ego's room is named, and no
vehicle that keeps the rules is reported as unforeseen."""

from __future__ import annotations

import math

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from hand_driven import Placed
from highway_env.vehicle.objects import Obstacle, RoadObject

from dynamics.road_networks.reachable.strips import SEVERAL
from shield import ShieldedEnv
from shield.certificate.network.clearance import _is_blocked

FASTER, IDLE, SLOWER = 3, 1, 4


class Sign(RoadObject):
    """An object of a class that highway-env does not have."""

    def __init__(self, road, position, heading=0.0, speed=0.0):
        super().__init__(road, position, heading, speed)


def body(road, position, heading, speed, size=(5.0, 2.0)):
    """A vehicle of a length and a width [m]."""
    out = Placed(road, (*position, heading, speed), size)
    out.collidable = False
    return out


def alone(env_id, frequency):
    """An ego without other vehicles, and the road."""
    config = {"simulation_frequency": frequency, "policy_frequency": 1, "duration": 100}
    env = ShieldedEnv(gym.make(env_id, config=config), "worst-case")
    env.reset(seed=0)
    road, ego = env.unwrapped.road, env.unwrapped.vehicle
    road.vehicles, road.objects = [ego], []
    return env, road, ego


def put_on(ego, index, s, r, speed, target):
    """Have an ego drive in a lane, with a target speed [m/s]."""
    lane = ego.road.network.get_lane(index)
    ego.position, ego.heading, ego.speed = lane.position(s, r), lane.heading_at(s), speed
    ego.target_speed, ego.speed_index = target, list(ego.target_speeds).index(target)
    ego.lane_index = ego.target_lane_index = index
    ego.lane = lane


def drive(env, action, steps, after, collide=False):
    """Some decisions; `after(frame)` is called when the vehicles have moved."""
    road, frame = env.unwrapped.road, 0

    def step(dt):
        nonlocal frame
        for vehicle in road.vehicles:
            vehicle.step(dt)
        after(frame)
        for i, vehicle in enumerate(road.vehicles if collide else ()):
            for other in [*road.vehicles[i + 1 :], *road.objects]:
                vehicle.handle_collisions(other, dt)
        frame += 1

    road.step = step
    for _ in range(steps):
        *_, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            break
    env.filter.monitor_last_frame()


@pytest.mark.parametrize("length", [1.0, 3.0, 3.4, 5.0])
def test_a_short_follower_around_the_ring_causes_no_prediction_mismatch(length):
    """The follower's obligation is to the body, one frame after a path is verified against the buffer. The lane
    after the ego's resting place has to be closed to the follower in both frames, or in neither."""
    env, road, ego = alone("roundabout-v1", 15)
    ring = [("sx", "se", 1), ("se", "ex", 1), ("ex", "ee", 1), ("ee", "nx", 1), ("nx", "ne", 1)]
    lanes = [road.network.get_lane(index) for index in ring]
    put_on(ego, ring[0], 13.8, 0.0, 8.0, 16.0)
    ego.plan_route_to("nxs")
    follower = body(road, lanes[0].position(5.8, 0), lanes[0].heading_at(5.8), 8.0, (length, 1.0))
    road.vehicles.append(follower)
    owed = []

    def follow(frame):
        s, k = 5.8 + 8.0 * (frame + 1) / 15, 0
        while s > lanes[k].length:
            s, k = s - lanes[k].length, k + 1
        follower.put(lanes[k].position(s, 0), lanes[k].heading_at(s), 8.0)
        owed.append(env.filter.has_distance_obligation(follower))

    drive(env, FASTER, 2, follow)
    assert any(owed)
    assert not env.filter.by_rule


def test_a_lane_that_two_reachable_intervals_lead_to_is_closed_with_both():
    """A long vehicle at the end of an approach turns on the spot, behind an ego that will stop at the joint. It then
    has two reachable intervals in the next lane, and the lane after that is closed with both."""
    env, road, ego = alone("roundabout-v0", 30)
    rng = np.random.default_rng(4)
    index = ("sx", "se", 1)
    s, r = rng.uniform(8, 17), rng.uniform(-0.5, 3)
    put_on(ego, index, s, r, rng.uniform(2, 8), 0.0)
    ego.plan_route_to("nxs")
    obstacle = Obstacle(road, road.network.get_lane(("se", "ex", 1)).position(rng.uniform(3, 12), 0), 0.0, 0.0)
    obstacle.collidable = False
    road.objects = [obstacle]
    turning = body(road, [2.27, 42.92], 0.177, 0.0, (14.6, 2.6))
    road.vehicles.append(turning)
    drive(env, SLOWER, 1, lambda frame: turning.put([2.27, 42.92], -1.7255, 0.0))
    assert "unforeseen" not in env.filter.by_rule


def test_a_lane_is_closed_where_all_lanes_that_lead_to_it_are():
    """A body within 3 m of a joint has two strips of the lane that goes on; both lead to the next."""
    env, road, _ = alone("roundabout-v0", 30)
    road.vehicles.append(body(road, [2.27, 42.92], -1.7255, 0.0, (14.6, 2.6)))
    env.filter.reset()
    env.filter.decide(IDLE)
    others = env.filter._others
    several = np.flatnonzero(others.marks[:, 2] == SEVERAL)
    assert several.size
    for j in several:
        shut = []
        for open_ in range(-1, j):
            others.shut[:] = True
            others.shut[max(open_, 0)] &= open_ < 0
            shut.append(_is_blocked(others, env.filter._road, j))
        assert shut[0]
        assert shut.count(False) == 2


def test_an_object_that_stands_and_gets_a_speed_has_moved():
    """highway-env counts a collision by its speed, though it stays where it is."""
    env, road, ego = alone("merge-v1", 15)
    obstacle = Obstacle(road, ego.position + np.array([60.0, -4.0]), 0.0, 0.0)
    road.objects = [obstacle]

    def speed_up(frame):
        obstacle.speed = -45.0 if frame >= 10 else 0.0

    drive(env, IDLE, 1, speed_up)
    assert env.filter.by_rule == {"moved": 1}


def test_a_vehicle_that_becomes_an_object_has_appeared():
    env, road, ego = alone("merge-v1", 15)
    it = body(road, ego.position + np.array([120.0, -4.0]), 0.0, 0.0)
    road.vehicles.append(it)

    def jump(frame):
        if frame == 8:
            road.vehicles.remove(it)
            road.objects.append(it)
            it.position = ego.position + np.array([6.5, 0.0])

    drive(env, IDLE, 1, jump)
    assert env.filter.by_rule == {"appeared": 1}


def test_an_object_of_any_class_is_named_and_the_others_are_judged():
    env, road, ego = alone("merge-v1", 15)
    far = body(road, ego.position + np.array([150.0, 0.0]), 0.0, 10.0)
    road.vehicles.append(far)

    def appear(frame):
        if frame == 4:
            road.objects.append(Sign(road, ego.position + np.array([80.0, 0.0])))
        far.put(far.position + np.array([far.speed / 15, 0.0]), 0.0, 10.0 if frame < 8 else 30.0)

    drive(env, IDLE, 1, appear)
    assert env.filter.by_rule == {"appeared": 1, "speed": 1}
    assert env.filter.cause == ""


def test_a_stale_lane_index_is_not_believed():
    """A vehicle that is placed without telling highway-env goes across the ego's road, and names a lane far away."""
    env, road, ego = alone("roundabout-v0", 20)
    stale = ("ex", "ee", 0)
    lane = road.network.get_lane(stale)
    it = body(road, lane.position(8, 0), lane.heading_at(8), 12.0)
    road.vehicles.append(it)
    touched = []

    def cross(frame):
        if frame >= 5:
            across = np.array([-math.sin(ego.heading), math.cos(ego.heading)])
            it.put(ego.position + 0.6 * (frame - 10) * across, ego.heading + math.pi / 2, 12.0)
            it.lane_index, it.lane = stale, lane
        touched.append((frame, dict(env.filter.by_rule)))
        if frame == 10:
            marks = env.filter._predict().others.marks
            there = {env.filter._names[lane] for lane in marks[marks[:, 2] == -1, 1]}
            assert road.network.get_closest_lane_index(it.position, it.heading) in there

    drive(env, IDLE, 1, cross)
    # It is named by the look that follows the frame in which it comes near.
    assert touched[6][1].get("ways") == 1


@pytest.mark.parametrize(("frequency", "speed"), [(5, 25.0), (10, 40.0)])
def test_a_vehicle_that_points_at_the_ego_for_one_frame_is_a_violator(frequency, speed):
    """Its body stays in its band, in the lane beside the ego's. highway-env counts a crash all the same, because of
    where both would be at constant velocity."""
    env, road, ego = alone("merge-v1", frequency)
    ego.speed = ego.target_speed = speed
    it = body(road, ego.position + np.array([-1.0, -ego.position[1] - 0.6]), 0.0, speed)
    it.collidable = True
    road.vehicles.append(it)

    def point(frame):
        heading = 0.49 if frame == 3 else 0.0
        it.put([it.position[0] + speed / frequency, it.position[1]], heading, speed)
        it.impact, it.crashed = None, False

    drive(env, IDLE, 1, point, collide=True)
    assert ego.crashed
    assert env.filter.by_rule.get("ways") == 1


def test_a_vehicle_that_always_drives_askew_is_a_violator_where_it_would_hit_the_ego():
    """It drives along its lane at an angle and catches up with the ego in the lane beside. Its body keeps to the
    middle of its lane, and its extent across the lane does not change."""
    env, road, ego = alone("merge-v1", 5)
    ego.speed = ego.target_speed = 20.0
    it = body(road, ego.position + np.array([-12.0, -ego.position[1] + 0.1]), 0.49, 25.0, (2.0, 1.0))
    it.collidable = True
    road.vehicles.append(it)

    def slide(frame):
        if not ego.crashed:
            it.put([it.position[0] + 25.0 / 5, it.position[1]], 0.49, 25.0)
        it.impact, it.crashed = None, False

    drive(env, IDLE, 3, slide, collide=True)
    assert ego.crashed
    assert env.filter.by_rule == {"ways": 1}


def test_a_motion_beyond_the_bound_that_uses_up_a_margin_is_a_violation_of_any_size():
    """Tolerances of the rules add up, frame by frame. They are far below the margin of a path that is clear."""
    env, road, ego = alone("merge-v1", 15)
    ahead = body(road, ego.position + np.array([80.0, 0.0]), 0.0, 20.0)
    road.vehicles.append(ahead)
    drive(env, IDLE, 1, lambda frame: ahead.put(ahead.position + np.array([20.0 / 15, 0.0]), 0.0, 20.0))
    network_filter, watch = env.filter, env.filter.watch
    assert not network_filter.by_rule
    last = watch.last
    least = float(last.others.least[0, 1])
    for less, named in ((0.0, {}), (1e-11, {}), (1e-8, {"ways": 1})):
        watch.last, watch.breaking, watch.by_rule = last, {}, {}
        kept = ahead.position.copy()
        ahead.put(kept + np.array([least - less, 0.0]), 0.0, 20.0 - 6.0 / 15)
        watch.next(network_filter._predict(), {ahead}, np.array([-5e-7]), network_filter._road, set())
        ahead.put(kept, 0.0, 20.0)
        assert {str(rule): count for rule, count in watch.by_rule.items()} == named


@pytest.mark.parametrize("offset", [10.0, 10.3, 10.6, 10.9])
def test_a_truck_on_the_ring_is_predicted_with_one_frame_straight_ahead(offset):
    """highway-env checks collisions in the coming frame at constant velocity. On an arc, the front of a truck at the
    outer edge of its lane so hits an ego at rest in the lane beside. The lane was once assumed to contain the truck."""
    env, road, ego = alone("roundabout-v0", 15)
    put_on(ego, ("ex", "ee", 1), 8.0, 0.0, 0.0, 0)
    speed, length, radius = 19.9, 12.0, 20.0
    width = 2 * (2.7 - 0.6 - length**2 / 8 / radius - 6 / radius) - 0.002
    out = radius + width / 2 + 0.6 + length**2 / 8 / radius + 6 / radius - 1e-6
    middle = math.sqrt(out**2 - length**2 / 4) - width / 2
    begins = math.atan2(ego.position[1], ego.position[0]) + offset / radius
    truck = body(road, (0.0, 0.0), 0.0, speed, (length, width))
    truck.collidable = True
    nodes = ["wx", "we", "sx", "se", "ex", "ee", "nx", "ne"]
    truck.route = [(a, b, 0) for a, b in zip(nodes[2:], [*nodes[3:], nodes[0]], strict=True)]

    def place(frame):
        angle = begins - (frame + 1) * speed / 15 / middle
        truck.put((middle * math.cos(angle), middle * math.sin(angle)), angle - math.pi / 2, speed)

    place(-1)
    road.vehicles.append(truck)
    records = []

    def after(frame):
        records.append(env.frame_decisions[-1].tier.verified)
        place(frame)

    drive(env, SLOWER, 1, after, collide=True)
    assert not (records[0] and ego.crashed)
    assert "unforeseen" not in env.filter.by_rule
