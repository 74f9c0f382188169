"""The bicycle, the controllers and the meta-actions are those of highway-env, to rounding.

The certificates of the shield are as good as this agreement: a rollout that differs from the simulator by a
centimetre is a margin that is wrong by a centimetre.
"""

import casadi as ca
import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.controller import ControlledVehicle, MDPVehicle
from highway_env.vehicle.kinematics import Vehicle

from dynamics.roads.straight import StraightRoad
from dynamics.scenes.scene import EgoControl, Scene, Target
from dynamics.vehicle import bicycle
from dynamics.vehicle.controllers import speed_control, speed_to_index, steering_control
from dynamics.vehicle.rollout_kernels import slip_at, table_of
from dynamics.vehicle.rollouts import NO_LIMIT, Rollouts

LABELS = ("LANE_LEFT", "IDLE", "LANE_RIGHT", "FASTER", "SLOWER")
TOLERANCE = 1e-9
ANGLES = (0.0, 0.7, -2.1)
SPEEDS = (None, tuple(float(v) for v in range(0, 45, 5)))


def make_road(angle=0.0, lanes=4):
    network = RoadNetwork.straight_road_network(lanes, angle=angle)
    return Road(network=network, np_random=np.random.RandomState(0))


def state_of(vehicle):
    return np.array([*vehicle.position, vehicle.heading, vehicle.speed])


def random_states(rng, n):
    """World states all over the place, reversing and faster than `MAX_SPEED` among them."""
    return np.column_stack(
        [rng.uniform(0, 1000, n), rng.uniform(-8, 20, n), rng.uniform(-np.pi, np.pi, n), rng.uniform(-45, 45, n)]
    )


def test_a_thousand_steps_of_the_bicycle_agree():
    rng = np.random.default_rng(0)
    states = random_states(rng, 1000)
    acceleration, steering = rng.uniform(-60, 60, 1000), rng.uniform(-np.pi / 3, np.pi / 3, 1000)
    kept = states.copy()
    for dt in (1 / 5, 1 / 15):
        got = bicycle.step(states, acceleration, steering, dt)
        for i, row in enumerate(states):
            vehicle = Vehicle(None, row[:2].copy(), row[2], row[3])
            vehicle.act({"acceleration": acceleration[i], "steering": steering[i]})
            vehicle.step(dt)
            np.testing.assert_allclose(got[i], state_of(vehicle), rtol=0, atol=TOLERANCE)
    np.testing.assert_array_equal(states, kept)


def test_the_expression_is_the_array_step():
    rng = np.random.default_rng(1)
    states = random_states(rng, 1000)
    acceleration, steering = rng.uniform(-60, 60, 1000), rng.uniform(-np.pi / 3, np.pi / 3, 1000)
    x, a, d = ca.SX.sym("x", 4), ca.SX.sym("a"), ca.SX.sym("d")
    function = ca.Function("step", [x, a, d], [bicycle.step_expression(x, a, d, 0.2)])
    got = np.array(function(states.T, acceleration[None], steering[None])).T
    np.testing.assert_allclose(got, bicycle.step(states, acceleration, steering, 0.2), rtol=0, atol=TOLERANCE)


def test_the_constants_are_those_of_the_simulator():
    assert (bicycle.LENGTH, bicycle.WIDTH, bicycle.MAX_SPEED) == (Vehicle.LENGTH, Vehicle.WIDTH, Vehicle.MAX_SPEED)


