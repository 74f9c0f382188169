"""Transitions survive a round trip through Minari bit for bit; an unreadable data set is an error with a reason."""

from __future__ import annotations

import builtins
from itertools import count

import numpy as np
import pytest
from driving_data import driving
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.errors import ConfigError, DataError
from dynamics.learned.data.minari import from_minari, to_minari
from dynamics.learned.data.transitions import Transitions

numbers = count()


@pytest.fixture(scope="module", autouse=True)
def store(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", str(tmp_path_factory.mktemp("minari")))
        yield


@pytest.fixture
def minari():
    return pytest.importorskip("minari")


@pytest.mark.filterwarnings("ignore")
@given(
    st.lists(st.integers(1, 4), min_size=1, max_size=4),
    st.integers(1, 3),
    st.sampled_from([0.05, 0.2, 1.0]),
    st.integers(0, 2**32 - 1),
)
@settings(max_examples=15, deadline=None)
def test_a_round_trip_through_minari_changes_nothing(lengths, width, dt, seed):
    pytest.importorskip("minari")
    rng = np.random.default_rng(seed)
    tracks = [rng.normal(size=(n + 1, width)) for n in lengths]
    data = Transitions(
        np.concatenate([t[:-1] for t in tracks]),
        rng.uniform(-1, 1, (sum(lengths), 2)),
        np.concatenate([t[1:] for t in tracks]),
        np.repeat(np.arange(len(lengths)), lengths),
        dt,
        {"seed": seed},
    )
    name = f"test/there-{next(numbers)}-v0"
    to_minari(data, name)
    back = from_minari(name)
    for part in ("states", "actions", "next_states", "episodes"):
        assert getattr(back, part).tobytes() == getattr(data, part).tobytes(), part
    assert (back.dt, dict(back.origin)) == (dt, {"seed": seed})


def foreign(minari, actions, space, ends, observations=None):
    """A data set that was not made here, of one episode."""
    from gymnasium import spaces
    from minari.data_collector import EpisodeBuffer

    n, name = len(actions), f"foreign/{next(numbers)}-data-v0"
    observations = np.arange(2.0 * (n + 1)).reshape(-1, 2) if observations is None else observations
    buffer = EpisodeBuffer(
        observations=observations,
        actions=actions,
        rewards=[0.0] * n,
        terminations=[False] * (n - 1) + [ends],
        truncations=[False] * (n - 1) + [not ends],
    )
    minari.create_dataset_from_buffers(
        name,
        [buffer],
        observation_space=spaces.Box(-99, 99, (2,), np.float64),
        action_space=space,
        data_format="arrow",
    )
    return name


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("ends", [True, False])
def test_a_foreign_data_set_is_normalised_and_loses_how_it_ended(minari, ends):
    from gymnasium import spaces

    actions = np.array([[0.0], [5.0], [10.0]])
    name = foreign(minari, actions, spaces.Box(0.0, 10.0, (1,), np.float64), ends)
    with pytest.raises(ConfigError, match="give dt"):
        from_minari(name)
    data = from_minari(name, dt=0.1)
    assert data.actions.ravel().tolist() == [-1.0, 0.0, 1.0][: 2 if ends else 3]
    assert data.next_states[-1].tolist() == ([4.0, 5.0] if ends else [6.0, 7.0])
    doubled = from_minari(name, dt=0.1, state=lambda observations: 2 * observations)
    assert doubled.states.tolist() == (2 * data.states).tolist()


@pytest.mark.filterwarnings("ignore")
def test_discrete_actions_are_one_hot(minari):
    from gymnasium import spaces

    name = foreign(minari, np.array([1, 2, 3]), spaces.Discrete(3, start=1), False)
    assert from_minari(name, dt=1.0).actions.tolist() == np.eye(3).tolist()


@pytest.mark.filterwarnings("ignore")
def test_errors_of_minari_data_sets_name_the_cause(minari):
    data = driving(episodes=2, steps=3)
    to_minari(data, "test/once-v0")
    with pytest.raises(ConfigError, match="already"):
        to_minari(data, "test/once-v0")
    with pytest.raises(ConfigError, match="NAME-vNUMBER"):
        to_minari(data, "once")
    with pytest.raises(ConfigError, match=r"0\.2 s, not of 0\.1"):
        from_minari("test/once-v0", dt=0.1)
    with pytest.raises(DataError, match=r"no readable data set 'test/never-v0'.*test/once-v0"):
        from_minari("test/never-v0")


def test_a_missing_minari_is_an_error_that_names_the_installation(monkeypatch):
    original = builtins.__import__

    def no_minari(name, *rest):
        if name == "minari":
            raise ImportError(name)
        return original(name, *rest)

    monkeypatch.setattr(builtins, "__import__", no_minari)
    for call in (lambda: to_minari(driving(2, 2), "a-v0"), lambda: from_minari("a-v0")):
        with pytest.raises(ConfigError, match=r"pip install.*\[minari\]"):
            call()
