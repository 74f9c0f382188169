"""The command line does what its help says, and answers mistakes with one line."""

import re
import subprocess
import sys

import pandas as pd
import pytest
from typer.testing import CliRunner

from evaluation.commands.cli import _split, app, main
from shield.config import ShieldConfig

RUN = CliRunner()


def test_help_names_every_command():
    result = RUN.invoke(app, ["--help"])
    assert result.exit_code == 0
    for command in ("train", "evaluate", "demo", "picture", "figures", "config"):
        assert command in result.output


def test_config_prints_the_defaults():
    result = RUN.invoke(app, ["config"])
    assert ShieldConfig.from_toml(result.output) == ShieldConfig()


def test_lists_may_be_repeated_or_separated_by_commas():
    assert _split(["none,full", " rss ", "full"]) == ["none", "full", "rss"]


def test_evaluate_prints_markdown_and_writes_three_tables(tmp_path):
    settings = tmp_path / "shield.toml"
    settings.write_text("braking = 7.0\n", encoding="utf-8")
    output = tmp_path / "out" / "x.csv"
    arguments = ["--policy", "slower", "--shield", "none,rss", "--episodes", "1", "--jobs", "1"]
    arguments += ["--config", str(settings), "--output", str(output), "--markdown"]
    result = RUN.invoke(app, ["evaluate", *arguments], catch_exceptions=False)
    assert result.exit_code == 0
    assert "| highway-fast | slower | rss (env) | 1 |" in re.sub(" +", " ", result.output)
    assert list(pd.read_csv(output)["seed"]) == [100_000, 100_000]
    assert (tmp_path / "out" / "x-summary.csv").is_file()
    assert (tmp_path / "out" / "x-comparison.csv").is_file()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["evaluate", "--shield", "fulll"], "valid are none, distance, rss, ttc, full"),
        (["evaluate", "--policy", "fastest", "--jobs", "1"], "have faster, idle, slower, throttle, random"),
        (["evaluate", "--setting", "motorway"], "highway-fast"),
        (["evaluate", "--output", "x.xlsx"], ".csv or .parquet"),
        (["evaluate", "--config", "missing.toml"], "missing.toml"),
        (["train"], "either --recipe or --setting"),
        (["train", "--recipe", "none"], "ppo-highway-fast"),
    ],
)
def test_mistakes_are_one_line_and_exit_code_2(arguments, message, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["shield", *arguments])
    with pytest.raises(SystemExit) as stop:
        main()
    captured = capsys.readouterr()
    assert stop.value.code == 2
    assert message in captured.err
    assert captured.err.startswith("Error: ")
    assert len(captured.err.strip().splitlines()) == 1


def test_the_module_runs_as_a_program():
    done = subprocess.run([sys.executable, "-m", "evaluation.commands.cli", "config"], capture_output=True, text=True)
    assert done.returncode == 0
    assert 'mode = "full"' in done.stdout
