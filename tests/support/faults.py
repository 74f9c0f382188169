"""An environment that records its actions, and a policy with given results, for tests of faults."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)

NAN, INF = float("nan"), float("inf")
SLOWER = 4


class Spy(gym.Wrapper):
    """Records the actions that reach the environment."""

    def __init__(self, env):
        super().__init__(env)
        self.seen = []

    def step(self, action):
        self.seen.append(action)
        return self.env.step(action)


class Policy:
    """Returns, or raises, the given values."""

    def __init__(self, action):
        self.action = action

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        if isinstance(self.action, Exception):
            raise self.action
        return self.action, state


def spied(**config):
    env = Spy(gym.make("highway-fast-v0", config={"duration": 20, **config}))
    env.reset(seed=0)
    return env


def kind(record):
    return record["reason"], record["tier"]
