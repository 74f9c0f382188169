"""`Shield` works in the places where users of Stable-Baselines3 put a model."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from highway_env.envs.exit_env import ExitEnv
from policies import KINDS, Always, Playback, Ranked, make, model_of
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from shield import Shield, ShieldConfig, ShieldedEnv
from shield.decision import Reason, Verification
from shield.errors import ConfigError, PolicyError, SceneError, ShieldError

BY_SIMULATION = {
    "lane-keeping-v0": {},
    "intersection-v1": {},
    "exit-v1": {"action": {"type": "ContinuousAction"}},
    "evaluation.wrappers:roundabout-continuous-v1": {},
    "evaluation.wrappers:two-way-continuous-v0": {},
    "evaluation.scenarios:ComplexRoads-v0": {},
}
"""Throttle and steering that only verification by simulation filters, and the configuration of each environment."""

# -- Shield: policies ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", KINDS)
def test_every_discrete_algorithm_is_filtered_in_its_own_environment(name, models):
    model = models[name]
    shielded = Shield(model)
    vec = model.get_env()
    obs, state, start = vec.reset(), None, np.ones(1, dtype=bool)
    for _ in range(6):
        action, state = shielded.predict(obs, state=state, episode_start=start, deterministic=True)
        assert action.shape == (1,)
        assert model.action_space.contains(action[0])
        assert shielded.last_decision.executed == action[0]
        obs, _, start, _ = vec.step(action)


@pytest.mark.parametrize("name", KINDS)
def test_evaluate_policy_accepts_the_shield_as_a_model(name, models):
    model = models[name]
    returns, lengths = evaluate_policy(
        Shield(model), model.get_env(), n_eval_episodes=2, return_episode_rewards=True, warn=False
    )
    assert len(returns) == len(lengths) == 2
    assert max(lengths) <= 6


def test_evaluate_policy_with_a_gymnasium_environment(env):
    model = model_of("PPO", env)
    mean, _ = evaluate_policy(Shield(model, env=env), env, n_eval_episodes=2, warn=False)
    assert 0 <= mean <= 6


def test_a_single_observation_gives_a_single_action(env, models):
    obs, _ = env.reset(seed=0)
    model = models["PPO"]
    action, _ = Shield(model, env=env).predict(obs, deterministic=True)
    assert np.shape(action) == np.shape(model.predict(obs, deterministic=True)[0]) == ()
    assert env.action_space.contains(int(action))
    batch, _ = Shield(model, env=env).predict(obs[None], deterministic=True)
    assert batch.shape == (1,)
    assert batch[0] == action


def test_an_sb3_policy_and_an_object_with_predict_are_wrapped(env, models):
    obs, _ = env.reset(seed=0)
    bare = models["DQN"].policy
    assert isinstance(bare, BasePolicy)
    for policy in (bare, Always(3), Ranked(3, [0, 1, 2, 3, 4])):
        action, _ = Shield(policy, env=env).predict(obs)
        assert env.action_space.contains(int(action))


def test_a_model_without_an_environment_is_refused_with_the_argument_to_pass(tmp_path, models):
    models["PPO"].save(tmp_path / "model.zip")
    alone = PPO.load(tmp_path / "model.zip", device="cpu")
    with pytest.raises(ConfigError, match=r"pass Shield\(policy, env=env\)"):
        Shield(alone)
    with pytest.raises(ConfigError, match=r"pass Shield\(policy, env=env\)"):
        Shield(models["DQN"].policy)
    assert Shield(PPO.load(tmp_path / "model.zip", env=make(), device="cpu")).last_decision is None


@pytest.mark.parametrize("kind", [SAC, TD3])
@pytest.mark.parametrize("size", [1, 2])
def test_continuous_models_are_filtered(kind, size):
    action = {"type": "ContinuousAction", "longitudinal": size == 2}
    env = make(action=action, simulation_frequency=10, policy_frequency=5)
    model = kind("MlpPolicy", env, policy_kwargs={"net_arch": [8]}, buffer_size=100, seed=0, device="cpu")
    shielded = Shield(model)
    obs, _ = env.reset(seed=0)
    for _ in range(8):
        proposed, _ = model.predict(obs, deterministic=True)
        action, state = shielded.predict(obs, deterministic=True)
        assert state is None
        assert action.shape == (size,)
        assert env.action_space.contains(action)
        decision = shielded.last_decision
        assert decision.overridden or action.tobytes() == proposed.tobytes()
        obs, *_ = env.step(action)
    mean, _ = evaluate_policy(shielded, DummyVecEnv([lambda: env]), n_eval_episodes=1)
    assert np.isfinite(mean)


def test_a_batch_of_continuous_actions_is_filtered_row_by_row():
    action = {"type": "ContinuousAction"}
    venv = DummyVecEnv([lambda: make(action=action, simulation_frequency=10, policy_frequency=5)] * 2)
    model = SAC("MlpPolicy", venv, policy_kwargs={"net_arch": [8]}, buffer_size=100, seed=0, device="cpu")
    shielded = Shield(model)
    obs = venv.reset()
    for _ in range(5):
        actions, _ = shielded.predict(obs)
        assert actions.shape == (2, 2)
        assert len(shielded.last_decisions) == 2
        obs, *_ = venv.step(actions)


def test_verified_inputs_are_not_rounded_if_the_policy_returns_integers():
    env = make(action={"type": "ContinuousAction"}, simulation_frequency=10, policy_frequency=5)
    env.reset(seed=0)
    shielded = Shield(Always(np.array([1, 1])), env=env)
    action, _ = shielded.predict(None)
    assert shielded.last_decision.overridden
    np.testing.assert_array_equal(action, shielded.last_decision.executed)


def test_speed_limits_of_another_kind_are_refused():
    with pytest.raises(ConfigError, match="speed_range"):
        ShieldedEnv(make(action={"type": "ContinuousAction", "speed_range": (0, 20)}))


@pytest.mark.parametrize(
    "wrap", [lambda env, config: Shield(Always(np.zeros(2)), env, config), ShieldedEnv], ids=["policy", "env"]
)
@pytest.mark.parametrize("env_id", BY_SIMULATION)
def test_the_refusal_of_inputs_names_simulated_traffic_and_that_works(env_id, wrap):
    env = gym.make(env_id, config=BY_SIMULATION[env_id])
    with pytest.raises(ShieldError, match=r"ShieldedEnv\(env, ShieldConfig\.simulated_traffic\(\)\)") as refusal:
        wrap(env, "worst-case")
    assert len(str(refusal.value)) < 700
    # Neither an option that highway-env lacks nor one refused next is named.
    assert 'dynamical": False' not in str(refusal.value)
    for config in (ShieldConfig.simulated_traffic(), None):
        shielded = ShieldedEnv(env, config)
        shielded.reset(seed=0)
        shielded.step(env.action_space.sample())
        assert wrap(env, config).verification is Verification.SIMULATED


class OwnSteps(ExitEnv):
    """Its traffic is not known: it steps in a way of its own."""

    def step(self, action):
        return super().step(action)


@pytest.mark.parametrize("dynamical", [False, True])
def test_simulated_traffic_is_not_named_as_a_remedy_if_it_is_refused_too(dynamical):
    env = OwnSteps({"action": {"type": "ContinuousAction", "dynamical": dynamical}})
    with pytest.raises(ConfigError, match="a way of its own"):
        ShieldedEnv(env, ShieldConfig.simulated_traffic())
    with pytest.raises(SceneError, match="branches at 2; supported") as refusal:
        ShieldedEnv(env)
    assert "simulated_traffic" not in str(refusal.value)


def test_the_refusal_of_slipping_tyres_names_the_setting_without_them():
    action = {"type": "ContinuousAction", "dynamical": True}
    for env_id, simulated in (("highway-fast-v0", True), ("parking-v0", False)):
        with pytest.raises(ConfigError, match='"dynamical": False') as refusal:
            ShieldedEnv(gym.make(env_id, config={"action": action}), "worst-case")
        assert ("ShieldConfig.simulated_traffic()" in str(refusal.value)) is simulated


def test_shielded_env_has_no_masks_for_continuous_actions():
    env = ShieldedEnv(make(action={"type": "ContinuousAction"}))
    env.reset(seed=0)
    with pytest.raises(ConfigError, match="DiscreteMetaAction"):
        env.action_masks()
    with pytest.raises(ConfigError, match="use none or full"):
        ShieldedEnv(make(action={"type": "ContinuousAction"}), ShieldConfig(mode="ttc"))


@pytest.mark.parametrize("policy", [None, 3, object(), "ppo"])
def test_an_object_without_predict_is_refused(policy, env):
    with pytest.raises(PolicyError, match=r"has no predict\(\); pass an SB3 model"):
        Shield(policy, env=env)


@pytest.mark.parametrize("wrap", [lambda env: Shield(Always(0), env=env), ShieldedEnv], ids=["policy", "env"])
def test_an_environment_that_is_not_of_highway_env_is_refused(wrap):
    with pytest.raises(ConfigError, match=r"CartPoleEnv is not a highway-env environment.*roundabouts.* and parking"):
        wrap(gym.make("CartPole-v1"))
    with pytest.raises(ConfigError, match=r"got ShieldConfig; settings go to config="):
        wrap(ShieldConfig())
    with pytest.raises(ConfigError, match="is a ShieldedEnv already"):
        wrap(gym.wrappers.TimeLimit(ShieldedEnv(make()), 5))
    several = {"type": "MultiAgentAction", "action_config": {"type": "DiscreteMetaAction"}}
    with pytest.raises(ConfigError, match="several"):
        wrap(gym.make("highway-fast-v0", config={"action": several}))


def test_attributes_of_the_model_are_reached_through_the_shield(models):
    shielded = Shield(models["PPO"])
    assert shielded.policy.n_steps == 8
    with pytest.raises(AttributeError, match=r"the wrapped policy has it: \.policy\.n_steps"):
        _ = shielded.n_steps
    assert shielded.observation_space == models["PPO"].observation_space
    with pytest.raises(AttributeError):
        _ = shielded.no_such_attribute


class Recurrent:
    """Counts its steps in its state, and records its arguments."""

    def __init__(self):
        self.given = []

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        self.given.append((state, episode_start, deterministic))
        return np.array([1]), (0 if state is None else state) + 1


def test_state_episode_start_and_deterministic_are_passed_through(env):
    obs, _ = env.reset(seed=0)
    policy, start = Recurrent(), np.ones(1, dtype=bool)
    shielded = Shield(policy, env=env)
    _, state = shielded.predict(obs[None], episode_start=start, deterministic=True)
    _, state = shielded.predict(obs[None], state, np.zeros(1, dtype=bool), False)
    assert state == 2
    assert policy.given[0] == (None, start, True)
    assert policy.given[1][0] == 1
    assert not policy.given[1][1].any()
    assert policy.given[1][2] is False


# -- Shield: several environments -------------------------------------------------------------------------------


def same(a, b):
    return (a.executed, a.reason, a.tier) == (b.executed, b.reason, b.tier) and (
        a.margin == b.margin or (np.isnan(a.margin) and np.isnan(b.margin))
    )


def test_two_environments_are_filtered_row_by_row_and_auto_reset_forgets():
    vec = DummyVecEnv([lambda: make(duration=3), lambda: make(duration=5)])
    vec.seed(0)
    obs = vec.reset()
    shielded, fresh = Shield(Always(3), vec, "worst-case", frames=False), [None, None]
    for _ in range(16):
        action, _ = shielded.predict(obs)
        assert action.shape == (2,)
        assert [d.executed for d in shielded.last_decisions] == list(action)
        for i, other in enumerate(fresh):
            if other is not None:
                other.predict(obs)
                assert same(other.last_decisions[i], shielded.last_decisions[i])
        obs, _, dones, _ = vec.step(action)
        # From an episode start on, the shield decides like a new one.
        fresh = [Shield(Always(3), vec, "worst-case", frames=False) if dones[i] else fresh[i] for i in range(2)]
    assert None not in fresh


def test_a_gymnasium_vector_environment():
    vec = gym.vector.SyncVectorEnv([make, make])
    obs, _ = vec.reset(seed=0)
    shielded = Shield(Always(3), env=vec)
    for _ in range(4):
        action, _ = shielded.predict(obs)
        obs, *_ = vec.step(action)
    assert len(shielded.last_decisions) == 2


def test_wrapped_vector_environments():
    vec = VecNormalize(DummyVecEnv([make]))
    obs = vec.reset()
    action, _ = Shield(Always(3), env=vec).predict(obs)
    assert action.shape == (1,)


@pytest.mark.parametrize("count", [1, 3])
def test_several_environments_need_one_action_each(count):
    """The assignment of actions to environments would be a guess, so this is a programming error."""
    envs = DummyVecEnv([lambda: gym.make("highway-fast-v0")] * 2)
    obs = envs.reset()
    with pytest.raises(ConfigError, match=f"{count} actions for 2 environments"):
        Shield(Playback([np.full(count, 3)]), env=envs).predict(obs)


def test_two_actions_for_one_environment_are_no_action(env):
    obs, _ = env.reset(seed=0)
    shield = Shield(Always(3), env=env)
    shield.predict(np.stack([obs, obs]))
    assert shield.last_decision.reason is Reason.BAD_ACTION
    assert shield.last_decision.tier.fallback


def test_the_refusal_of_other_processes_names_the_place_of_the_shield():
    class Remote:
        num_envs = 2

    with pytest.raises(ConfigError, match=r"SubprocVecEnv\(\[lambda: ShieldedEnv"):
        Shield(Always(3), env=Remote())
