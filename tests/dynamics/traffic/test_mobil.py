"""Lane-change incentives against highway-env's own MOBIL."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
from highway_env.vehicle.behavior import IDMVehicle
from hypothesis import given
from hypothesis import strategies as st

from dynamics.highway_simulator.kinds import constants_of
from dynamics.highway_simulator.layout import COMFORT, DISTANCE, GAIN, TIME, TWICE_ROOT
from dynamics.scenes.scene import SceneReader
from dynamics.traffic import mobil
from dynamics.traffic.occupancy import order_by_position

SIGHT = 3.0


def gains(states, *args, ego=None):
    """Vehicles with an incentive to change to either side, (m, 2) bool."""
    out = np.empty((len(states), 2), dtype=bool)
    nobody = np.array([-np.inf, 0.0, 0.0, 0.0]) if ego is None else ego
    lane, low, high, *sight = args
    traffic = mobil.TrafficInLanes(states, states[:, 3] * np.sin(states[:, 2]), lane, low, high)
    mobil.lane_change_incentives(traffic, mobil.LaneSight(*sight), nobody, np.ones_like(out), out)
    return out


def lanes_wanted(env):
    """Which neighbouring lane each IDM vehicle's own MOBIL recommends, (m, 2) bool; the ego is not there."""
    base = env.unwrapped
    ego, road = base.vehicle, base.road
    others = [v for v in road.vehicles if v is not ego]
    road.vehicles = others
    wanted = np.zeros((len(others), 2), dtype=bool)
    for i, v in enumerate(others):
        assert isinstance(v, IDMVehicle)
        for lane in road.network.side_lanes(v.lane_index):
            wanted[i, int(lane[2] > v.lane_index[2])] = v.mobil(lane)
    road.vehicles = [ego, *others]
    return wanted


def test_the_constants_are_highway_envs():
    """The constants of the certificate are those that the simulator reads from highway-env's classes."""
    known = constants_of(IDMVehicle)
    assert known[[DISTANCE, TIME, TWICE_ROOT, COMFORT, GAIN]].tolist() == [
        mobil.GAP,
        mobil.TIME,
        mobil.TWICE_ROOT,
        mobil.COMFORT,
        mobil.LEAST_GAIN,
    ]


