"""Columns added to observations: their values, their composition, and a shield that ignores them."""

from __future__ import annotations

import shlex
from collections import deque

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecNormalize

from evaluation.names import CHANNEL_NAMES
from evaluation.running.episodes import run_episode
from evaluation.running.records import ShieldVariant
from evaluation.training.train import train
from evaluation.wrappers import SENSORS, Confidence, Intent, SensorModel, SensorNoise, TrackedConfidence, seen_through
from evaluation.wrappers.channels import CHANNELS
from shield import Shield, ShieldedEnv
from shield.decision import Reason
from shield.errors import ConfigError
from shield.perception.scenes import observe_now
from shield.perception.spec import ObservationSpec

SEEN = {"type": "Kinematics", "vehicles_count": 15, "see_behind": True}
ALL = "normalised-0.5+confidence+intent"


def highway(observation=SEEN):
    return gym.make("highway-fast-v0", config={"observation": observation})


@pytest.mark.parametrize("name", ["exact+intent", ALL, "metric-2-late+tracked-confidence+intent", "ghosts+confidence"])
def test_a_sensor_with_channels_is_a_valid_environment(name):
    env = seen_through(highway(), name)
    check_env(env)
    assert env.observation_space.shape == (15, 5 + name.count("+"))
    one, two = ([env.reset(seed=3)[0], env.step(1)[0]] for _ in range(2))
    np.testing.assert_array_equal(one, two)
    assert env.observation_space.contains(one[0])


def test_channels_are_added_and_nothing_is_changed():
    wide, narrow = seen_through(highway(), ALL), seen_through(highway(), "normalised-0.5")
    pairs = [(wide.reset(seed=5)[0], narrow.reset(seed=5)[0])]
    for action in (1, 4, 1):
        pairs.append((wide.step(action)[0], narrow.step(action)[0]))
    for added, plain in pairs:
        np.testing.assert_array_equal(added[:, :5], plain)
        empty = ~plain.any(axis=1)
        assert not added[empty].any()


def test_several_channels_compose():
    world = DummyVecEnv([lambda: seen_through(highway(), ALL)] * 2)
    world.seed(0)
    first = world.reset()
    assert first.shape == (2, 15, 7)
    shown, *_ = world.step([1, 1])
    assert np.abs(shown[0] - shown[1]).max() > 0


# -- confidence ------------------------------------------------------------------------------------------------


def test_confidence_is_the_exponential_of_minus_the_variance_of_the_row():
    env = Confidence(seen_through(highway(), "normalised-0.2"), window=3)
    shown, past = env.reset(seed=0)[0], deque(maxlen=3)
    for _ in range(6):
        past.append(shown[:, 1:5])
        for row in range(15):
            there = [each[row] for each in past if each[row].any()]
            expected = np.exp(-np.var(there, axis=0).sum()) if shown[row].any() else 0.0
            assert shown[row, 5] == pytest.approx(expected, abs=1e-5)
        shown, *_ = env.step(4)
    assert 0 < shown[1:, 5].max() < 1.0
    # As many as the window has, and a reset forgets.
    np.testing.assert_array_equal(np.unique(env.reset(seed=1)[0][:, 5]), [0.0, 1.0] if not shown.all() else [1.0])


def test_the_same_instant_counts_once():
    env = Confidence(seen_through(highway(), "normalised-0.5"))
    env.reset(seed=0)
    for _ in range(3):
        assert set(env.observation(observe_now(env))[:, 5].tolist()) <= {0.0, 1.0}


def test_tracked_confidence_is_calibrated():
    """Reliability, in bins: a vehicle is within a metre as often as its probability says."""
    said, was = [], []
    env = TrackedConfidence(
        SensorNoise(highway(), SensorModel({"x": 1.5, "y": 0.5, "vx": 1.0, "vy": 0.5}, dropout=0.2)), 1.0
    )
    base = env.unwrapped
    for seed in range(6):
        shown, _ = env.reset(seed=seed)
        for _ in range(12):
            close = base.road.close_objects_to(base.vehicle, 200.0, count=14, see_behind=True, sort=True)
            tracks, ego = env._scenes.perception.tracks, env._scenes.perception.ego
            at = {int(p): i for i, p in enumerate(tracks.places) if tracks.missed[i] == 0}
            for row in np.flatnonzero(shown[1:].any(axis=1)) + 1:
                mean, true = tracks.mean[at[row]], close[row - 1].position - base.vehicle.position
                off = mean[:2] - [ego[0], base.vehicle.position[1]] - true
                said.append(float(shown[row, 5]))
                was.append(bool(np.hypot(*off) <= 1.0))
            shown, _, over, _, _ = env.step(4)
            if over:
                break
    said, was = np.array(said), np.array(was)
    assert len(said) > 400
    assert said.mean() == pytest.approx(was.mean(), abs=0.08)
    low, high = said <= np.median(said), said > np.median(said)
    assert was[high].mean() > was[low].mean()
    for half in (low, high):
        assert said[half].mean() == pytest.approx(was[half].mean(), abs=0.12)


