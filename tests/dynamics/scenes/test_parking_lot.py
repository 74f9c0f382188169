"""Parking lots as scenes, and refusals of other environments."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest

from dynamics.errors import SceneError
from dynamics.scenes.parking_lot import ParkingScene, ParkingSceneReader, is_parking_lot
from dynamics.scenes.rectangles import gaps

EGO = np.array([0.0, 0.0, 0.5, 1.0, 5.0, 2.0])
CARS = np.array([[10.0, 0, 0, 0, 5, 2], [0, 10.0, 1, 0, 5, 2]])


def parking(seed=0, **config):
    env = gym.make("parking-v0", config=config)
    env.reset(seed=seed)
    return env


@pytest.mark.parametrize(("vehicles", "walls"), [(0, True), (10, True), (3, False)])
def test_everything_that_can_be_hit_is_in_it(vehicles, walls):
    env = parking(vehicles_count=vehicles, add_walls=walls)
    lot = ParkingScene.from_env(env)
    ego, road = env.unwrapped.vehicle, env.unwrapped.road
    assert lot.ego.tolist() == [*ego.position, ego.heading, ego.speed, 5.0, 2.0]
    assert len(lot.obstacles) == vehicles + 4 * walls
    others = {tuple(v.position) for v in road.vehicles if v is not ego}
    others |= {tuple(o.position) for o in road.objects if o is not ego.goal}
    assert {tuple(row[:2]) for row in lot.obstacles} == others
    assert lot.dt == 1 / 15
    assert lot.finite
    assert not lot.moving.any()


def test_the_goal_is_nothing_to_be_hit():
    env = parking()
    env.unwrapped.vehicle.position = env.unwrapped.vehicle.goal.position.copy()
    lot = ParkingScene.from_env(env)
    assert gaps(lot.ego[:4], (5.0, 2.0), lot.boxes, lot.dt)[0].min() > 0


def test_a_moving_obstacle_is_marked():
    env = parking(vehicles_count=3)
    env.unwrapped.road.vehicles[2].speed = -0.01
    assert ParkingScene.from_env(env).moving.tolist() == [False, True, False, *[False] * 4]


@pytest.mark.parametrize("name", ["parking-v0", "parking-parked-v0", "parking-ActionRepeat-v0"])
def test_an_environment_derived_from_parking_is_a_lot(name):
    assert is_parking_lot(gym.make(name))


def test_an_environment_without_a_lot_is_refused():
    env = gym.make("highway-fast-v0")
    assert not is_parking_lot(env)
    with pytest.raises(SceneError, match="ParkingEnv"):
        ParkingSceneReader(env)
    with pytest.raises(SceneError, match="one controlled vehicle, got 2"):
        ParkingSceneReader(gym.make("parking-v0", config={"controlled_vehicles": 2}))


def test_reading_before_the_first_reset_is_an_error():
    reader = ParkingSceneReader(parking())
    reader._env.road = None
    with pytest.raises(SceneError, match="reset"):
        reader.read()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"ego": EGO[:4]}, r"\(6,\)"),
        ({"obstacles": CARS[0]}, r"\(m, 6\)"),
        ({"dt": 0.0}, "dt"),
        ({"dt": float("nan")}, "dt"),
        ({"ego": EGO * [1, 1, 1, 1, -1, 1]}, "positive"),
        ({"obstacles": CARS * [1, 1, 1, 1, 1, 0]}, "positive"),
    ],
)
def test_an_invalid_lot_is_refused(changes, message):
    with pytest.raises(SceneError, match=message):
        ParkingScene(**{"ego": EGO, "obstacles": CARS, "dt": 0.1, **changes})


@pytest.mark.parametrize("column", range(6))
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_value_that_is_not_finite_is_detected(column, value):
    ego, cars = EGO.copy(), CARS.copy()
    ego[column] = value
    assert not ParkingScene(ego, CARS, 0.1).finite
    cars[1, column] = value
    assert not ParkingScene(EGO, cars, 0.1).finite
    assert ParkingScene(EGO, CARS, 0.1).finite
