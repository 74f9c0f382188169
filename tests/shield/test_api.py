"""Both doors fit where users of Stable-Baselines3 and Gymnasium would put them."""

import pickle
import warnings
from collections import Counter

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from sb3_contrib import QRDQN, TRPO, MaskablePPO, RecurrentPPO
from stable_baselines3 import A2C, DQN, PPO, SAC, TD3
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecNormalize

from dynamics.scene import Scene
from shield import Shield, ShieldConfig, ShieldedEnv
from shield.errors import ConfigError, PolicyError
from shield.meta import MetaCore
from shield.preference import default_order, order_from_scores, ranking_of

SHORT = {"duration": 6}
KINDS = {
    "PPO": (PPO, "MlpPolicy", {"n_steps": 8, "batch_size": 8}),
    "A2C": (A2C, "MlpPolicy", {}),
    "DQN": (DQN, "MlpPolicy", {"buffer_size": 100}),
    "QRDQN": (QRDQN, "MlpPolicy", {"buffer_size": 100}),
    "TRPO": (TRPO, "MlpPolicy", {"n_steps": 8, "batch_size": 8}),
    "MaskablePPO": (MaskablePPO, "MlpPolicy", {"n_steps": 8, "batch_size": 8}),
    "RecurrentPPO": (RecurrentPPO, "MlpLstmPolicy", {"n_steps": 8, "batch_size": 8}),
}


def make(**config):
    return gym.make("highway-fast-v0", config={**SHORT, **config})


def model_of(name, env):
    kind, policy, kwargs = KINDS[name]
    return kind(policy, env, policy_kwargs={"net_arch": [8]}, device="cpu", seed=0, **kwargs)


class Always:
    """A constant action, as an object with SB3's `predict`."""

    def __init__(self, action, scores=None):
        self.action, self.scores = action, scores

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        batch = np.ndim(observation) - 2
        return (np.full(len(observation), self.action) if batch else np.array(self.action)), state


class Ranked(Always):
    """The same with an order of preference."""

    def action_scores(self, obs):
        return np.tile(self.scores, (1 if np.ndim(obs) == 2 else len(obs), 1))


@pytest.fixture(scope="module")
def env():
    env = make()
    env.reset(seed=0)
    yield env
    env.close()


@pytest.fixture(scope="module")
def models():
    return {name: model_of(name, make()) for name in KINDS}


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
def test_evaluate_policy_takes_the_shield_for_a_model(name, models):
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


def test_a_bare_policy_and_an_object_with_predict(env, models):
    obs, _ = env.reset(seed=0)
    bare = models["DQN"].policy
    assert isinstance(bare, BasePolicy)
    for policy in (bare, Always(3), Ranked(3, [0, 1, 2, 3, 4])):
        action, _ = Shield(policy, env=env).predict(obs)
        assert env.action_space.contains(int(action))


def test_a_model_without_an_environment_is_told_what_to_pass(tmp_path, models):
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


def test_what_was_verified_leaves_as_it_is_even_where_the_policy_speaks_in_whole_numbers():
    env = make(action={"type": "ContinuousAction"}, simulation_frequency=10, policy_frequency=5)
    env.reset(seed=0)
    shielded = Shield(Always(np.array([1, 1])), env=env)
    action, _ = shielded.predict(None)
    assert shielded.last_decision.overridden
    np.testing.assert_array_equal(action, shielded.last_decision.executed)


def test_speed_limits_of_another_kind_are_refused():
    with pytest.raises(ConfigError, match="speed_range"):
        ShieldedEnv(make(action={"type": "ContinuousAction", "speed_range": (0, 20)}))


def test_the_other_door_has_no_masks_for_continuous_actions():
    env = ShieldedEnv(make(action={"type": "ContinuousAction"}))
    env.reset(seed=0)
    with pytest.raises(ConfigError, match="DiscreteMetaAction"):
        env.action_masks()
    with pytest.raises(ConfigError, match="use none or full"):
        ShieldedEnv(make(action={"type": "ContinuousAction"}), ShieldConfig(mode="ttc"))


