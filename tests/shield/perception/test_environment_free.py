"""A shield with the arguments of `predict` alone: it queries its prior map once, and reads no simulator state."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import TransformObservation
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from seen_highway import FRAMELESS, SEEN, Actions, configured, driven, driven_in_parallel, make, record
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecFrameStack, VecMonitor, VecNormalize

from dynamics.roads.straight import StraightRoad
from dynamics.scenes.scene import SceneReader
from evaluation.learning.fast_vec_env import FastHighwayVecEnv
from evaluation.wrappers import SENSORS, SensorNoise
from shield import ConfigError, Known, ObservationSpec, Shield, ShieldedEnv
from shield.decision import Reason, Tier

# -- an environment that is out of reach ----------------------------------------------------------------------------


@given(actions=st.lists(st.integers(0, 4), min_size=3, max_size=8), seed=st.integers(0, 3_000))
@settings(max_examples=3, deadline=None, phases=[Phase.generate])
def test_observations_alone_decide_as_with_the_environment(actions, seed):
    """The target command and the clock equal the environment's in every decision. With every vehicle observed,
    decisions equal those from the simulator's state."""
    env = make()
    one = driven(Shield(Actions(actions), env=env, **FRAMELESS), env, seed, 12)
    assert driven(Shield(Actions(actions), known=Known.from_config(configured()), **FRAMELESS), env, seed, 12) == one
    state = driven(Shield(Actions(actions), env, "worst-case", frames=False), env, seed, 12)
    # A violation is seen in exact states only, and with it the choice of the fallback.
    for there, seen in zip(state, one, strict=False):
        assert (there[1].fallback, there[4]) == (seen[1].fallback, seen[4])
        if there[1].fallback:
            break
        assert there[:3] == seen[:3]
        assert there[3] == pytest.approx(seen[3], abs=0.01)
    assert len(one) > 1


def test_the_order_of_the_rows_does_not_change_decisions():
    rng, known = np.random.default_rng(0), Known.from_config(configured({**SEEN, "order": "shuffled"}))
    env = make()

    def mixed(obs):
        return obs[[0, *(1 + rng.permutation(len(obs) - 1))]]

    found = [driven(Shield(Actions([3, 0, 2]), known=known, **FRAMELESS), env, 0, 12, each) for each in (list, mixed)]
    assert found[0] == found[1]


LAYERS = {
    "stacked": lambda env: VecFrameStack(env, 3),
    "stacked on the first axis": lambda env: VecFrameStack(env, 2, channels_order="first"),
    "normalised": lambda env: VecMonitor(VecNormalize(env, clip_obs=1e9)),
    "normalised, then stacked": lambda env: VecFrameStack(VecNormalize(env, clip_obs=1e9), 2),
    "stacked, then normalised": lambda env: VecNormalize(VecFrameStack(VecMonitor(env), 2), clip_obs=1e9),
}


def envs(two=2, wrap=lambda env: env, **config):
    return [lambda: wrap(make(duration=4, **config)) for _ in range(two)]


@pytest.mark.parametrize("layers", ["stacked, then normalised"])
@pytest.mark.parametrize("told", [True, False])
def test_the_state_of_another_process_is_not_queried(layers, told, monkeypatch):
    """After one query for the configuration the shield decides as with local environments, without further queries."""
    wrap = LAYERS[layers]
    local, remote = DummyVecEnv(envs()), SubprocVecEnv(envs(), start_method="fork")
    try:
        asked = []
        ask = remote.get_attr
        monkeypatch.setattr(remote, "get_attr", lambda name, indices=None: asked.append(name) or ask(name, indices))
        near, far = wrap(local), wrap(remote)
        asked.clear()
        shields = [Shield(Actions([3, 3, 0, 2]), env=env, **FRAMELESS) for env in (near, far)]
        assert asked == ["config"]

        def forbidden(*args, **kwargs):
            raise AssertionError("another process was asked for something")

        with monkeypatch.context() as deciding:
            for name in ("get_attr", "set_attr", "has_attr", "env_method", "env_is_wrapped", "get_images"):
                deciding.setattr(remote, name, forbidden)
            found = [driven_in_parallel(s, e, 11, 10, told) for s, e in zip(shields, (near, far), strict=True)]
        assert found[0] == found[1]
        assert all(each[4].value != "none" or each[1] is not Tier.EMERGENCY for row in found[1] for each in row)
        # With states to read, the same shield is refused, and the configuration says which remedies there are.
        with pytest.raises(ConfigError, match="other processes"):
            Shield(Actions([3]), env=far)
        with pytest.raises(ConfigError, match="frames=False, or put the shield inside"):
            Shield(Actions([3]), env=far, perception="observation")
        assert set(asked) == {"config"}
    finally:
        remote.close()


