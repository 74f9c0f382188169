"""Every model file is loaded for prediction, or the object that prevents it is named with a remedy."""

from __future__ import annotations

import base64
import json
import pickle
import zipfile

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
import torch.nn as nn
from stable_baselines3 import DQN, PPO, SAC, HerReplayBuffer
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from evaluation.learning.algorithms import load_model
from evaluation.running.named_policies import make_policy
from shield.errors import PolicyError


class Narrow(BaseFeaturesExtractor):
    """A features extractor of the user's own."""

    def __init__(self, space, features_dim=16):
        super().__init__(space, features_dim)
        self.net = nn.Sequential(nn.Flatten(), nn.Linear(25, features_dim), nn.ReLU())

    def forward(self, x):
        return self.net(x)


class Unreadable:
    """Raises when it is unpickled, as a code object of another Python does."""

    def __reduce__(self):
        return (len, (3,))


NARROW = {"features_extractor_class": Narrow, "features_extractor_kwargs": {"features_dim": 16}}


@pytest.fixture(scope="module")
def env():
    return gym.make("highway-fast-v0")


def ppo(env, **settings):
    return PPO("MlpPolicy", env, n_steps=8, batch_size=8, device="cpu", **settings)


def rewritten(path, target, change):
    """A copy of a model file with changed settings."""
    source = zipfile.ZipFile(path)
    data = json.loads(source.read("data"))
    change(data)
    with zipfile.ZipFile(target, "w") as archive:
        for name in source.namelist():
            archive.writestr(name, json.dumps(data) if name == "data" else source.read(name))
    return target


def spoil(*names):
    def change(data):
        for name in names:
            entry = data[name] if isinstance(data[name], dict) else {}
            data[name] = {**entry, ":serialized:": base64.b64encode(pickle.dumps(Unreadable())).decode()}

    return change


def of_gym(data):
    """As SB3 1.x wrote it: the spaces are of the package gym, which is not installed."""
    for name in ("observation_space", "action_space"):
        raw = pickle.dumps(pickle.loads(base64.b64decode(data[name][":serialized:"])), protocol=2)
        old = raw.replace(b"cgymnasium.spaces", b"cgym.spaces")
        assert old != raw
        data[name][":serialized:"] = base64.b64encode(old).decode()


def acts_alike(one, other, env):
    for seed in range(5):
        obs, _ = env.reset(seed=seed)
        acted = [model.predict(obs, deterministic=True)[0] for model in (one, other)]
        np.testing.assert_array_equal(*acted)


def test_a_model_of_hindsight_experience_replay_is_loaded_without_its_environment(tmp_path):
    """SAC and HER on parking-v0, which highway-env's own notebook trains."""
    env = gym.make("parking-v0")
    model = SAC(
        "MultiInputPolicy",
        env,
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs={"n_sampled_goal": 4},
        buffer_size=1000,
        device="cpu",
    )
    model.save(tmp_path / "her.zip")
    loaded = make_policy(str(tmp_path / "her.zip"), env)
    acts_alike(model, loaded, env)
    # It can be saved unchanged, and refuses to continue learning.
    loaded.save(tmp_path / "again.zip")
    again = SAC.load(tmp_path / "again.zip", env=env, device="cpu")
    assert isinstance(again.replay_buffer, HerReplayBuffer)
    assert again.buffer_size == 1000
    assert loaded.replay_buffer is None


def test_no_replay_buffer_is_allocated_to_predict(tmp_path, env):
    DQN("MlpPolicy", env, buffer_size=50, device="cpu").save(tmp_path / "dqn.zip")
    huge = rewritten(tmp_path / "dqn.zip", tmp_path / "huge.zip", lambda data: data.update(buffer_size=10**13))
    loaded = load_model(huge)
    assert loaded.buffer_size == 10**13
    acts_alike(load_model(tmp_path / "dqn.zip"), loaded, env)


def test_a_model_of_gyms_time_takes_the_environments_spaces(tmp_path, env, caplog):
    model = ppo(env)
    model.save(tmp_path / "new.zip")
    old = rewritten(tmp_path / "new.zip", tmp_path / "old.zip", of_gym)
    acts_alike(model, make_policy(str(old), env), env)
    assert "old.zip: observation_space and action_space cannot be read here" in caplog.text
    with pytest.raises(PolicyError, match=r"its observation_space cannot be read .*gym.*load_model\(path, env=env"):
        load_model(old)


@pytest.mark.parametrize(
    ("config", "told"),
    [
        ({"action": {"type": "DiscreteMetaAction", "lateral": False}}, r"another action_space: it is Discrete\(5\)"),
        ({"observation": {"type": "Kinematics", "vehicles_count": 7}}, r"its shape is \(5, 5\), the environment's \(7"),
    ],
)
def test_a_model_of_gyms_time_for_other_spaces_is_refused(tmp_path, env, config, told):
    ppo(env).save(tmp_path / "new.zip")
    old = rewritten(tmp_path / "new.zip", tmp_path / "old.zip", of_gym)
    with pytest.raises(PolicyError, match=told):
        load_model(old, env=gym.make("highway-fast-v0", config=config))


@pytest.mark.parametrize("name", ["policy_kwargs", "policy_class"])
def test_an_unreadable_part_of_the_network_is_named_with_a_working_remedy(tmp_path, env, name):
    model = ppo(env, policy_kwargs=NARROW)
    model.save(tmp_path / "mine.zip")
    broken = rewritten(tmp_path / "mine.zip", tmp_path / "broken.zip", spoil(name))
    with pytest.raises(PolicyError) as caught:
        make_policy(str(broken), env)
    said = str(caught.value)
    assert f"broken.zip: its {name} cannot be read here (TypeError" in said
    assert f"PPO.load({str(broken)!r}, custom_objects={{{name!r}: ...}})" in said
    if name == "policy_kwargs":
        assert "Narrow" in said
    mine = {"policy_kwargs": NARROW, "policy_class": type(model.policy)}[name]
    by_hand = PPO.load(broken, device="cpu", custom_objects={name: mine})
    acts_alike(model, by_hand, env)
    by_hand.save(tmp_path / "again.zip")
    acts_alike(model, make_policy(str(tmp_path / "again.zip"), env), env)
    acts_alike(model, load_model(broken, custom_objects={name: mine}), env)


def test_policy_settings_of_another_kind_are_named_as_well(tmp_path, env):
    """A pickle that can be read, and holds no dict."""
    ppo(env).save(tmp_path / "mine.zip")

    def change(data):
        data["policy_kwargs"] = {":serialized:": base64.b64encode(pickle.dumps([1])).decode()}

    with pytest.raises(PolicyError, match=r"its policy_kwargs cannot be read here .*a list instead of a dict"):
        load_model(rewritten(tmp_path / "mine.zip", tmp_path / "broken.zip", change))


def test_a_part_needed_for_training_alone_may_be_unreadable(tmp_path, env):
    """Schedules are functions, which another Python version pickles differently."""
    model = ppo(env, learning_rate=lambda left: 1e-3 * left, clip_range=lambda left: 0.2 * left)
    model.save(tmp_path / "mine.zip")
    names = ("learning_rate", "lr_schedule", "clip_range", "rollout_buffer_class")
    broken = rewritten(tmp_path / "mine.zip", tmp_path / "broken.zip", spoil(*names))
    acts_alike(model, make_policy(str(broken), env), env)
