"""The compiled highway is highway-env's, to the last bit: whatever is configured, wherever it starts, however long.

Where this machine's numpy makes sums of products in an unknown way (`Simulator.exact`), to 1e-9.
"""

from contextlib import suppress

import gymnasium as gym
import numpy as np
import pytest
import simulator_pair
from highway_env.envs.highway_env import HighwayEnvFast
from highway_env.vehicle.behavior import IDMVehicle, LinearVehicle
from highway_env.vehicle.objects import Landmark, Obstacle
from hypothesis import given, settings
from hypothesis import strategies as st
from simulator_pair import DRIVERS, SMALL, Pair, drive, place, random_configuration, random_scene

from dynamics.errors import ActionError, ConfigError, SceneError, ShieldError
from dynamics.simulator.layout import SPEED, X
from dynamics.simulator.observe import FEATURES
from dynamics.simulator.simulator import Simulator

ROAD = 10_000.0
CONTINUOUS = {"type": "ContinuousAction"}


def live(config=None, seed=0, env_id="highway-fast-v0"):
    env = gym.make(env_id, config={**SMALL, "duration": 1000, **(config or {})})
    env.reset(seed=seed)
    return env


def drive_live(env, decisions=10, seed=0):
    pair = Pair.of(env)
    pair.drive(decisions, np.random.default_rng(seed))
    env.close()


def same_or_refused(make):
    """The project's own error, or the same; never something else in silence."""
    with suppress(ShieldError):
        make()


# Episodes


def test_episodes_as_configured_by_default_are_the_same():
    pair = Pair("highway-fast-v0")
    pair.reset([3])
    pair.drive(12, np.random.default_rng(3))


def test_traffic_that_looks_for_collisions_is_the_same():
    drive({"vehicles_count": 12, "vehicles_density": 4.0}, seeds=(0, 1), decisions=12, env_id="highway-v0")


@pytest.mark.parametrize("driver", DRIVERS, ids=lambda path: path.rsplit(".", 1)[1])
def test_traffic_of_every_kind_is_the_same(driver):
    drive({"other_vehicles_type": driver, "vehicles_density": 3.0, "lanes_count": 2})


@pytest.mark.parametrize("frequencies", [(2, 1), (15, 7), (10, 3), (31, 0.5), (5, 5), (60, 2)])
def test_frames_and_decisions_of_any_length_are_the_same(frequencies):
    simulation, policy = frequencies
    drive({"simulation_frequency": simulation, "policy_frequency": policy, "vehicles_count": 4}, decisions=8)


@pytest.mark.parametrize("lanes", [1, 2, 8])
@pytest.mark.parametrize("first", [None, 0])
def test_roads_of_any_width_are_the_same(lanes, first):
    drive({"lanes_count": lanes, "initial_lane_id": first, "ego_spacing": 0.2, "vehicles_density": 6.0}, decisions=8)


@pytest.mark.parametrize("vehicles", [0, 1])
def test_an_empty_road_is_the_same(vehicles):
    drive({"vehicles_count": vehicles})


@pytest.mark.parametrize(
    "action",
    [
        {"longitudinal": False},
        {"lateral": False},
        {"target_speeds": [0, 10, 20, 30, 40]},
        {"target_speeds": [-5.0, 12.5, 13.0, 50.0]},
        {"target_speeds": [30, 20]},
    ],
    ids=str,
)
def test_meta_actions_of_every_kind_are_the_same(action):
    drive({"action": {"type": "DiscreteMetaAction", **action}})


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(
    "action",
    [
        {},
        {"longitudinal": False},
        {"lateral": False},
        {"clip": False},
        {"acceleration_range": [-9.7, 3.1], "steering_range": [-1.4, 0.6], "speed_range": [-12.0, 47.0]},
        {"acceleration_range": (np.float64(-3.3), np.float64(3.3))},
    ],
    ids=str,
)
def test_throttle_and_steering_of_every_kind_are_the_same(action, dtype):
    drive({"action": {**CONTINUOUS, **action}, "vehicles_count": 3}, seeds=(0, 1), dtype=dtype, scale=1.5)


