"""The road-frame rectangle of a car on a bend, grown by the function, contains the whole car."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from road_growth import road_growth

from dynamics.errors import SceneError
from dynamics.roads.arcs import Arcs
from dynamics.roads.footprint import bend_growth
from dynamics.roads.path import PathRoad
from dynamics.roads.path_reader import read_network

SLACK = 1e-9
t = np.linspace(-1, 1, 81)
OUTLINE = np.concatenate(
    [np.column_stack([t, 0 * t + e]) for e in (-1, 1)] + [np.column_stack([0 * t + e, t]) for e in (-1, 1)]
)


def outline(world, length, width):
    """World states (n, 4) of points around a car's outline."""
    a, b = OUTLINE[:, 0] * length / 2, OUTLINE[:, 1] * width / 2
    cos, sin = np.cos(world[2]), np.sin(world[2])
    points = np.zeros((len(a), 4))
    points[:, 0], points[:, 1] = world[0] + a * cos - b * sin, world[1] + a * sin + b * cos
    return points


def half_extents(length, width, psi):
    cos, sin = abs(np.cos(psi)), abs(np.sin(psi))
    return length / 2 * cos + width / 2 * sin, length / 2 * sin + width / 2 * cos


def reached(road, state, length, width):
    """How far the outline goes from the centre in the road frame, along and across [m]."""
    local = road.to_road(outline(road.to_world(state), length, width), near=state[0])
    return np.abs(local[:, 0] - state[0]).max(), np.abs(local[:, 1] - state[1]).max()


@given(
    k=st.one_of(st.just(0.0), st.floats(-0.07, 0.07), st.floats(-1e-9, 1e-9)),
    r=st.floats(-6, 6),
    psi=st.floats(-np.pi, np.pi),
    length=st.floats(1, 8),
    width=st.floats(1, 3),
)
@settings(max_examples=400, deadline=None)
def test_the_grown_rectangle_contains_the_outline_and_no_smaller_one_does(k, r, psi, length, width):
    assume(k * r + abs(k) * np.hypot(length, width) < 0.9)
    road = PathRoad(Arcs(np.array([[3.0, 4.0, 0.5]]), np.array([k]), np.array([40.0])), np.zeros(1), width=1e-3)
    along, across = bend_growth(length, width, psi, r, k)
    state = np.array([20.0, r, psi, 5.0])
    got, base = reached(road, state, length, width), half_extents(length, width, psi)
    assert got[0] <= base[0] + along + SLACK
    assert got[1] <= base[1] + across + SLACK
    # tight: the outline is sampled every 1/80 of a side
    assert along == 0 or got[0] >= base[0] + along - 1e-6
    assert across == 0 or got[1] >= base[1] + across - 1e-2
    assert k != 0 or (along < SLACK and across < SLACK)


@pytest.mark.parametrize("name", ["racetrack-v0", "racetrack-oval-v0", "lane-keeping-v0"])
def test_the_grown_rectangle_contains_the_outline_anywhere_on_a_road(name):
    env = gym.make(name)
    env.reset(seed=0)
    road = read_network(env.unwrapped.road.network)
    rng, n = np.random.default_rng(0), 1500
    joints = np.array(road.profile.breaks)[rng.integers(1, len(road.profile.breaks) - 1, n)]
    s = np.where(rng.random(n) < 0.7, joints + rng.uniform(-4, 4, n), rng.uniform(10, road.length - 10, n))
    states = np.column_stack(
        [s, rng.uniform(road.centers[0] - 2, road.centers[-1] + 2, n), rng.uniform(-0.6, 0.6, n), np.full(n, 9.0)]
    )
    along, across = road_growth(road, states, 5.0, 2.0)
    for state, more_along, more_across in zip(states, along, across, strict=True):
        got, base = reached(road, state, 5.0, 2.0), half_extents(5.0, 2.0, state[2])
        assert got[0] <= base[0] + more_along + SLACK, state
        assert got[1] <= base[1] + more_across + SLACK, state
    assert across.max() > 0.05  # the bends of these roads do cost something


def test_a_car_that_follows_a_bend_of_twenty_metres():
    """5 m by 2 m in the middle of the inner lane: a corner lies sqrt(21^2 + 2.5^2) - 21 m further out."""
    along, across = bend_growth(5.0, 2.0, 0.0, 0.0, -0.05)
    assert across == pytest.approx(np.hypot(21, 2.5) - 21, abs=1e-12)
    assert along == pytest.approx(20 * np.arctan2(2.5, 19) - 2.5, abs=1e-12)


def test_batches_are_their_rows():
    psi, k = np.linspace(-1, 1, 7), np.linspace(-0.05, 0.05, 7)
    along, across = bend_growth(5.0, 2.0, psi, 1.0, k)
    rows = np.array([bend_growth(5.0, 2.0, p, 1.0, c) for p, c in zip(psi, k, strict=True)])
    np.testing.assert_array_equal(np.column_stack([along, across]), rows)


def test_a_car_across_the_centre_of_a_bend_is_refused():
    with pytest.raises(SceneError, match="centre of the bend"):
        bend_growth(5.0, 2.0, 0.0, 9.0, 0.1)


@pytest.mark.parametrize("name", ["racetrack-v0", "racetrack-oval-v0"])
@pytest.mark.parametrize("length", [5.0, 18.0, 22.0, 26.0, 30.0])
def test_the_growth_of_a_body_of_any_length_is_known(name, length):
    """A long body that turns reaches the centre of a tight bend at some places; those are left out."""
    env = gym.make(name)
    env.reset(seed=0)
    along, across = read_network(env.unwrapped.road.network).bends.growth(length, 2.6)
    assert 0 <= along < length
    assert 0.05 < across < length
