"""The fast observations are highway-env's own."""

import gymnasium as gym
import numpy as np
import pytest
from slowly import later

from evaluation.learning.observations import FastObservations
from evaluation.settings import get_setting
from shield.errors import ConfigError


@pytest.mark.parametrize(
    ("setting", "steering"),
    [("highway-continuous-training", 0.02), ("highway-fast", None), ("racetrack", 0.4)],
)
@pytest.mark.parametrize("seed", [0, 1, *later(2, 3)])
def test_every_observation_of_an_episode_is_the_original(setting, steering, seed):
    slow, fast = get_setting(setting).make(), FastObservations(get_setting(setting).make())
    random = np.random.default_rng(seed)
    np.testing.assert_array_equal(slow.reset(seed=seed)[0], fast.reset(seed=seed)[0])
    seen = set()
    for _ in range(40):
        size = slow.action_space.shape
        action = random.integers(5) if steering is None else random.uniform(-steering, steering, size)
        one, two = slow.step(action), fast.step(action)
        assert one[0].dtype == two[0].dtype
        np.testing.assert_allclose(two[0], one[0], atol=1e-6)
        assert one[1:4] == two[1:4]
        seen.add(one[0].tobytes())
        if one[2] or one[3]:
            break
    assert len(seen) > 3


def test_observations_continue_after_a_reset():
    env, again = FastObservations(get_setting("racetrack").make()), get_setting("racetrack").make()
    for seed in (0, 1):
        env.reset(seed=seed)
        again.reset(seed=seed)
        np.testing.assert_array_equal(env.step([0.1])[0], again.step([0.1])[0])


@pytest.mark.parametrize(
    ("observation", "message"),
    [
        ({"type": "TimeToCollision"}, "KinematicObservation"),
        ({"type": "OccupancyGrid"}, "vehicle's axes"),
    ],
)
def test_other_observations_are_refused(observation, message):
    env = FastObservations(gym.make("highway-fast-v0", config={"observation": observation}))
    with pytest.raises(ConfigError, match=message):
        env.reset(seed=0)
