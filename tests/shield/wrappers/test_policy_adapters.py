"""The policies that `Shield` accepts, the actions that it returns, and the attributes of the policy that it passes
on."""

import gymnasium as gym
import numpy as np
import pytest
from policies import Always, make
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import DummyVecEnv

from shield import Reason, Shield, ShieldCallback, ShieldConfig, ShieldedEnv
from shield.errors import ConfigError

INPUTS = {"action": {"type": "ContinuousAction"}}
DISCRETE = {"action": {"type": "DiscreteAction"}}
EAGER = {"meta": 3, "inputs": [1.0, 0.0], "discrete": 7}
CONFIGS = {"meta": {}, "inputs": INPUTS, "discrete": DISCRETE}
FORMS = {
    "list": lambda action: np.asarray(action).tolist(),
    "tuple": lambda action: tuple(np.asarray(action).tolist()) if np.ndim(action) else action,
    "array": lambda action: np.asarray(action),
    "in a list": lambda action: [action],
}
WRONG = {
    "nothing": None,
    "no number": "faster",
    "too many": [1.0, 0.0, 0.5],
    "too few": [],
    "ragged": [[1.0], [0.0, 0.5]],
    "a dictionary": {"action": 3},
    "two rows": [[1.0, 0.0], [1.0, 0.0]],
}


class Returns:
    """A policy that returns this very object."""

    def __init__(self, action):
        self.action = action

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return self.action, state


def drive(kind, action, placement, config=None, steps=6):
    """Drive a policy of one constant action: the records of each step, and whether the ego crashed."""
    env = make(duration=steps, **CONFIGS[kind])
    shielded = ShieldedEnv(env, config) if placement == "env" else None
    shield = None if shielded is not None else Shield(Returns(action), env, config)
    obs, _ = (shielded or env).reset(seed=3)
    records, done = [], False
    while not done:
        if shielded is not None:
            obs, _, terminated, truncated, _ = shielded.step(action)
            records.append(shielded.last_decision)
        else:
            given, _ = shield.predict(obs)
            given = np.reshape(given, -1) if kind == "inputs" else given
            assert env.action_space.contains(np.float32(given) if kind == "inputs" else np.int64(given.item()))
            obs, _, terminated, truncated, _ = env.step(given if kind == "inputs" else int(given.item()))
            records.append(shield.last_decision)
        done = terminated or truncated
    return records, env.unwrapped.vehicle.crashed


@pytest.mark.parametrize(
    ("kind", "form", "placement"),
    [
        (kind, form, placement)
        for kind in EAGER
        for form in FORMS
        for placement in ("env", "policy")
        # A batch of one row is for `predict()`; an environment takes one action.
        if (kind, form, placement) != ("inputs", "in a list", "env")
    ],
)
def test_lists_and_tuples_are_actions_as_arrays_are(kind, form, placement):
    """A policy that returned a list was good until the first override, at which `Shield` raised."""
    records, crashed = drive(kind, FORMS[form](EAGER[kind]), placement)
    plain, _ = drive(kind, np.float32(EAGER[kind]) if kind == "inputs" else EAGER[kind], placement)
    assert any(record.overridden for record in records)
    assert not crashed
    assert [record.tier for record in records] == [record.tier for record in plain]
    assert Reason.BAD_ACTION not in {record.reason for record in records}


@pytest.mark.parametrize("placement", ["env", "policy"])
@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("kind", EAGER)
def test_an_invalid_action_gets_the_documented_fallback(kind, wrong, placement):
    """`Shield` once raised a ConfigError for actions of another shape, while `ShieldedEnv` fell back on
    `bad_action`."""
    records, crashed = drive(kind, WRONG[wrong], placement, ShieldConfig(failure_limit=0), steps=3)
    assert {record.reason for record in records} <= {Reason.BAD_ACTION, Reason.POLICY_FAILED}
    assert all(record.overridden or record.tier.fallback for record in records)
    assert not crashed


@pytest.mark.parametrize("kind", ["meta", "inputs"])
def test_each_row_of_several_environments_is_judged_by_itself(kind):
    vec = DummyVecEnv([lambda: make(duration=6, **CONFIGS[kind])] * 2)
    good = 1 if kind == "meta" else [0.0, 0.0]
    shield = Shield(lambda observation: [good, None], vec, ShieldConfig(failure_limit=0))
    actions, _ = shield.predict(vec.reset())
    assert actions.shape == vec.action_space.sample()[None].repeat(2, 0).shape if kind == "inputs" else (2,)
    vec.step(actions)
    reasons = [each.reason for each in shield.decisions]
    assert reasons == [Reason.NONE, Reason.BAD_ACTION]
    with pytest.raises(ConfigError, match=r"returned 3 actions for 2 environments"):
        Shield(lambda observation: [good] * 3, vec).predict(vec.reset())


def test_learning_behind_a_shield_is_refused_and_the_named_remedy_works():
    """`Shield(model).learn()` once trained the model without the shield, by delegation and without a warning."""
    env = make()
    model = PPO("MlpPolicy", env, n_steps=8, batch_size=8, device="cpu")
    shielded = Shield(model, env=env)
    for name in ("learn", "train"):
        with pytest.raises(ConfigError, match=r"without the shield.*model.set_env\(ShieldedEnv\(env\)\)"):
            getattr(shielded, name)(8)
    assert model.num_timesteps == 0
    model.set_env(ShieldedEnv(make()))
    model.learn(8, callback=ShieldCallback())
    assert model.num_timesteps == 8


def test_a_callback_of_an_environment_without_a_shield_says_so():
    """It logged nothing, and let the run look like a shielded one."""
    model = PPO("MlpPolicy", make(), n_steps=8, batch_size=8, device="cpu")
    with pytest.raises(ConfigError, match=r"1 of 1 environments report no shield.*ShieldedEnv"):
        model.learn(8, callback=ShieldCallback())
    mixed = DummyVecEnv([make, lambda: ShieldedEnv(make())])
    with pytest.raises(ConfigError, match="1 of 2"):
        PPO("MlpPolicy", mixed, n_steps=8, batch_size=8, device="cpu").learn(8, callback=ShieldCallback())


def test_attributes_of_the_policy_are_passed_on_or_refused_by_name():
    env = make(duration=3)
    model = PPO("MlpPolicy", env, n_steps=8, batch_size=8, device="cpu")
    shielded = Shield(model, env=env)
    assert shielded.observation_space is model.observation_space
    assert shielded.action_space is model.action_space
    assert shielded.device == model.device
    assert shielded.num_timesteps == 0
    assert shielded.n_envs == 1
    assert shielded.get_env() is model.get_env()
    assert shielded.get_vec_normalize_env() is None
    assert shielded.policy is model
    with pytest.raises(AttributeError, match=r"'Shield' has no attribute 'save'; the wrapped policy has it: .policy"):
        shielded.save("model.zip")
    with pytest.raises(AttributeError, match=r"'Shield' has no attribute 'last_desicion'$"):
        shielded.last_desicion  # noqa: B018
    with pytest.raises(AttributeError, match="no attribute 'device'"):
        Shield(Always(3), env=env).device  # noqa: B018
    assert np.isfinite(evaluate_policy(shielded, gym.wrappers.RecordEpisodeStatistics(env), 1, warn=False)[0])
