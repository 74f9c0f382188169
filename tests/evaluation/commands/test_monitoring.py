"""`shield monitor`: a small monitor is trained, graded and refused in one line."""

from __future__ import annotations

import pandas as pd
import pytest
from typer.testing import CliRunner

from dynamics.errors import ModelError
from evaluation.commands.cli import app
from shield.errors import ConfigError

RUN = CliRunner()


def run(*words):
    return RUN.invoke(app, ["monitor", *map(str, words)], catch_exceptions=False)


def test_a_monitor_is_trained_and_graded(tmp_path):
    sizes = ["--rounds", 1, "--environments", 8, "--steps", 100, "--calibration", 12, "--miss", 0.2]
    made = run("train", *sizes, "--output", tmp_path / "monitor")
    assert made.exit_code == 0, made.output
    given = ["--drivers", "faster", "--episodes", 3, "--seed", 300, "--output", tmp_path / "grades.csv"]
    graded = run("grade", tmp_path / "monitor", *given)
    assert graded.exit_code == 0, graded.output
    table = pd.read_csv(tmp_path / "grades.csv")
    assert table.driver.tolist() == ["faster", "faster"]
    assert table.monitor.tolist() == [False, True]
    assert (table.episodes == 3).all()
    assert table.overridden[0] == 0
    assert table.executed_unsafe.between(0, 1).all()
    assert (table.crash_low <= table.crashed).all()
    assert (table.crashed <= table.crash_high).all()


def test_what_makes_no_monitor_is_refused(tmp_path):
    with pytest.raises(ModelError, match="is no checkpoint"):
        run("grade", tmp_path)
    with pytest.raises(ConfigError, match="1 to 7 rounds, not 9"):
        run("train", "--rounds", 9)
