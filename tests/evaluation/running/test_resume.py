"""After any interruption of a run, finished episodes are kept, none lost and none doubled."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pandas as pd
import pytest
from killing import episodes_kept, kill_at_moments
from slowly import later
from typer.testing import CliRunner

from dynamics.errors import ConfigError, DataError
from evaluation.commands.cli import app
from evaluation.experiments import Result
from evaluation.running import store as storing
from evaluation.running.episodes import RunOptions, run_paired
from evaluation.running.records import make_variants
from evaluation.running.store import Store
from evaluation.running.store_rows import KEY, is_store, read_store
from evaluation.settings import Setting

EPISODES = 20
SHORT = Setting("short", "highway-fast-v0", {"duration": 2, "vehicles_count": 5})
ASKED = {"seed": 5, "policies": {"faster": {}}}


def command(folder, *more, episodes=EPISODES):
    (folder / "short.toml").write_text("duration = 2\nvehicles_count = 5\n", encoding="utf-8")
    arguments = ["evaluate", "--env-id", "highway-fast-v0", "--env-config", str(folder / "short.toml"), "--jobs", "1"]
    arguments += ["--policy", "faster", "--episodes", str(episodes), "--output", str(folder / "x.parquet"), *more]
    # In its compiled copy a run would be over before it is killed.
    arguments += ["--simulator", "highway-env"]
    return [sys.executable, "-m", "evaluation.commands.cli", *arguments]


def lines(folder):
    return episodes_kept(folder / "x.parquet")


def same(one, two):
    times = [column for column in one if column.startswith("latenc")]
    pd.testing.assert_frame_equal(one.drop(columns=times), two.drop(columns=times), check_dtype=False)


@pytest.mark.parametrize(("moments", "jobs"), [(2, 1), *later((10, 1), (10, 2))])
def test_a_run_killed_at_several_moments_ends_like_an_uninterrupted_one(moments, jobs, tmp_path):
    """`kill -9`: the episodes kept after one kill remain after the next, each once, and the table is that of an
    uninterrupted run."""
    # So many that the run is not over before the last moment, on a busy machine neither.
    whole, episodes = tmp_path / "whole", 10 * moments
    whole.mkdir()
    subprocess.run(command(whole, episodes=episodes), check=True, capture_output=True)
    asked = command(tmp_path, "--resume", episodes=episodes)
    asked[asked.index("--jobs") + 1] = str(jobs)
    kept = kill_at_moments(asked, tmp_path / "x.parquet", moments)
    assert len(kept) == moments
    assert kept == sorted(set(kept))
    _, rows = read_store(tmp_path / "x.parquet.episodes")
    before = pd.DataFrame(rows)
    assert len(before) >= kept[-1] - 1
    done = subprocess.run(asked, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = pd.read_parquet(tmp_path / "x.parquet")
    same(pd.read_parquet(whole / "x.parquet"), found)
    # Those that were kept were not driven again: their latencies are the same.
    again = before[[*KEY]].merge(found, on=list(KEY))
    assert [list(each) for each in again["latencies_ms"]] == before["latencies_ms"].tolist()
    assert not (tmp_path / "x.parquet.episodes").exists()
    assert found.attrs["made"]["asked"]["episodes"] == episodes


def test_control_c_prints_and_keeps_the_finished_episodes(tmp_path):
    # Enough episodes that a busy machine does not finish before the interruption.
    asked = command(tmp_path)
    asked[asked.index("--episodes") + 1] = "400"
    # A process that a shell starts in the background ignores the signal, and so would its children.
    heed = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    run = subprocess.Popen(asked, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=heed)
    while run.poll() is None and lines(tmp_path) < 4:
        time.sleep(0.005)
    run.send_signal(signal.SIGINT)
    out, err = run.communicate(timeout=60)
    assert run.returncode == 130, err
    assert "crashes %" in out
    assert "--resume goes on from there" in err
    kept = lines(tmp_path)
    assert kept >= 4
    again = subprocess.run(asked, capture_output=True, text=True)
    assert again.returncode == 2
    assert "--resume goes on with it, --force begins again" in " ".join(again.stderr.split())
    assert lines(tmp_path) == kept


def drive(store, jobs=1):
    variants = make_variants(["none", "full"], ["env"])
    return run_paired(SHORT, "faster", variants, range(100, 104), jobs=jobs, run=RunOptions(store=store))


@pytest.mark.parametrize("jobs", [1, 2])
def test_stored_episodes_are_not_driven_again(tmp_path, jobs):
    path = tmp_path / "x.parquet"
    store = Store(path, ASKED)
    frame = drive(store, jobs)
    kept = store.parts.folder / "open.jsonl"
    file = kept.read_bytes().splitlines(keepends=True)
    assert len(file) == 8
    # The last line is truncated, and one line is doubled.
    kept.write_bytes(b"".join([*file[:4], file[2], file[4][:20]]))
    again = Store(path, ASKED, resume=True)
    assert len(again.rows) == 4
    same(frame, drive(again))
    assert len(again.rows) == 8
    assert {len(json.loads(line)) for line in kept.read_bytes().splitlines()} == {len(frame.columns)}
    same(frame, drive(Store(path, ASKED, resume=True)))


def test_episodes_of_another_comparison_are_not_mixed_in(tmp_path):
    path = tmp_path / "x.parquet"
    Store(path, ASKED)
    with pytest.raises(ConfigError, match=r"was stopped; --resume goes on with it, --force begins again"):
        Store(path, ASKED)
    with pytest.raises(
        ConfigError,
        match=r"another comparison: seed \(5, now 6\), model \(none, now learned\) differ; --force begins again",
    ):
        Store(path, {**ASKED, "seed": 6, "model": "learned"}, resume=True)
    assert Store(path, ASKED, resume=True).rows == []
    for name in ("open.jsonl", "manifest.json"):
        (tmp_path / "x.parquet.episodes" / name).write_bytes(b"nothing\n{}\n")
        with pytest.raises(DataError, match=rf"{name} is damaged"):
            Store(path, ASKED, resume=True)


def test_a_store_without_a_path_keeps_episodes_in_memory():
    store = Store(None, ASKED)
    same(drive(store), pd.DataFrame(store.rows))
    store.finish()


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="reads the table of processes where Linux has it")
@pytest.mark.slow
def test_workers_end_with_their_parent(tmp_path):
    arguments = command(tmp_path)
    arguments[arguments.index("--jobs") + 1] = "2"
    arguments[arguments.index("--episodes") + 1] = "400"
    run = subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        _wait_for(lambda: lines(tmp_path) >= 4 or run.poll() is not None)
        workers = _below(run.pid)
        assert run.poll() is None
        assert len(workers) >= 2
    finally:
        run.kill()
        run.wait()
    _wait_for(lambda: not any(Path(f"/proc/{pid}").exists() and not _ended(pid) for pid in workers))


def _wait_for(condition, seconds=300.0):
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.1)


def _below(pid):
    """All child processes of a process, recursively."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [each for child in children for each in (int(child), *_below(int(child)))]


