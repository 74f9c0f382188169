"""Routes of other vehicles that name no road."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest

from dynamics.road_networks.geometry.network import index_of, network_of
from shield import ShieldedEnv
from shield.certificate.network.others import read_traffic

WRONG = [[("x", "y", 0)], [("a", None, None)], [(["a"], "b", 0)], [("a",)]]


@pytest.mark.parametrize("route", WRONG)
def test_a_route_that_names_no_road_is_no_route(route):
    env = gym.make("u-turn-v0")
    env.reset(seed=1)
    base = env.unwrapped
    network, lanes = network_of(base.road.network), index_of(base.road.network)
    other = next(vehicle for vehicle in base.road.vehicles if vehicle is not base.vehicle)
    other.route = None
    without = read_traffic(base, network, lanes).routes
    other.route = route
    assert (read_traffic(base, network, lanes).routes == without).all()
    named = base.road.vehicles[-1]
    named.route = [lane for lane in lanes if lane[2] == 0][:2]
    assert not (read_traffic(base, network, lanes).routes == without).all()


def test_a_decision_verifies_beside_a_vehicle_whose_route_names_no_road():
    env = ShieldedEnv(gym.make("u-turn-v0"), "worst-case")
    env.reset(seed=1)
    env.step(0)
    base = env.unwrapped
    far = max(base.road.vehicles, key=lambda each: float(np.hypot(*(each.position - base.vehicle.position))))
    far.route = WRONG[0]
    far.act = lambda action=None: None
    env.step(0)
    assert env.last_decision.reason != "stage_failed"
