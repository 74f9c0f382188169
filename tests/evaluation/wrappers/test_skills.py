"""Skills: the steps of a skill, its end, and learning with SB3."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.vec_env import DummyVecEnv

from evaluation.wrappers import REPORT_SKILLS, Skills, nearer_than, overridden
from shield import ShieldedEnv
from shield.errors import ConfigError

CONFIG = {"vehicles_count": 5, "lanes_count": 3, "duration": 12}


class Counted(gym.Env):
    """Five actions; the reward is the action, and an episode has some steps."""

    action_space, observation_space = gym.spaces.Discrete(5), gym.spaces.Box(-1, 1, (1,))
    actions = ()

    def __init__(self, steps):
        self.left = self.steps = steps

    def reset(self, *, seed=None, options=None):
        self.left = self.steps
        return np.zeros(1, np.float32), {}

    def step(self, action):
        self.left -= 1
        return np.zeros(1, np.float32), float(action), self.left <= 0, False, {"action": action}


def highway(**more):
    return gym.make("highway-fast-v0", config={**CONFIG, **more})


@settings(max_examples=60, deadline=None)
@given(
    actions=st.lists(st.integers(0, 4), min_size=1, max_size=6),
    length=st.integers(1, 8),
    stop=st.integers(0, 7),
    discount=st.floats(0.5, 1.0),
)
def test_a_skill_sums_the_discounted_rewards_of_its_steps(actions, length, stop, discount):
    """A skill ends with its sequence, the episode or the predicate, whichever comes first."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("evaluation.wrappers.skills.check_highway_env", lambda env, wrapper: None)
        asked = []
        env = Skills(
            Counted(length), {"one": actions}, lambda env, info: asked.append(info) or len(asked) > stop, discount
        )
        env.reset()
        _, reward, terminated, _, info = env.step(0)
    skill, steps = info["skill"], min(len(actions), length, stop + 1)
    assert skill["steps"] == steps
    assert skill["actions"] == actions[:steps]
    assert reward == pytest.approx(sum(discount**k * a for k, a in enumerate(actions[:steps])))
    assert skill["discount"] == pytest.approx(discount**steps)
    assert terminated == (steps == length)
    assert skill["interrupted"] == (stop + 1 < min(len(actions), length))


def test_a_skill_has_the_results_of_its_primitive_steps():
    """Observation, end and info are those of the last primitive step."""
    env, bare = Skills(highway(), REPORT_SKILLS), highway()
    env.reset(seed=3)
    bare.reset(seed=3)
    for skill, name in ((0, "FOLLOW"), (3, "SLOW_DOWN")):
        obs, total, *ends, info = env.step(skill)
        rewards = []
        for action in REPORT_SKILLS[name]:
            seen, reward, *over, last = bare.step(action)
            rewards.append(reward)
        assert (obs == seen).all()
        assert ends == over
        assert total == pytest.approx(sum(rewards))
        assert info["skill"]["rewards"] == rewards
        assert {key: info[key] for key in ("speed", "crashed", "action")} == {
            key: last[key] for key in ("speed", "crashed", "action")
        }


def test_the_shields_verdict_ends_a_skill_at_the_very_step():
    env = Skills(ShieldedEnv(highway(vehicles_density=2)), {"RUSH": ["FASTER"] * 6}, overridden)
    ended = 0
    for seed in range(4):
        env.reset(seed=seed)
        over = False
        while not over:
            *_, terminated, truncated, info = env.step(0)
            over, skill = terminated or truncated, info["skill"]
            assert not info["crashed"]
            assert skill["overridden"] <= 1
            if skill["interrupted"]:
                ended += 1
                assert info["shield"]["overridden"]
                assert skill["steps"] < skill["planned"]
    assert ended > 4


def test_a_near_vehicle_ends_a_skill():
    env = Skills(highway(), {"FOLLOW": [1] * 4}, nearer_than(1e4))
    env.reset(seed=0)
    assert env.step(0)[-1]["skill"] | {"rewards": []} == {
        "name": "FOLLOW",
        "actions": [1],
        "planned": 4,
        "steps": 1,
        "interrupted": True,
        "rewards": [],
        "discount": 1.0,
    }
    env = Skills(highway(), {"FOLLOW": [1] * 4}, nearer_than(1e-3))
    env.reset(seed=0)
    assert not env.step(0)[-1]["skill"]["interrupted"]


@pytest.mark.parametrize("algorithm", [PPO, DQN])
def test_stable_baselines_learns_over_skills(algorithm):
    env = DummyVecEnv([lambda: Skills(ShieldedEnv(highway()), interrupt=overridden) for _ in range(2)])
    options = {"n_steps": 8, "batch_size": 8} if algorithm is PPO else {"learning_starts": 4, "buffer_size": 100}
    model = algorithm("MlpPolicy", env, device="cpu", **options).learn(16)
    assert model.action_space.n == len(REPORT_SKILLS)


def test_the_wrapper_is_a_gymnasium_environment():
    check_env(Skills(highway()), warn=False)


@pytest.mark.parametrize(
    ("skills", "more", "says"),
    [
        ({}, {}, "at least one skill"),
        ({"a": []}, {}, "skill 'a' is a sequence"),
        ({"a": "IDLE"}, {}, "skill 'a' is a sequence"),
        ({"a": ["IDEL"]}, {}, "IDLE"),
        ({"a": [5]}, {}, "which is no action; have LANE_LEFT, IDLE"),
        ({"a": [1]}, {"discount": 0.0}, "discount"),
        ({"a": [1]}, {"discount": 1.5}, "at most 1"),
        ({"a": [1]}, {"interrupt": 3}, "interrupt is a function"),
    ],
)
def test_invalid_skills_are_refused(skills, more, says):
    with pytest.raises(ConfigError, match=says):
        Skills(highway(), skills, **more)


def test_unsupported_environments_are_refused_by_skills():
    with pytest.raises(ConfigError, match="sequences of discrete actions"):
        Skills(gym.make("highway-fast-v0", config={"action": {"type": "ContinuousAction"}}))
    with pytest.raises(ConfigError, match="road and vehicles"):
        Skills(gym.make("CartPole-v1"))
    env = Skills(highway(), interrupt=overridden)
    env.reset(seed=0)
    with pytest.raises(ConfigError, match=r"ShieldedEnv\(env\)"):
        env.step(0)
    with pytest.raises(ConfigError, match="no skill; have 0 FOLLOW"):
        env.step(9)
