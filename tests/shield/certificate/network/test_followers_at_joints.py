"""A follower's obligation lasts while the follower is behind the ego's body, across the joints of lanes."""

from __future__ import annotations

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from highway_env.vehicle.kinematics import Vehicle

from shield import ShieldConfig
from shield.filters.network import NetworkFilter

BEFORE, LANE = ("ser", "ses", 0), ("ses", "se", 0)
IDLE = 1


def creep_up(length, width, step, until):
    """A follower creeps up to a standing ego that is at an angle to its lane, down to a gap [m]; each frame yields
    the decision, the filter and the gap."""
    env = gym.make("roundabout-v0")
    env.reset(seed=0)
    base = env.unwrapped
    road, ego = base.road, base.vehicle
    ego.position, ego.heading, ego.speed = np.array([2.48, 37.87]), -1.426, 0.0
    ego.lane_index = ego.target_lane_index = LANE
    ego.lane, ego.route, ego.speed_index, ego.target_speed = road.network.get_lane(LANE), None, 0, 0.0
    lane = road.network.get_lane(BEFORE)
    rear = min(lane.local_coordinates(corner)[0] for corner in ego.polygon()[:4])
    start = lane.position(rear - 2.3 - 0.5 * length, 0.0)
    body = Vehicle(road, start, lane.heading, step * base.config["simulation_frequency"])
    body.LENGTH, body.WIDTH, body.route = length, width, None
    road.vehicles, road.objects = [ego, body], []
    network_filter = NetworkFilter(base, ShieldConfig.for_roads())
    network_filter.reset()
    while (left := rear - lane.local_coordinates(body.position)[0] - 0.5 * length) > until:
        network_filter.decide(IDLE)
        yield network_filter.frame()[1], network_filter, left
        body.position = body.position + step * np.array([np.cos(body.heading), np.sin(body.heading)])
        body.on_state_update()
        base.steps += 1


@pytest.mark.parametrize(("length", "width"), [(5.0, 2.0), (1.0, 2.0), (0.6, 0.5)])
def test_a_follower_that_creeps_up_to_the_body_keeps_its_obligation(length, width):
    """Across the joint or not, with the ego at an angle: in each frame a path verifies, and no rule is broken. The
    follower comes as near as the rules let it."""
    step, nearest = 0.005, np.inf
    until = 0.1 * width + 2 * step
    for decision, network_filter, nearest in creep_up(length, width, step, until):
        assert decision.tier.verified, nearest
        assert network_filter.violations == 0
        assert network_filter.has_distance_obligation(network_filter._base.road.vehicles[1])
    assert nearest < until + step


@pytest.mark.parametrize(("length", "width"), [(1.4, 0.3), (5.0, 2.0)])
def test_a_follower_far_behind_an_ego_that_will_stand_beyond_the_joint_can_keep_its_distance(length, width):
    """It brakes for the ego in its own lane, where it sees it, before it comes into the next."""
    env = gym.make("roundabout-v0")
    env.reset(seed=0)
    base = env.unwrapped
    road, ego = base.road, base.vehicle
    lane = road.network.get_lane(BEFORE)
    body = Vehicle(road, lane.position(22.0, 0.0), lane.heading, 0.4)
    body.LENGTH, body.WIDTH, body.route = length, width, None
    road.vehicles, road.objects, verified = [ego, body], [], 0
    for s in np.arange(100.0, 122.0, 0.5):
        ego.position, ego.heading, ego.speed = lane.position(s, 0.0), lane.heading, 15.6
        ego.lane_index = ego.target_lane_index = BEFORE
        ego.lane, ego.route, ego.speed_index, ego.target_speed = lane, None, 2, 16.0
        network_filter = NetworkFilter(base, ShieldConfig.for_roads())
        network_filter.reset()
        network_filter.decide(IDLE)
        if network_filter.frame()[1].tier.verified:
            verified += 1
            assert network_filter._braking.stays[body] > 50.0, s
    assert verified > 20