def test_an_ego_that_leaves_the_road_spins_and_reverses_is_the_same():
    pair = Pair("highway-fast-v0", {**SMALL, "action": CONTINUOUS, "vehicles_count": 2})
    for steering in (0.9, -0.5):
        pair.reset([2])
        for decision in range(20):
            pair.step([np.array([0.3 if decision < 3 else -1.0, steering], dtype=np.float32)])
        base = pair.envs[0].unwrapped
        assert base.vehicle.speed < -1
        assert not base.vehicle.on_road
        assert abs(base.vehicle.heading) > np.pi


@pytest.mark.parametrize(
    "rewards",
    [
        {"collision_reward": 0, "right_lane_reward": 0, "high_speed_reward": 0},
        {"collision_reward": 1.0, "right_lane_reward": 0.0, "high_speed_reward": -1},
        {"collision_reward": 0.3, "right_lane_reward": 0.2, "high_speed_reward": 0.1},
        {"on_road_reward": -0.7, "normalize_reward": False},
        {"reward_speed_range": [25, 25], "ego_spacing": 1},
        {"reward_speed_range": [30, 20], "normalize_reward": False},
    ],
    ids=str,
)
def test_rewards_of_any_weights_are_the_same(rewards):
    drive(rewards, seeds=(0, 1, 2), decisions=12)


def test_an_episode_ends_off_the_road_where_it_should():
    pair = Pair("highway-fast-v0", {**SMALL, "action": CONTINUOUS, "offroad_terminal": True, "vehicles_count": 1})
    pair.reset([0])
    ends = [pair.step([np.array([0.0, 0.2])])[0] for _ in range(4)]
    assert ends[-1]
    assert not pair.envs[0].unwrapped.vehicle.on_road


def test_driving_on_after_a_crash_is_the_same():
    pair = Pair("highway-v0", {**SMALL, "vehicles_density": 6.0, "lanes_count": 1, "action": CONTINUOUS})
    pair.reset([0])
    for _ in range(20):
        pair.step([np.array([1.0, 0.0])])
    assert sum(vehicle.crashed for vehicle in pair.envs[0].unwrapped.road.vehicles) > 1


def test_hundreds_of_decisions_are_the_same():
    pair = Pair("highway-fast-v0", {"vehicles_count": 2, "lanes_count": 2, "duration": 1000})
    pair.reset([5])
    pair.drive(400, np.random.default_rng(0))
    assert pair.decision == 400


def test_the_end_of_the_road_is_the_same():
    env = live({"action": {"type": "DiscreteMetaAction", "target_speeds": [20, 30, 40]}})
    for k, vehicle in enumerate(env.unwrapped.road.vehicles):
        place(vehicle, ROAD - 60 * (k + 1), 4.0 * (k % 3), 28.0)
    drive_live(env, 15)
    assert all(vehicle.position[0] > ROAD + 10 for vehicle in env.unwrapped.road.vehicles[:4])


# Observations


@pytest.mark.parametrize(
    "observation",
    [
        {"features": list(FEATURES)},
        {"features": list(reversed(FEATURES)), "normalize": False},
        {"absolute": True, "see_behind": True},
        {"absolute": True, "clip": False},
        {"vehicles_count": 2},
        {"vehicles_count": 30, "see_behind": True},
        {"features": ["heading", "x", "long_off"], "features_range": {"x": [-30, 60], "heading": [-0.1, 0.2]}},
        {"features_range": {"vx": [0, 0]}},
        {"include_obstacles": False, "observe_intentions": True},
    ],
    ids=str,
)
def test_observations_of_every_kind_are_the_same(observation):
    drive({"observation": {"type": "Kinematics", **observation}}, decisions=8)


@pytest.mark.parametrize(
    "observation",
    [
        {},
        {"features": ["presence", "x", "y", "vx", "vy", "heading", "cos_h", "sin_h", "lat_off", "on_road"]},
        {"grid_size": [[-40, 60], [-12, 12]], "grid_step": [3, 3]},
        {
            "features": ["vx", "on_road"],
            "features_range": {"vx": [-9, 9], "x": [-99, 99], "y": [-70, 90]},
            "clip": False,
        },
        {"grid_size": [[-18, 18], [-18, 18]], "grid_step": [0.7, 1.3]},
    ],
)
def test_grids_of_every_kind_are_the_same(observation):
    drive({"observation": {"type": "OccupancyGrid", **observation}}, decisions=10)


