"""The conformance tests accept a correct implementation and name each flaw."""

from dataclasses import dataclass

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from stable_baselines3 import DQN, PPO

from shield.config import ShieldConfig
from shield.decision import Reason
from shield.rules import BufferRule, DistanceRule, RssRule, TtcRule
from shield.testing import check_policy, check_rule, random_scene

BUILT_IN = [
    BufferRule(2.0),
    DistanceRule(15.0),
    DistanceRule(60.0),
    RssRule(ShieldConfig()),
    RssRule(ShieldConfig(response_time=1.0, braking=4.0)),
    TtcRule(2.0),
    TtcRule(4.0),
]


@pytest.mark.parametrize("rule", BUILT_IN, ids=lambda rule: type(rule).__name__)
def test_the_built_in_rules_conform(rule):
    check_rule(rule)


@pytest.mark.parametrize("rule", BUILT_IN, ids=lambda rule: type(rule).__name__)
def test_the_random_scenes_exercise_both_answers(rule):
    rng = np.random.default_rng(0)
    scenes = [random_scene(rng) for _ in range(100)]
    answers = {rule.objects(s, s.target_of(a)) for s in scenes for a in range(5)}
    assert answers == {True, False}


@dataclass
class Bad:
    """A rule with one thing wrong."""

    flaw: str
    reason: Reason = Reason.DISTANCE
    calls: int = 0

    def objects(self, scene, target):
        self.calls += 1
        if self.flaw == "numpy":
            return np.bool_(False)
        if self.flaw == "mutates":
            scene.others[:, 0] += 1
        if self.flaw == "forgets":
            return self.calls % 7 == 0
        if self.flaw == "order":
            return bool(scene.others.shape[0] and scene.others_road[0, 0] > 2000)
        if self.flaw == "place":
            return bool(scene.others.shape[0] and scene.ego_road[0] > 2500)
        return self.flaw == "always"


@pytest.mark.parametrize(
    ("flaw", "text"),
    [
        ("numpy", "must return a bool"),
        ("mutates", "changed the scene"),
        ("forgets", "to the same question"),
        ("order", "the order of the others"),
        ("place", "a shift along the road"),
        ("always", "empty road"),
    ],
)
def test_each_flaw_of_a_rule_is_named(flaw, text):
    with pytest.raises(AssertionError, match=text):
        check_rule(Bad(flaw))


def test_a_rule_needs_a_reason_and_a_method():
    with pytest.raises(AssertionError, match="reason must be a Reason"):
        check_rule(Bad("none", reason="because"))
    with pytest.raises(AssertionError, match="objects"):
        check_rule(type("NoMethod", (), {"reason": Reason.TTC})())


@pytest.fixture(scope="module")
def env():
    env = gym.make("highway-fast-v0", config={"duration": 8})
    yield env
    env.close()


@pytest.mark.parametrize("kind", [PPO, DQN])
def test_sb3_models_conform(kind, env):
    check_policy(kind("MlpPolicy", env, policy_kwargs={"net_arch": [8]}, device="cpu", seed=0), env)


class Fake:
    """A policy with one thing wrong, or nothing."""

    def __init__(self, action=1, flaw=""):
        self.action, self.flaw, self.calls = action, flaw, 0

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        self.calls += 1
        if self.flaw == "mutates":
            observation += 1
        if self.flaw == "single":
            return self.action
        return (self.calls % 2 if self.flaw == "random" else self.action), state


class Scored(Fake):
    def __init__(self, scores):
        super().__init__()
        self.scores = scores

    def action_scores(self, obs):
        return self.scores


def test_an_object_with_predict_conforms(env):
    check_policy(Fake(), env)
    check_policy(Fake(np.array([3])), env)
    check_policy(Fake(flaw="random"), env, deterministic=False)
    check_policy(Scored([[0.1, 0.2, 0.3, 0.2, 0.2]]), env)


@pytest.mark.parametrize(
    ("policy", "text"),
    [
        (object(), "no method predict"),
        (Fake(99), "not an action"),
        (Fake(float("nan")), "not an action"),
        (Fake(1.5), "not an action"),
        (Fake(np.array([1, 2])), "one action is wanted"),
        (Fake(flaw="single"), "must return the pair"),
        (Fake(flaw="mutates"), "changed the observation"),
        (Fake(flaw="random"), "deterministic=True"),
        (Scored([0.0, 1.0]), "one per action"),
        (Scored([0.0, 1.0, np.nan, 0.0, 0.0]), "finite scores"),
        (type("Old", (), {"predict": lambda self, obs: (1, None)})(), "must take"),
    ],
)
def test_each_flaw_of_a_policy_is_named(policy, text, env):
    with pytest.raises(AssertionError, match=text):
        check_policy(policy, env)


def test_a_policy_is_checked_in_an_environment_with_discrete_actions():
    env = gym.make("highway-fast-v0", config={"action": {"type": "ContinuousAction"}})
    with pytest.raises(AssertionError, match="discrete actions"):
        check_policy(Fake(), env)
