"""The queue of episodes against a list of them, and after a stop."""

from __future__ import annotations

import json
import shutil
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynamics.errors import ConfigError
from dynamics.world_model.episode_queue import EpisodeQueue

COLUMNS = {"frame": ((2, 3), "uint8"), "reward": ((), "float32")}
CAPACITY = 20


def episode(steps: int, number: int) -> dict[str, np.ndarray]:
    """An episode whose rewards are its number and the step."""
    rewards = (100 * number + np.arange(steps)).astype(np.float32)
    return {"frame": (rewards[:, None, None] + np.arange(6).reshape(2, 3)).astype(np.uint8), "reward": rewards}


def newest(added: list[int]) -> list[int]:
    """Numbers of the episodes that a queue without gaps would keep at least: the newest that fill half of it."""
    kept, steps = [], 0
    for number in range(len(added) - 1, -1, -1):
        steps += added[number]
        if steps > CAPACITY // 2 and kept:
            break
        kept.append(number)
    return kept[::-1]


@given(st.lists(st.integers(1, CAPACITY), min_size=1, max_size=25))
def test_the_queue_keeps_the_newest_episodes_whole_and_in_order(lengths: list[int]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        queue = EpisodeQueue(folder, COLUMNS, CAPACITY)
        for number, steps in enumerate(lengths):
            queue.add(episode(steps, number))
            kept = [int(queue.episode(i)["reward"][0]) // 100 for i in range(len(queue.lengths))]
            assert kept == list(range(number + 1 - len(kept), number + 1))
            assert set(newest(lengths[: number + 1])) <= set(kept)
            assert len(queue) == sum(queue.lengths) <= CAPACITY
            for i, each in enumerate(kept):
                for name, values in episode(lengths[each], each).items():
                    assert (queue.episode(i)[name] == values).all()
        again = EpisodeQueue.open(folder)
        assert again.lengths == queue.lengths
        assert (again.episode(-1)["frame"] == queue.episode(-1)["frame"]).all()


@given(st.lists(st.integers(1, 8), min_size=3, max_size=12), st.integers(1, 6), st.integers(0, 99))
def test_sequences_follow_the_episodes(lengths: list[int], length: int, seed: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        queue = EpisodeQueue(folder, COLUMNS, CAPACITY)
        for number, steps in enumerate(lengths):
            queue.add(episode(steps, number))
        length = min(length, len(queue))
        sample = queue.sample(32, length, np.random.default_rng(seed))
        assert sample["frame"].shape == (32, length, 2, 3)
        assert sample["first"][:, 0].all()
        # The next step is the next of the episode, or the first of the next episode.
        number, step = np.divmod(sample["reward"].astype(int), 100)
        begins = sample["first"][:, 1:]
        assert (np.diff(number) == begins).all()
        assert (step[:, 1:][begins] == 0).all()
        assert (np.diff(step)[~begins] == 1).all()
        # All steps that can begin a sequence do.
        many = queue.sample(2000, length, np.random.default_rng(seed))["reward"][:, 0]
        assert len(set(many.tolist())) == len(queue) - length + 1


def test_a_stop_while_an_episode_is_added_loses_that_episode_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    queue = EpisodeQueue(tmp_path / "queue", COLUMNS, CAPACITY)
    for number in range(3):
        queue.add(episode(6, number))
    flushed = []

    class Stop(Exception):
        pass

    def stop(self: EpisodeQueue) -> None:
        flushed.append(len(self._episodes))
        if len(flushed) == 2:
            raise Stop
        write(self)

    write = EpisodeQueue._write_index
    monkeypatch.setattr(EpisodeQueue, "_write_index", stop)
    with pytest.raises(Stop):
        queue.add(episode(6, 3))
    monkeypatch.undo()
    again = EpisodeQueue.open(tmp_path / "queue")
    assert [int(again.episode(i)["reward"][0]) // 100 for i in range(len(again.lengths))] == [1, 2]
    assert all((again.episode(i)["frame"] == episode(6, i + 1)["frame"]).all() for i in range(2))
    again.add(episode(6, 4))
    assert again.lengths == [6, 6, 6]


def test_episodes_and_folders_that_do_not_fit(tmp_path: Path) -> None:
    queue = EpisodeQueue(tmp_path / "queue", COLUMNS, CAPACITY)
    good = episode(3, 0)
    for wrong in (
        {"frame": good["frame"]},
        {**good, "action": good["reward"]},
        {**good, "reward": good["reward"][:2]},
        {**good, "frame": good["frame"][:, :1]},
        episode(CAPACITY + 1, 0),
        {name: values[:0] for name, values in good.items()},
    ):
        with pytest.raises(ConfigError):
            queue.add(wrong)
    assert len(queue) == 0
    with pytest.raises(ConfigError, match="1 to 0 steps"):
        queue.sample(1, 1, np.random.default_rng(0))
    with pytest.raises(ConfigError, match="not empty"):
        EpisodeQueue(tmp_path / "queue", COLUMNS, CAPACITY)
    for columns in ({}, {"first": ((), "bool")}, {"no name": ((), "bool")}):
        with pytest.raises(ConfigError, match="columns"):
            EpisodeQueue(tmp_path / "other", columns, CAPACITY)
    with pytest.raises(ConfigError, match="at least 1"):
        EpisodeQueue(tmp_path / "other", COLUMNS, 0)
    with pytest.raises(ConfigError, match="no queue"):
        EpisodeQueue.open(tmp_path)
    shutil.copytree(tmp_path / "queue", tmp_path / "broken")
    (tmp_path / "broken" / "index.json").write_text(json.dumps({"capacity": 3}))
    with pytest.raises(ConfigError, match="no queue"):
        EpisodeQueue.open(tmp_path / "broken")
