"""Recorded quantities of an episode, on straight, curved and branching roads, with meta-actions and with steering."""

import numpy as np
import pytest
from highway_env.vehicle.controller import ControlledVehicle
from hypothesis import given
from hypothesis import strategies as st

from dynamics.roads.path import PathRoad
from dynamics.roads.straight import StraightRoad
from evaluation.measuring.attribution import Cause, attribute_from_simulator_state
from evaluation.measuring.recorder import History, Recorder, Track
from evaluation.measuring.rectangles import separation
from evaluation.running.episodes import run_episode
from evaluation.settings import Setting, get_setting

ROAD = StraightRoad.from_lanes(3)
MERGE = Setting("merge", "merge-v0")


def ego_track(speeds, headings=None):
    track = np.zeros((len(speeds), 1, len(Track)))
    track[:, 0, Track.SPEED] = speeds
    track[:, 0, Track.HEADING] = 0.0 if headings is None else headings
    return track


@given(st.floats(-4, 4), st.floats(-6, 6), st.sampled_from([0.05, 0.1, 0.2]))
def test_jerk_is_the_third_derivative_of_the_way(jerk, acceleration, dt):
    t = np.arange(30) * dt
    history = History(ego_track(20 + acceleration * t + jerk * t**2 / 2), ROAD, dt)
    assert history.mean_jerk() == pytest.approx(abs(jerk), abs=1e-6)


@given(st.floats(0, 30), st.floats(-0.5, 0.5))
def test_lateral_acceleration_is_speed_times_yaw_rate(speed, rate):
    dt = 0.1
    headings = (rate * dt * np.arange(200) + np.pi) % (2 * np.pi) - np.pi
    history = History(ego_track(np.full(200, speed), headings), ROAD, dt)
    assert history.mean_lateral_acceleration() == pytest.approx(speed * abs(rate), abs=1e-9)


def test_the_crash_itself_is_no_jerk():
    track = ego_track(np.r_[np.full(10, 20.0), 0.0, 0.0])
    track[10:, 0, Track.CRASHED] = 1
    assert History(track, ROAD, 0.1).mean_jerk() == 0.0
    assert np.isnan(History(track[:2], ROAD, 0.1).mean_jerk())
    assert np.isnan(History(track[:1], ROAD, 0.1).mean_lateral_acceleration())


def drive_racetrack(frames, seed=3):
    """Drive the racetrack with highway-env's own lane controller; returns the record and the ego's positions."""
    env = get_setting("racetrack").override({"other_vehicles": 3}).make()
    env.reset(seed=seed)
    base = env.unwrapped
    bare = base.vehicle
    ego = ControlledVehicle(base.road, bare.position, bare.heading, bare.speed, target_speed=8.0)
    base.road.vehicles[0] = base.vehicle = ego
    recorder = Recorder(env)
    places = [ego.position.copy()]
    for _ in range(frames):
        base.road.act()
        base.road.step(1 / base.config["simulation_frequency"])
        places.append(ego.position.copy())
    return recorder.history(), np.array(places)


def test_a_curved_road_is_read_and_laps_are_counted():
    history, places = drive_racetrack(1200)
    assert isinstance(history.road, PathRoad)
    assert not history.off_road
    way = np.hypot(*np.diff(places, axis=0).T).sum()
    s = history.ego[:, Track.S]
    assert s[-1] - s[0] > 1.2 * history.road.length, "the drive goes on into a second lap"
    assert s[-1] - s[0] == pytest.approx(way, rel=0.15)  # the lanes of a bend differ in length
    assert np.abs(np.diff(s)).max() < 1.5
    others = history.states[:, 1:, Track.S] - s[:, None]
    assert np.abs(others).max() <= history.road.length / 2 + 1e-6


def test_the_gap_on_a_bend_is_that_of_the_rectangles():
    history, _ = drive_racetrack(300)
    centers = history.world[..., :2]
    apart = np.hypot(*np.moveaxis(centers[:, 1:] - centers[:, :1], -1, 0))
    for frame in range(0, 300, 50):
        gaps = history.gaps(frame)
        assert (gaps <= apart[frame]).all()
        assert (gaps >= apart[frame] - np.hypot(5, 2)).all()


def test_a_crash_on_a_bend_is_not_attributed():
    history, _ = drive_racetrack(20)
    history.states[-1, 0, Track.CRASHED] = 1
    assert history.crash_frame == 20
    assert attribute_from_simulator_state(history) is Cause.UNATTRIBUTED
    history.states[-1, 0, Track.CRASHED] = 0
    assert attribute_from_simulator_state(history) is Cause.NONE


def test_a_network_that_branches_is_recorded_as_it_is():
    record = run_episode(MERGE, "faster", seed=1)
    assert record.distance > 50
    assert np.isnan(record.lane_changes)
    assert np.isnan(record.laps)
    assert record.min_gap >= 0
    assert record.attribution in ("none", "unattributed")
    assert (record.attribution == "unattributed") == record.crashed


def test_constant_steering_is_recorded_as_off_the_road():
    setting = get_setting("highway-continuous").override({"vehicles_count": 2})
    env = setting.make()
    env.reset(seed=0)
    recorder = Recorder(env)
    done = False
    while not done:
        *_, terminated, truncated, _ = env.step([0.0, 0.2])
        done = terminated or truncated
    history = recorder.history()
    assert history.off_road
    assert history.crash_frame is None
    half = history.road.width / 2
    r = history.ego[:, Track.R]
    outside = (r < history.road.centers[0] - half) | (r > history.road.centers[-1] + half)
    np.testing.assert_array_equal(history.ego[:, Track.OFF_ROAD] > 0, outside)


@pytest.mark.parametrize(("setting", "policy"), [("highway-continuous", "random"), ("racetrack", "idle")])
def test_an_episode_off_the_road_says_so(setting, policy):
    chosen = get_setting(setting)
    if setting == "highway-continuous":
        chosen = chosen.override({"vehicles_count": 2})
    record = run_episode(chosen, policy, seed=2)
    assert record.off_road
    assert not record.crashed
    assert record.attribution == "none"
    assert np.isnan(record.laps) == (setting == "highway-continuous")
    assert record.mean_jerk == pytest.approx(0.0, abs=1e-6) or policy == "random"
    assert record.steps < 300


def test_vehicles_that_enter_and_leave_are_recorded_while_present():
    env = get_setting("intersection").make()
    env.reset(seed=5)
    road, ego, least, counts = env.unwrapped.road, env.unwrapped.vehicle, [np.inf], [len(env.unwrapped.road.vehicles)]
    recorder, step = Recorder(env), road.step

    def look():
        counts.append(len(road.vehicles))
        rows = np.array([[*v.position, v.heading, v.speed, v.LENGTH, v.WIDTH] for v in road.vehicles if v is not ego])
        own = np.array([*ego.position, ego.heading, ego.speed, ego.LENGTH, ego.WIDTH])
        least[0] = min(least[0], float(separation(own[None], rows).min()))

    def watched(dt):
        step(dt)
        look()

    look()
    road.step = watched
    for action in [0, 1] * 6:
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            break
    history = recorder.history()
    assert len(set(counts)) > 1
    assert history.states.shape[1] >= max(counts)
    assert history.min_gap() == (0.0 if history.crash_frame is not None else pytest.approx(least[0], abs=1e-9))