@pytest.mark.parametrize("rows", [2, 3, 5, 17])
def test_a_shuffled_order_is_drawn_in_the_same_way(rows):
    drive({"observation": {"type": "Kinematics", "order": "shuffled", "vehicles_count": rows}}, seeds=(0, 1, 2, 3))


def test_obstacles_are_observed_in_the_same_way():
    observation = {"type": "Kinematics", "features": list(FEATURES), "see_behind": True, "vehicles_count": 9}
    for extra in ({}, {"normalize": False}, {"features_range": {"heading": [-1, 1], "long_off": [0, 1], "x": [0, 9]}}):
        env = live({"observation": {**observation, **extra}})
        base = env.unwrapped
        for along, across in ((30.0, 0.0), (-30.0, 2.0), (8.0, 6.0)):
            at = base.vehicle.position + np.array([along, across])
            base.road.objects.append(Obstacle(base.road, at, heading=0.3))
        drive_live(env, 4)


# Generators and resets


@pytest.mark.parametrize("seed", [0, 1, 2**32 - 1, 2**32, 2**62 + 12345, 2**63 - 1])
def test_any_seed_makes_the_same_scene(seed):
    Pair("highway-fast-v0", SMALL).reset([seed])


def test_resets_without_a_seed_go_on_with_the_generator():
    pair = Pair("highway-fast-v0", {**SMALL, "other_vehicles_type": DRIVERS[1]}, num_envs=2)
    pair.reset([7, 8])
    for _ in range(3):
        pair.reset()
        pair.drive(2, np.random.default_rng(0))


@pytest.mark.parametrize("order", ["sorted", "shuffled"])
def test_copies_that_start_again_by_themselves_are_separate_environments(order):
    observation = {"type": "Kinematics", "order": order}
    pair = Pair("highway-fast-v0", {**SMALL, "duration": 4, "observation": observation, "vehicles_count": 4}, 3)
    pair.reset([1, 2, 3])
    rng, ends = np.random.default_rng(0), 0
    for _ in range(15):
        ends += sum(pair.step([int(rng.integers(5)) for _ in pair.envs], again=True))
    assert ends >= 9


# Live scenes


@pytest.mark.parametrize("seed", range(24))
def test_scenes_that_somebody_has_arranged_go_on_in_the_same_way(seed):
    rng = np.random.default_rng(seed)
    pair = Pair.of(random_scene(rng))
    pair.drive(10, rng, scale=float(rng.choice([0.1, 1.0, 2.0])))


@pytest.mark.parametrize("seed", [100, 101, 102, 103])
def test_a_stored_scene_goes_on_in_the_same_way(seed):
    rng = np.random.default_rng(seed)
    pair = Pair.of(random_scene(rng))
    pair.drive(2, rng)
    for _ in range(3):  # the simulator alone
        action = pair.envs[0].action_space.sample()
        pair.simulator.step(np.asarray([action]))
    pair.simulator.store(pair.envs[0])
    pair.compare_states()
    pair.drive(6, rng)


def test_vehicles_that_come_level_within_a_decision_are_seen_in_the_same_order():
    env = live({"vehicles_count": 3, "simulation_frequency": 4})
    ego, follower, ahead, later = env.unwrapped.road.vehicles
    place(ego, 0.0, 8.0, 20.0)
    place(follower, 20.0, 0.0, 20.0)
    follower.enable_lane_change = False
    place(ahead, 100.0, 0.0)
    place(later, 99.0, 3.0, 4.0)  # on the first lane too; a metre a frame
    ahead.crashed = later.crashed = True
    drive_live(env, 3)


def test_a_vehicle_that_enters_the_road_within_a_frame_is_seen():
    env = live({"vehicles_count": 2, "simulation_frequency": 2})
    ego, entering, follower = env.unwrapped.road.vehicles
    place(ego, -30.0, 8.0, 20.0)
    place(entering, -6.0, 0.0, 40.0)
    place(follower, -20.0, 0.0, 30.0)
    drive_live(env, 4)


