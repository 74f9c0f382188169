"""A row for each decision: the same for any distribution of the episodes, and complete after a continued run."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from evaluation import Experiment
from evaluation.commands.cli import app
from evaluation.running.store_rows import KEY
from evaluation.settings import Setting
from shield.errors import ConfigError

SHORT = Setting("short", "highway-fast-v0", {"duration": 5, "vehicles_count": 10})


def asked(folder, **options):
    given = {"episodes": 3, "shield": ["none", "full"], "config": "worst-case", "seed": 100_010}
    where = {"output": folder / "x.parquet", "steps": folder / "steps.parquet"}
    return Experiment("random", SHORT, **{**given, **where, **options})


def same(one, two):
    pd.testing.assert_frame_equal(one.drop(columns="latency_ms"), two.drop(columns="latency_ms"))


def test_the_rows_of_decisions_add_up_to_those_of_episodes(tmp_path):
    """Decisions, returns, overrides, distances and the last speed; two processes write the same as one."""
    result = asked(tmp_path).run(progress=False)
    steps = pd.read_parquet(tmp_path / "steps.parquet")
    assert "decisions" not in result.episodes
    assert "decisions" not in pd.read_parquet(tmp_path / "x.parquet")
    for _, row in result.episodes.iterrows():
        mine = steps[(steps[list(KEY)] == row[list(KEY)].to_list()).all(axis=1)]
        assert mine["step"].tolist() == list(range(row["steps"]))
        assert mine["reward"].sum() == pytest.approx(row["return"])
        assert mine["overridden"].sum() == row["overridden"]
        assert mine["frames_overridden"].sum() == row["frames_overridden"]
        assert mine["input_distance"].mean() == pytest.approx(row["input_distance"])
        assert mine["on_lane"].mean() == row["on_lane_share"]
        assert mine["crashed"].any() == row["crashed"]
        differ = mine["proposed"].map(list) != mine["executed"].map(list)
        assert (differ == (mine["input_distance"] > 0)).all()
        assert (differ <= mine["overridden"]).all()
    other = tmp_path / "two"
    asked(other, jobs=2).run(progress=False)
    same(pd.read_parquet(other / "steps.parquet"), steps)


def test_the_decisions_of_shards_are_those_of_the_whole(tmp_path):
    """The shards are unchanged. Shards that do not fit are refused, and nothing is written."""
    asked(tmp_path, shield="none").run(progress=False)
    for i in (1, 2):
        where = {"output": tmp_path / f"part-{i}.parquet", "steps": tmp_path / f"steps-{i}.parquet"}
        asked(tmp_path, shield="none", shard=(i, 2), **where).run(progress=False)
    named = [str(tmp_path / f"{name}-{i}.parquet") for name in ("part", "steps") for i in (1, 2)]
    merge, out = ["merge", str(tmp_path / "all.parquet")], tmp_path / "all-steps.parquet"
    for files, options, said in (
        (named, [], "has a row for each decision; --steps FILE.parquet"),
        (named[:2], ["--steps", str(out)], "give them beside the parts"),
        (named[:3], ["--steps", str(out)], "decisions of 1 of 3 episodes are missing"),
        ([*named, named[3]], ["--steps", str(out)], "in two of the --steps files"),
        (named, ["--steps", str(tmp_path / "all.csv")], "must end in .parquet"),
    ):
        ended = CliRunner().invoke(app, [*merge, *files, *options])
        assert said in str(ended.exception), said
        assert not out.exists()
        assert not (tmp_path / "all.parquet").exists()
    done = CliRunner().invoke(app, [*merge, *named, "--steps", str(out)], catch_exceptions=False)
    assert done.exit_code == 0
    same(pd.read_parquet(out), pd.read_parquet(tmp_path / "steps.parquet"))


def test_a_continued_run_has_all_decisions(tmp_path):
    """Also those of earlier episodes; an error says where they are missing."""
    whole = asked(tmp_path / "whole", episodes=4).run(progress=False)
    asked(tmp_path).run(progress=False)
    result = asked(tmp_path, episodes=4, resume=True).run(progress=False)
    assert len(result.episodes) == len(whole.episodes) == 8
    tables = [pd.read_parquet(folder / "steps.parquet") for folder in (tmp_path, tmp_path / "whole")]
    same(*(each.sort_values([*KEY, "step"], ignore_index=True) for each in tables))
    (tmp_path / "steps.parquet").unlink()
    with pytest.raises(ConfigError, match=r"8 episodes that are there already have no decisions in .*steps.parquet"):
        asked(tmp_path, episodes=5, resume=True).run(progress=False)
    pd.DataFrame({"a": [1]}).to_parquet(tmp_path / "steps.parquet")
    with pytest.raises(ConfigError, match="has other columns than a table of decisions"):
        asked(tmp_path, episodes=5, resume=True).run(progress=False)


def test_the_command_refuses_an_existing_file(tmp_path):
    run, file = CliRunner(), tmp_path / "steps.parquet"
    words = ["evaluate", "--policy", "idle", "--shield", "none", "--episodes", "1", "--jobs", "1", "--steps", str(file)]
    assert run.invoke(app, words).exit_code == 0
    assert np.isfinite(pd.read_parquet(file)["acceleration"].iloc[0])
    assert "exists already; --force overwrites it" in str(run.invoke(app, words).exception)
    assert run.invoke(app, [*words, "--force"]).exit_code == 0
    assert "must end in .parquet" in str(run.invoke(app, [*words[:-1], "steps.csv"]).exception)
