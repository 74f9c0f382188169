"""Every example runs as it stands, in an empty folder, and is short."""

from __future__ import annotations

import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "examples"
EXAMPLES = sorted(FOLDER.glob("*.py"))
LONG = {"film", "evaluate_and_plot"}
SHORT = {"STEPS": "128", "EPISODES": "2", "MPLBACKEND": "agg"}


@pytest.mark.parametrize("path", [p for p in EXAMPLES if p.stem not in LONG], ids=lambda path: path.stem)
def test_an_example_runs(path, tmp_path, monkeypatch, capsys):
    assert len(path.read_text(encoding="utf-8").splitlines()) < 40
    for name, value in SHORT.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(sys, "argv", [str(path)])
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(path), run_name="__main__")
    assert capsys.readouterr().out.strip()


@pytest.mark.slow
@pytest.mark.parametrize("path", EXAMPLES, ids=[path.stem for path in EXAMPLES])
def test_an_example_runs_by_itself(path, tmp_path):
    env = {**os.environ, **SHORT, "PYTHONPATH": str(FOLDER.parent)}
    done = subprocess.run([sys.executable, str(path)], cwd=tmp_path, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    assert done.stdout.strip()


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_states_its_run_time(path):
    """CPU seconds by `time python examples/NAME.py`, with all kernels compiled."""
    assert re.search(r"^Takes \d+ s on one core\.$", path.read_text(encoding="utf-8").split('"""')[1], re.MULTILINE)


def test_thirteen_examples_exist():
    assert len(EXAMPLES) == 13
