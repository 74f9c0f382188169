"""Scenes from observations alone; each record states its guarantee."""

from __future__ import annotations

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from observed_roads import SEEN, make
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecNormalize

from dynamics.scenes.scene import SceneReader
from shield import ConfigError, Shield, ShieldConfig, ShieldedEnv
from shield.decision import Reason
from shield.perception.perceiving import PerceptionConfig
from shield.perception.unwrapping import undo_vec_wrappers


def test_full_observations_give_the_decisions_of_the_simulator_s_state():
    """With every vehicle observed, the shield acts as with the simulator's state."""
    executed = []
    for perception in ("simulator", "observation"):
        env = ShieldedEnv(make({**SEEN, "vehicles_count": 40}), perception=perception)
        env.reset(seed=0)
        over, done = False, []
        while not over:
            _, _, terminated, truncated, info = env.step(3)
            done.append((int(env.last_decision.executed), info["shield"]["frames_overridden"]))
            over = terminated or truncated
            assert not info["crashed"]
        executed.append(done)
    same = sum(a == b for a, b in zip(*executed, strict=False))
    assert same >= 0.9 * len(executed[0])


@pytest.mark.parametrize("observation", [{"type": "Kinematics"}, SEEN])
@pytest.mark.parametrize("action", [0, 2, 3])
def test_the_observation_alone_is_read_and_the_ego_does_not_crash(observation, action, monkeypatch):
    def forbidden(self):
        raise AssertionError("the simulator's state was read")

    monkeypatch.setattr(SceneReader, "read", forbidden)
    env = ShieldedEnv(make(observation), perception="observation")
    env.reset(seed=300)
    over = False
    while not over:
        _, _, terminated, truncated, info = env.step(action)
        over = terminated or truncated
    assert not info["crashed"]


class Faster:
    def predict(self, obs, state=None, episode_start=None, deterministic=False):
        return (np.full(len(obs), 3) if np.ndim(obs) == 3 else 3), state


def test_normalised_and_stacked_observations_are_undone():
    inner = DummyVecEnv([lambda: make(SEEN)])
    world = VecFrameStack(VecNormalize(inner, norm_reward=False, clip_obs=1e6), 3)
    inner.seed(3)
    seen = world.reset()
    for _ in range(3):
        seen, *_ = world.step([1])
    base = inner.envs[0].unwrapped
    shown = undo_vec_wrappers(world, seen)
    np.testing.assert_allclose(shown[0], base.observation_type.observe(), atol=1e-4)
    world.reset()
    shielded = Shield(Faster(), env=world, perception="observation")
    action, _ = shielded.predict(seen)
    assert action.shape == (1,)


@pytest.mark.parametrize("frames", [True, False])
def test_a_shield_around_a_policy_reads_the_observation_of_predict(frames):
    env = make(SEEN)
    obs, _ = env.reset(seed=5)
    shielded = Shield(Faster(), env=env, frames=frames, perception="observation")
    over = False
    while not over:
        action, _ = shielded.predict(obs)
        assert shielded.last_decision.reason is not Reason.BAD_SCENE
        obs, _, terminated, truncated, info = env.step(int(action))
        over = terminated or truncated
    assert not info["crashed"] or not frames


def test_scenes_are_observed_on_straight_highways_only():
    with pytest.raises(ConfigError, match="straight highway"):
        ShieldedEnv(gym.make("roundabout-v0"), perception="observation")
    with pytest.raises(ConfigError, match="unknown perception 'lidar'; have simulator, observation"):
        ShieldedEnv(gym.make("highway-fast-v0"), perception="lidar")


def test_a_decision_says_which_guarantee_it_has():
    def guarantees(observation, perception, action=3, mode="full"):
        env = ShieldedEnv(make(observation, vehicles_count=20), ShieldConfig(mode=mode), perception=perception)
        env.reset(seed=0)
        return {env.step(action)[4]["shield"]["guarantee"] for _ in range(4)}

    assert guarantees(SEEN, "simulator") == {"all vehicles seen"}
    assert guarantees({**SEEN, "vehicles_count": 50}, "observation") == {"all vehicles seen"}
    assert guarantees({"type": "Kinematics"}, "observation") == {"assumed"}
    noisy = PerceptionConfig(noise=(0.5, 0.5, 0.5, 0.5), bound=2.0)
    assert guarantees({**SEEN, "vehicles_count": 50}, noisy) <= {"probabilistic", "none"}
    assert guarantees(SEEN, "simulator", action=9) == {"none"}
    assert guarantees(SEEN, "simulator", mode="distance") == {"none"}
    env = ShieldedEnv(make(SEEN), perception=noisy)
    env.reset(seed=0)
    env.step(1)
    assert env.last_decision.level == pytest.approx(0.9772, abs=1e-4)
