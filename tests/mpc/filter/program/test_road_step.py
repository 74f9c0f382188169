"""The stage is the simulator's own arithmetic: on a straight road, and on an arc through the world and back."""

import numpy as np
from highway_env.vehicle.kinematics import Vehicle
from hypothesis import given
from hypothesis import strategies as st

from dynamics.vehicle import bicycle
from mpc.filter.program.road_step import rollout_function

DT = 1 / 15
floats = st.floats
states = st.tuples(floats(-50, 50), floats(-6, 6), floats(-1, 1), floats(-5, 45)).map(np.array)
inputs = st.lists(st.tuples(floats(-5, 5), floats(-0.7, 0.7)), min_size=4, max_size=4).map(np.array)


def rollout(state, controls, curvature, substeps=3):
    """Road states after each stage, (N, 4)."""
    n = len(controls)
    return rollout_function(n, substeps, DT)(state, controls.T, np.full((1, n), curvature)).full().T


@given(states, inputs)
def test_a_straight_stage_is_the_simulators_frames(state, controls):
    vehicle = Vehicle(None, state[:2].copy(), state[2], state[3])
    for got, (a, delta) in zip(rollout(state, controls, 0.0), controls, strict=True):
        for _ in range(3):
            vehicle.act({"acceleration": a, "steering": delta})
            vehicle.step(DT)
        np.testing.assert_allclose(got, [*vehicle.position, vehicle.heading, vehicle.speed], atol=1e-9)


def on_circle(road, curvature):
    """Road states (..., 4) on a circle through the origin along x, to the world."""
    s, r, psi, v = np.moveaxis(road, -1, 0)
    angle, radius = curvature * s, 1 / curvature - r
    return np.stack([radius * np.sin(angle), 1 / curvature - radius * np.cos(angle), psi + angle, v], axis=-1)


@given(states, inputs, floats(0.005, 0.1), st.sampled_from([-1, 1]))
def test_a_curved_stage_is_the_simulators_frames_in_the_world(state, controls, curvature, sign):
    curvature = sign * curvature
    state = state * [0.1, 0.5, 1, 1]
    road = rollout(state, controls, curvature)
    world = on_circle(state, curvature)
    for got, (a, delta) in zip(road, controls, strict=True):
        for _ in range(3):
            world = bicycle.step(world, a, delta, DT)
        to_center = np.hypot(world[0], 1 / curvature - world[1])
        if abs(curvature) * to_center < 0.1:  # through the circle's centre: the frame ends there
            return
        np.testing.assert_allclose(on_circle(got, curvature)[:2], world[:2], atol=1e-7)
        turn = on_circle(got, curvature)[2] - world[2]
        assert abs(np.sin(0.5 * turn)) < 1e-7
        assert abs(got[3] - world[3]) < 1e-9


@given(states, inputs)
def test_vanishing_curvature_is_straight(state, controls):
    straight, bent = rollout(state, controls, 0.0), rollout(state, controls, 1e-9)
    np.testing.assert_allclose(bent, straight, atol=1e-4)
