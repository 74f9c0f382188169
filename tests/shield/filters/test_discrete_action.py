"""Throttle and steering in steps: `DiscreteAction`, and a grid with a number of steps for each."""

from __future__ import annotations

import gymnasium as gym
import highway_env  # noqa: F401
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from policies import Always
from stable_baselines3 import DQN

from dynamics.vehicle.actuators import Actuators
from shield import ConfigError, Shield, ShieldConfig, ShieldedEnv

EXACT = ShieldConfig.simulated_traffic()
COMPLEX = "evaluation.scenarios:ComplexRoads-v0"


def make(env_id="highway-fast-v0", **action):
    return gym.make(env_id, config={"action": {"type": "DiscreteAction", **action}})


@pytest.mark.parametrize("options", [{}, {"actions_per_axis": 5}, {"lateral": False}, {"longitudinal": False}])
def test_each_number_means_the_inputs_that_highway_env_applies(options):
    env = make(**options)
    env.reset(seed=0)
    base = env.unwrapped
    actuators = Actuators.of(base.action_type)
    for action in range(env.action_space.n):
        base.action_type.act(action)
        low = base.vehicle.action
        assert actuators.physical(actuators.read(action)) == pytest.approx([low["acceleration"], low["steering"]])
    for wrong in (-1, env.action_space.n, 0.5, np.nan, [0, 1], None):
        assert actuators.read(wrong) is None


def test_the_inputs_of_a_grid_are_read_from_the_environment():
    env = gym.make(COMPLEX)
    env.reset(seed=0)
    base = env.unwrapped
    actuators = Actuators.of(base.action_type)
    assert len(actuators.choices) == 45
    for action in range(45):
        base.action_type.act(action)
        low = base.vehicle.action
        assert actuators.physical(actuators.read(action)) == pytest.approx([low["acceleration"], low["steering"]])


@given(st.floats(-12, 12), st.floats(-1.5, 1.5), st.integers(2, 7))
def test_the_nearest_number_is_nearest(acceleration, wheel, count):
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, count)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    actuators = Actuators(choices=grid)
    chosen = actuators.normalised(np.array([acceleration, wheel]))
    exact = np.clip([acceleration / 5, wheel / (np.pi / 4)], -1, 1)
    assert np.abs(grid[chosen] - exact).sum() == pytest.approx(np.abs(grid - exact).sum(axis=1).min())


@pytest.mark.parametrize("config", [ShieldConfig(), EXACT], ids=["certificate", "exact"])
@pytest.mark.parametrize("placement", ["env", "policy"])
def test_full_throttle_does_not_crash(config, placement):
    """The executed action is a number again; between decisions, the frames get the verified inputs."""
    env, action = make(policy_frequency=5), 7
    if placement == "env":
        env = ShieldedEnv(env, config)
    obs, _ = env.reset(seed=11)
    shield = Shield(Always(action), env, config) if placement == "policy" else None
    for _ in range(60):
        taken = action if shield is None else shield.predict(obs)[0]
        assert np.issubdtype(np.asarray(taken).dtype, np.integer)
        obs, _, terminated, truncated, _ = env.step(int(taken))
        decision = shield.last_decision if shield else env.last_decision
        assert env.action_space.contains(int(decision.executed))
        assert not terminated
        if truncated:
            break


@pytest.mark.parametrize("env_id", ["highway-fast-v0", "parking-v0"])
def test_a_fail_safe_that_the_numbers_do_not_have_is_refused(env_id):
    """Braking in the lane is none of a few inputs, and with actions alone there is nothing else to brake with."""
    with pytest.raises(ConfigError, match=r"frames=False.*ShieldedEnv"):
        Shield(Always(0), make(env_id), frames=False)


def test_dqn_learns_inside_the_shield():
    env = ShieldedEnv(gym.make(COMPLEX, config={"duration": 5, "vehicle_density": 4}), EXACT)
    model = DQN("MlpPolicy", env, learning_starts=4, buffer_size=100, device="cpu", seed=0)
    model.learn(20)
    assert not env.unwrapped.vehicle.crashed


def test_a_drive_on_complex_roads_matches_its_prediction():
    """Including the ego: predicting its motion does not move it."""
    env = ShieldedEnv(gym.make(COMPLEX, config={"random_start": True}), EXACT)
    for seed in (20, 21):
        env.reset(seed=seed)
        rng = np.random.default_rng(seed)
        for _ in range(40):
            *_, terminated, _, info = env.step(int(rng.integers(45)))
            assert not env._filter._scene.mismatched
            assert env.unwrapped.vehicle.on_road
            assert info["shield"]["violations"] == 0
            if terminated:
                break
        assert not env.unwrapped.vehicle.crashed