@pytest.mark.parametrize("angle", ANGLES)
def test_a_thousand_steering_and_speed_commands_agree(angle):
    rng = np.random.default_rng(2)
    road = make_road(angle)
    map_ = StraightRoad.from_network(road.network)
    n = 1000
    local = np.column_stack(
        [rng.uniform(0, 1000, n), rng.uniform(-3, 15, n), rng.uniform(-1.5, 1.5, n), rng.uniform(-10, 45, n)]
    )
    local[:50, 3] = rng.uniform(-0.02, 0.02, 50)  # around the speed at which highway-env stops dividing by it
    world = map_.to_world(local)
    lanes, target_speeds = rng.integers(0, 4, n), rng.uniform(0, 40, n)
    steering = steering_control(map_.to_road(world), map_.centers[lanes])
    acceleration = speed_control(local[:, 3], target_speeds)
    table, slips = table_of(map_), []
    for row, r in zip(map_.to_road(world), map_.centers[lanes], strict=True):
        slips.append(slip_at(*row, r, table, 0.1))
    compiled = np.arctan(2 * np.tan(np.arcsin(slips)))
    for i, row in enumerate(world):
        vehicle = ControlledVehicle(road, row[:2].copy(), row[2], row[3])
        want = vehicle.steering_control(("0", "1", int(lanes[i])))
        assert steering[i] == pytest.approx(want, abs=TOLERANCE, rel=0), (i, local[i])
        assert compiled[i] == pytest.approx(want, abs=TOLERANCE, rel=0), (i, local[i])
        assert acceleration[i] == pytest.approx(vehicle.speed_control(target_speeds[i]), abs=TOLERANCE, rel=0)


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("dt", [1 / 5, 1 / 15])
def test_a_thousand_controlled_frames_agree(angle, dt):
    rng = np.random.default_rng(3)
    road = make_road(angle)
    map_ = StraightRoad.from_network(road.network)
    n = 1000
    local = np.column_stack(
        [rng.uniform(0, 1000, n), rng.uniform(-2, 14, n), rng.uniform(-0.8, 0.8, n), rng.uniform(-2, 45, n)]
    )
    lanes, targets = rng.integers(0, 4, n), rng.uniform(0, 40, n)
    world = map_.to_world(local)
    commands = np.column_stack([map_.centers[lanes], targets, np.full(n, NO_LIMIT)])
    got = map_.to_world(Rollouts(dt).run(map_.to_road(world), commands[:, None])[:, 0])
    for i, row in enumerate(world):
        vehicle = ControlledVehicle(
            road, row[:2].copy(), row[2], row[3], target_lane_index=("0", "1", int(lanes[i])), target_speed=targets[i]
        )
        vehicle.act()
        vehicle.step(dt)
        np.testing.assert_allclose(got[i], state_of(vehicle), rtol=0, atol=TOLERANCE)


def test_a_limited_frame_brakes_to_a_stop_and_stays():
    rollouts = Rollouts(1 / 15)
    commands = np.tile([4.0, -1e9, 8.0], (1, 90, 1))
    path = rollouts.run(np.array([0.0, 4.0, 0.0, 30.0]), commands)[0]
    assert (np.diff(path[:, 0]) >= 0).all()
    assert (np.diff(path[:, 3]) >= -8.0 / 15 - 1e-12).all()
    assert path[-1, 3] == 0
    assert path[-1, 0] == path[-2, 0]


