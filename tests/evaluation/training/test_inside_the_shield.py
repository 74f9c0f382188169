"""Training inside the shield: the override penalty, the learned action, masks, and features of lanes."""

from __future__ import annotations

import json
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from evaluation.learning.algorithms import get_algorithm
from evaluation.learning.lane_features import LaneFeatures
from evaluation.learning.shielded_vec_env import ShieldedVecEnv
from evaluation.settings import Setting
from evaluation.training.executed_actions import LearnFromExecuted
from evaluation.training.penalised_vec_env import PenalisedVecEnv
from evaluation.training.train import train
from evaluation.wrappers.override_penalty import OverridePenalty, less_overrides
from shield import ShieldedEnv
from shield.errors import ConfigError

CONFIG = {"vehicles_count": 10, "duration": 10}
TINY = Setting("tiny", "highway-fast-v0", CONFIG)
SMALL: dict[str, Any] = {"policy_kwargs": {"net_arch": [16]}}
ROLLOUT = {**SMALL, "n_steps": 32, "batch_size": 16, "n_epochs": 1}


def live(envs: int) -> DummyVecEnv:
    return DummyVecEnv([lambda: Monitor(ShieldedEnv(gym.make("highway-fast-v0", config=CONFIG)))] * envs)


@given(st.lists(st.tuples(st.floats(-5, 5), st.booleans()), min_size=1), st.floats(0, 10))
def test_only_overridden_steps_cost_something(steps, penalty):
    rewards, overridden = (np.array(column) for column in zip(*steps, strict=True))
    paid = less_overrides(rewards, overridden, penalty)
    assert np.array_equal(paid[~overridden], rewards[~overridden])
    assert paid[overridden] == pytest.approx(rewards[overridden] - penalty)


def test_compiled_and_live_environments_take_the_same_penalty():
    """One step of always FASTER after another: rewards less the penalty where `info` says overridden, in all three."""
    penalty, seed = 0.25, 3
    compiled = PenalisedVecEnv(ShieldedVecEnv(2, "highway-fast-v0", CONFIG), penalty)
    around = PenalisedVecEnv(live(2), penalty)
    single = OverridePenalty(ShieldedEnv(gym.make("highway-fast-v0", config=CONFIG)), penalty)
    compiled.seed(seed)
    around.seed(seed)
    compiled.reset()
    around.reset()
    single.reset(seed=seed)
    costs = 0
    for _ in range(10):
        _, one, _, infos = compiled.step(np.array([3, 3]))
        _, two, _, _ = around.step(np.array([3, 3]))
        _, three, _, _, info = single.step(3)
        assert np.array_equal(one, two)
        assert np.float32(three) == one[0]
        assert info["shield"]["overridden"] == infos[0]["shield"]["overridden"]
        costs += infos[0]["shield"]["overridden"]
    assert costs > 0
    # The return that is reported is the environment's.
    assert infos[0]["episode"]["r"] > 0.6 * 10


def test_a_penalty_without_a_shield_or_of_no_number_is_refused():
    env = OverridePenalty(gym.make("highway-fast-v0", config=CONFIG), 0.1)
    env.reset(seed=0)
    with pytest.raises(ConfigError, match="ShieldedEnv"):
        env.step(1)
    for wrong in (-1.0, float("nan"), float("inf")):
        with pytest.raises(ConfigError, match="penalty"):
            OverridePenalty(env, wrong)


class _Buffered(BaseCallback):
    """Stores proposals and executed actions; comes before `LearnFromExecuted`."""

    def __init__(self) -> None:
        super().__init__()
        self.proposed: list[int] = []
        self.executed: list[int] = []

    def _on_step(self) -> bool:
        self.proposed += self.locals["actions"].reshape(-1).tolist()
        self.executed += [int(info["action"]) for info in self.locals["infos"]]
        return True


@pytest.mark.parametrize("world", [lambda: ShieldedVecEnv(2, "highway-fast-v0", CONFIG), lambda: live(2)])
def test_ppo_stores_the_executed_action_and_its_probability(world):
    """The probability stored is that of the executed action: otherwise the first ratio would not be 1."""
    model = PPO("MlpPolicy", world(), **{**ROLLOUT, "learning_rate": 0.0}, seed=0, device="cpu")
    seen, learn = _Buffered(), LearnFromExecuted()
    model.learn(64, callback=[seen, learn])
    buffer = model.rollout_buffer
    # `RolloutBuffer.get` has made environments come one after the other.
    executed = np.array(seen.executed).reshape(-1, 2).T.reshape(-1)
    assert learn.replaced == (np.array(seen.proposed) != np.array(seen.executed)).sum() > 0
    assert np.array_equal(buffer.actions.reshape(-1), executed)
    with torch.no_grad():
        observations = torch.as_tensor(buffer.observations.reshape(-1, 5, 5))
        _, expected, _ = model.policy.evaluate_actions(observations, torch.as_tensor(executed))
    assert buffer.log_probs.reshape(-1) == pytest.approx(expected.numpy(), abs=1e-5)