def test_a_vehicle_that_would_change_lanes_has_an_incentive():
    env = gym.make("highway-fast-v0", config={"vehicles_density": 1.5})
    reader, found = SceneReader(env), 0
    for k in range(160):
        if k % 8 == 0:
            env.reset(seed=k // 8)
        env.step(1)
        scene, wanted = reader.read(), lanes_wanted(env)
        centers = scene.road.centers
        lane = np.abs(scene.others_road[:, 1, None] - centers).argmin(axis=1)
        edges = scene.others_road[:, 1] - 1.25, scene.others_road[:, 1] + 1.25
        exact = gains(scene.others_road, lane, *edges, centers, SIGHT, 0.0)
        # highway-env knows the desired speeds of the new follower and the vehicle; the incentive covers all that it
        # permits.
        settled = np.abs(scene.others_road[:, 1] - centers[lane]) < 0.05
        assert not (wanted & ~exact)[settled].any()
        assert not (exact & ~gains(scene.others_road, lane, *edges, centers, SIGHT, 1.0)).any()
        found += wanted.sum()
    env.close()
    assert found > 10


def test_a_blocked_vehicle_has_an_incentive_and_a_free_one_has_none():
    lane, centers = np.array([0, 0, 1]), np.array([0.0, 4.0])
    states = np.array([[0.0, 0.0, 0.0, 20.0], [30.0, 0.0, 0.0, 10.0], [60.0, 4.0, 0.0, 20.0]])
    edges = states[:, 1] - 1.25, states[:, 1] + 1.25
    assert gains(states, lane, *edges, centers, SIGHT, 0.0).tolist() == [[False, True], [False, False], [False, False]]
    # Not into a lane where the new follower would have to brake hard.
    states[2] = [-5.0, 4.0, 0.0, 25.0]
    assert not gains(states, lane, *edges, centers, SIGHT, 0.0)[0].any()


def test_a_vehicle_about_to_be_blocked_has_an_incentive():
    """A slower vehicle on its way into the lane counts before MOBIL sees it there."""
    lane, centers = np.array([1, 2]), np.array([0.0, 4.0, 8.0])
    states = np.array([[0.0, 4.0, 0.0, 20.0], [30.0, 7.1, -0.3, 10.0]])
    straight, turning = np.array([2.75, 6.75]), np.array([2.75, 2.75])
    high = np.array([5.25, 9.25])
    assert not gains(states, lane, straight, high, centers, SIGHT, 0.0)[0].any()
    # To either side, because that vehicle is on its way out of the lane above, too.
    assert gains(states, lane, turning, high, centers, SIGHT, 0.0)[0].tolist() == [True, True]


def test_a_vehicle_that_leaves_a_lane_is_no_leader_there():
    """A slow vehicle on its way out of a lane has left it by the time that another one enters."""
    lane, centers = np.array([2, 0, 2]), np.array([0.0, 4.0, 8.0])
    states = np.array([[0.0, 8.0, 0.0, 18.0], [60.0, 1.07, -0.2, 14.5], [60.0, 8.0, 0.0, 16.0]])
    edges = states[:, 1] - 1.25, states[:, 1] + 1.25
    assert gains(states, lane, *edges, centers, SIGHT, 0.0)[0, 0]
    states[1, 2] = 0.2  # it comes in instead
    assert not gains(states, lane, *edges, centers, SIGHT, 0.0)[0, 0]


def test_an_ego_ahead_is_a_reason_to_leave_the_lane():
    lane, centers = np.array([1]), np.array([0.0, 4.0, 8.0])
    states, ego = np.array([[0.0, 4.0, 0.0, 16.0]]), np.array([16.0, 3.6, 0.05, 20.0])
    edges = states[:, 1] - 1.25, states[:, 1] + 1.25
    assert not gains(states, lane, *edges, centers, SIGHT, 0.0).any()
    assert gains(states, lane, *edges, centers, SIGHT, 0.0, ego=ego).all()
    assert not gains(states, lane, *edges, centers, SIGHT, 0.0, ego=ego * [-1, 1, 1, 1]).any()


def asked_one_by_one(states, lane, low, high, centers, slack, ego):
    """The formulas of MOBIL, vehicle by vehicle, for each pair."""
    across, wanted = states[:, 3] * np.sin(states[:, 2]), np.zeros((len(states), 2), bool)

    def held_up(v, speed, gap):
        return (mobil.GAP + mobil.TIME * v + v * (v - speed) / mobil.TWICE_ROOT) / max(gap, 1e-2)

    for j, (s, _, _, v) in enumerate(states):
        own, others = centers[lane[j]], [i for i in range(len(states)) if i != j]
        ahead = [i for i in others if states[i, 0] >= s]
        leaders = [i for i in ahead if abs(states[i, 1] - own) <= SIGHT or low[i] < own < high[i]]
        now = max([held_up(v, states[i, 3], states[i, 0] - s) ** 2 for i in leaders], default=0.0)
        if ego[0] >= s and (abs(ego[1] - own) <= SIGHT or low[j] < ego[1] < high[j]):
            now = max(now, held_up(v, ego[3], ego[0] - s) ** 2)
        for side, to in enumerate((lane[j] - 1, lane[j] + 1)):
            if not 0 <= to < len(centers):
                continue
            there = [i for i in others if max(np.abs(states[i, 1] + [0, across[i]] - centers[to])) <= SIGHT]
            leader = min((i for i in there if i in ahead), key=lambda i: states[i, 0], default=None)
            follower = max((i for i in there if i not in ahead), key=lambda i: states[i, 0], default=None)
            then = 0.0 if leader is None else held_up(v, states[leader, 3], states[leader, 0] - s) ** 2
            back = 0.0 if follower is None else held_up(states[follower, 3], v, s - states[follower, 0])
            wanted[j, side] = 3.0 * (now - then) >= 0.2 - slack and back <= 1.3 + slack
    return wanted


@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.sampled_from([0.0, 1.0]))
def test_incentives_are_those_of_the_formulas_vehicle_by_vehicle(seed, m, slack):
    """Places are multiples of 3 m, so that some are as far along the road as others."""
    rng, centers = np.random.default_rng(seed), np.array([0.0, 4.0, 8.0, 12.0])
    lane = rng.integers(4, size=m)
    r = centers[lane] + rng.choice([0.0, 0.0, rng.uniform(-2, 2)], m)
    states = np.stack([rng.integers(0, 60, m) * 3.0, r, rng.choice([0.0, 0.1, -0.1], m), rng.uniform(0, 30, m)], axis=1)
    edges, ego = (r - 1.25, r + 1.25), np.array([rng.uniform(0, 180), rng.choice(centers), 0.0, 20.0])
    want = asked_one_by_one(states, lane, *edges, centers, slack, ego)
    assert gains(states, lane, *edges, centers, SIGHT, slack, ego=ego).tolist() == want.tolist()


@given(st.lists(st.sampled_from([0.0, 1.0, 2.0, 3.5, np.nan]), max_size=9))
def test_the_first_along_the_road_come_first(places):
    states, order = np.zeros((len(places), 4)), np.empty(len(places), np.intp)
    states[:, 0] = places
    order_by_position(states, order)
    assert order.tolist() == sorted(
        range(len(places)), key=lambda i: (np.isnan(places[i]), -np.nan_to_num(places[i]), i)
    )
