"""Transformation into the ego's frame and back is the identity, and rigid motions are invisible in it."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from driving_data import angles, coordinates, moved, states
from hypothesis import given, settings

from dynamics.errors import ConfigError
from dynamics.learned.models.body_frame import Layout

LAYOUT = Layout()


@settings(deadline=None)
@given(states, states)
def test_to_world_and_about_are_inverse(x, other):
    np.testing.assert_allclose(LAYOUT.to_world(x, LAYOUT.about(x, other)), other, atol=1e-9)
    np.testing.assert_allclose(LAYOUT.about(x, LAYOUT.to_world(x, other)), other, atol=1e-9)


@settings(deadline=None)
@given(states, coordinates, coordinates, angles)
def test_the_ego_sees_no_rigid_motion(x, dx, dy, angle):
    z = LAYOUT.to_body(x)
    np.testing.assert_allclose(LAYOUT.to_body(moved(x, dx, dy, angle)), z, atol=1e-9)
    np.testing.assert_allclose(z[[0, 1, 4, 5]], [0, 0, 1, 0], atol=1e-12)


@settings(deadline=None)
@given(states, states)
def test_torch_agrees_with_numpy(x, other):
    for name in ("about", "to_world"):
        want = getattr(LAYOUT, name)(x, other)
        got = getattr(LAYOUT, name)(torch.from_numpy(x), torch.from_numpy(other)).numpy()
        np.testing.assert_allclose(got, want, atol=1e-12)
    np.testing.assert_allclose(LAYOUT.unit_heading(torch.from_numpy(3 * x)).numpy()[4:], x[4:], atol=1e-12)


@settings(deadline=None)
@given(states, states)
def test_the_rotation_is_the_linear_part(x, z):
    shift = np.r_[x[:2], np.zeros(4)]
    np.testing.assert_allclose(LAYOUT.rotation(x) @ z + shift, LAYOUT.to_world(x, z), atol=1e-9)


def test_another_order_of_columns_and_plain_numbers():
    layout = Layout(position=(6, 3), heading=(0, 5), vectors=((4, 1),))
    x = np.array([0.0, 2, 7, 20, -1, 1, 10])  # heading +y, velocity (-1, 2) in columns (4, 1), position (10, 20)
    z = layout.to_body(x)
    np.testing.assert_allclose(z, [1, 1, 7, 0, 2, 0, 0], atol=1e-12)
    np.testing.assert_allclose(layout.to_world(x, z), x, atol=1e-12)


def test_invalid_layouts_are_refused():
    with pytest.raises(ConfigError, match="each column once"):
        Layout(position=(0, 1), heading=(1, 2))
    with pytest.raises(ConfigError, match="columns 0 to 4"):
        LAYOUT.check(5)