def test_dqn_stores_the_executed_action_in_its_buffer():
    model = DQN(
        "MlpPolicy",
        ShieldedVecEnv(2, "highway-fast-v0", CONFIG),
        **SMALL,
        learning_starts=20,
        buffer_size=200,
        seed=0,
        device="cpu",
    )
    seen, learn = _Buffered(), LearnFromExecuted()
    model.learn(100, callback=[seen, learn])
    assert learn.replaced > 0
    assert model.replay_buffer.actions[: model.replay_buffer.pos].reshape(-1).tolist() == seen.executed


def test_learning_from_either_action_trains_another_model_and_the_manifest_says_which(tmp_path):
    weights = []
    for learn_from in ("proposed", "executed"):
        options = {"hyperparameters": ROLLOUT, "shield": "default", "envs": 2, "progress": False}
        trained = train(TINY, "ppo", 64, 1, output=tmp_path / learn_from, learn_from=learn_from, **options)
        assert trained.manifest.get("learn_from", "proposed") == learn_from
        weights.append(PPO.load(trained.path, device="cpu").policy.state_dict())
    assert any(not torch.equal(value, weights[1][key]) for key, value in weights[0].items())


def test_continuous_actions_have_no_executed_one_to_learn_from(tmp_path):
    setting = TINY.override({"action": {"type": "ContinuousAction"}})
    with pytest.raises(ConfigError, match="discrete actions"):
        train(
            setting,
            "ppo",
            8,
            0,
            output=tmp_path / "x",
            shield="default",
            learn_from="executed",
            progress=False,
            hyperparameters={**ROLLOUT, "n_steps": 8, "batch_size": 8},
        )


@pytest.mark.parametrize("simulator", ["compiled", "highway-env"])
def test_masks_restrict_proposals_to_actions_that_verify(tmp_path, simulator):
    trained = train(
        TINY,
        "ppo",
        64,
        1,
        output=tmp_path / "x",
        shield="default",
        masks=True,
        envs=2,
        simulator=simulator,
        hyperparameters=ROLLOUT,
        progress=False,
    )
    assert trained.manifest["algorithm"] == "maskableppo"
    model = get_algorithm("maskableppo").load(trained.path, device="cpu")
    world = ShieldedVecEnv(4, "highway-fast-v0", CONFIG)
    world.seed(0)
    observations, excluded = world.reset(), 0
    for _ in range(20):
        masks = world.action_masks()
        actions, _ = model.predict(observations, action_masks=masks, deterministic=False)
        assert masks[np.arange(4), actions].all()
        excluded += (~masks).sum()
        observations, _, _, _ = world.step(actions)
    assert excluded > 0


def test_a_penalty_in_training_changes_the_learned_weights(tmp_path):
    """With the same seed the first rollout is the same, and the learned weights are not."""
    weights, overridden = [], []
    for penalty in (0.0, 0.5):
        trained = train(
            TINY, "ppo", 64, 1, output=tmp_path / str(penalty), shield="default", envs=2, hyperparameters=ROLLOUT,
            override_penalty=penalty, progress=False,
        )  # fmt: skip
        overridden.append(trained.manifest["in_training"]["overridden"])
        weights.append(PPO.load(trained.path, device="cpu").policy.state_dict())
    assert overridden[0] == overridden[1] > 0
    assert any(not torch.equal(value, weights[1][key]) for key, value in weights[0].items())


