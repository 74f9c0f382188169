"""Two limits of rules: a vehicle at exactly the slowest speed at which turning counts, and a lane that comes to be
owned while the ego leaves it."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
from highway_env.vehicle.kinematics import Vehicle

from dynamics.traffic.assumptions import Assumptions
from shield import ShieldedEnv
from shield.decision import Reason

SWING = {
    "lanes_count": 2,
    "vehicles_count": 0,
    "simulation_frequency": 15,
    "policy_frequency": 15,
    "action": {"type": "ContinuousAction"},
}
HELD = {**SWING, "simulation_frequency": 5, "policy_frequency": 5}


def highway(config, at, heading, speed):
    env = ShieldedEnv(gym.make("highway-v0", config=config), "worst-case")
    env.reset(seed=0)
    ego = env.unwrapped.vehicle
    ego.position, ego.heading, ego.speed = np.array(at), heading, speed
    ego.on_state_update()
    return env, env.unwrapped.road


def test_a_newly_owned_lane_takes_no_plan_away():
    """A scene from an attack: the plan stops in a lane that the reachable interval of a wide follower comes near. The
    ego does not own that lane before it touches it."""
    env, road = highway(SWING, [300.0, 2.2896448920349495], 0.8249786296351735, 23.615081912096798)
    follower = Vehicle(road, [280.1857916132634, 4.186992402723296], 0.0, 22.226541557677034)
    follower.WIDTH = 4.4347691260803845
    follower.act({"acceleration": -2.9, "steering": 0.0})
    parked = Vehicle(road, [337.73368292645114, 4.6305588548343986], 0.0, 0.0)
    parked.LENGTH = parked.WIDTH = 2.0
    road.vehicles += [follower, parked]
    for wheel in (0.8095393338343296, -0.5256011648418802, 0.5348920294685925):
        env.step(np.array([1.0, wheel]))
        assert env.decisions[0].reason is not Reason.NO_SAFE_PLAN
    assert env.filter.violations == 0


def lost_at(speed):
    """The lateral room that a vehicle may still use up by turning, (2,), after a frame at rest, at 5 Hz."""
    env, road = highway(HELD, [300.0, 0.0], 0.0, 20.0)
    other = Vehicle(road, [200.0, 4.0], 0.0, speed)
    road.vehicles.append(other)
    env.step(np.zeros(2))
    other.step = lambda dt: None
    env.step(np.zeros(2))
    env.filter.monitor_last_frame()
    bodies = env.filter.core.memory.verifier.around.bodies
    return np.array([bodies.budget[0], bodies.action[0]])


def test_turning_counts_from_the_slow_speed_on_inclusively():
    slow = Assumptions.idm().slow_speed
    np.testing.assert_allclose(lost_at(slow), lost_at(slow + 1e-9), atol=1e-6)
