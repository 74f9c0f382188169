"""A follower with an obligation moves aside, so that the stored plan has to stay clear of it. It leaves the plan its
room, or the monitor names it. Both scenes come from an attack in which no vehicle was named."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from hand_driven import Placed
from highway_env.vehicle.objects import Obstacle

from shield import ShieldConfig, ShieldedEnv
from shield.errors import ConfigError

THROTTLE = {"vehicles_count": 0, "action": {"type": "ContinuousAction"}, "offroad_terminal": False, "duration": 40}


def driven(config, ego_at, follower, actions):
    """The environment after these actions, and the decisions of all frames; the ego alone is on the road before."""
    env = ShieldedEnv(gym.make("highway-v0", config={**THROTTLE, **config}))
    env.reset(seed=0)
    road, ego = env.unwrapped.road, env.unwrapped.vehicle
    ego.position, ego.heading, ego.speed = np.array(ego_at[:2]), ego_at[2], ego_at[3]
    ego.on_state_update()
    road.vehicles[:] = [ego]
    speed, size, places = follower
    road.vehicles.append(Placed(road, (*places[0], speed), size, lambda frame: (*places[frame], speed)))
    frames = []
    for action in actions:
        env.step(np.array(action, np.float32))
        frames += env.frame_decisions
    return env, frames


def check(env, frames):
    """The first frame verifies. Some later frame does not, or another vehicle is at fault, and then a vehicle is
    named."""
    assert frames[0].tier.verified
    lost = [decision for decision in frames if decision.guarantee.value == "none"]
    assert not lost or env.filter.violations > 0


def test_a_follower_that_leaves_its_lane_and_spoils_the_plan_is_a_violator():
    """Its reachable interval shrank past the place where the ego stops, so that the lateral wander of the plan came
    back into it."""
    config = {"lanes_count": 4, "simulation_frequency": 6, "policy_frequency": 6}
    speed, y = 5.1476387014039435, 6.84
    places = [(192.31401115720362, y, 0.0), *((193.17195094077096 + k * speed / 6, 6.8501, 0.0) for k in range(3))]
    ego = (200.0, 3.8270450589699094, 0.37053935485576767, 5.7531658452141485)
    actions = [(-0.9321912527084351, -0.9557884335517883)] * 2
    env, frames = driven(config, ego, (speed, (5.0, 2.0), places), actions)
    check(env, frames)
    assert env.filter.violations == 1


def test_a_vehicle_that_turns_beside_the_entered_lane_and_spoils_the_plan_is_a_violator():
    """Its obligation covered several lanes. The ego gets out of its sight by the plan, so that it may enter the
    lane."""
    config = {"lanes_count": 3, "simulation_frequency": 15, "policy_frequency": 5}
    speed, x = 12.821662467816502, 188.08803884950777
    places = [(x + k * speed / 15, 8.9, -np.pi / 2 if k < 17 else 0.0) for k in range(30)]
    ego = (200.0, 0.33612268822915004, 0.29607762347326405, 17.161967921249254)
    actions = [
        (0.07901636511087418, 0.42666465044021606),
        (-0.5978143215179443, -0.17564158141613007),
        (-0.6753512024879456, -0.13739463686943054),
        (-0.7424114346504211, 0.4451982080936432),
        (0.12065232545137405, 0.0111034344881773),
        (0.27079081535339355, 0.20141643285751343),
    ]
    env, frames = driven(config, ego, (speed, (20.0, 3.2), places), actions)
    check(env, frames)
    assert env.filter.violations == 1


def test_speeds_that_cannot_be_braked_from_within_the_perception_range_are_refused():
    """In one frame at 5 Hz FASTER led from 38 to 100 m/s, and to an obstacle that had been too far to count."""
    fast = {"action": {"type": "DiscreteMetaAction", "target_speeds": [20, 310, 600]}, "vehicles_count": 0}
    env = gym.make("highway-fast-v0", config=fast)
    with pytest.raises(ConfigError, match="perception_range"):
        ShieldedEnv(env)
    env.reset(seed=1)
    env.unwrapped.road.objects.append(Obstacle(env.unwrapped.road, [430.0, 0.0]))
    assert ShieldedEnv(env, ShieldConfig(perception_range=20_000.0)).filter is not None
