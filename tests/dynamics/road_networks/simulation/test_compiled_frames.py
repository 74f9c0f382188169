"""highway-env with compiled frames equals highway-env, bit for bit: every result, and the whole state."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from unknown_traffic import UNKNOWN

import evaluation.scenarios
import evaluation.wrappers  # noqa: F401  (registers environments)
from dynamics.errors import ConfigError
from dynamics.road_networks.simulation.compiled_frames import CompiledFrames
from dynamics.road_networks.simulation.kinematics import without_data_frames

ROADS = (
    "merge-v0",
    "merge-generic-v1",
    "two-way-v0",
    "exit-v1",
    "intersection-v2",
    "intersection-v1",
    "racetrack-v0",
    "intersection-multi-agent-v0",
    "roundabout-v1",
    "roundabout-continuous-v1",
    "u-turn-v0",
    "evaluation.scenarios:ComplexRoads-v0",
    "intersection-v0",
)
FEATURES = (
    *("presence", "x", "y", "vx", "vy", "heading", "cos_h", "sin_h", "cos_d", "sin_d"),
    *("long_off", "lat_off", "ang_off"),
)


def contents(env):
    """The state of an environment, except the road map, regenerated values, and the regression data of vehicles of
    the linear model."""
    base = env.unwrapped
    bodies = []
    for body in [*base.road.vehicles, *base.road.objects]:
        row = {k: plain(x) for k, x in vars(body).items() if k not in ("road", "lane", "history", "log", "data")}
        if not row.get("is_yielding", True):  # highway-env leaves a False behind after yielding
            row.pop("is_yielding")
        row.pop("yield_timer", None)
        bodies.append((type(body).__name__, row, body.lane is base.road.network.get_lane(body.lane_index)))
    return bodies, base.steps, base.time, getattr(base.road, "steps", None), base.np_random.bit_generator.state


def plain(value):
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, dict):
        return {k: float(x) for k, x in value.items()}
    if isinstance(value, tuple) and len(value) == 3 and isinstance(value[0], str):
        return (*value[:2], int(value[2] or 0))
    return value


def assert_same(one, other, name):
    np.testing.assert_equal(one, other, err_msg=name)


def drive_both(env_id, seeds, decisions=12, config=None):
    plain_env, compiled = gym.make(env_id, config=config), CompiledFrames(gym.make(env_id, config=config))
    if not compiled.exact:
        pytest.skip("this machine's numpy adds in a way of its own")
    for seed in seeds:
        assert_same(plain_env.reset(seed=seed)[0], compiled.reset(seed=seed)[0], env_id)
        plain_env.action_space.seed(seed)
        for k in range(decisions):
            action = plain_env.action_space.sample()
            one, other = plain_env.step(action), compiled.step(action)
            name = f"{env_id} seed {seed} decision {k}"
            assert_same(one, other, name)
            assert_same(contents(plain_env), contents(compiled), name)
            if np.any(one[2]) or one[3]:
                break


@pytest.mark.parametrize("env_id", ROADS[1::2])
def test_an_episode_is_the_same(env_id):
    drive_both(env_id, [31])


@pytest.mark.parametrize("kind", ["Linear", "Aggressive", "Defensive"])
@pytest.mark.parametrize("env_id", ["roundabout-v1", "intersection-v2", "racetrack-v0"])
def test_an_episode_among_vehicles_of_the_linear_model_is_the_same(env_id, kind):
    drive_both(env_id, [31], config={"other_vehicles_type": f"highway_env.vehicle.behavior.{kind}Vehicle"})


@pytest.mark.slow
@pytest.mark.parametrize("env_id", ROADS)
def test_fifty_episodes_are_the_same(env_id):
    drive_both(env_id, range(1_000, 1_050), decisions=60)


@given(
    features=st.lists(st.sampled_from(FEATURES), min_size=1, max_size=8, unique=True),
    count=st.integers(1, 16),
    options=st.fixed_dictionaries(
        {
            **{k: st.booleans() for k in ("absolute", "normalize", "clip", "see_behind", "observe_intentions")},
            "include_obstacles": st.booleans(),
            "order": st.sampled_from(["sorted", "shuffled"]),
        }
    ),
    env_id=st.sampled_from(["merge-v0", "roundabout-v1", "intersection-v0"]),
    seed=st.integers(0, 50),
)
@settings(max_examples=25, deadline=None)
def test_kinematics_without_a_data_frame_is_the_same(features, count, options, env_id, seed):
    observation = {"type": "Kinematics", "features": features, "vehicles_count": count, **options}
    env = gym.make(env_id, config={"observation": observation}).unwrapped
    env.reset(seed=seed)
    state = env.np_random.bit_generator.state
    expected, after = env.observation_type.observe(), env.np_random.bit_generator.state
    env.np_random.bit_generator.state = state
    without_data_frames(env.observation_type)
    seen = env.observation_type.observe()
    np.testing.assert_array_equal(seen, expected)
    assert seen.dtype == expected.dtype
    assert env.np_random.bit_generator.state == after


def test_a_watcher_gets_each_frame_and_whether_the_ego_is_on_the_road():
    env, seen = CompiledFrames(gym.make("roundabout-continuous-v1")), []
    env.reset(seed=0)
    env.watchers.append(lambda bodies, rows, on_road: seen.append((len(bodies), rows, on_road)))
    for _ in range(5):
        env.step(np.array([1.0, 0.6]))
    bodies, rows, on_road = seen[0]
    assert rows.shape == (len(on_road), bodies, 7)
    assert seen[0][2][0]
    assert not seen[-1][2][-1]
    ego = env.unwrapped.road.vehicles.index(env.unwrapped.vehicle)
    np.testing.assert_array_equal(seen[-1][1][-1, ego, :2], env.unwrapped.vehicle.position)


def test_closing_restores_the_frames_of_the_environment():
    env = gym.make("merge-v0")
    compiled = CompiledFrames(env)
    compiled.reset(seed=0)
    assert "_simulate" in vars(env.unwrapped)
    compiled.close()
    assert "_simulate" not in vars(env.unwrapped)


def test_environments_without_compiled_frames_are_refused():
    with pytest.raises(ConfigError, match="does not follow from its state"):
        CompiledFrames(gym.make("parking-v0"))
    with pytest.raises(ConfigError, match="show_trajectories"):
        CompiledFrames(gym.make("merge-v0", config={"show_trajectories": True}))
    with pytest.raises(ConfigError, match="Dozy has act of its own"):
        CompiledFrames(gym.make("roundabout-v0", config=UNKNOWN))
