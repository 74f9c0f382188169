"""Where a body on a lane is taken to be: its true corners are inside what the worst case on roads takes it to fill."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from highway_env.road.lane import CircularLane, SineLane, StraightLane
from highway_env.vehicle.kinematics import Vehicle

from dynamics.networks.reachable.strips import FAR, HALF, HIGH, LOW, NEAR
from shield import ShieldedEnv

TOLERANCE = 1e-6


def worst_corner(kind, angles=0.15):
    """How far any corner reaches out of the band of its body across the lane, and along it [m]."""
    env = ShieldedEnv(gym.make("roundabout-v0"), "worst-case")
    env.reset(seed=1)
    base, worst = env.unwrapped, np.array([-np.inf, -np.inf])
    road, rng = base.road, np.random.default_rng(0)
    lanes = {key: lane for key, lane in road.network.lanes_dict().items() if type(lane) is kind}
    assert lanes
    for key, lane in lanes.items():
        for _ in range(8):
            s = rng.uniform(0.2, 0.8) * lane.length
            heading = lane.heading_at(s) + rng.uniform(-angles, angles)
            body = Vehicle(road, lane.position(s, rng.uniform(-1.5, 1.5)), heading, 2.0)
            body.lane_index, body.lane, body.route = key, lane, None
            road.vehicles = [base.vehicle, body]
            env.door.reset()
            env.door._read()
            others = env.door.watch.last.others
            number = next(k for k, name in enumerate(road.network.lanes_dict()) if name == key)
            ours = others.marks[: int(others.found[0]), 1] == number
            row = others.numbers[: int(others.found[0])][ours][0]
            local = np.array([lane.local_coordinates(corner) for corner in body.polygon()[:4]])
            across = max(row[LOW] - local[:, 1].min(), local[:, 1].max() - row[HIGH])
            along = max(-row[FAR] - row[HALF] - local[:, 0].min(), local[:, 0].max() + row[NEAR] - row[HALF])
            worst = np.maximum(worst, [across, along])
    return worst


OPEN = pytest.mark.xfail(strict=True, reason="open: an attack came 4 cm into the buffer, and nobody had broken a rule")
ACROSS, ALONG = 0, 1


@pytest.mark.parametrize(
    ("kind", "side"),
    [
        (StraightLane, ACROSS),
        (StraightLane, ALONG),
        (CircularLane, ACROSS),
        # Towards the centre of an arc a body takes more of its length than at its centre line.
        pytest.param(CircularLane, ALONG, marks=OPEN),
        # The slope and the curvature of a sine are left out of the band.
        pytest.param(SineLane, ACROSS, marks=OPEN),
        (SineLane, ALONG),
    ],
)
def test_a_body_is_inside_its_band(kind, side):
    assert worst_corner(kind)[side] <= TOLERANCE
