"""Scenes equal the simulator's state; a state that is no scene is refused."""

from dataclasses import replace

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from highway_env.vehicle.objects import Landmark, Obstacle

from dynamics.errors import ActionError, SceneError
from dynamics.roads.straight import StraightRoad
from dynamics.scenes.scene import EgoControl, Scene, SceneReader, Target
from dynamics.state import State, Vehicle

EGO = np.array([100.0, 4.0, 0.0, 25.0, 5.0, 2.0, 0.0])


def scene_with(**changes):
    fields = {
        "ego": EGO,
        "others": np.zeros((0, 7)),
        "road": StraightRoad.from_lanes(3),
        "control": EgoControl(Target(1, 25.0)),
        "dt": 1 / 15,
        "frames_per_decision": 15,
    }
    return Scene(**{**fields, **changes})


@pytest.fixture(scope="module")
def env():
    env = gym.make("highway-fast-v0")
    env.reset(seed=1)
    yield env
    env.close()


def test_the_scene_is_the_state_of_the_simulator(env):
    scene = Scene.from_env(env)
    base = env.unwrapped
    ego = base.vehicle
    np.testing.assert_array_equal(scene.ego, [*ego.position, ego.heading, ego.speed, ego.LENGTH, ego.WIDTH, 0])
    others = [v for v in base.road.vehicles if v is not ego]
    assert scene.others.shape == (len(others), len(Vehicle)) == (20, 7)
    np.testing.assert_array_equal(scene.others[:, State.SPEED], [v.speed for v in others])
    assert scene.control == EgoControl(Target(int(ego.target_lane_index[2]), float(ego.target_speed)))
    assert (scene.dt, scene.frames_per_decision) == (1 / 5, 5)
    assert scene.finite


def test_reading_changes_nothing_and_is_a_copy(env):
    before = [v.position.copy() for v in env.unwrapped.road.vehicles]
    scene = Scene.from_env(env)
    scene.ego[:] = 0
    scene.others[:] = 0
    for v, position in zip(env.unwrapped.road.vehicles, before, strict=True):
        np.testing.assert_array_equal(v.position, position)


def test_solid_obstacles_are_others_and_landmarks_are_not():
    env = gym.make("highway-fast-v0", config={"vehicles_count": 1})
    env.reset(seed=1)
    road = env.unwrapped.road
    road.objects += [Obstacle(road, [400.0, 4.0]), Landmark(road, [300.0, 4.0])]
    scene = Scene.from_env(env)
    assert scene.others.shape == (2, 7)
    np.testing.assert_array_equal(scene.others[1, :4], [400.0, 4.0, 0.0, 0.0])


def test_other_action_sets_and_target_speeds_are_read():
    speeds = list(range(0, 45, 5))
    action = {"type": "DiscreteMetaAction", "lateral": False, "target_speeds": speeds}
    env = gym.make("highway-fast-v0", config={"action": action})
    env.reset(seed=1)
    control = Scene.from_env(env).control
    assert control.actions == ("SLOWER", "IDLE", "FASTER")
    assert control.target_speeds == tuple(map(float, speeds))


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"ego": EGO[:4]}, r"Scene.ego must have shape \(7,\), got \(4,\)"),
        ({"ego": EGO[None]}, r"Scene.ego must have shape"),
        ({"others": np.zeros((2, 4))}, r"Scene.others must have shape \(n, 7\), got \(2, 4\)"),
        ({"others": np.zeros(7)}, "Scene.others must have shape"),
        ({"likely": np.zeros((3, 7))}, r"Scene.likely must have the shape of others, \(\d, 7\), got \(3, 7\)"),
        ({"dt": 0.0}, "positive"),
        ({"dt": -0.1}, "positive"),
        ({"dt": float("nan")}, "positive"),
        ({"frames_per_decision": 0}, "positive"),
        ({"control": EgoControl(Target(3, 25.0))}, "lanes 0 to 2"),
        ({"control": EgoControl(Target(-1, 25.0))}, "lanes 0 to 2"),
    ],
)
def test_impossible_scenes_are_refused(changes, word):
    with pytest.raises(SceneError, match=word):
        scene_with(**changes)


@pytest.mark.parametrize("column", range(4))
@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
def test_a_scene_knows_when_it_is_not_finite(column, value):
    assert scene_with().finite
    ego = EGO.copy()
    ego[column] = value
    with np.errstate(invalid="ignore"):
        assert not scene_with(ego=ego).finite
        assert not scene_with(others=ego[None]).finite


def test_a_target_speed_that_is_not_finite_is_seen():
    assert not scene_with(control=EgoControl(Target(1, float("nan")))).finite


@pytest.mark.parametrize("action", [-1, 5, 99])
def test_an_unknown_action_lists_the_known_ones(action):
    with pytest.raises(ActionError, match=r"valid are 0 to 4.*LANE_LEFT"):
        scene_with().target_of(action)


@pytest.mark.parametrize(
    ("action", "lane", "speed"),
    [(0, 0, 25.0), (1, 1, 25.0), (2, 2, 25.0), (3, 1, 30.0), (4, 1, 20.0)],
)
def test_targets_of_the_meta_actions(action, lane, speed):
    assert scene_with().target_of(action) == Target(lane, speed)


def test_targets_stay_on_the_road_and_in_the_range_of_speeds():
    left = scene_with(ego=np.array([0, 0, 0, 20.0, 5, 2, 0]), control=EgoControl(Target(0, 20.0)))
    assert left.target_of(0) == Target(0, 20.0)
    assert left.target_of(4) == Target(0, 20.0)
    right = scene_with(ego=np.array([0, 8, 0, 30.0, 5, 2, 0]), control=EgoControl(Target(2, 30.0)))
    assert right.target_of(2) == Target(2, 30.0)
    assert right.target_of(3) == Target(2, 30.0)


def test_a_lane_out_of_reach_is_not_targeted():
    far = scene_with(ego=np.array([0, 0.0, 0, 25.0, 5, 2, 0]), control=EgoControl(Target(2, 25.0)))
    road = StraightRoad.from_lanes(4)
    assert replace(far, road=road).target_of(2) == Target(2, 25.0)


def test_something_else_than_a_highway_is_refused():
    with pytest.raises(SceneError, match="not a highway-env environment"):
        SceneReader(gym.make("CartPole-v1"))
    with pytest.raises(SceneError, match="not a highway-env environment"):
        SceneReader(None)


def test_several_controlled_vehicles_are_refused():
    config = {
        "controlled_vehicles": 2,
        "action": {"type": "MultiAgentAction", "action_config": {"type": "DiscreteMetaAction"}},
    }
    with pytest.raises(SceneError, match="one controlled vehicle, got 2"):
        SceneReader(gym.make("highway-fast-v0", config=config))


def test_a_missing_road_is_an_error_that_names_reset():
    env = gym.make("highway-fast-v0")
    reader = SceneReader(env)
    env.unwrapped.road = None
    with pytest.raises(SceneError, match=r"call reset\(\) first"):
        reader.read()


def test_a_reader_follows_the_environment_to_its_next_episode():
    env = gym.make("highway-fast-v0")
    env.reset(seed=0)
    reader = SceneReader(env)
    first = reader.read()
    assert reader.read().road is first.road
    env.reset(seed=1, options={"config": {"lanes_count": 5}})
    assert reader.read().road.centers.size == 5
