"""Collection of transitions: the motion in parking, the own generator, terminal transitions, any action space."""

from __future__ import annotations

import gymnasium as gym
import highway_env  # noqa: F401
import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.errors import ConfigError, DataError
from dynamics.learned.data.collect import RESET_SEEDS, RepeatedRandomPolicy, collect
from dynamics.learned.models.bicycle import BicycleModel
from dynamics.learned.tasks import parking_state as parking


class Countdown(gym.Env):
    """Counts its decisions; ends by itself after `end`, is cut off after `limit`."""

    observation_space = spaces.Box(-np.inf, np.inf, (1,))

    def __init__(self, end: int = 99, limit: int = 99, space: spaces.Space | None = None) -> None:
        self.end, self.limit = end, limit
        self.action_space = spaces.Box(-2.0, 6.0, (1,)) if space is None else space
        self.seeds: list[int] = []
        self.actions: list[object] = []

    def reset(self, *, seed=None, options=None):
        self.seeds.append(seed)
        self.count = 0
        # highway-env does so: a generator that was seeded before is lost.
        self.action_space = type(self.action_space)(**_arguments(self.action_space))
        return np.zeros(1), {}

    def step(self, action):
        self.count += 1
        self.actions.append(action)
        return np.array([float(self.count)]), 0.0, self.count == self.end, self.count == self.limit, {}


def _arguments(space):
    return {"low": space.low, "high": space.high} if isinstance(space, spaces.Box) else {"n": space.n}


def gather(env, n=20, seed=0, policy=None, **options):
    return collect(env, policy, n, seed, state=lambda observation: observation, dt=0.2, **options)


@settings(deadline=None)
@given(st.integers(2, 6), st.integers(1, 40), st.integers(0, 9))
def test_the_last_transition_of_an_episode_that_ended_by_itself_is_dropped(end, n, seed):
    data = gather(Countdown(end=end), n, seed)
    assert len(data) == n
    assert data.next_states.max() <= end - 1


@settings(deadline=None)
@given(st.integers(1, 6), st.integers(1, 40), st.booleans())
def test_the_last_transition_of_a_truncated_episode_is_kept(limit, n, by_option):
    env = Countdown() if by_option else Countdown(limit=limit)
    data = gather(env, n, episode_steps=limit if by_option else None)
    assert data.next_states.max() == min(limit, n)
    assert len(env.seeds) == -(-n // limit)


@settings(deadline=None)
@given(st.integers(0, 99), st.integers(1, 4))
def test_the_same_seed_gives_the_same_data_and_another_gives_others(seed, hold):
    a, b, c = (gather(Countdown(limit=5), 15, s, hold=hold) for s in (seed, seed, seed + 1))
    np.testing.assert_array_equal(a.actions, b.actions)
    assert (a.actions != c.actions).any()


@settings(deadline=None)
@given(st.integers(0, 99))
def test_episodes_are_reset_with_seeds_of_training(seed):
    env = Countdown(limit=2)
    gather(env, 20, seed)
    assert all(0 <= s < RESET_SEEDS for s in env.seeds)
    assert len(set(env.seeds)) > 1


@settings(deadline=None)
@given(st.integers(0, 99))
def test_actions_of_a_box_are_scaled_to_minus_one_to_one(seed):
    env = Countdown(limit=4)
    data = gather(env, 12, seed)
    np.testing.assert_allclose(data.actions * 4 + 2, np.array(env.actions), atol=1e-6)
    assert np.abs(data.actions).max() <= 1
    assert np.ptp(data.actions) > 0.5


def test_discrete_actions_are_collected_one_hot():
    env = Countdown(limit=4, space=spaces.Discrete(3))
    data = gather(env, 30)
    np.testing.assert_array_equal(data.actions, np.eye(3)[env.actions])
    assert data.actions.any(axis=0).all()


class Alternating:
    """A policy with a state of its own."""

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        count = 0 if np.all(episode_start) else state
        return np.array([9.0 if count % 2 else -2.0]), count + 1


def test_any_policy_with_predict_drives_and_gets_its_state_back():
    data = gather(Countdown(limit=3), 6, policy=Alternating())
    np.testing.assert_array_equal(data.actions[:, 0], [-1, 1, -1, -1, 1, -1])
    assert data.origin["policy"] == "Alternating"


@settings(deadline=None)
@given(st.integers(1, 6), st.integers(0, 99))
def test_a_random_action_is_held_for_a_limited_time(hold, seed):
    policy = RepeatedRandomPolicy(spaces.Box(-1, 1, (2,)), np.random.default_rng(seed), hold)
    actions = np.array([policy.predict(None)[0] for _ in range(60)])
    lengths = np.diff(np.flatnonzero(np.r_[True, (np.diff(actions, axis=0) != 0).any(axis=1), True]))
    assert lengths.max() <= hold
    assert (len(set(lengths[:-1])) > 1) == (hold > 1)


@settings(deadline=None)
@given(st.integers(0, 9))
def test_parking_moves_like_the_bicycle(seed):
    """In SI units, without the effect of a crash, up to rounding."""
    env = gym.make("parking-v0")
    data = collect(env, None, 25, seed, state=parking.state, dt=parking.DT, hold=5)
    env.close()
    assert data.widths == (parking.STATE_DIM, parking.ACTION_DIM)
    np.testing.assert_allclose(BicycleModel().step(data.states, data.actions), data.next_states, atol=1e-5)


test_parking_moves_like_the_bicycle = pytest.mark.filterwarnings("ignore")(test_parking_moves_like_the_bicycle)


@settings(deadline=None)
@given(st.lists(st.floats(-100, 100), min_size=6, max_size=6))
def test_states_and_observations_are_inverse(values):
    observation = parking.observation(values)
    np.testing.assert_allclose(parking.state({"observation": observation}), values, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(parking.goal({"desired_goal": observation}), values, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("bad", [np.zeros(6), {}, {"observation": np.zeros(5)}, {"observation": "x"}, None])
def test_an_observation_of_another_environment_than_parking_is_refused(bad):
    with pytest.raises(DataError, match="observation"):
        parking.state(bad)


def test_invalid_collection_settings_are_refused():
    with pytest.raises(ConfigError, match="must be positive"):
        gather(Countdown(), 0)
    with pytest.raises(ConfigError, match="hold"):
        gather(Countdown(), 5, hold=0)
    for space in (spaces.MultiDiscrete([2, 2]), spaces.Box(-np.inf, np.inf, (1,)), spaces.Box(-1, 1, (2, 2))):
        with pytest.raises(ConfigError, match="Discrete or a bounded Box"):
            gather(Countdown(space=space))
    with pytest.raises(DataError, match="nothing to learn from"):
        gather(Countdown(end=1))


def test_a_state_that_is_not_finite_is_refused():
    with pytest.raises(DataError, match="must be finite"):
        collect(Countdown(), None, 5, state=lambda observation: observation * np.nan, dt=0.2)
