"""Compiled rollouts of raw inputs, and of commands on curved roads, are what highway-env's vehicles do."""

import numpy as np
import pytest
from highway_env.vehicle.kinematics import Vehicle
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics import bicycle
from dynamics.road import StraightRoad
from dynamics.rollout import Rollouts

TOLERANCE = 1e-9


def state_of(vehicle):
    return np.array([*vehicle.position, vehicle.heading, vehicle.speed])


def drive(state, inputs, dt):
    """What a vehicle of highway-env does under (acceleration, wheel angle), in the world, after each frame."""
    vehicle = Vehicle(None, state[:2].copy(), state[2], state[3])
    states = []
    for acceleration, steering in inputs:
        vehicle.act({"acceleration": acceleration, "steering": steering})
        vehicle.step(dt)
        states.append(state_of(vehicle))
    return np.array(states)


@given(
    seed=st.integers(0, 9_999),
    rows=st.integers(1, 5),
    frames=st.integers(1, 20),
    heading=st.floats(-3, 3),
    dt=st.sampled_from([1 / 5, 1 / 15]),
)
@settings(max_examples=60, deadline=None)
def test_raw_inputs_on_a_straight_road_drive_as_the_simulator_does(seed, rows, frames, heading, dt):
    rng = np.random.default_rng(seed)
    road = StraightRoad.from_lanes(4, origin=(3.0, -2.0), heading=heading)
    world = np.array([rng.uniform(-50, 50), rng.uniform(-50, 50), rng.uniform(-3, 3), rng.uniform(-45, 45)])
    inputs = np.stack(
        [rng.uniform(-30, 30, (rows, frames)), rng.uniform(-np.pi / 3, np.pi / 3, (rows, frames))], axis=-1
    )
    kept = inputs.copy()
    got = road.to_world(Rollouts(dt).run_inputs(road.to_road(world), inputs))
    assert got.shape == (rows, frames, 4)
    np.testing.assert_array_equal(inputs, kept)
    for row in range(rows):
        np.testing.assert_allclose(got[row], drive(world, inputs[row], dt), rtol=0, atol=TOLERANCE)


def test_raw_inputs_are_limited_by_speed_only():
    fast = np.array([0.0, 0.0, 0.0, 41.0])
    inputs = np.array([[[60.0, 0.0]], [[-60.0, 0.0]]])
    got = Rollouts(0.2).run_inputs(fast, inputs)[:, 0, 3]
    assert got == pytest.approx([41.0 - 1.0 * 0.2, 41.0 - 60.0 * 0.2])


def test_raw_inputs_and_commands_do_not_share_buffers():
    rollouts, rng = Rollouts(0.2), np.random.default_rng(0)
    state, inputs = np.array([0.0, 1.0, 0.1, 20.0]), rng.uniform(-0.3, 0.3, (3, 8, 2))
    commands = np.tile([4.0, 25.0, 1e12], (3, 8, 1))
    first = rollouts.run_inputs(state, inputs)
    between = rollouts.run(state, commands)
    np.testing.assert_array_equal(rollouts.run_inputs(state, inputs), first)
    np.testing.assert_array_equal(rollouts.run(state, commands), between)
    step = bicycle.step(np.tile(state, (3, 1)), inputs[:, 0, 0], inputs[:, 0, 1], 0.2)
    np.testing.assert_allclose(first[:, 0], step, rtol=0, atol=TOLERANCE)
