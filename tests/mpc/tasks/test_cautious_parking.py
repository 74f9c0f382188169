"""A cost of disagreement: plans avoid places where an ensemble is uncertain; MPPI drives as CEM does."""

from __future__ import annotations

import gymnasium as gym
import highway_env  # noqa: F401
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.errors import ConfigError
from dynamics.learned.models.bicycle import BicycleModel
from mpc.cem_policy import CEMPolicy
from mpc.sampling.mppi import MPPI
from mpc.sampling.plan import evaluate
from mpc.tasks.cautious_parking import CautiousTask
from mpc.tasks.parking import PROFILES, ParkingTask, parking_settings


class Unsure(BicycleModel):
    """A model whose members disagree by a given amount for states on the left of the middle."""

    def disagreement(self, states, actions):
        out = np.zeros((len(states), 6))
        out[:, 0] = np.where(np.asarray(states)[:, 0] < 0, 100.0, 0.0)
        return out


@pytest.fixture(scope="module")
def env():
    made = gym.make("parking-v0")
    made.reset(seed=0)
    yield made
    made.close()


def observation(seed=0):
    rng = np.random.default_rng(seed)
    now = np.array([rng.uniform(-0.2, 0.2), 0.0, 0.0, 0.0, 1.0, 0.0])
    return {"observation": now, "achieved_goal": now, "desired_goal": np.array([0.1, 0.14, 0, 0, 0, 1.0])}


@given(st.integers(0, 1000), st.floats(0, 10))
@settings(max_examples=20, deadline=None)
def test_the_cost_is_the_tasks_and_the_weighted_disagreement(env, seed, weight):
    plain, model = ParkingTask(env), Unsure()
    obs, rng = observation(seed), np.random.default_rng(seed)
    states, _, _ = plain.read(obs)
    samples = rng.uniform(-1, 1, (1, 5, 3, 2)).astype(np.float32)
    grid = parking_settings(blocks=3).grid

    def costs(task):
        return evaluate(model, task.cost(obs, np.ones(1, bool)), states, samples, grid)[0]

    base, one, scaled = (costs(CautiousTask(plain, model, w)) for w in (0.0, 1.0, weight))
    np.testing.assert_array_equal(base, costs(plain))
    np.testing.assert_allclose(scaled, base + weight * (one - base), rtol=1e-4, atol=1e-3)
    assert (one >= base - 1e-5).all()


def test_plans_stay_where_the_model_is_sure(env):
    """Straight ahead lies the left; without the cost the plan goes there."""
    now = np.array([0.05, 0.0, 0.0, 0.0, -1.0, 0.0])
    obs = {"observation": now, "achieved_goal": now, "desired_goal": np.array([-0.15, 0.0, 0, 0, -1.0, 0])}
    reached = {}
    for weight in (0.0, 10.0):
        policy = CEMPolicy.parking(env, Unsure(dtype=np.float32), task=CautiousTask(ParkingTask(env), Unsure(), weight))
        policy.predict(obs)
        reached[weight] = policy.last_plan.trajectory[0, :, 0].min()
    assert reached[0.0] < -5
    assert reached[10.0] > -3


@pytest.mark.parametrize("weight", [-1, np.nan, np.inf])
def test_a_weight_that_is_none_is_refused(env, weight):
    with pytest.raises(ConfigError, match="weight must be"):
        CautiousTask(ParkingTask(env), Unsure(), weight)


def test_mppi_parks(env):
    policy = CEMPolicy.parking(env, temperature=0.05)
    assert isinstance(policy.planner, MPPI)
    parked = 0
    for seed in (7000, 7001):
        obs, _ = env.reset(seed=seed)
        state, done, steps, info = None, False, 0, {}
        while not done and steps < 150:
            action, state = policy.predict(obs, state, np.array([steps == 0]))
            assert env.action_space.contains(action)
            obs, _, terminated, truncated, info = env.step(action)
            done, steps = terminated or truncated, steps + 1
        parked += bool(info["is_success"])
    assert parked == 2
    assert policy.fallbacks == 0


def test_every_way_to_search_has_the_same_samples():
    sizes = {name: parking_settings(name).restarts * parking_settings(name).samples for name in PROFILES}
    assert set(sizes.values()) == {128}
    with pytest.raises(ConfigError, match="have quality, fast, plain, icem, mppi"):
        parking_settings("best")