@pytest.mark.parametrize("policy", [None, 3, object(), "ppo", make])
def test_what_has_no_predict_is_refused(policy, env):
    with pytest.raises(PolicyError, match=r"has no predict\(\); pass an SB3 model"):
        Shield(policy, env=env)


def test_other_environments_are_refused():
    with pytest.raises(ConfigError, match="DiscreteMetaAction"):
        Shield(Always(0), env=gym.make("CartPole-v1"))


def test_attributes_of_the_model_are_reached_through_the_shield(models):
    shielded = Shield(models["PPO"])
    assert shielded.n_steps == 8
    assert shielded.observation_space == models["PPO"].observation_space
    with pytest.raises(AttributeError):
        _ = shielded.no_such_attribute


class Recurrent:
    """Counts its steps in its state; remembers what it was given."""

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
    shielded, fresh = Shield(Always(3), env=vec), [None, None]
    for _ in range(16):
        action, _ = shielded.predict(obs)
        assert action.shape == (2,)
        assert [d.executed for d in shielded.last_decisions] == list(action)
        for i, other in enumerate(fresh):
            if other is not None:
                other.predict(obs)
                assert same(other.last_decisions[i], shielded.last_decisions[i])
        obs, _, dones, _ = vec.step(action)
        # From an episode's start on, the shield decides as one that has seen nothing before.
        fresh = [Shield(Always(3), env=vec) if dones[i] else fresh[i] for i in range(2)]
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


def test_a_batch_needs_one_row_per_environment(env):
    obs, _ = env.reset(seed=0)
    with pytest.raises(ConfigError, match="2 actions for 1 environments"):
        Shield(Always(3), env=env).predict(np.stack([obs, obs]))


def test_environments_in_other_processes_are_told_where_to_put_the_shield():
    class Remote:
        num_envs = 2

    with pytest.raises(ConfigError, match=r"SubprocVecEnv\(\[lambda: ShieldedEnv"):
        Shield(Always(3), env=Remote())


# -- order of preference ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["PPO", "A2C", "TRPO", "MaskablePPO", "DQN", "QRDQN"])
def test_the_order_is_that_of_the_models_own_scores(name, models):
    model, obs = models[name], make().reset(seed=2)[0]
    scores = np.asarray(ranking_of(model, obs)).reshape(-1)
    tensor, _ = model.policy.obs_to_tensor(obs)
    with torch.no_grad():
        if name == "DQN":
            want = model.policy.q_net(tensor)
        elif name == "QRDQN":
            want = model.policy.quantile_net(tensor).mean(dim=1)
        else:
            want = model.policy.get_distribution(tensor).distribution.probs
    np.testing.assert_allclose(scores, want.numpy().reshape(-1))
    best = int(model.predict(obs, deterministic=True)[0])
    assert best == int(scores.argmax())
    order = order_from_scores(scores, best)
    assert sorted([*order, best]) == list(range(5))
    assert (np.diff(scores[order]) <= 0).all()


def test_scores_that_are_not_numbers_come_last():
    assert order_from_scores([0.1, np.nan, 0.3, 0.2, np.nan], proposed=2) == [3, 0, 1, 4]


def test_an_object_without_scores_has_no_ranking(env):
    assert ranking_of(Always(3), env.reset(seed=0)[0]) is None


@pytest.mark.parametrize("scores", [None, [4, 3, 2, 0, 1], [0, 1, 4, 0, 3], [0, 2, 1, 0, 4]])
def test_an_override_is_the_first_in_order_that_verifies(scores):
    env, seen = make(duration=20), 0
    for seed in range(4):
        obs, _ = env.reset(seed=seed)
        shielded = Shield(Always(3) if scores is None else Ranked(3, scores), env=env)
        done = False
        while not done:
            scene = Scene.from_env(env)
            action, _ = shielded.predict(obs)
            decision = shielded.last_decision
            if decision.tier == "alternative":
                seen += 1
                targets = [scene.target_of(a) for a in range(5)]
                order = default_order(scene, 3, targets) if scores is None else order_from_scores(scores, 3)
                passed = [MetaCore().decide(scene, a).tier == "passed" for a in order]
                assert decision.executed == order[passed.index(True)]
            obs, _, terminated, truncated, _ = env.step(int(action))
            done = terminated or truncated
    assert seen > 3
    env.close()


