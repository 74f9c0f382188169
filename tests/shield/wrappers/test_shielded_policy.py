"""`Shield(policy)` between the policy and an environment that it reads: the choice of the environment, and its
lifetime."""

import copy
import pickle
from collections import Counter

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
import torch
from gymnasium.wrappers import RecordEpisodeStatistics
from policies import Always, Playback, make
from stable_baselines3 import PPO
from stable_baselines3.common.logger import configure
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from dynamics.scenes.scene import SceneReader
from shield import Shield, ShieldCallback, ShieldConfig, ShieldedEnv
from shield.errors import ConfigError, PolicyError, SceneError
from shield.wrappers.ranking import normalised, ranking_of

CONTINUOUS = {"action": {"type": "ContinuousAction"}}


def driven(env, act, seed):
    """Rewards and shield reports of an episode."""
    obs, _ = env.reset(seed=seed)
    out, done = [], False
    while not done:
        obs, reward, terminated, truncated, info = env.step(act(obs))
        out.append((reward, info))
        done = terminated or truncated
    return out


@pytest.mark.parametrize("config", [{}, CONTINUOUS], ids=["meta", "inputs"])
@pytest.mark.parametrize("seed", range(3))
def test_the_policy_wrapper_drives_exactly_as_the_environment_wrapper(config, seed):
    actions = np.random.default_rng(seed)
    plan = [actions.uniform(-1, 1, 2).astype(np.float32) if config else int(actions.integers(5)) for _ in range(12)]
    env = gym.make("highway-fast-v0", config={"duration": 12, **config})
    policy = Playback(plan)
    shield = Shield(policy, env=env)
    reports = []

    def act(obs):
        if shield.last_decisions:
            reports.append(shield.report())
        return shield.predict(obs)[0]

    mine = driven(env, act, seed)
    theirs = driven(ShieldedEnv(gym.make("highway-fast-v0", config={"duration": 12, **config})), Playback(plan), seed)
    assert [reward for reward, _ in mine] == [reward for reward, _ in theirs]
    reports.append(shield.report())
    for report, (_, info) in zip(reports, theirs, strict=True):
        mirrored = info["shield"]
        assert np.array_equal(report.pop("margin"), mirrored.pop("margin"), equal_nan=True)
        assert report == mirrored


def test_always_faster_does_not_crash_between_two_decisions():
    env = gym.make("highway-fast-v0")
    shield = Shield(Always(3), env=env)
    for seed in range(4):
        driven(env, lambda obs: int(shield.predict(obs)[0]), seed)
        assert not env.unwrapped.vehicle.crashed


def test_an_environment_other_than_the_driven_one_is_detected(tmp_path):
    trained, driven = make(duration=20), make(duration=20)
    model = PPO("MlpPolicy", trained, n_steps=8, batch_size=8, device="cpu")
    model.save(tmp_path / "model.zip")
    shield = Shield(PPO.load(tmp_path / "model.zip", env=trained, device="cpu"))
    obs, _ = driven.reset(seed=0)
    action, _ = shield.predict(obs)
    shield.predict(obs)  # a second call with the same observation is no step
    obs, *_ = driven.step(int(action))
    with pytest.raises(SceneError, match=r"Shield\(model, env=env\)"):
        shield.predict(obs)


def test_an_environment_of_several_that_is_not_stepped_is_detected():
    vec = DummyVecEnv([make, make])
    shield = Shield(Always(1), env=vec)
    obs = vec.reset()
    shield.predict(obs)
    obs[0], *_ = vec.envs[0].step(1)
    shield.predict(obs)
    obs[1] += 0.01
    with pytest.raises(SceneError, match="is not driven"):
        shield.predict(obs)


def test_a_copy_of_the_environment_is_not_supervised():
    env = make()
    shield = Shield(Always(3), env=env)
    obs, _ = env.reset(seed=0)
    shield.predict(obs)
    copied = copy.deepcopy(env.unwrapped)
    before = pickle.dumps((env.unwrapped.vehicle.position, env.unwrapped.vehicle.speed))
    copied.step(3)
    assert shield.frame_decisions == [[]]
    assert pickle.dumps((env.unwrapped.vehicle.position, env.unwrapped.vehicle.speed)) == before
    assert copied.vehicle.speed != env.unwrapped.vehicle.speed
    env.step(3)
    assert shield.frame_decisions[0]


def test_reset_releases_the_vehicle():
    env = make()
    shield = Shield(Always(3), env=env)
    obs, _ = env.reset(seed=0)
    shield.predict(obs)
    assert "act" in vars(env.unwrapped.vehicle)
    shield.reset()
    assert "act" not in vars(env.unwrapped.vehicle)
    off = Shield(Always(3), env=env, config=ShieldConfig(mode="none"))
    off.predict(obs)
    assert "act" not in vars(env.unwrapped.vehicle)


