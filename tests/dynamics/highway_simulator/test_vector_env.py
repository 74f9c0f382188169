"""The compiled highway with Gymnasium's vector interface equals Gymnasium's vector environment of highway-env, to
the bit."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from dynamics.errors import ActionError, ConfigError, PlatformError
from dynamics.highway_simulator.simulator import Simulator
from dynamics.highway_simulator.vector_env import HighwayVectorEnv
from evaluation.running.episodes import run_episode
from evaluation.settings import Setting

CONFIG = {"vehicles_count": 8, "duration": 6}


def test_the_vector_environment_steps_and_resets_as_gymnasiums_own():
    mine = HighwayVectorEnv("highway-fast-v0", 3, CONFIG)
    options = {"autoreset_mode": AutoresetMode.SAME_STEP}
    theirs = gym.make_vec("highway-fast-v0", 3, vectorization_mode="sync", vector_kwargs=options, config=CONFIG)
    assert mine.single_observation_space == theirs.single_observation_space
    assert mine.action_space == theirs.action_space
    assert mine.metadata["autoreset_mode"] == theirs.metadata["autoreset_mode"]
    first, _ = mine.reset(seed=5)
    assert np.array_equal(first, theirs.reset(seed=5)[0])
    rng, ends = np.random.default_rng(0), 0
    for _ in range(40):
        actions = rng.integers(5, size=3)
        *one, info = mine.step(actions)
        *two, known = theirs.step(actions)
        for a, b in zip(one, two, strict=True):
            assert np.array_equal(a, b)
        ended = one[2] | one[3]
        ends += ended.sum()
        assert ("final_obs" in info) == ("final_obs" in known) == ended.any()
        for i in np.flatnonzero(ended):
            assert np.array_equal(info["final_obs"][i], known["final_obs"][i])
            assert info["final_info"]["speed"][i] == known["final_info"]["speed"][i]
            assert (
                info["final_info"]["rewards"]["high_speed_reward"][i]
                == (known["final_info"]["rewards"]["high_speed_reward"][i])
            )
    assert ends > 5


def test_a_reset_of_some_environments_leaves_the_others_running():
    env = HighwayVectorEnv("highway-fast-v0", 3, CONFIG)
    env.reset(seed=[1, 2, 3])
    env.step([1, 1, 1])
    before = env.simulator.worlds.f.copy()
    env.reset(seed=9, options={"reset_mask": np.array([False, True, False])})
    after = env.simulator.worlds.f
    assert np.array_equal(before[[0, 2]], after[[0, 2]])
    assert np.array_equal(after[1], Simulator("highway-fast-v0", 1, CONFIG).worlds.f[0]) is False
    alone = Simulator("highway-fast-v0", 1, CONFIG)
    alone.reset([10])
    assert np.array_equal(after[1], alone.worlds.f[0])


def test_the_number_of_threads_changes_nothing():
    one, two = (Simulator("highway-fast-v0", 7, CONFIG, threads) for threads in (1, 3))
    assert np.array_equal(one.reset(range(7)), two.reset(range(7)))
    rng = np.random.default_rng(1)
    for _ in range(30):
        actions = rng.integers(5, size=7)
        for a, b in zip(one.step(actions, again=True), two.step(actions, again=True), strict=True):
            assert np.array_equal(a, b)


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        ([1, 5], "from 0 to 4"),
        ([1], "have 2 meta-actions"),
        ([[1], [1]], "have 2 meta-actions"),
        ([1, -1], "from 0 to 4"),
    ],
)
def test_an_invalid_action_is_refused(actions, message):
    with pytest.raises(ActionError, match=message):
        Simulator("highway-fast-v0", 2, CONFIG).step(actions)


@pytest.mark.parametrize(
    ("env_id", "config", "message"),
    [
        ("merge-v0", {}, "runs highway-v0 and highway-fast-v0, not merge-v0"),
        ("nothing-v0", {}, "there is no environment 'nothing-v0'"),
        ("highway-v0", {"observation": {"type": "TimeToCollision"}}, "observation TimeToCollision"),
        ("highway-v0", {"action": {"type": "DiscreteAction"}}, "action DiscreteAction"),
        (
            "highway-v0",
            {"other_vehicles_type": "highway_env.vehicle.kinematics.Vehicle"},
            "other_vehicles_type=highway_",
        ),
        ("highway-v0", {"controlled_vehicles": 2, "manual_control": True}, "controlled_vehicles=2; manual_control"),
        ("highway-v0", {"lanes": 3}, "lanes=3"),
    ],
)
def test_an_unsupported_environment_is_refused_with_a_list(env_id, config, message):
    with pytest.raises(ConfigError, match=message):
        Simulator(env_id, 1, config)


def test_another_version_of_highway_env_is_refused(monkeypatch):
    monkeypatch.setattr("dynamics.highway_simulator.scenario.version", lambda name: "1.11")
    with pytest.raises(PlatformError, match=r"a copy of highway-env 1.12; 1.11 is installed"):
        Simulator("highway-fast-v0", 1, CONFIG)
    episode = run_episode(Setting("short", "highway-fast-v0", CONFIG), "faster")
    assert episode.simulator == "highway-env"