# -- intent ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "options", [{}, {"absolute": True, "normalize": False}, {"features": ["vy", "x", "presence", "vx", "y"]}]
)
def test_intent_is_the_sign_of_the_velocity_across_in_the_world(options):
    env, found = Intent(highway({**SEEN, **options})), []
    base = env.unwrapped
    rng = np.random.default_rng(0)
    for seed in range(4):
        env.reset(seed=seed)
        for vehicle in base.road.vehicles:
            vehicle.heading = float(np.arcsin(rng.uniform(-0.6, 0.6) / vehicle.speed))
        close = base.road.close_objects_to(base.vehicle, 200.0, count=14, see_behind=True, sort=True)
        shown = env.observation(base.observation_type.observe())
        for row, vehicle in zip(shown, [base.vehicle, *close], strict=False):
            vy = vehicle.velocity[1]
            if abs(abs(vy) - 0.3) > 1e-3:
                assert row[-1] == (np.sign(vy) if abs(vy) > 0.3 else 0.0)
                found.append(row[-1])
    assert set(found) == {-1.0, 0.0, 1.0}


# -- the shield ------------------------------------------------------------------------------------------------


class Faster:
    def predict(self, obs, state=None, episode_start=None, deterministic=False):
        return (np.full(len(obs), 3) if np.ndim(obs) == 3 else 3), state


def driven(env, frames=False):
    obs, _ = env.reset(seed=5)
    shielded, found = Shield(Faster(), env=env, frames=frames, perception="observation"), []
    for _ in range(8):
        action, _ = shielded.predict(obs)
        decision = shielded.last_decision
        found.append((int(action), decision.reason, decision.margin))
        obs, _, over, _, _ = env.step(int(action))
        if over:
            break
    return found


def test_a_shield_decides_as_without_the_channels():
    wide, narrow = (
        driven(seen_through(highway(), "metric-0.5+confidence+intent")),
        driven(seen_through(highway(), "metric-0.5")),
    )
    assert Reason.BAD_SCENE not in {reason for _, reason, _ in wide}
    assert len(wide) > 2
    assert wide == narrow


def test_a_shield_around_the_environment_looks_below_the_channels():
    env = seen_through(highway(), "metric-0.5+confidence+intent")
    shielded = ShieldedEnv(env, perception="observation")
    obs, _ = shielded.reset(seed=0)
    assert obs.shape == (15, 7)
    assert observe_now(env).shape == (15, 5)
    for _ in range(3):
        obs, *_ = shielded.step(3)
        assert obs.shape == (15, 7)
        assert shielded.last_decision.reason is not Reason.BAD_SCENE
        assert all(each.reason is not Reason.BAD_SCENE for each in shielded.frame_decisions)
    assert shielded.filter.reader.perception.config.noise == (0.5, 0.5, 0.5, 0.5)


def test_a_policy_that_learned_with_the_channels_is_shielded_from_its_environment_alone():
    world = VecFrameStack(
        VecNormalize(DummyVecEnv([lambda: seen_through(highway(), ALL)]), norm_reward=False, clip_obs=1e6), 2
    )
    model = PPO("MlpPolicy", world, n_steps=8, batch_size=8, n_epochs=1, seed=0, device="cpu").learn(8)
    shielded = Shield(model, perception="observation")
    obs = world.reset()
    for _ in range(3):
        action, _ = shielded.predict(obs, deterministic=True)
        assert shielded.last_decision.reason is not Reason.BAD_SCENE
        obs, *_ = world.step(action)


def test_training_and_evaluation_go_through_the_same_sensor(tmp_path):
    small = {"n_steps": 16, "batch_size": 16, "n_epochs": 1, "gamma": 0.8}
    trained = train(
        "highway-fast", "ppo", 16, 0, output=tmp_path / "seen", hyperparameters=small, sensor=ALL, progress=False
    )
    assert trained.manifest["sensor"] == ALL
    assert f"sensor={ALL!r}" in shlex.split(trained.manifest["command"])[-1]
    assert PPO.load(trained.path, device="cpu").observation_space.shape == (5, 7)
    record = run_episode("highway-fast", str(trained.path), ShieldVariant(), 600, sensor=ALL)
    assert record.steps > 0
    with pytest.raises(ConfigError, match="observes highway-env itself"):
        train("merge", "ppo", 16, 0, output=tmp_path / "no", simulator="compiled", sensor=ALL)


def test_a_specification_may_name_the_channels():
    spec = ObservationSpec(features=("presence", "x", "y", "vx", "vy", "confidence", "intent"))
    assert spec.shape == (5, 7)


# -- refusals -------------------------------------------------------------------------------------------------


def test_the_command_line_names_every_channel():
    assert tuple(CHANNELS) == CHANNEL_NAMES


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: seen_through(highway(), "exact+radar"), "unknown channel 'radar'; have confidence"),
        (lambda: seen_through(highway(), "radar+intent"), "unknown sensor 'radar'; have exact"),
        (lambda: Intent(highway({"type": "TimeToCollision"})), "not to TimeToCollisionObservation"),
        (lambda: Intent(highway({**SEEN, "features": ["presence", "x", "y"]})), "lacks vx, vy"),
        (lambda: Confidence(highway(), window=1), "window"),
        (lambda: Intent(highway(), threshold=-0.1), "threshold"),
        (lambda: TrackedConfidence(highway(), distance=0.0), "distance"),
        (lambda: TrackedConfidence(highway({**SEEN, "order": "shuffled"})), "sorted"),
    ],
)
def test_invalid_channels_are_refused(make, match):
    with pytest.raises(ConfigError, match=match):
        make()


def test_a_sensor_by_name_has_the_named_wrappers():
    env = seen_through(highway(), "metric-2+intent")
    assert isinstance(env, Intent)
    assert isinstance(env.env, SensorNoise)
    assert env.env.model is SENSORS["metric-2"]
    plain = highway()
    assert seen_through(plain, "exact") is plain
