"""The code of the README and of the tutorials runs as it stands, and prints what the page shows below it."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import pytest
from stable_baselines3 import PPO

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
PAGES = [README, *sorted((ROOT / "docs" / "tutorials").glob("*.md"))]
SNIPPET = re.compile(r"^```python\n(.*?)^```\n(?:\n```text\n(.*?)^```\n)?", re.MULTILINE | re.DOTALL)
"""A block of code, and the output that follows it, if any. Output that depends on training is shown in other blocks."""
MODULE = re.compile(r"# (\w+)\.py\n")
"""The first line of a block that the reader saves as a file."""
STEPS = 512
"""Training steps here; a reader trains for longer."""


def snippets(page: Path) -> list[tuple[str, str | None]]:
    """The code and the shown output of each block of a page, in order; None where no output is shown."""
    return [(code, shown or None) for code, shown in SNIPPET.findall(page.read_text(encoding="utf-8"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_code_of_a_page_prints_what_the_page_shows(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    learn = PPO.learn
    monkeypatch.setattr(PPO, "learn", lambda model, steps, **options: learn(model, min(steps, STEPS), **options))
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    names: dict[str, Any] = {"__name__": "__main__"}
    blocks = snippets(page)
    assert blocks
    for code, shown in blocks:
        if module := MODULE.match(code):
            (tmp_path / f"{module[1]}.py").write_text(code, encoding="utf-8")
            monkeypatch.delitem(sys.modules, module[1], raising=False)
            continue
        capsys.readouterr()
        exec(compile(code, page.name, "exec"), names)
        printed = capsys.readouterr().out
        assert shown is None or printed == shown


def test_each_page_shows_some_output() -> None:
    for page in PAGES:
        assert any(shown for _, shown in snippets(page)), page


def test_the_readme_is_short() -> None:
    assert len(README.read_text(encoding="utf-8").splitlines()) < 150


def test_the_figures_of_the_readme_are_those_of_the_pages_it_names() -> None:
    """Crash rates with their intervals, and returns, of each row of the table."""
    text = README.read_text(encoding="utf-8")
    results = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    driven = (ROOT / "docs" / "what-it-drives.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\S+)-(v\d) \| (PPO|FASTER) \| ([\d,]+) \| (.*) \|$", text, re.MULTILINE)
    assert len(rows) >= 9
    for road, version, policy, episodes, cells in rows:
        name = f"ppo-{road}" if policy == "PPO" else "faster"
        here = rf"^\| {road} \| {name} \|.*" if episodes != "1,000" else rf"^\| {road}-{version} \| .* \| {name} \|.*"
        lines = " ".join(re.findall(here, driven if episodes == "1,000" else results, re.MULTILINE)).replace("**", "")
        assert lines, (road, policy)
        returns = {f"{float(number):.1f}" for number in re.findall(r"(?<=\| )-?\d+\.\d+", lines)}
        shown = cells.replace("**", "").split(" | ")
        for crashes, total in zip([shown[0], *shown[2::3]], [shown[1], *shown[3::3]], strict=False):
            if "[" in crashes:
                assert crashes in lines, (road, policy, crashes)
                assert total in returns, (road, policy, total)
    for revision in re.findall(r"revision (\w{7})", text):
        assert revision in results + driven
