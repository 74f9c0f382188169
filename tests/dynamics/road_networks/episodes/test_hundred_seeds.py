"""Whole episodes of a hundred seeds, of each kind of configuration that there is, are highway-env's to the last bit."""

import pytest
from simulator_pair import DRIVERS, drive

SEEDS = range(4_000, 4_100)
KINDS = {
    "default": {},
    "lanes": {"lanes_count": 2, "initial_lane_id": 1, "ego_spacing": 0.5},
    "density": {"vehicles_density": 4.0, "vehicles_count": 8},
    "frequencies": {"simulation_frequency": 7, "policy_frequency": 3},
    "rewards": {"collision_reward": -2, "high_speed_reward": 0.7, "normalize_reward": False},
    "off road": {"offroad_terminal": True, "action": {"type": "ContinuousAction"}},
    "speeds": {"action": {"type": "DiscreteMetaAction", "target_speeds": [0, 10, 20, 30, 40]}},
    "lateral": {"action": {"type": "DiscreteMetaAction", "longitudinal": False}},
    "continuous": {"action": {"type": "ContinuousAction", "acceleration_range": [-9.0, 3.0]}},
    "features": {"observation": {"type": "Kinematics", "features": ["presence", "x", "vy", "cos_h"], "absolute": True}},
    "ranges": {"observation": {"type": "Kinematics", "see_behind": True, "features_range": {"x": [-50, 50]}}},
    "shuffled": {"observation": {"type": "Kinematics", "order": "shuffled", "normalize": False}},
    "grid": {"observation": {"type": "OccupancyGrid"}},
    **{path.rsplit(".", 1)[1]: {"other_vehicles_type": path, "vehicles_density": 3.0} for path in DRIVERS},
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_hundred_seeds_are_the_same(kind):
    drive({"duration": 2, "vehicles_count": 3, **KINDS[kind]}, SEEDS, decisions=2)


def test_a_hundred_seeds_of_the_slow_highway_are_the_same():
    """Its traffic looks for collisions."""
    drive({"duration": 2, "vehicles_count": 5, "vehicles_density": 3.0}, SEEDS, decisions=2, env_id="highway-v0")
