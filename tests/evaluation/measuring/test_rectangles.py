"""The distance of two rectangles is that of their nearest points."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from evaluation.measuring.rectangles import separation

BOX = st.tuples(
    st.floats(-8, 8), st.floats(-8, 8), st.floats(-4, 4), st.just(0.0), st.floats(0.5, 6), st.floats(0.5, 6)
).map(np.array)


def points(box, n=25):
    """A grid of points that covers the box, and its greatest distance to any point of it."""
    grid = np.linspace(-0.5, 0.5, n)
    x, y = (axis.ravel() for axis in np.meshgrid(grid * box[4], grid * box[5]))
    c, s = np.cos(box[2]), np.sin(box[2])
    return box[:2] + np.stack([c * x - s * y, s * x + c * y], axis=-1), np.hypot(box[4], box[5]) / (2 * (n - 1))


@settings(deadline=None)
@given(BOX, BOX)
def test_the_distance_is_that_of_the_nearest_of_many_points(one, two):
    (a, coarse_a), (b, coarse_b) = points(one), points(two)
    sampled = np.sqrt(((a[:, None] - b) ** 2).sum(axis=-1).min())
    distance = float(separation(one, two))
    assert distance <= sampled + 1e-9
    assert distance >= sampled - coarse_a - coarse_b - 1e-9


@given(BOX, BOX, st.floats(-4, 4), st.floats(-50, 50))
def test_the_distance_does_not_depend_on_frame_or_order(one, two, angle, shift):
    def moved(box):
        c, s = np.cos(angle), np.sin(angle)
        out = box.copy()
        out[:2] = np.array([[c, -s], [s, c]]) @ box[:2] + shift
        out[2] += angle
        return out

    np.testing.assert_allclose(separation(moved(two), moved(one)), separation(one, two), atol=1e-9)


def test_a_cross_overlaps_although_no_corner_is_inside():
    bar = np.array([0.0, 0.0, 0.0, 0.0, 6.0, 1.0])
    post = np.array([0.0, 0.0, np.pi / 2, 0.0, 6.0, 1.0])
    assert separation(bar, post) == 0.0


def test_the_distance_is_batched():
    one = np.tile([0.0, 0.0, 0.0, 0.0, 4.0, 2.0], (3, 1, 1))
    two = np.tile([10.0, 0.0, 0.0, 0.0, 4.0, 2.0], (3, 5, 1))
    np.testing.assert_allclose(separation(one, two), np.full((3, 5), 6.0))