def test_a_vehicle_moved_to_another_lane_finds_out_where_it_is():
    env = live()
    vehicle = env.unwrapped.road.vehicles[1]
    place(vehicle, 300.0, 8.0, 20.0, aware=False)
    vehicle.target_lane_index = ("0", "1", 2)
    drive_live(env, 3)


def test_a_vehicle_made_larger_by_hand_is_touched_in_the_same_way():
    for kept in (False, True):  # highway-env measures its diagonal once, when it is made
        env = live({"vehicles_count": 10, "vehicles_density": 5.0}, env_id="highway-v0")
        for vehicle in env.unwrapped.road.vehicles:
            vehicle.LENGTH, vehicle.WIDTH = 11.0, 3.5
            if not kept:
                vehicle.diagonal = np.sqrt(vehicle.LENGTH**2 + vehicle.WIDTH**2)
        drive_live(env, 10)


def test_a_range_of_speeds_holds_from_the_first_decision_of_a_live_scene():
    env = live({"action": {**CONTINUOUS, "speed_range": [0, 26]}, "vehicles_count": 1})
    pair = Pair.of(env)
    for _ in range(3):
        pair.step([np.array([1.0, 0.0])])


def test_a_copied_scene_that_ends_starts_again_as_configured():
    env = live({"duration": 3})
    pair = Pair.of(env)
    pair.drive(8, np.random.default_rng(0), again=True)


def test_a_copied_scene_of_other_bodies_does_not_start_again():
    env = live({"duration": 1})
    road = env.unwrapped.road
    road.objects.append(Obstacle(road, [900.0, 0.0]))
    simulator = Simulator.of(env)
    with pytest.raises(ConfigError):
        simulator.step([1], again=True)
    del road.vehicles[2]  # as many bodies as are configured, but not the same
    simulator = Simulator.of(env)
    with pytest.raises(ConfigError):
        simulator.reset([0])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("route", [("0", "1", 0)]),
        ("KP_LATERAL", 0.3),
        ("MAX_STEERING_ANGLE", 0.01),
        ("solid", False),
        ("collidable", False),
        ("act", lambda action=None: None),
    ],
)
def test_vehicles_with_another_nature_than_the_simulator_knows_are_refused_or_the_same(name, value):
    env = live({"vehicles_density": 4.0, "vehicles_count": 10}, seed=3, env_id="highway-v0")
    for vehicle in env.unwrapped.road.vehicles[1:]:
        setattr(vehicle, name, value)
    place(env.unwrapped.road.vehicles[3], *(env.unwrapped.vehicle.position + np.array([3.0, 0.5])), 20.0)
    same_or_refused(lambda: drive_live(env, 8))


@pytest.mark.parametrize(
    ("name", "value"), [("target_speeds", np.arange(5) * 10.0), ("KP_A", 0.2), ("MAX_SPEED", 22.0)]
)
def test_an_ego_with_another_nature_than_the_simulator_knows_is_refused_or_the_same(name, value):
    env = live()
    setattr(env.unwrapped.vehicle, name, value)
    same_or_refused(lambda: drive_live(env, 8))


def test_a_route_of_the_ego_is_refused_or_observed():
    env = live({"observation": {"type": "Kinematics", "features": ["x", "cos_d", "sin_d"]}})
    env.unwrapped.vehicle.plan_route_to("1")
    same_or_refused(lambda: drive_live(env, 3))


def test_scenes_of_another_road_or_of_strange_objects_are_refused():
    env = live()
    env.unwrapped.road.network.graph["0"]["1"][0].speed_limit = 20
    with pytest.raises(SceneError):
        Simulator.of(env)
    env = live()
    env.unwrapped.road.objects.append(Landmark(env.unwrapped.road, [100.0, 0.0]))
    with pytest.raises(SceneError):
        Simulator.of(env)


def test_an_ego_of_another_kind_than_the_simulators_is_refused():
    for mine, other in (({}, {"action": CONTINUOUS}), ({"action": CONTINUOUS}, {})):
        with pytest.raises(ShieldError):
            Simulator("highway-fast-v0", 1, {**SMALL, **mine}).load(live(other))


# Refusals


class _Timid(IDMVehicle):
    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.target_speed = 10.0


class _Slow(IDMVehicle):
    @classmethod
    def create_random(cls, road, **kwargs):
        vehicle = super().create_random(road, **kwargs)
        vehicle.target_speed = 5.0
        return vehicle


