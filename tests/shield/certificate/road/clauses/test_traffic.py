"""Where the others can be, who of them may come in, and who owes the ego its distance: one clause at a time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from clause_scenes import BODY, CONFIG, DT, along, braking, clear, driven, extents, margin, scene_of
from cores import ContinuousCore, ShieldCore

from dynamics.roads.straight import StraightRoad
from dynamics.traffic.assumptions import Assumptions
from dynamics.traffic.occupancy import Surroundings
from shield import Buffer
from shield.certificate.road.verify import Surveyor

HELD_UP = CONFIG.replace(assumptions=replace(CONFIG.assumptions, calm_braking=6.0))


@pytest.mark.parametrize(("ahead", "calm"), [((), 45), ((35.0,), 0), ((600.5,), 45)])
@pytest.mark.parametrize("frames", [8, 80])
def test_the_bound_along_the_road_is_that_of_one_that_brakes(frames, ahead, calm):
    """In each frame; the last column stands for all the rest. On a free road it does not brake hard for three
    seconds."""
    rows = np.array([[0.0, 0.0, 0.0, 20.0, *BODY], *([s, 0.0, 0.0, 0.0, *BODY] for s in ahead)])
    around = Surroundings(rows, rows[:, :4], StraightRoad.from_lanes(1), CONFIG.assumptions, DT)
    bound = around.rear(frames)[0]
    rates = np.where(np.arange(80) < calm, 3.0, 6.0)
    way = np.cumsum(np.maximum(20.0 - np.cumsum([0.0, *rates[:-1]]) * DT, 0.0)) * DT
    assert (bound[:-1] <= way[: frames - 1] - 2.5 + 1e-9).all()
    assert bound[-1] <= way[-1] - 2.5
    assert around.bodies.floor[0] <= way[-1]
    # And no further back than what turning may take, and the diagonal.
    assert (bound[: min(frames - 1, 25)] >= way[: min(frames - 1, 25)] - 2.7 - 2.5).all()


@pytest.mark.parametrize("config", [CONFIG, HELD_UP])
@pytest.mark.parametrize(("v", "leader"), [(10.0, 10.0), (25.0, 15.0)])
def test_a_leader_that_brakes_and_turns_as_it_may_is_not_touched(v, leader, config):
    """It turns as soon as it is slow, and again with what has come back since."""
    accepted, least = 0, np.inf
    for gap in np.arange(8.0, 60.0, 0.1):
        scene = scene_of((0, 0, 0, v), (gap, 0, 0, leader))
        if margin(scene, 0, config=config) < 0:
            continue
        accepted += 1
        s, u, lost, spent, k = gap, leader, 0.0, 0.0, 0
        for state in driven(scene, 0):
            turned = 0.0
            if u < 5.5:
                turned = min(u * DT, 1.47 + 0.5 * k * DT - lost, (8.6 + 6 * k * DT - spent) / max(u, 1e-9))
            rate, k = (6 if k >= 45 or config is HELD_UP else 3), k + 1
            s, u, lost, spent = s + u * DT - turned, max(u - rate * DT, 0.0), lost + turned, spent + u * turned
            least = min(least, s - 2.5 - (state[0] + 4.5))
            assert s - 2.5 - (state[0] + 4.5) >= -1e-9, gap
    assert 0 < accepted < 520
    assert least < 4.0


PUSHES = [("idm", 15, 20), ("rss", 25, 20), ("idm", 20, 40)]
PUSHES += [("rss", 15, 20)]


def test_the_fail_safe_of_inputs_is_what_the_bicycle_does():
    scene = scene_of((0, 0, 0, 20))
    plan = ContinuousCore(predictive=False).filter(scene, np.zeros(2))[1].plan
    np.testing.assert_allclose(plan[len(driven(scene, 0)) :, 0], driven(scene, 0)[-1, 0], atol=1e-6)


@pytest.mark.parametrize("begins", [0.0, 1.5])
@pytest.mark.parametrize(("profile", "v", "fast"), PUSHES)
def test_a_follower_that_pushes_until_it_owes_its_braking_does_not_touch(profile, v, fast, begins):
    """The ego changes lanes; one behind there accelerates until it has seen it for the reaction time."""
    a = Assumptions.profile(profile)
    config, reaction = CONFIG.replace(assumptions=a), int(np.ceil(a.reaction_time / DT - 1e-9))
    accepted = 0
    for gap in np.arange(6.0, 150.0, 0.5):
        scene = scene_of((0, begins, 0, v), (-gap, 4, 0, fast), lanes=2)
        if clear(scene, 1, config=config) < 0:
            continue
        accepted += 1
        path = driven(scene, 1)
        s, u, since, r, k = -gap, float(fast), 0, begins, 0
        while k < len(path) or u > 0:
            state = path[min(k, len(path) - 1)]
            since = since + 1 if abs(r - 4) <= 3 else 0
            rate = (
                -a.follower_braking
                if since > reaction
                else min(a.acceleration, a.power / max(u, 1e-3), (max(a.max_speed, fast) - u) / DT)
            )
            s, u, r, k = s + u * DT, max(u + rate * DT, 0.0), state[1], k + 1
            half_s, half_r = extents(state)
            if state[1] + half_r > 3:
                assert state[0] - half_s - (s + 2.5) >= -1e-9, (gap, k)
    assert 0 < accepted < 288


def test_the_buffer_is_kept_along_and_across():
    bare = CONFIG.replace(buffer=Buffer(0.0, 0.0))
    ahead, beside = scene_of((0, 0, 0, 0), (7, 0, 0, 0)), scene_of((0, 1.2, 0, 0), (0, 4, 0, 0))
    for scene, room in ((ahead, 2.0), (beside, 0.3)):
        clear = (braking(scene, 0, config=c).separations.min() for c in (bare, CONFIG))
        assert next(clear) - next(clear) == pytest.approx(room)


def test_one_that_stands_in_a_queue_may_reverse_into_the_ego():
    """From one that stands 6 m ahead of it, by another 8 m."""
    assert margin(scene_of((0, 0, 0, 0), (14, 0, 0, 0)), 0) > 6
    assert margin(scene_of((0, 0, 0, 0), (14, 0, 0, 0), (20, 0, 0, 0)), 0) < 0


def test_the_last_frame_that_is_looked_at_stands_for_all_that_follow():
    """One that stands 6 m behind another may reverse until it is 8 m away from it."""
    rows = np.array([[s, 0.0, 0.0, 0.0, *BODY] for s in (14.0, 20.0)])
    around = Surroundings(rows, rows[:, :4], StraightRoad.from_lanes(1), CONFIG.assumptions, DT)
    rears = [around.rear(frames)[0] for frames in (3, 200)]
    for rear in rears:
        assert rear[-1] <= rear[0] - 1.5
        assert rear[-1] == pytest.approx(rears[1].min())
    assert rears[0][1] > rears[0][-1] + 1


def test_a_body_beyond_the_midline_may_go_back():
    scene = scene_of((0, 0, 0, 10), (1, 2.4, 0, 10), dt=0.1)
    assert clear(scene, 0) < 0


def test_a_body_counts_as_where_its_heading_leads():
    rows = np.array([[0.0, 3.4, -0.15, 20.0, *BODY]])
    around = Surroundings(rows, rows[:, :4], StraightRoad.from_lanes(2), Assumptions.idm(), 0.2)
    assert around.low[0] <= 4 - 0.6 - 20 * np.sin(0.15) * 0.2 - 1.36 + 1e-3
    assert around.low[0] < -1


def test_a_turned_body_reaches_along_the_road_by_its_diagonal():
    turned = np.arctan2(2, 5)
    rows = np.array([[0.0, 0.0, turned, 0.0, *BODY]])
    around = Surroundings(rows, rows[:, :4], StraightRoad.from_lanes(1), Assumptions.idm(), DT)
    assert around.rear(1)[0, 0] <= -2.5 * np.cos(turned) - np.sin(turned) + 1e-9


def beside(psi, at):
    """A path that points at the car beside in frame `at`, and nowhere else."""
    path = np.array([[4.0 * k, 0.05, 0.0, 20.0] for k in range(1, 5)])
    path[at, 2] = psi
    return path


@pytest.mark.parametrize("at", [0, 1])
def test_the_coming_frame_is_clear_too(at):
    """highway-env counts as a collision what constant velocity would bring within a frame."""
    scene = scene_of((0, 0, 0, 20), (2.0, 4, 0, 20), lanes=2, dt=0.2)
    assert along(scene, beside(0.0, at)) >= 0
    assert along(scene, beside(0.3, at)) < 0


def test_a_vehicle_beyond_the_lane_that_is_entered_may_enter_it_as_well():
    blind = CONFIG.replace(assumptions=replace(CONFIG.assumptions, blind_merge=False))
    slow = 30, 8, 0, 10
    for at in (8, -3):
        held_up = scene_of((0, 0, 0, 20), (at, 8, 0, 15), slow)
        assert clear(held_up, 1) < 0 <= clear(held_up, 1, config=blind)
    # The lane that the fail-safe would return to as well.
    returning = scene_of((0, 8, 0, 20), (-3, 0, 0, 20), (20, 0, 0, 10))
    assert clear(returning, 2, fail=1) < 0 <= clear(returning, 2)


def test_who_loses_by_it_does_not_enter():
    leader = 60, 4, 0, 15
    beyond = (0, 0, 0, 20), (8, 8, 0, 15)
    assert clear(scene_of(*beyond), 1) < 0 <= clear(scene_of(*beyond, leader), 1)
    # One that is on its way does.
    assert clear(scene_of((0, 0, 0, 20), (8, 8, -0.05, 15), leader), 1) < 0


def test_nobody_joins_those_who_may_enter_once_there_is_a_plan_to_stop_there():
    held_up = scene_of((0, 0, 0, 20), (8, 8, 0, 15), (30, 8, 0, 10))
    nobody = np.zeros((4, 2), dtype=bool)
    assert clear(held_up, 1, coming=nobody) < 0 <= clear(held_up, 1, coming=nobody, stored=1)
    # But for a lane out of whose sight the ego gets meanwhile.
    seen = np.array([1000, 1000, 0, 0])
    leaving = scene_of((0, 1.2, -0.3, 20), (8, 8, 0, 15), (30, 8, 0, 10))
    assert clear(leaving, 0, fail=1, coming=nobody, stored=1, visible=seen) < 0


def test_one_that_is_on_its_way_may_still_come_until_the_ego_has_been_seen_for_long():
    visible = np.array([1, 1, 0, 0])
    straight, turning = (scene_of((0, 2.5, 0, 15), (6, 8, psi, 15)) for psi in (0.0, -0.03))
    visible[1] = 4
    assert clear(turning, 1, visible=visible) < 0 <= clear(straight, 1, visible=visible)
    assert clear(turning, 1, visible=visible + 1000) >= 0


def leaning(v):
    return [[v * DT * k, 1.6, 0.0, v] for k in range(1, 20)]


def test_who_owes_the_ego_its_distance():
    behind = scene_of((0, 0, 0, 5), (-12, 0, 0, 25))
    assert along(behind, leaning(5.0), 0) == np.inf
    assert along(scene_of((0, 0, 0, 5), (12, 0, 0, 0)), leaning(5.0), 0) < 0
    # In a lane that the ego leans into and does not own.
    other = scene_of((0, 1.0, 0, 5), (-12, 4, 0, 25))
    assert along(other, leaning(5.0), 0) < 0
    # In the ego's lane and in the one that it enters.
    both = scene_of((0, 0, 0, 5), (-12, 2.2, 0, 25))
    assert clear(both, 1) < 0


def passing(*across):
    """A path at 5 m/s that is so far across the road in its first frames, and stays at the last of them."""
    r = [*across, *[across[-1]] * 20]
    return [[5.0 * DT * k, r[k - 1], 0.0, 5.0] for k in range(1, len(r))]


def test_nobody_owes_a_place_that_the_ego_has_left_and_comes_back_to():
    behind = scene_of((0, 0, 0, 5), (-12, 0, 0, 25))
    for path, owed in (([0.0], True), ([0.0, 1.5, 0.0], True), ([0.0, 4.0], True), ([0.0, 4.0, 0.0], False)):
        assert (along(behind, passing(*path)) == np.inf) == owed
    assert along(behind, passing(0.0, 4.0, 0.0)) < 0


def test_one_that_owes_the_ego_its_distance_does_so_until_the_ego_has_left_its_strip():
    """The ego has left its old lane for the next one, but for a corner that still touches the strip of one behind."""
    for r, duty in ((2.4, True), (2.7, False)):
        scene = scene_of((0, r, 0, 5), (-12, 0, 0, 25))
        marks = {"owned": [False, True, False, False]}
        held = [Surveyor(scene, CONFIG, followers=np.array([f]), **marks).others.held[0] for f in (False, True)]
        assert held == [False, duty]
    scene = scene_of((0, 2.4, 0, 5), (-12, 0, 0, 25))
    assert along(scene, passing(2.4), 1, **marks) < 0
    assert along(scene, passing(2.4), 1, followers=np.array([True]), **marks) == np.inf


@pytest.mark.parametrize(("front", "owed", "behind"), [(-4.6, True, True), (-4.6, False, False), (-4.4, True, False)])
def test_one_that_owes_the_ego_its_distance_is_behind_until_it_touches_the_buffer(front, owed, behind):
    """Beside the rearmost corner of a turned ego, the other corner of whose buffer is further ahead."""
    scene = scene_of((0, 0, 0.3, 5), (front - 2.5, -1.6, 0, 5))
    assert 4.5 * np.cos(0.3) + 1.3 * np.sin(0.3) > 4.6
    assert Surveyor(scene, CONFIG, followers=np.array([owed])).others.behind[0] == behind


def test_anybody_may_come_into_a_lane_out_of_whose_sight_the_ego_has_got():
    """The ego has a plan to stop in lane 1, from which it gets out of sight; nobody gains by going there."""
    for r, comes in ((5.5, False), (7.2, True)):
        core = ShieldCore()
        core.look(scene_of((0, 5.4, 0, 10), (20, 0, 0, 10)))
        core.stored = 1
        assert core.look(scene_of((10 * DT, r, 0, 10), (20 + 10 * DT, 0, 0, 10))).survey.others.comes[1, 0] == comes


def test_a_lane_is_owned_only_with_a_verified_plan_and_no_longer_than_it_is_touched():
    for stored, r, owned in ((0, 2.0, [1, 0]), (1, 2.0, [1, 1]), (1, 4.0, [0, 1])):
        core = ShieldCore()
        core.supervise(scene_of((0, 0, 0, 10), lanes=2))
        core.stored = stored
        scene = scene_of((1, r, 0.1, 10), lanes=2)
        assert list(core.look(scene).survey.owned) == owned


def test_one_alongside_may_slip_in_behind_an_ego_that_passes_it():
    scene = scene_of((100, 0.7, 0, 34), (99, 4, 0, 18.5), (111, 4, 0, 10), lanes=2, dt=0.05)
    off = CONFIG.replace(assumptions=replace(CONFIG.assumptions, slip_in=False))
    assert margin(scene, 0) < 0 <= margin(scene, 0, config=off)
