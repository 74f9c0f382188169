"""A vehicle inside the ego's buffer for a single frame. The fail-safe is judged from the next frame on, when the
vehicle has passed; the monitor names it all the same."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from highway_env.vehicle.kinematics import Vehicle

from shield import Shield, ShieldedEnv

IDLE = 1


class Dart(Vehicle):
    """Drives straight on beside the ego, and is at other places across the road in the frames that come."""

    places: tuple[float, ...] = ()

    def act(self, action=None):
        pass

    def step(self, dt):
        super().step(dt)
        if self.places:
            self.position = np.array([self.position[0], self.places[0]])
            self.places = self.places[1:]


def road_with(env, hz, relative, depth, ego_speed, across):
    """An ego in the middle of lane 0, and a dart that overtakes it: two frames from now its rear is `depth` [m] behind
    the front of the ego's buffer, `across` the road from the ego's middle [m]."""
    base, dt = env.unwrapped, 1 / hz
    ego, road = base.vehicle, base.road
    road.vehicles = [ego]
    ego.position, ego.heading, ego.speed = np.array([200.0, 0.0]), 0.0, ego_speed
    ego.target_lane_index = ("0", "1", 0)
    ego.speed_index = ego.speed_to_index(20.0)
    ego.target_speed = ego.index_to_speed(ego.speed_index)
    ego.on_state_update()
    dart = Dart(road, [207.0 - depth - 2 * relative * dt, 3.2], 0.0, ego_speed + relative)
    dart.places = (3.2, across, across)
    dart.action = {"steering": 0.0, "acceleration": 0.0}
    road.vehicles.append(dart)


def highway(hz):
    config = {
        "simulation_frequency": hz,
        "policy_frequency": hz,
        "lanes_count": 3,
        "vehicles_count": 1,
        "duration": 1000,
    }
    return gym.make("highway-fast-v0", config=config)


CASES = [
    (5, 7.0, 0.5, 20.0, 1.31),
    (5, 18.0, 2.4, 20.0, 1.31),
    (10, 34.0, 2.1, 5.0, 1.31),
    (15, 34.0, 1.0, 5.0, 1.31),
    (30, 34.0, 0.3, 5.0, 2.0),
]


@pytest.mark.parametrize(("hz", "relative", "depth", "ego_speed", "across"), CASES)
@pytest.mark.parametrize("placement", ["env", "policy"])
def test_a_vehicle_that_crosses_the_buffer_in_one_frame_is_a_violator(
    hz, relative, depth, ego_speed, across, placement
):
    env = highway(hz)
    shield = ShieldedEnv(env, "worst-case") if placement == "env" else Shield(lambda obs: IDLE, env, "worst-case")
    world = shield if placement == "env" else env
    obs, _ = world.reset(seed=0)
    road_with(world, hz, relative, depth, ego_speed, across)
    if placement == "env":
        shield.filter.reset()
    told = []
    for _ in range(3):
        action = IDLE if placement == "env" else shield.predict(obs)[0]
        obs, *_, info = world.step(action)
        told.append(info["shield"]["violations"] if placement == "env" else shield.statistics.violations)
        if info["crashed"]:
            break
    # A violation in the last frame of a step is reported with the next step, or with this one if it is the last.
    assert told[0] == 0
    assert sum(told) >= 1


@pytest.mark.parametrize(("hz", "relative", "depth", "ego_speed", "across"), CASES)
def test_a_vehicle_that_stays_in_its_lane_is_no_violator(hz, relative, depth, ego_speed, across):
    env = ShieldedEnv(highway(hz), "worst-case")
    env.reset(seed=0)
    road_with(env, hz, relative, depth, ego_speed, 3.2)
    env.filter.reset()
    assert [env.step(IDLE)[-1]["shield"]["violations"] for _ in range(3)] == [0, 0, 0]