class _Close(IDMVehicle):
    def lane_distance_to(self, other, lane=None):
        return super().lane_distance_to(other, lane) - 4.0


class _Blind(IDMVehicle):
    def to_dict(self, *args, **kwargs):
        return {**super().to_dict(*args, **kwargs), "x": 0.0}


class _Straight(LinearVehicle):
    def steering_features(self, target_lane_index):
        return np.zeros(2)


class _Eager(LinearVehicle):
    def acceleration_features(self, *args):
        return np.ones(3)


class _Lazy(IDMVehicle):
    KP_LATERAL = 0.5


class _Stiff(IDMVehicle):
    MAX_STEERING_ANGLE = 0.01


@pytest.mark.parametrize("kind", [_Timid, _Slow, _Close, _Blind, _Straight, _Eager, _Lazy, _Stiff])
def test_traffic_that_drives_in_its_own_way_is_refused_or_the_same(kind, monkeypatch):
    monkeypatch.setattr(simulator_pair, kind.__name__, kind, raising=False)
    path = f"simulator_pair.{kind.__name__}"
    same_or_refused(lambda: drive({"other_vehicles_type": path, "vehicles_density": 3.0}, decisions=8))


@pytest.mark.parametrize(
    "config",
    [
        {"observation": {"type": "Kinematics", "vehicles_count": 1}},
        {"observation": {"type": "Kinematics", "vehicles_count": 0}},
        {"observation": {"type": "Kinematics", "order": "none"}},
        {"observation": {"type": "Kinematics", "features": ["x", "x"]}},
        {"observation": {"type": "Kinematics", "features": ["x", "colour"]}},
        {"observation": {"type": "OccupancyGrid", "as_image": True}},
        {"observation": {"type": "OccupancyGrid", "align_to_vehicle_axes": True}},
        {"observation": {"type": "OccupancyGrid", "absolute": True}},
        {"observation": {"type": "OccupancyGrid", "features": ["on_road", "colour"]}},
        {"observation": {"vehicles_count": 5}},
        {"action": {}},
        {"action": {"type": "DiscreteAction"}},
        {"action": {"type": "ContinuousAction", "dynamical": True}},
        {"action": {"type": "DiscreteMetaAction", "target_speeds": [20]}},
        {"action": {"type": "DiscreteMetaAction", "target_speeds": [20, 25, 20]}},
        {"action": {"type": "DiscreteMetaAction", "longitudinal": False, "lateral": False}},
        {"initial_lane_id": 3},
        {"initial_lane_id": -4},
        {"vehicles_count": -3},
        {"vehicles_density": 0},
        {"policy_frequency": 0},
        {"lanes_count": 0},
        {"controlled_vehicles": 2},
        {"other_vehicles_type": "highway_env.vehicle.kinematics.Vehicle"},
        {"other_vehicles_type": "math.sqrt"},
        {"duration": None},
        {"unheard_of": 1},
    ],
    ids=str,
)
def test_what_the_simulator_cannot_do_is_refused(config):
    with pytest.raises(ConfigError):
        Simulator("highway-fast-v0", 1, {**SMALL, **config})


def test_the_last_lane_may_be_asked_for_as_minus_one():
    same_or_refused(lambda: drive({"initial_lane_id": -1}, decisions=1))


def test_other_environments_are_refused():
    for env_id in ("merge-v0", "intersection-v0", "no-such-v0"):
        with pytest.raises(ConfigError):
            Simulator(env_id)


def test_the_configuration_that_an_environment_is_registered_with_counts():
    gym.register(id="my-highway-v0", entry_point=HighwayEnvFast, kwargs={"config": {"lanes_count": 2}})
    try:
        same_or_refused(lambda: Pair("my-highway-v0").reset([0]))
    finally:
        gym.registry.pop("my-highway-v0")


@pytest.mark.parametrize("which", [2, -3])
def test_copies_that_there_are_not_are_refused(which):
    with pytest.raises(ShieldError):
        Simulator("highway-fast-v0", 2, SMALL).reset([1], which=[which])