def test_a_model_in_other_processes_needs_nothing_else():
    remote = SubprocVecEnv(envs(wrap=Monitor), start_method="fork")
    try:
        model = PPO("MlpPolicy", remote, n_steps=8, batch_size=8, device="cpu")
        shielded = Shield(model, **FRAMELESS)
        driven_in_parallel(shielded, model.get_env(), 0, 5)
        assert [each.reason for each in shielded.last_decisions] != [Reason.BAD_SCENE] * 2
    finally:
        remote.close()


@pytest.mark.parametrize("layers", LAYERS)
def test_the_compiled_highway_is_shielded_from_its_observations(layers):
    """Each wrapper is undone, in the right order: decisions equal those from the unwrapped observation."""
    found = []
    for wrap in (lambda env: env, LAYERS[layers]):
        env = wrap(FastHighwayVecEnv(2, "highway-fast-v0", {"observation": SEEN, "duration": 4}))
        found.append(driven_in_parallel(Shield(Actions([3, 2, 0]), env=env, **FRAMELESS), env, 3, 9))
    assert found[0] == found[1]


def test_a_sensor_in_another_process_says_how_noisy_it_is():
    def wrap(env):
        return SensorNoise(env, SENSORS["metric-2-late"])

    remote = SubprocVecEnv(envs(1, wrap), start_method="fork")
    try:
        with pytest.raises(ConfigError, match="reset the environments before"):
            Known.of(remote)
        remote.reset()
        (known,) = Known.of(remote)
        assert known.noise == pytest.approx((2.0, 2.0, 2.0, 2.0))
        assert known.delay == 5
        assert not known.spec.clip
        shielded = Shield(Actions([1]), env=remote, **FRAMELESS)
        shielded.predict(remote.reset())
        assert shielded.last_decision.guarantee.value in ("probabilistic", "none")
        assert shielded.last_decision.level < 1
    finally:
        remote.close()


def test_an_ego_that_did_not_execute_its_action_is_detected():
    """Without `episode_start` a new episode is assumed; with it, another driver is at the wheel."""
    env, known = make(), Known.from_config(configured())
    obs, _ = env.reset(seed=4)
    unsaid, said = (Shield(Actions([1]), known=known, **FRAMELESS) for _ in range(2))
    unsaid.predict(obs)
    said.predict(obs, episode_start=np.array([True]))
    for action in (4, 4):  # slower than its command
        obs, *_ = env.step(action)
    said.predict(obs, episode_start=np.array([False]))
    assert said.last_decision.reason is Reason.BAD_SCENE
    assert said.last_decision.tier.fallback
    unsaid.predict(obs)
    assert unsaid.last_decision.reason is not Reason.BAD_SCENE
    fresh = Shield(Actions([1]), known=known, **FRAMELESS)
    fresh.predict(obs)
    assert record(unsaid.last_decision) == record(fresh.last_decision)
    said.predict(obs, episode_start=np.array([True]))
    assert said.last_decision.reason is not Reason.BAD_SCENE


