"""`MPCPolicy` in highway-env: it drives, and refuses unsupported environments."""

from __future__ import annotations

import gymnasium as gym
import highway_env  # noqa: F401
import numpy as np
import pytest
from highway_env.vehicle.kinematics import Vehicle

from dynamics.errors import ConfigError, SceneError
from mpc.mpc_policy import MPCPolicy

CONTINUOUS = {"action": {"type": "ContinuousAction"}, "simulation_frequency": 10, "policy_frequency": 5}


def make(name="highway-fast-v0", **config):
    return gym.make(name, config={**CONTINUOUS, "duration": 8, **config})


@pytest.mark.filterwarnings("ignore:.*out of date")
@pytest.mark.parametrize("backend", ["daqp", "osqp"])
@pytest.mark.parametrize(
    ("name", "config"),
    [
        ("highway-fast-v0", {}),
        ("highway-fast-v0", {"action": {"type": "ContinuousAction", "longitudinal": False}, "vehicles_count": 0}),
        ("racetrack-oval-v0", {"other_vehicles": 1}),
    ],
)
def test_the_controller_drives(name, config, backend):
    env = make(name, **config)
    policy = MPCPolicy(env, speed=25.0, backend=backend)
    obs, _ = env.reset(seed=0)
    done, way = False, 0.0
    while not done:
        action, state = policy.predict(obs, state="kept")
        assert state == "kept"
        assert env.action_space.contains(action)
        obs, _, terminated, truncated, _ = env.step(action)
        way += env.unwrapped.vehicle.speed / 5
        done = terminated or truncated
    assert not env.unwrapped.vehicle.crashed
    assert env.unwrapped.vehicle.on_road
    assert way > 50
    env.close()


def test_the_controller_overtakes_and_does_not_hit_a_standing_vehicle():
    env = make(vehicles_count=0, duration=12)
    ends = {}
    for lanes in (1, 3):
        env.unwrapped.configure({"lanes_count": lanes})
        env.reset(seed=3)
        ego, road = env.unwrapped.vehicle, env.unwrapped.road
        road.vehicles.append(Vehicle(road, np.add(ego.position, [120.0, 0.0]), 0.0, 0.0))
        policy = MPCPolicy(env)
        for _ in range(60):
            _, _, terminated, truncated, _ = env.step(policy.predict()[0])
            if terminated or truncated:
                break
        assert not ego.crashed
        ends[lanes] = road.vehicles[-1].position[0] - ego.position[0]
    assert ends[1] > 5
    assert ends[3] < -5


def test_a_new_episode_is_as_good_as_a_new_policy():
    env = make(duration=3)

    def drive(policy, seed):
        env.reset(seed=seed)
        out = []
        for _ in range(12):
            action, _ = policy.predict()
            out.append(action)
            env.step(action)
        return np.array(out)

    used = MPCPolicy(env)
    drive(used, 1)
    np.testing.assert_array_equal(drive(used, 2), drive(MPCPolicy(env), 2))


def test_unsupported_environments_are_refused_by_the_controller():
    with pytest.raises(ConfigError, match=r"DiscreteMetaAction.*ContinuousAction"):
        MPCPolicy(gym.make("highway-fast-v0"))
    with pytest.raises(ConfigError, match="dynamical"):
        MPCPolicy(make(action={"type": "ContinuousAction", "dynamical": True}))
    for speed in (0, -1, np.nan, np.inf):
        with pytest.raises(ConfigError, match="speed must be positive"):
            MPCPolicy(make(), speed=speed)
    with pytest.raises(ConfigError, match="valid are daqp, osqp"):
        MPCPolicy(make(), backend="ipopt")
    with pytest.raises(ConfigError, match="buffer"):
        MPCPolicy(make(), buffer=(-1, 0))
    policy = MPCPolicy(make())
    policy._reader._env.road = None
    with pytest.raises(SceneError, match="reset"):
        policy.predict()


def test_a_scene_that_is_not_finite_is_refused():
    env = make()
    env.reset(seed=0)
    env.unwrapped.vehicle.speed = np.nan
    with pytest.raises(SceneError, match="not finite"):
        MPCPolicy(env).predict()
