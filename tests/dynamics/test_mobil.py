"""Who gains by a lane change, against highway-env's own MOBIL."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
from highway_env.vehicle.behavior import IDMVehicle

from dynamics.scenes.scene import SceneReader
from dynamics.traffic import mobil

SIGHT = 3.0


def gains(states, *args, ego=None):
    """Who gains by a change to either side, (m, 2) bool."""
    out = np.empty((len(states), 2), dtype=bool)
    nobody = np.array([-np.inf, 0.0, 0.0, 0.0]) if ego is None else ego
    mobil.gains(states, states[:, 3] * np.sin(states[:, 2]), *args, nobody, np.ones_like(out), out)
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


def test_whoever_would_change_lanes_gains_by_it():
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
        # highway-env knows the new follower's wish and its own: what it lets in is part of what gains.
        settled = np.abs(scene.others_road[:, 1] - centers[lane]) < 0.05
        assert not (wanted & ~exact)[settled].any()
        assert not (exact & ~gains(scene.others_road, lane, *edges, centers, SIGHT, 1.0)).any()
        found += wanted.sum()
    env.close()
    assert found > 10


def test_who_is_held_up_gains_and_who_is_not_does_not():
    lane, centers = np.array([0, 0, 1]), np.array([0.0, 4.0])
    states = np.array([[0.0, 0.0, 0.0, 20.0], [30.0, 0.0, 0.0, 10.0], [60.0, 4.0, 0.0, 20.0]])
    edges = states[:, 1] - 1.25, states[:, 1] + 1.25
    assert gains(states, lane, *edges, centers, SIGHT, 0.0).tolist() == [[False, True], [False, False], [False, False]]
    # Not into a lane where the next behind would have to brake hard.
    states[2] = [-5.0, 4.0, 0.0, 25.0]
    assert not gains(states, lane, *edges, centers, SIGHT, 0.0)[0].any()


def test_who_is_about_to_be_held_up_gains_too():
    """Somebody slower who is on the way into the lane counts, before MOBIL sees it there."""
    lane, centers = np.array([1, 2]), np.array([0.0, 4.0, 8.0])
    states = np.array([[0.0, 4.0, 0.0, 20.0], [30.0, 7.1, -0.3, 10.0]])
    straight, turning = np.array([2.75, 6.75]), np.array([2.75, 2.75])
    high = np.array([5.25, 9.25])
    assert not gains(states, lane, straight, high, centers, SIGHT, 0.0)[0].any()
    # To either side: that one is on the way out of the lane above, too.
    assert gains(states, lane, turning, high, centers, SIGHT, 0.0)[0].tolist() == [True, True]


def test_who_is_leaving_a_lane_is_nobodys_leader_there():
    """A slow one on its way out: by the time that somebody else enters, it is gone."""
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