def test_the_order_reaches_the_other_door_too():
    executed = {}
    for name, scores in {"left": [4, 0, 1, 0, 2], "slower": [0, 1, 0, 0, 4]}.items():
        env = ShieldedEnv(make(duration=20), policy=Ranked(3, scores))
        chosen = Counter()
        for seed in range(4):
            env.reset(seed=seed)
            done = False
            while not done:
                _, _, terminated, truncated, _ = env.step(3)
                chosen[env.last_decision.executed] += env.last_decision.overridden
                done = terminated or truncated
        executed[name] = chosen
        env.close()
    assert executed["left"][0] > executed["slower"][0]
    assert executed["slower"][4] > executed["left"][4]


# -- ShieldedEnv -------------------------------------------------------------------------------------------------


KEYS = {
    "overridden": bool,
    "reason": str,
    "tier": str,
    "margin": float,
    "latency_ms": float,
    "frames_overridden": int,
    "violations": int,
}


def test_info_has_the_documented_keys_and_types():
    env = ShieldedEnv(make(duration=20))
    for seed in range(2):
        env.reset(seed=seed)
        done = False
        while not done:
            _, reward, terminated, truncated, info = env.step(3)
            done = terminated or truncated
            assert {k: type(v) for k, v in info["shield"].items()} == KEYS
            assert type(reward) is float
            assert info["shield"]["latency_ms"] > 0
            assert 0 <= info["shield"]["frames_overridden"] <= 5
            assert {"speed", "crashed", "action", "rewards"} <= set(info)
            pickle.dumps(info["shield"])
    env.close()


class WithoutTimes(gym.Wrapper):
    """Leaves out the wall time, in which two equal runs do differ."""

    spec = None

    def step(self, action):
        *rest, info = self.env.step(action)
        del info["shield"]["latency_ms"]
        return *rest, info


def test_gymnasiums_own_checker_passes():
    env = WithoutTimes(ShieldedEnv(make()))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        check_env(env, skip_render_check=True)


@pytest.mark.parametrize("config", [None, ShieldConfig(mode="rss", braking=5.0)])
def test_the_spec_rebuilds_the_shielded_environment(config):
    env = ShieldedEnv(make(), config)
    for spec in (env.spec, pickle.loads(pickle.dumps(env.spec))):
        again = gym.make(spec)
        inner = again
        while not isinstance(inner, ShieldedEnv):
            inner = inner.env
        assert inner.config == (config or ShieldConfig())
        obs, _ = again.reset(seed=5)
        np.testing.assert_array_equal(obs, env.reset(seed=5)[0])
        np.testing.assert_array_equal(again.step(3)[0], env.step(3)[0])


class Uncopied(Always):
    """Holds what cannot be copied, as a model with environments in other processes does."""

    def __deepcopy__(self, memo):
        raise TypeError("cannot be copied")


def test_a_policy_that_cannot_be_copied_gives_its_order_all_the_same():
    env = ShieldedEnv(make(), policy=Uncopied(3))
    env.reset(seed=0)
    assert env.step(3)[4]["shield"]["tier"] in {"passed", "alternative", "governed"}


def test_a_path_as_configuration_and_its_spec_as_json(tmp_path):
    path = str(tmp_path / "shield.toml")
    ShieldConfig(braking=5.5).save(path)
    env = ShieldedEnv(make(), path)
    assert env.config.braking == 5.5
    assert "ShieldedEnv" in env.spec.to_json()


def test_inside_a_dummy_vector_environment():
    vec = DummyVecEnv([lambda: ShieldedEnv(make())] * 2)
    vec.reset()
    for _ in range(7):
        _, rewards, _, infos = vec.step(np.array([3, 4]))
    assert rewards.shape == (2,)
    assert all("shield" in info for info in infos)
    vec.close()


def shielded_short():
    return ShieldedEnv(make())


