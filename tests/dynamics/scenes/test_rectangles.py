"""Gaps are positive exactly where rectangles are apart; predicted collisions are those that highway-env predicts."""

import numpy as np
import pytest
from highway_env import utils
from highway_env.vehicle.kinematics import Vehicle
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from dynamics.scenes.parking_lot import ParkingScene
from dynamics.scenes.rectangles import gaps

SIZE = st.floats(0.5, 6)
PLACE = st.tuples(st.floats(-8, 8), st.floats(-8, 8), st.floats(-7, 7))
EGO = st.tuples(PLACE, st.floats(-30, 30), SIZE, SIZE).map(lambda e: np.array([*e[0], *e[1:]]))
BOX = st.tuples(PLACE, SIZE, SIZE).map(lambda b: np.array([*b[0], *b[1:]]))
DT = 1 / 15


def of(ego, *boxes):
    now, coming = gaps(ego[:4], (ego[4], ego[5]), np.array(boxes), DT)
    return now, coming


def corners(x, y, heading, length, width):
    return np.array(utils.rect_corners(np.array([x, y]), length, width, heading))


def filled(box, n=13):
    """Points that cover a box, and the greatest distance of any point of it to the nearest of them."""
    x, y = (g.ravel() for g in np.meshgrid(*[np.linspace(-0.5, 0.5, n)] * 2))
    c, s = np.cos(box[2]), np.sin(box[2])
    points = box[:2] + np.stack([c * x * box[3] - s * y * box[4], s * x * box[3] + c * y * box[4]], axis=1)
    return points, np.hypot(box[3], box[4]) / (2 * (n - 1))


@settings(deadline=None, max_examples=300)
@given(EGO, BOX)
def test_gaps_have_the_signs_of_highway_envs_own_check(ego, box):
    now, coming = of(ego, box)
    assume(min(abs(now[0]), abs(coming[0])) > 1e-9)
    car = Vehicle(None, ego[:2], ego[2], ego[3])
    a, b = (np.vstack([p, p[:1]]) for p in (corners(*ego[[0, 1, 2, 4, 5]]), corners(*box)))
    meets, will_meet, _ = utils.are_polygons_intersecting(a, b, car.velocity * DT, np.zeros(2))
    assert bool(meets) == (now[0] <= 0)
    assert bool(will_meet) == (coming[0] <= 0)


@settings(deadline=None)
@given(EGO, BOX)
def test_the_distance_is_never_less_than_the_gap(ego, box):
    (a, error_a), (b, error_b) = filled(ego[[0, 1, 2, 4, 5]]), filled(box)
    sampled = np.sqrt(np.square(a[:, None] - b).sum(axis=-1).min())
    gap = of(ego, box)[0][0]
    assert gap <= sampled + 1e-9
    # and it is as good as the distance but for corners that face corners
    if sampled > error_a + error_b:
        assert gap > 0
        assert gap >= (sampled - error_a - error_b) / np.sqrt(2) - 1e-9


@given(EGO, BOX)
def test_the_coming_gap_is_never_larger_than_the_present_one(ego, box):
    now, coming = of(ego, box)
    assert coming[0] <= now[0] + 1e-12
    ego[3] = 0.0
    assert of(ego, box)[1][0] == pytest.approx(of(ego, box)[0][0], abs=1e-12)


@given(EGO, BOX, st.floats(-4, 4), st.floats(-50, 50))
def test_gaps_do_not_depend_on_the_coordinate_frame(ego, box, angle, shift):
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    moved = [x.copy() for x in (ego, box)]
    for x in moved:
        x[:2], x[2] = turn @ x[:2] + shift, x[2] + angle
    for a, b in zip(of(ego, box), of(*moved), strict=True):
        assert a == pytest.approx(b, abs=1e-9)


@given(st.lists(EGO, min_size=1, max_size=6), st.lists(BOX, max_size=5))
def test_a_batch_is_its_rows(egos, boxes):
    states, rectangles = np.array(egos)[:, None, :4], np.array(boxes).reshape(-1, 5)
    now, coming = gaps(states, (5.0, 2.0), rectangles, DT)
    assert now.shape == coming.shape == (len(egos), 1, len(boxes))
    for i, ego in enumerate(egos):
        for j, box in enumerate(boxes):
            one = of(np.array([*ego[:4], 5.0, 2.0]), box)
            assert (now[i, 0, j], coming[i, 0, j]) == (one[0][0], one[1][0])


def test_the_walls_of_the_simulator_are_where_it_says():
    lot = ParkingScene(np.array([0.0, 0, 0, 0, 5, 2]), np.array([[35.0, 0, np.pi / 2, 0, 42, 1]]), DT)
    assert gaps(lot.ego[:4], (5.0, 2.0), lot.boxes, DT)[0] == pytest.approx([32.0])
