"""A live environment on a network of roads, and its compiled copy."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
from highway_env.vehicle.behavior import AggressiveVehicle, DefensiveVehicle, IDMVehicle, LinearVehicle
from highway_env.vehicle.objects import Obstacle
from simulator_pair import same_numbers

from dynamics.highway_simulator.layout import KIND, LANE, OBSTACLE, TARGET, TARGET_SPEED, TIMER
from dynamics.road_networks.geometry.layout import ROUTE, ROUTE_END, YIELDS
from dynamics.road_networks.geometry.network import index_of
from dynamics.road_networks.simulation.simulator import NetworkSimulator

__all__ = ["INTERSECTIONS", "Pair", "wild_scene"]

INTERSECTIONS = ("intersection-v0", "intersection-v2")
"""Vehicles come and go between two decisions."""


class Pair:
    """A live environment, and its compiled copy."""

    def __init__(self, env_id, seed, config=None):
        self.env = gym.make(env_id, config=dict(config or {})).unwrapped
        self.env.reset(seed=seed)
        self.name = f"{env_id} seed {seed}"
        self.start()

    def start(self):
        self.simulator = NetworkSimulator(self.env)
        self.bodies = list(self.env.road.vehicles)
        self.numbers = index_of(self.env.road.network)

    def step(self, action):
        """A decision of both, compared; whether the episode is over."""
        _, _, terminated, truncated, _ = self.env.step(action)
        rows = self.simulator.step(action)[-1]
        self.compare(rows)
        return terminated or truncated

    def compare_bodies(self, rows):
        """The place, lane and crash flag of each remaining vehicle, and their columns of `f` and `g`."""
        road, f, g = self.env.road, self.simulator.worlds.f[0], self.simulator.worlds.g[0]
        there = [v in road.vehicles for v in self.bodies] + [True] * len(road.objects)
        assert [kind == OBSTACLE for kind in g[KIND, : len(self.bodies)]] == [
            not each for each in there[: len(self.bodies)]
        ]
        rows, f, g = rows[there], f[:, there], g[:, there]
        bodies, m = [*road.vehicles, *road.objects], len(road.vehicles)
        real = np.array([[*v.position, v.heading, v.speed] for v in bodies], float)
        exact = self.simulator.exact
        assert same_numbers(real, rows[:, :4], exact), self.name
        assert [v.crashed for v in bodies] == (rows[:, 6] > 0).tolist(), self.name
        assert [self.numbers[self.key(v.lane_index)] for v in road.vehicles] == g[LANE, :m].tolist(), self.name
        return f, g

    def compare(self, rows):
        """Each remaining vehicle, with its target commands."""
        f, g = self.compare_bodies(rows)
        road, exact, m = self.env.road, self.simulator.exact, len(self.env.road.vehicles)
        assert [self.numbers[self.key(v.target_lane_index)] for v in road.vehicles] == g[TARGET, :m].tolist(), self.name
        assert same_numbers([float(v.target_speed) for v in road.vehicles], f[TARGET_SPEED, :m], exact), self.name
        assert same_numbers([float(getattr(v, "timer", 0.0)) for v in road.vehicles], f[TIMER, :m], exact), self.name
        assert [getattr(v, "is_yielding", False) for v in road.vehicles] == g[YIELDS, :m].tolist(), self.name
        assert [-1 if v.route is None else len(v.route) for v in road.vehicles] == (g[ROUTE_END] - g[ROUTE])[
            :m
        ].tolist()

    @staticmethod
    def key(index):
        return index[0], index[1], int(index[2])


def wild_scene(env_id, seed, kind=Pair):
    """Vehicles of all kinds thrown over a network, with routes, targets and obstacles of their own."""
    rng = np.random.default_rng(seed)
    pair = kind(env_id, seed)
    road, network = pair.env.road, pair.env.road.network
    keys = list(network.lanes_dict())
    kinds = [
        IDMVehicle,
        type("Coach", (IDMVehicle,), {"LENGTH": 11.0, "WIDTH": 2.4, "POLITENESS": 0.4, "DELTA": 2.0}),
        type("Rash", (IDMVehicle,), {"LANE_CHANGE_DELAY": 0.1, "LANE_CHANGE_MIN_ACC_GAIN": -1.0, "TIME_WANTED": 0.4}),
        AggressiveVehicle,
        DefensiveVehicle,
        type(
            "Hasty", (LinearVehicle,), {"LANE_CHANGE_DELAY": 0.1, "LANE_CHANGE_MIN_ACC_GAIN": -1.0, "POLITENESS": 0.4}
        ),
    ]
    for _ in range(rng.integers(2, 9)):
        lane = network.get_lane(keys[rng.integers(len(keys))])
        s = rng.uniform(-8, lane.length + 8)
        at, heading = lane.position(s, rng.normal(0, 1.5)), lane.heading_at(s) + rng.normal(0, 0.3)
        drives = kinds[rng.integers(len(kinds))]
        vehicle = drives(road, at, heading, rng.uniform(-3, 25), enable_lane_change=rng.random() < 0.8)
        if rng.random() < 0.7:
            nodes = sorted({key[1] for key in keys})
            vehicle.plan_route_to(nodes[rng.integers(len(nodes))])
        if rng.random() < 0.2 and vehicle.route:
            vehicle.route = [(a, b, int(rng.integers(len(network.graph[a][b])))) for a, b, _ in vehicle.route]
        if rng.random() < 0.3:
            vehicle.target_lane_index = network.side_lanes(vehicle.lane_index)[-1:] or [vehicle.lane_index]
            vehicle.target_lane_index = vehicle.target_lane_index[0]
        vehicle.target_speed = rng.uniform(-1, 30)
        if rng.random() < 0.5:
            vehicle.randomize_behavior()
        vehicle.crashed = bool(rng.random() < 0.05)
        road.vehicles.append(vehicle)
    for _ in range(rng.integers(0, 3)):
        lane = network.get_lane(keys[rng.integers(len(keys))])
        road.objects.append(Obstacle(road, lane.position(rng.uniform(0, lane.length), rng.normal())))
    if env_id in INTERSECTIONS:
        pair.env._clear_vehicles()
    pair.name = f"wild {env_id} seed {seed}"
    pair.start()
    return pair, rng