def test_inside_subprocesses():
    vec = SubprocVecEnv([shielded_short, shielded_short], start_method="fork")
    try:
        vec.seed(0)
        vec.reset()
        for _ in range(3):
            _, _, _, infos = vec.step(np.array([3, 4]))
        assert all(set(info["shield"]) == set(KEYS) for info in infos)
    finally:
        vec.close()


def test_ppo_learns_in_it():
    model = model_of("PPO", ShieldedEnv(make()))
    assert model.learn(64).num_timesteps == 64


def test_maskable_ppo_learns_with_its_masks():
    env = ShieldedEnv(make())
    env.reset(seed=0)
    mask = env.action_masks()
    assert mask.shape == (5,)
    assert mask.dtype == bool
    assert mask.any()
    assert model_of("MaskablePPO", env).learn(64).num_timesteps == 64


def test_a_masked_action_is_one_that_would_be_overridden():
    env, disagreed = ShieldedEnv(make(duration=15)), 0
    for seed in range(3):
        env.reset(seed=seed)
        done = False
        while not done:
            mask = env.action_masks()
            _, _, terminated, truncated, _ = env.step(3)
            if mask.sum() < 5 and mask.any():
                disagreed += 1
            # All True also stands for none: MaskablePPO cannot handle an empty mask.
            assert env.last_decision.overridden == (not mask[3]) or mask.all()
            done = terminated or truncated
    assert disagreed
    env.close()


def record(env, policy, seed, steps=30):
    """Everything that an episode shows, but for the shield's own record of times."""
    rows = [env.reset(seed=seed)[0]]
    for i in range(steps):
        obs, reward, terminated, truncated, info = env.step(policy(i))
        shield = {k: v for k, v in info.pop("shield", {}).items() if k != "latency_ms"}
        ego = env.unwrapped.vehicle
        others = [(*v.position, v.heading, v.speed, v.crashed) for v in env.unwrapped.road.vehicles]
        rows.append((obs, reward, terminated, truncated, info, shield, ego.target_speed, others))
        if terminated or truncated:
            break
    env.close()
    return rows


def assert_bitwise(a, b, shield=True):
    assert len(a) == len(b)
    np.testing.assert_array_equal(a[0], b[0])
    for x, y in zip(a[1:], b[1:], strict=True):
        np.testing.assert_array_equal(x[0], y[0])
        assert x[1:4] == y[1:4]
        assert x[4] == y[4]
        assert x[6:] == y[6:]
        assert not shield or x[5] == y[5]


def playing(i):
    return (3, 0, 3, 2, 1, 4)[i % 6]


@pytest.mark.parametrize("env_id", ["highway-fast-v0", "highway-v0"])
def test_two_runs_on_one_seed_are_equal_to_the_bit(env_id):
    config = {"duration": 8}
    runs = [record(ShieldedEnv(gym.make(env_id, config=config)), playing, 7) for _ in range(2)]
    assert_bitwise(*runs)


def test_a_second_episode_is_not_coloured_by_the_first():
    env = ShieldedEnv(make(duration=15))
    env.reset(seed=1)
    for _ in range(6):
        env.step(3)
    assert_bitwise(record(env, playing, 7), record(ShieldedEnv(make(duration=15)), playing, 7))


@pytest.mark.parametrize("seed", range(3))
def test_without_a_mode_it_is_the_bare_environment(seed):
    config = ShieldConfig(mode="none")
    shielded = record(ShieldedEnv(make(duration=20), config), playing, seed)
    assert_bitwise(shielded, record(make(duration=20), playing, seed), shield=False)
    assert {row[5]["tier"] for row in shielded[1:]} == {"off"}


def test_where_nothing_is_overridden_it_is_the_bare_environment():
    compared = 0
    for seed in range(6):
        config = {"duration": 20, "vehicles_density": 0.3, "vehicles_count": 8}
        shielded = record(ShieldedEnv(make(**config)), lambda i: (1, 4, 1, 1)[i % 4], seed)
        if any(row[5]["overridden"] for row in shielded[1:]):
            continue
        compared += 1
        assert_bitwise(shielded, record(make(**config), lambda i: (1, 4, 1, 1)[i % 4], seed), shield=False)
    assert compared >= 2
