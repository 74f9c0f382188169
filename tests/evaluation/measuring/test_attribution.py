"""Crashes built by hand, one for each cause, and recorded ones."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynamics.roads.straight import StraightRoad
from evaluation.measuring.attribution import Cause, attribute_from_simulator_state, rss_gap
from evaluation.measuring.recorder import History, Recorder, Track
from evaluation.settings import get_setting

DT = 0.1
ROAD = StraightRoad.from_lanes(3)


def drive(s, r, speed, braking=0.0, frames=60, crashed_at=None, lateral=0.0, lateral_from=0):
    """A track: constant braking [m/s^2] from the start, sideways at `lateral` m/s from a frame."""
    t = np.arange(frames) * DT
    track = np.zeros((frames, len(Track)))
    stop = np.minimum(t, speed / braking) if braking > 0 else t
    track[:, Track.S] = s + speed * stop - braking * stop**2 / 2
    track[:, Track.SPEED] = speed - braking * stop
    track[:, Track.R] = r + lateral * np.maximum(t - lateral_from * DT, 0.0)
    track[:, Track.LENGTH], track[:, Track.WIDTH] = 5.0, 2.0
    if crashed_at is not None:
        track[crashed_at:, Track.CRASHED] = 1
    return track


def collide(ego, other, from_reset=False):
    """The history up to the first overlap, in which both are marked as crashed."""
    along = np.abs(ego[:, Track.S] - other[:, Track.S]) < 5.0
    across = np.abs(ego[:, Track.R] - other[:, Track.R]) < 2.0
    hit = np.flatnonzero(along & across)
    assert hit.size, "the scene that the test built has no crash"
    states = np.stack([ego, other], axis=1)[: hit[0] + 1].copy()
    states[-1, :, Track.CRASHED] = 1
    return History(states, ROAD, DT, from_reset)


def cause(*args, **kwargs):
    return attribute_from_simulator_state(collide(*args, **kwargs))


def test_no_crash_has_no_cause():
    states = np.stack([drive(0, 0, 20), drive(50, 0, 20)], axis=1)
    assert attribute_from_simulator_state(History(states, ROAD, DT)) is Cause.NONE


def test_running_into_a_steady_leader_is_the_egos_fault():
    assert cause(drive(0, 0, 30), drive(30, 0, 20)) is Cause.EGO_AT_FAULT


def test_running_into_a_leader_that_brakes_within_the_bound_is_the_egos_fault():
    assert cause(drive(0, 0, 25), drive(30, 0, 25, braking=6.0)) is Cause.EGO_AT_FAULT


def test_a_follower_that_keeps_coming_strikes_from_behind():
    assert cause(drive(50, 4, 10), drive(0, 4, 25)) is Cause.STRUCK_FROM_BEHIND


def test_an_ego_that_has_just_come_in_front_of_a_follower_is_at_fault():
    ego = drive(15, 4, 20, lateral=-2.0, lateral_from=5)
    ego[25:, Track.R] = 0.0
    assert cause(ego, drive(0, 0, 26)) is Cause.EGO_AT_FAULT


def test_a_vehicle_that_comes_in_alongside_strikes_from_the_side():
    other = drive(2, 4, 25, lateral=-2.0, lateral_from=10)
    assert cause(drive(0, 0, 25), other) is Cause.STRUCK_FROM_SIDE


def test_a_vehicle_that_cuts_in_too_near_strikes_from_the_side():
    other = drive(13, 4, 18, lateral=-4.0, lateral_from=0)
    other[10:, Track.R] = 0.0
    assert cause(drive(0, 0, 25), other) is Cause.STRUCK_FROM_SIDE


def test_a_vehicle_that_comes_in_far_ahead_leaves_the_ego_at_fault():
    other = drive(45, 4, 5, lateral=-4.0, lateral_from=0, frames=80)
    other[10:, Track.R] = 0.0
    assert cause(drive(0, 0, 25, frames=80), other) is Cause.EGO_AT_FAULT


def test_an_ego_that_speeds_up_while_it_is_cut_off_is_at_fault():
    other = drive(13, 4, 18, lateral=-4.0, lateral_from=0)
    other[10:, Track.R] = 0.0
    assert cause(drive(0, 0, 22, braking=-3.0), other) is Cause.EGO_AT_FAULT


def test_an_ego_that_moves_sideways_itself_is_at_fault():
    ego = drive(0, 0, 25, lateral=2.0, lateral_from=10)
    assert cause(ego, drive(1, 4, 25)) is Cause.EGO_AT_FAULT


def test_a_leader_that_stops_dead_at_a_proper_gap_has_violated_the_assumptions():
    gap = rss_gap(25.0, 25.0, 8.0, 6.0, 0.5)
    ego, other = drive(0, 0, 25), drive(gap + 6, 0, 25, braking=25.0)
    assert cause(ego, other) is Cause.ASSUMPTION_VIOLATED


def test_a_leader_that_crashed_just_before_has_violated_the_assumptions():
    other = drive(30, 0, 25, braking=5.9, crashed_at=8)
    assert cause(drive(0, 0, 25), other) is Cause.ASSUMPTION_VIOLATED


def test_a_tailgating_ego_is_at_fault_when_its_leader_stops_abruptly():
    assert cause(drive(0, 0, 25), drive(5.5, 0, 25, braking=25.0)) is Cause.EGO_AT_FAULT


def test_a_wreck_that_was_there_before_leaves_the_ego_at_fault():
    other = drive(100, 0, 0, crashed_at=0)
    assert cause(drive(0, 0, 20), other) is Cause.EGO_AT_FAULT


def test_an_overlap_at_reset_is_attributed_to_the_reset():
    history = collide(drive(0, 0, 25), drive(4, 0, 25), from_reset=True)
    assert attribute_from_simulator_state(history) is Cause.SPAWNED_IN_COLLISION


def test_a_crash_unavoidable_from_the_reset_is_attributed_to_the_reset():
    ego, other = drive(0, 0, 30), drive(10, 0, 5)
    assert cause(ego, other, from_reset=True) is Cause.SPAWNED_IN_COLLISION
    assert cause(ego, other, from_reset=False) is Cause.EGO_AT_FAULT


@given(st.floats(0, 40), st.floats(0, 40), st.floats(2, 9), st.floats(2, 9), st.floats(0, 1.5))
def test_the_rss_gap_is_just_enough(v, w, b, c, rho):
    gap = rss_gap(v, w, b, c, rho)
    t = np.linspace(0, 30, 3001)
    tb = np.clip(t - rho, 0, v / b)
    tw = np.minimum(t, w / c)
    rear = v * np.minimum(t, rho) + v * tb - b * tb**2 / 2
    front = w * tw - c * tw**2 / 2
    assert np.all(gap + front - rear > -0.02)
    assert gap >= max(0.0, v * rho + v**2 / (2 * b) - w**2 / (2 * c)) - 0.02


def _episode(setting, action, seed, record):
    env = get_setting(setting).make()
    env.reset(seed=seed)
    recorder = Recorder(env) if record else None
    states = []
    for _ in range(30):
        obs, _, terminated, truncated, _ = env.step(action)
        states.append(obs)
        if terminated or truncated:
            break
    return np.array(states), recorder


def test_recording_changes_nothing():
    plain, _ = _episode("highway-fast", 1, 12_000, record=False)
    recorded, recorder = _episode("highway-fast", 1, 12_000, record=True)
    np.testing.assert_array_equal(plain, recorded)
    assert recorder.history().from_reset


@pytest.mark.parametrize("seed", range(12_000, 12_006))
def test_always_faster_runs_into_its_leaders(seed):
    _, recorder = _episode("highway-fast", 3, seed, record=True)
    history = recorder.history()
    assert history.crash_frame is not None
    assert attribute_from_simulator_state(history) is Cause.EGO_AT_FAULT
    assert history.min_gap() == 0.0
