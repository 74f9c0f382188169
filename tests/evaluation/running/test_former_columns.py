"""Tables, stores and manifests of earlier versions are read: their columns and assumptions get the present names."""

import json
import re

import pandas as pd
import pytest
from typer.testing import CliRunner

from dynamics.traffic.assumptions import FORMER_ASSUMPTIONS, Assumptions
from evaluation.commands.cli import app
from evaluation.experiments import Experiment, Result
from evaluation.measuring.metrics import summarise
from evaluation.running.manifest import check_fits
from evaluation.running.parts import PARTS
from evaluation.running.step_table import is_steps
from evaluation.running.store_rows import OPEN, read_store
from evaluation.settings import Setting

SHORT = Setting("short", "highway-fast-v0", {"duration": 1, "vehicles_count": 2})


def experiment(output, **options):
    return Experiment(policy="faster", env=SHORT, shield="none", episodes=2, output=output, **options)


@pytest.fixture(scope="module")
def result():
    return experiment(None).run(progress=False)


def with_former_column(path):
    """Write a Parquet table with the former name of the column."""
    frame = pd.read_parquet(path).rename(columns={"placement": "door"})
    frame.to_parquet(path, index=False)
    assert "door" in pd.read_parquet(path).columns


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_a_table_with_the_former_column_is_read_and_extended(ending, tmp_path):
    path = tmp_path / f"episodes.{ending}"
    before = experiment(path).run(progress=False).episodes
    if ending == "parquet":
        with_former_column(path)
    else:
        path.write_text(path.read_text(encoding="utf-8").replace("placement", "door", 1), encoding="utf-8")
    assert list(Result.read(path).episodes["placement"]) == ["none", "none"]
    longer = experiment(path, resume=True).with_options(episodes=3).run(progress=False).episodes
    assert "door" not in longer.columns
    assert list(longer["seed"]) == [*before["seed"], before["seed"].max() + 1]


def test_a_store_with_the_former_column_is_read(result, tmp_path):
    rows = result.episodes.rename(columns={"placement": "door"})
    folder = tmp_path / "store"
    (folder / PARTS).mkdir(parents=True)
    (folder / "manifest.json").write_text(json.dumps(result.made), encoding="utf-8")
    rows.iloc[:1].to_parquet(folder / PARTS / "0.parquet", index=False)
    (folder / OPEN).write_text(rows.iloc[1:].to_json(orient="records", lines=True), encoding="utf-8")
    _, found = read_store(folder)
    assert [row["placement"] for row in found] == ["none", "none"]
    assert not any("door" in row for row in found)


def test_a_table_of_decisions_with_the_former_column_is_one(tmp_path):
    path = tmp_path / "steps.parquet"
    experiment(tmp_path / "x.parquet", steps=path).run(progress=False)
    with_former_column(path)
    assert is_steps(path)


def test_a_summary_takes_a_table_with_the_former_column_and_warns(result):
    with pytest.warns(DeprecationWarning, match="rename it to 'placement'"):
        former = summarise(result.episodes.rename(columns={"placement": "door"}))
    pd.testing.assert_frame_equal(former, summarise(result.episodes))


def test_a_manifest_with_former_settings_fits():
    present = {name: getattr(Assumptions(), name) for name in FORMER_ASSUMPTIONS.values()}
    former = {name: present[FORMER_ASSUMPTIONS[name]] for name in FORMER_ASSUMPTIONS}

    def made(assumptions, limit="failure_limit"):
        return {"asked": {"shields": {"env": {"assumptions": assumptions, limit: 5}}}, "versions": {}}

    check_fits("x", made(former, "patience"), made(present), "stop")
    with pytest.raises(Exception, match="comfortable_braking"):
        check_fits("x", made({**former, "calm_braking": 1.0}), made(present), "stop")


def test_the_former_option_is_taken_with_a_message(tmp_path):
    path = tmp_path / "x.parquet"
    words = ["evaluate", "--setting", "highway-fast", "--policy", "idle", "--shield", "full", "--config", "simulated"]
    words += ["--door", "actions", "--episodes", "1", "--jobs", "1", "--output", str(path)]
    run = CliRunner().invoke(app, words, env={"COLUMNS": "200"})
    assert run.exit_code == 0, run.output
    assert re.search("--door is deprecated: write --placement", run.stderr)
    assert list(Result.read(path).episodes["placement"]) == ["actions"]
    shown = CliRunner().invoke(app, ["evaluate", "--help"], env={"COLUMNS": "200"}).output
    assert "--placement" in shown
    assert "--door" not in shown