def closed_loop(vehicle, road, rng, frequency, seconds, target_speeds):
    """Drive both with the same random meta-actions.

    Returns the greatest difference in the state before the vehicle is first slower than 1 m/s, over all frames, and
    of one frame at a time that begins where the vehicle is.
    (Its steering saturates when it stops across a lane: below 1 m/s each frame multiplies a difference by up to 3,
    be it one of rounding, and how much is rounded differs between processors.)
    """
    map_ = StraightRoad.from_network(road.network)
    rollouts, dt = Rollouts(1 / frequency), 1 / frequency
    state = map_.to_road(state_of(vehicle))
    target = Target(int(vehicle.target_lane_index[2]), float(vehicle.target_speed))
    before, worst, frame, slow, none = 0.0, 0.0, 0.0, False, np.zeros((0, 7))
    for _ in range(seconds):
        action = int(rng.integers(5))
        ego = np.array([*map_.to_world(state), 5.0, 2.0, 0.0])
        scene = Scene(ego, none, map_, EgoControl(target, target_speeds, LABELS), dt, frequency)
        target = scene.target_of(action)
        commands = np.tile([map_.centers[target.lane], target.speed, NO_LIMIT], (1, frequency, 1))
        path = map_.to_world(rollouts.run(state, commands)[0])
        vehicle.act(LABELS[action])
        for k in range(frequency):
            vehicle.act()
            alone = map_.to_world(rollouts.run(map_.to_road(state_of(vehicle)), commands[:, :1])[0, 0])
            vehicle.step(dt)
            frame = max(frame, float(np.abs(alone - state_of(vehicle)).max()))
            worst = max(worst, float(np.abs(path[k] - state_of(vehicle)).max()))
            slow = slow or vehicle.speed < 1.0
            before = before if slow else worst
        assert (target.lane, target.speed) == (vehicle.target_lane_index[2], vehicle.target_speed)
        state = map_.to_road(path[-1])
    return before, worst, frame


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("frequency", [5, 15])
@pytest.mark.parametrize("speeds", SPEEDS, ids=["default", "0-40"])
def test_twenty_seconds_of_random_meta_actions_agree(angle, frequency, speeds):
    road = make_road(angle)
    map_ = StraightRoad.from_network(road.network)
    for seed in range(10):
        rng = np.random.default_rng(seed)
        start = np.array([rng.uniform(0, 300), 4.0 * rng.integers(4), rng.uniform(-0.1, 0.1), rng.uniform(15, 35)])
        x, y, heading, speed = map_.to_world(start)
        vehicle = MDPVehicle(road, np.array([x, y]), heading, speed, target_speeds=speeds)
        target_speeds = tuple(map(float, vehicle.target_speeds))
        before, worst, frame = closed_loop(vehicle, road, rng, frequency, 20, target_speeds)
        assert max(before, frame) < TOLERANCE, seed
        assert worst < 1e-2, seed


@pytest.mark.parametrize("env_id", ["highway-v0", "highway-fast-v0"])
def test_twenty_seconds_in_the_real_environment_agree(env_id):
    env = gym.make(env_id, config={"vehicles_count": 0, "duration": 100})
    env.reset(seed=3)
    rng = np.random.default_rng(3)
    for _ in range(20):
        scene, action = Scene.from_env(env), int(rng.integers(5))
        target = scene.target_of(action)
        commands = np.tile([scene.road.centers[target.lane], target.speed, NO_LIMIT], (1, scene.frames_per_decision, 1))
        path = scene.road.to_world(Rollouts(scene.dt).run(scene.ego_road, commands)[0])
        env.step(action)
        np.testing.assert_allclose(path[-1], Scene.from_env(env).ego[:4], rtol=0, atol=TOLERANCE)
    env.close()


@pytest.mark.parametrize("speeds", [(20.0, 25.0, 30.0), SPEEDS[1], (0.0, 8.0, 16.0)])
def test_the_nearest_target_speed_is_that_of_the_simulator(speeds):
    vehicle = MDPVehicle(make_road(), [0.0, 0.0], 0.0, 20.0, target_speeds=speeds)
    for speed in np.random.default_rng(4).uniform(-10, 60, 1000):
        assert speed_to_index(float(speed), speeds) == vehicle.speed_to_index(speed)


def test_rollouts_do_not_depend_on_earlier_rollouts():
    rng, state = np.random.default_rng(5), np.array([0.0, 0.0, 0.05, 25.0])
    commands = np.dstack([rng.uniform(0, 12, (3, 7)), rng.uniform(0, 40, (3, 7)), np.full((3, 7), NO_LIMIT)])
    used = Rollouts(0.2)
    used.run(np.full(4, 9.0), rng.uniform(0, 9, (4, 8, 3)))
    np.testing.assert_array_equal(used.run(state, commands), Rollouts(0.2).run(state, commands))