def test_seeds_that_highway_env_does_not_take_are_refused():
    simulator = Simulator("highway-fast-v0", 2, SMALL)
    for seeds in ([-1, 0], [0], [2**64, 0]):
        with pytest.raises(ShieldError):
            simulator.reset(seeds)
    with pytest.raises(ConfigError):
        Simulator("highway-fast-v0", 0, SMALL)


def test_actions_outside_the_space_are_refused():
    simulator = Simulator("highway-fast-v0", 2, SMALL)
    for actions in ([0], [0, 5], [-1, 0], [0, np.nan], [[0], [1]]):
        with pytest.raises(ActionError):
            simulator.step(actions)
    simulator = Simulator("highway-fast-v0", 1, {**SMALL, "action": CONTINUOUS})
    for actions in ([[0.0]], [[0.0, np.inf]], [0.0, 0.0]):
        with pytest.raises(ActionError):
            simulator.step(actions)


# Fuzzing


def fuzz(seed, most, decisions):
    rng = np.random.default_rng(seed)
    pair = Pair(*random_configuration(rng, most))
    wild = {"dtype": rng.choice([np.float32, np.float64]), "scale": float(rng.choice([0.05, 0.3, 1, 2]))}
    pair.reset([int(rng.integers(1 << 40))])
    pair.drive(decisions, rng, **wild)
    pair.reset()
    pair.drive(decisions, rng, again=True, **wild)


@settings(max_examples=12)
@given(st.integers(0, 2**32 - 1))
def test_whatever_is_configured_is_the_same(seed):
    fuzz(seed, 5, 4)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(300))
def test_three_hundred_configurations_are_the_same(seed):
    fuzz(seed, 20, 12)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1000, 1200))
def test_two_hundred_arranged_scenes_are_the_same(seed):
    rng = np.random.default_rng(seed)
    Pair.of(random_scene(rng)).drive(25, rng)


# The comparison itself


def test_one_bit_of_a_position_is_noticed_and_named():
    pair = Pair("highway-fast-v0", SMALL)
    pair.reset([4])
    worlds = pair.simulator.worlds
    if not pair.simulator.exact:
        pytest.skip("states are compared to 1e-9 here")
    kept = worlds.f[0, X, 3]
    worlds.f[0, X, 3] = np.nextafter(kept, np.inf)
    with pytest.raises(AssertionError, match=r"seed 4, copy 0, decision 0, vehicle 3, x: .*0x1.*0x1"):
        pair.compare_states()
    worlds.f[0, X, 3] = kept
    pair.compare_states()
    worlds.rows[0, 5] += np.uint64(1)
    with pytest.raises(AssertionError, match="generator"):
        pair.compare_states()


def test_a_constant_of_the_world_that_changes_is_noticed(monkeypatch):
    pair = Pair("highway-fast-v0", SMALL)
    pair.reset([0])
    pair.step([1])
    monkeypatch.setattr(IDMVehicle, "TIME_WANTED", 1.5 + 1e-6)
    with pytest.raises(AssertionError, match=r"decision \d+, vehicle \d+, "):
        pair.drive(10, np.random.default_rng(0))


@pytest.mark.parametrize("name", ["reward", "terminated", "truncated", "observations"])
def test_what_a_step_returns_is_compared(name, monkeypatch):
    pair = Pair("highway-fast-v0", SMALL)
    pair.reset([0])
    right = pair.simulator.step

    def wrong(actions, again=False):
        right(actions, again)
        seen = pair.simulator.seen
        changed = {"reward": seen.reward + 1e-6, "observations": seen.observations + np.float32(1e-6)}
        changed |= {"terminated": ~seen.terminated, "truncated": ~seen.truncated}
        shown = {key: changed[key] if key == name else getattr(seen, key) for key in changed}
        return shown["observations"], shown["reward"], shown["terminated"], shown["truncated"]

    monkeypatch.setattr(pair.simulator, "step", wrong)
    with pytest.raises(AssertionError, match=name.removesuffix("s")):
        pair.step([1])


def test_a_simulator_that_stands_still_is_noticed():
    pair = Pair("highway-fast-v0", SMALL)
    pair.reset([0])
    pair.simulator.worlds.f[0, SPEED, 0] = 0.0
    with pytest.raises(AssertionError, match="vehicle 0, x"):
        pair.step([1])