UNSUPPORTED = [
    ("merge-v0", "DiscreteMetaAction"),
    ("roundabout-v0", "DiscreteMetaAction"),
    ("intersection-v0", "DiscreteMetaAction"),
    ("intersection-v0", "ContinuousAction"),
    ("exit-v0", "DiscreteMetaAction"),
    ("exit-v0", "ContinuousAction"),
    ("two-way-v0", "DiscreteMetaAction"),
    ("u-turn-v0", "DiscreteMetaAction"),
]


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("name", "kind"), UNSUPPORTED)
@pytest.mark.parametrize(
    "placement", [lambda env, config: Shield(Always(0), env=env, config=config), ShieldedEnv], ids=["policy", "env"]
)
def test_roads_that_are_not_supported_are_refused_at_once(placement, name, kind):
    """Throttle and steering; and one rule alone, which knows straight roads."""
    env = gym.make(name, config={"action": {"type": kind}})
    with pytest.raises(SceneError, match=r"support"):
        placement(env, ShieldConfig(mode="rss") if kind == "DiscreteMetaAction" else "worst-case")
    assert env.reset(seed=0)  # the environment is none the worse for it


class Broken:
    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        raise RuntimeError("weights are gone")


def test_a_policy_that_keeps_failing_is_an_error_and_warned_of_once(caplog):
    env = make(duration=100, policy_frequency=5)
    shield = Shield(Broken(), env=env, config=ShieldConfig(failure_limit=4))
    obs, _ = env.reset(seed=0)
    for _ in range(4):
        action, _ = shield.predict(obs)
        obs, *_ = env.step(int(action))
    assert [r.message for r in caplog.records if "weights are gone" in r.message] == [caplog.records[-1].message]
    with pytest.raises(PolicyError, match=r"5 decisions in a row.*RuntimeError: weights are gone.*failure_limit"):
        shield.predict(obs)


@pytest.mark.parametrize("placement", ["policy", "env"])
def test_a_scene_that_cannot_be_read_is_an_error_after_a_while(placement, monkeypatch, caplog):
    env = make(duration=100, policy_frequency=5)
    shield = Shield(Always(1), env=env, config=ShieldConfig(failure_limit=3))
    shielded = ShieldedEnv(env, ShieldConfig(failure_limit=3)) if placement == "env" else env
    obs, _ = shielded.reset(seed=0)

    def unreadable(self):
        raise SceneError("fog")

    monkeypatch.setattr(SceneReader, "read", unreadable)

    def step(obs):
        return shielded.step(1 if placement == "env" else int(shield.predict(obs)[0]))[0]

    for _ in range(3):
        obs = step(obs)
    with pytest.raises(SceneError, match=r"4 decisions in a row: the scene could not be read.*\(fog\)"):
        step(obs)
    assert sum("fog" in r.message for r in caplog.records) == 1


@pytest.mark.parametrize("failure_limit", [-1, 2.5, True, "7"])
def test_the_failure_limit_is_a_number_of_decisions(failure_limit):
    with pytest.raises(ConfigError, match="whole number of decisions"):
        ShieldConfig(failure_limit=failure_limit)


# -- accepted policies -------------------------------------------------------------------------------------------


class Old:
    def predict(self, obs):
        return 3


WRAPPERS = [lambda p, env: Shield(p, env=env), lambda p, env: ShieldedEnv(env, policy=p)]


@pytest.mark.parametrize("placement", WRAPPERS, ids=["policy", "env"])
@pytest.mark.parametrize(
    ("policy", "message"),
    [
        (42, r"int has no predict\(\); pass an SB3 model, a BasePolicy, a torch.nn.Module, a function"),
        ("ppo.zip", r"str has no predict"),
        (PPO, r"PPO is a class; pass a model, such as PPO.load\(path\)"),
        (Old(), r"Old.predict\(obs\) cannot be called as SB3's predict.*Add these arguments"),
    ],
    ids=["number", "path", "class", "signature"],
)
def test_an_object_that_is_no_policy_is_refused(placement, policy, message):
    if policy is PPO:
        policy = type("PPO", (), {})  # one without a predict of its own
    with pytest.raises(PolicyError, match=message):
        placement(policy, make())


