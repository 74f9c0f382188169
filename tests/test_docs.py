"""What the README shows works as shown."""

from __future__ import annotations

import re
from itertools import takewhile
from pathlib import Path

import pytest
from typer.testing import CliRunner

from evaluation.commands.cli import app

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
TEXT = {page.name: page.read_text(encoding="utf-8") for page in PAGES}
COMMANDS = sorted({line for text in TEXT.values() for line in re.findall(r"^shield .*$", text, re.MULTILINE)})


def test_the_readme_example_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    (block,) = re.findall(r"```python\n(.*?)```", TEXT["README.md"], re.DOTALL)
    names: dict[str, object] = {}
    exec(compile(block, "README.md", "exec"), names)
    assert set(names["info"]["shield"]) >= {"overridden", "reason", "tier", "margin"}  # type: ignore[index]


@pytest.mark.parametrize("command", COMMANDS)
def test_every_option_of_every_command_exists(command: str) -> None:
    words = command.split(">")[0].split()[1:]
    names = list(takewhile(lambda word: not word.startswith("-"), words))
    help_text = CliRunner().invoke(app, [*names, "--help"], env={"COLUMNS": "200"}).output
    for option in (word for word in words if word.startswith("--")):
        assert option in help_text, f"{option} of `{command}`"
