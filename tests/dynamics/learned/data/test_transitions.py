"""Transitions: what is valid, splitting by episode, windows, joining, files."""

from __future__ import annotations

import json

import numpy as np
import pytest
from driving_data import driving
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.errors import DataError, ShieldError
from dynamics.learned.data.transitions import Transitions

lengths = st.lists(st.integers(1, 7), min_size=1, max_size=6)


def walk(episode_lengths: list[int], first: int = 0) -> Transitions:
    """Transitions whose state 0 is their number in the whole, so that every row can be identified."""
    n = sum(episode_lengths)
    episodes = np.repeat(np.arange(len(episode_lengths)), episode_lengths)
    number = first + np.arange(n) + episodes
    states, after = (np.stack([number + k, -(number + k)], axis=1).astype(float) for k in (0, 1))
    return Transitions(states, np.zeros((n, 1)), after, episodes, 0.2)


@settings(deadline=None)
@given(lengths, st.integers(1, 8))
def test_windows_are_all_runs_within_an_episode(episode_lengths, horizon):
    data = walk(episode_lengths)
    states, actions, after = data.sequences(horizon)
    assert len(states) == sum(max(n - horizon + 1, 0) for n in episode_lengths)
    assert actions.shape == (len(states), horizon, 1)
    np.testing.assert_array_equal(after[..., 0], states[:, :1] + np.arange(1, horizon + 1))


@settings(deadline=None)
@given(lengths.filter(lambda x: len(x) > 1), st.floats(0.01, 0.99), st.integers(0, 9))
def test_a_split_parts_whole_episodes_and_loses_nothing(episode_lengths, share, seed):
    data = walk(episode_lengths)
    train, held_out = data.split(share, seed)
    assert not set(train.episodes) & set(held_out.episodes)
    together = np.concatenate([train.states, held_out.states])
    assert sorted(together[:, 0]) == sorted(data.states[:, 0])
    np.testing.assert_array_equal(data.split(share, seed)[0].states, train.states)


@settings(deadline=None)
@given(lengths, lengths)
def test_joined_transitions_stay_different_episodes(a, b):
    joined = walk(a) + walk(b, first=100)
    assert len(joined) == sum(a) + sum(b)
    assert np.unique(joined.episodes, return_counts=True)[1].tolist() == [*a, *b]


@settings(deadline=None)
@given(lengths, st.integers(0, 99))
def test_a_file_preserves_every_bit(tmp_path_factory, episode_lengths, seed):
    data = driving(len(episode_lengths), max(episode_lengths), seed)
    path = data.save(tmp_path_factory.mktemp("data") / "a.npz")
    back = Transitions.load(path)
    for name in ("states", "actions", "next_states", "episodes"):
        np.testing.assert_array_equal(getattr(back, name), getattr(data, name))
    assert (back.dt, back.origin) == (data.dt, data.origin)


@settings(deadline=None)
@given(st.integers(0, 29), st.sampled_from(["states", "actions", "next_states"]), st.sampled_from([np.nan, np.inf]))
def test_a_value_that_is_not_finite_is_refused_and_named(row, name, value):
    parts = {k: getattr(driving(1), k).copy() for k in ("states", "actions", "next_states", "episodes")}
    parts[name][row, 0] = value
    with pytest.raises(DataError, match=f"{name} must be finite.*row {row}"):
        Transitions(**parts, dt=0.2)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"states": np.zeros((0, 2)), "next_states": np.zeros((0, 2)), "actions": np.zeros((0, 1)), "episodes": []},
            "no",
        ),
        ({"actions": np.zeros((4, 1))}, "expected, got"),
        ({"next_states": np.zeros((5, 3))}, "expected, got"),
        ({"states": np.zeros(5)}, "expected, got"),
        ({"episodes": np.zeros((5, 1))}, "expected, got"),
        ({"episodes": [0, 0, 1, 0, 0]}, "in order"),
        ({"episodes": [0, 0, 0, 0, 0]}, "row 3"),
        ({"dt": 0.0}, "dt"),
        ({"dt": float("nan")}, "dt"),
    ],
)
def test_invalid_transitions_are_refused(change, message):
    data = walk([3, 2])
    parts = {k: getattr(data, k) for k in ("states", "actions", "next_states", "episodes", "dt")}
    with pytest.raises(DataError, match=message):
        Transitions(**{**parts, **change})


def test_invalid_splits_windows_and_sums_are_refused():
    with pytest.raises(DataError, match="two episodes"):
        walk([5]).split()
    with pytest.raises(DataError, match="between 0 and 1"):
        walk([5, 5]).split(1.0)
    with pytest.raises(DataError, match="1 transition or more"):
        walk([5]).windows(0)
    with pytest.raises(DataError, match="cannot be joined"):
        walk([5]) + driving(1)
    with pytest.raises(TypeError):
        walk([5]) + 1


def test_a_missing_file_is_an_error_of_the_project(tmp_path):
    with pytest.raises(ShieldError, match="there is no file"):
        Transitions.load(tmp_path / "none.npz")


@pytest.mark.parametrize("content", [b"", b"not a file of arrays", b"PK\x03\x04 broken"])
def test_a_foreign_file_is_refused(tmp_path, content):
    path = tmp_path / "a.npz"
    path.write_bytes(content)
    with pytest.raises(DataError, match="no readable file of transitions"):
        Transitions.load(path)


def test_a_cut_file_is_refused(tmp_path):
    path = driving(2).save(tmp_path / "a.npz")
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(DataError):
        Transitions.load(path)


def test_a_pickled_file_is_refused(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, manifest=np.array([{"format": "transitions/1"}], dtype=object))
    with pytest.raises(DataError, match="no readable file of transitions"):
        Transitions.load(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "other/1"}, "says format 'other/1'"),
        ({"transitions": 3}, "manifest says 3"),
        ({"dt": None}, "manifest"),
    ],
)
def test_a_manifest_that_does_not_fit_is_refused(tmp_path, change, message):
    data = walk([3, 2])
    manifest = {"format": "transitions/1", "dt": 0.2, "transitions": 5, "origin": {}} | change
    arrays = {k: getattr(data, k) for k in ("states", "actions", "next_states", "episodes")}
    np.savez(tmp_path / "a.npz", manifest=np.array(json.dumps(manifest)), **arrays)
    with pytest.raises(DataError, match=message):
        Transitions.load(tmp_path / "a.npz")