def _ended(pid):
    """Whether a process has ended, possibly as a zombie."""
    try:
        return "(zombie)" in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return True


def test_progress_is_said_where_the_output_is_no_terminal(tmp_path):
    done = CliRunner().invoke(app, command(tmp_path)[3:])
    assert done.exit_code == 0, done.output
    assert f"12 of {2 * EPISODES} episodes" in done.stderr
    assert f"{2 * EPISODES} of {2 * EPISODES} episodes" in done.stderr
    assert re.search(rf"no shield: \d+ of {EPISODES} crashed, full at env: 0 of {EPISODES} crashed", done.stderr)


def test_the_file_of_an_earlier_version_is_continued(tmp_path):
    """Earlier versions kept episodes in one file, with the manifest in its first line: none of them is driven again."""
    path = tmp_path / "x.parquet"
    store = Store(path, ASKED)
    frame = drive(store)
    lines = [json.dumps(each) for each in (store.made, *store.rows[:3])]
    store.finish()
    old = path.with_name("x.parquet.episodes")
    assert not old.exists()
    old.write_text("\n".join(lines) + '\n{"cut o', encoding="utf-8")
    again = Store(path, ASKED, resume=True)
    assert again.rows == store.rows[:3]
    assert is_store(old)
    same(frame, drive(again))
    # Killed before its first line was whole, it is begun again.
    again.finish()
    old.write_text('{"cut o', encoding="utf-8")
    assert Store(path, ASKED, resume=True).rows == []


def test_episodes_become_parts_that_are_read_back(tmp_path, monkeypatch):
    """Parquet parts and the lines after them are one table; killed between the two, an episode is there once."""
    monkeypatch.setattr(storing, "_PART", 3)
    path = tmp_path / "x.parquet"
    store = Store(path, ASKED)
    frame = drive(store)
    assert store.parts.names == ["000000", "000001"]
    made, rows = read_store(store.parts.folder)
    assert made == store.made
    assert {"asked", "versions", "commit", "models", "machine"} <= made.keys()
    same(pd.DataFrame(rows), pd.DataFrame(store.rows))
    # As if it had been killed after the part and before the lines were removed.
    kept = store.parts.folder / "open.jsonl"
    kept.write_bytes(b"".join(json.dumps(row).encode() + b"\n" for row in store.rows[3:]))
    again = Store(path, ASKED, resume=True)
    assert len(again.rows) == len(store.rows) == 8
    assert kept.read_bytes().count(b"\n") == 2
    same(frame, drive(again))
    same(Result.read(store.parts.folder).episodes, pd.DataFrame(store.rows))