def test_the_target_command_is_known_after_an_unreadable_observation():
    """One observation is lost: the ego follows its command all the same, and the next observation is read as usual."""
    env, known = make(), Known.from_config(configured())
    shielded, obs = Shield(Actions([3]), known=known, **FRAMELESS), env.reset(seed=2)[0]
    for k in range(6):
        action, _ = shielded.predict(np.full_like(obs, np.nan) if k == 2 else obs, episode_start=np.array([k == 0]))
        assert (shielded.last_decision.reason is Reason.BAD_SCENE) is (k == 2)
        control = shielded._filters[0].reader._target
        obs, *_ = env.step(int(action))
        ego = env.unwrapped.vehicle
        assert (control.lane, control.speed) == (ego.target_lane_index[2], ego.target_speed)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"observation": {"type": "TimeToCollision"}}, "not TimeToCollision: set"),
        ({"observation": {**SEEN, "features": ["x", "y"]}}, "lacks vx, vy: add them to config"),
        ({"action": {"type": "ContinuousAction"}}, "DiscreteMetaAction, not 'ContinuousAction'"),
        ({"controlled_vehicles": 2}, "one ego, not 2"),
    ],
)
def test_a_configuration_without_a_prior_map_is_refused_with_the_setting_to_change(change, match):
    with pytest.raises(ConfigError, match=match):
        Known.from_config(configured(**change))


def test_a_prior_map_is_checked():
    known, road = Known.from_config(configured()), StraightRoad.from_lanes(3)
    with pytest.raises(ConfigError, match="lacks lanes_count"):
        Known.from_config({key: value for key, value in configured().items() if key != "lanes_count"})
    with pytest.raises(ConfigError, match="along x only"):
        Known(known.spec, StraightRoad.from_lanes(3, heading=1.0), 0.2, 5)
    with pytest.raises(ConfigError, match="target speeds ascend"):
        Known(known.spec, road, 0.2, 5, target_speeds=(20.0,))
    with pytest.raises(ConfigError, match="dt, frames and stacked"):
        Known(known.spec, road, 0.0, 5)
    with pytest.raises(ConfigError, match="frames=False, or put"):
        Shield(Actions([1]), known=known, perception="observation")
    with pytest.raises(ConfigError, match="known is for"):
        Shield(Actions([1]), known=known, frames=False)
    with pytest.raises(ConfigError, match="1 environments, and 2 are known"):
        Shield(Actions([1]), env=make(), known=[known, known], **FRAMELESS)


def test_the_prior_map_from_a_configuration_is_that_of_the_environment():
    for name, change in (
        ("highway-v0", {}),
        ("highway-fast-v0", {"action": {"type": "DiscreteMetaAction", "lateral": False}}),
    ):
        env = gym.make(name, config=change)
        env.reset(seed=0)
        reader, known = SceneReader(env), Known.from_config(env.unwrapped.config)
        scene = reader.read()
        assert known.spec == ObservationSpec.of(env)
        np.testing.assert_array_equal(known.road.centers, scene.road.centers)
        assert (known.road.width, known.road.length) == (scene.road.width, scene.road.length)
        assert (known.dt, known.frames, known.actions) == (scene.dt, scene.frames_per_decision, scene.control.actions)
        assert known.target_speeds == scene.control.target_speeds


@pytest.mark.parametrize(
    ("wrap", "match"),
    [
        (lambda env: ShieldedEnv(env), "ShieldedEnv already"),
        (
            lambda env: TransformObservation(env, lambda obs: 2 * obs, env.observation_space),
            "TransformObservation changes",
        ),
    ],
)
def test_wrappers_that_cannot_be_undone_are_refused_in_other_processes(wrap, match):
    remote = SubprocVecEnv(envs(1, wrap), start_method="fork")
    try:
        with pytest.raises(ConfigError, match=match):
            Shield(Actions([1]), env=remote, **FRAMELESS)
    finally:
        remote.close()


def test_an_environment_with_a_road_of_its_own_has_to_be_described():
    env = DummyVecEnv([lambda: gym.make("roundabout-v0", config={"observation": SEEN})])
    with pytest.raises(ConfigError, match=r"road of RoundaboutEnv is not known.* known=Known"):
        Known.of(env)