def test_a_model_of_another_environment_is_refused():
    other = PPO("MlpPolicy", gym.make("CartPole-v1"), n_steps=8, batch_size=8, device="cpu")
    with pytest.raises(PolicyError, match=r"made for another observation_space.*Box\(.*\(4,\).*\(5, 5\)"):
        Shield(other, env=make())
    inputs = PPO("MlpPolicy", make(**CONTINUOUS), n_steps=8, batch_size=8, device="cpu")
    with pytest.raises(PolicyError, match=r"made for another action_space"):
        Shield(inputs, env=make())


def test_a_function_and_a_network_are_policies():
    env = make()
    obs, _ = env.reset(seed=0)
    shield = Shield(lambda observation: 1, env=env)
    assert int(shield.predict(obs)[0]) == shield.last_decision.executed
    torch.manual_seed(0)
    network = torch.nn.Sequential(torch.nn.Flatten(), torch.nn.Linear(25, 5))
    scores = network(torch.as_tensor(obs[None])).detach().numpy()
    shield = Shield(network, env=env)
    action, _ = shield.predict(obs)
    assert np.shape(action) == ()
    assert shield.last_decision.proposed == scores.argmax()
    np.testing.assert_array_equal(ranking_of(shield.policy, obs), scores)
    vec = DummyVecEnv([make, make])
    assert Shield(network, env=vec).predict(vec.reset())[0].shape == (2,)
    wheel = make(**CONTINUOUS)
    shield = Shield(torch.nn.Sequential(torch.nn.Flatten(), torch.nn.Linear(25, 2)), env=wheel)
    action, _ = shield.predict(wheel.reset(seed=0)[0])
    assert wheel.action_space.contains(action)


def test_a_models_own_normalisation_is_applied_before_it_ranks():
    vec = VecNormalize(DummyVecEnv([make]))
    model = PPO("MlpPolicy", vec, n_steps=64, batch_size=32, device="cpu", seed=0).learn(64)
    env = ShieldedEnv(make(), policy=model)
    obs, _ = env.reset(seed=0)
    np.testing.assert_allclose(normalised(model, obs), vec.normalize_obs(obs))
    assert not np.allclose(ranking_of(model, normalised(model, obs)), ranking_of(model, obs))
    assert normalised(Always(3), obs) is obs


# -- statistics ----------------------------------------------------------------------------------------------------


def test_the_statistics_of_a_shield_are_those_of_its_reports():
    env = make(duration=8)
    shield, reports = Shield(Always(3), env=env), []
    for seed in range(2):
        obs, _ = env.reset(seed=seed)
        done = False
        while not done:
            action, _ = shield.predict(obs)
            obs, _, terminated, truncated, _ = env.step(int(action))
            reports.append(shield.report())
            done = terminated or truncated
    counted = shield.statistics
    assert counted.decisions == len(reports)
    assert counted.overridden == sum(report["overridden"] for report in reports) > 0
    assert counted.frames_overridden == sum(report["frames_overridden"] for report in reports)
    assert counted.reasons == Counter(report["reason"] for report in reports)
    assert shield.statistics == counted
    shield.reset()
    assert shield.statistics == counted


def test_an_episodes_last_info_sums_it_up():
    env = RecordEpisodeStatistics(ShieldedEnv(make(duration=8)))
    for seed in range(2):
        env.reset(seed=seed)
        reports, latencies, done = [], [], False
        while not done:
            *_, terminated, truncated, info = env.step(3)
            reports.append(info["shield"])
            latencies.append(env.get_wrapper_attr("latency"))
            done = terminated or truncated
            assert ("shield_episode" in info) == done
        episode = info["shield_episode"]
        assert episode["decisions"] == info["episode"]["l"] == len(reports)
        for name in ("overridden", "frames_overridden", "violations"):
            assert episode[name] == sum(report[name] for report in reports)
        assert episode["margin"] == min(report["margin"] for report in reports)
        assert episode["reasons"] == Counter(report["reason"] for report in reports)
        assert episode["latency_ms"] == pytest.approx(1e3 * np.mean(latencies))
        assert episode["overridden"] > 0


def test_a_training_run_logs_the_interventions_of_the_shield(tmp_path):
    model = PPO("MlpPolicy", ShieldedEnv(make()), n_steps=32, batch_size=32, device="cpu")
    model.set_logger(configure(str(tmp_path), ["csv"]))
    model.learn(64, callback=ShieldCallback())
    (header, *rows) = (tmp_path / "progress.csv").read_text().splitlines()
    columns = header.split(",")
    assert {"shield/overridden", "shield/frames_overridden", "shield/violations", "shield/latency_ms"} <= set(columns)
    reasons = [i for i, name in enumerate(columns) if name.startswith("shield/reason/")]
    assert reasons
    assert all(float(row.split(",")[columns.index("shield/latency_ms")]) > 0 for row in rows)