def test_masks_in_either_simulator_teach_the_same(tmp_path):
    weights = []
    for simulator in ("compiled", "highway-env"):
        trained = train(
            TINY,
            "maskableppo",
            64,
            1,
            output=tmp_path / simulator,
            shield="default",
            simulator=simulator,
            override_penalty=0.3,
            hyperparameters=ROLLOUT,
            progress=False,
        )
        weights.append(get_algorithm("maskableppo").load(trained.path, device="cpu").policy.state_dict())
    assert all(torch.equal(value, weights[1][key]) for key, value in weights[0].items())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"override_penalty": 0.1}, "goes with a shield"),
        ({"masks": True}, "goes with a shield"),
        ({"learn_from": "executed"}, "goes with a shield"),
        ({"shield": "default", "learn_from": "both"}, "proposed, executed"),
        ({"shield": "default", "override_penalty": -0.1}, "from 0 on"),
        ({"shield": "default", "masks": True, "learn_from": "executed"}, "with masks every proposal"),
        ({"shield": "default", "masks": True, "algorithm": "dqn"}, "masks are for ppo"),
    ],
)
def test_incompatible_options_are_refused_before_any_file_is_written(tmp_path, options, message):
    algorithm = options.pop("algorithm", "ppo")
    with pytest.raises(ConfigError, match=message):
        train(TINY, algorithm, 8, 0, output=tmp_path / "x", progress=False, **options)
    assert not list(tmp_path.iterdir())


def test_crashes_and_overrides_in_training_are_in_the_manifest(tmp_path):
    """Bare training crashes, training inside the shield does not."""
    told = {}
    for shield in ("none", "default"):
        trained = train(
            TINY,
            "ppo",
            256,
            0,
            output=tmp_path / shield,
            shield=shield,
            envs=4,
            progress=False,
            hyperparameters=ROLLOUT,
        )
        told[shield] = json.loads((tmp_path / f"{shield}.json").read_text())["in_training"]
        assert trained.manifest["in_training"] == told[shield]
    assert told["none"]["crashes"] > 0 == told["none"]["overridden"]
    assert told["default"]["crashes"] == 0 < told["default"]["overridden"]
    assert told["default"]["episodes"] >= 20


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31))
def test_lane_features_do_not_depend_on_the_order_of_the_others(seed):
    """Which row a vehicle stands in says nothing; where it is does."""
    random = np.random.default_rng(seed)
    rows = random.uniform(-1, 1, (1, 6, 5)).astype(np.float32)
    rows[:, 1:, 0] = random.integers(0, 2, 5)
    extractor = LaneFeatures(gym.spaces.Box(-1.0, 1.0, (6, 5)))
    shuffled = rows[:, [0, *(1 + random.permutation(5))]]
    one, two = (extractor(torch.as_tensor(each)) for each in (rows, shuffled))
    assert torch.equal(one, two)


def test_lane_features_show_the_nearest_ahead_in_each_lane():
    rows = np.zeros((1, 5, 5), np.float32)
    rows[0, 0] = [1, 0.5, 0.25, 0.3, 0]
    rows[0, 1] = [1, 0.1, 0.0, -0.05, 0]
    rows[0, 2] = [1, 0.2, 0.0, 0.05, 0]
    rows[0, 3] = [1, 0.3, -0.25, 0.1, 0]
    shown = LaneFeatures(gym.spaces.Box(-1.0, 1.0, (5, 5)), reach=1)(torch.as_tensor(rows))[0].numpy()
    nearness, speed, taken = shown[3:6], shown[6:9], shown[9:]
    assert taken.tolist() == [1, 1, 0]
    assert nearness[:2] == pytest.approx(np.exp([-2.4, -0.8]))
    assert speed == pytest.approx([0.8, -0.4, 0.0])
    with pytest.raises(ConfigError, match="shape"):
        LaneFeatures(gym.spaces.Box(-1.0, 1.0, (5, 7)))


def test_a_class_in_the_hyperparameters_is_given_by_its_dotted_name(tmp_path):
    named = {"features_extractor_class": "evaluation.learning.lane_features.LaneFeatures", "net_arch": [8]}
    hyperparameters = {**ROLLOUT, "policy_kwargs": named}
    trained = train(TINY, "ppo", 32, 0, output=tmp_path / "x", hyperparameters=hyperparameters, progress=False)
    assert trained.manifest["hyperparameters"]["policy_kwargs"] == named
    assert isinstance(PPO.load(trained.path, device="cpu").policy.features_extractor, LaneFeatures)
    for wrong in ("LaneFeatures", "evaluation.nowhere.Lanes", "torch.nn.Nothing"):
        with pytest.raises(ConfigError, match="dotted name"):
            train(
                TINY,
                "ppo",
                32,
                0,
                output=tmp_path / "y",
                progress=False,
                hyperparameters={"policy_kwargs": {"features_extractor_class": wrong}},
            )
