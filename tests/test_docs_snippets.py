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
def test_the_code_of_a_page_prints_the_output_on_the_page(
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


def figures(text: str) -> list[tuple[str, str, list[str]]]:
    """Road, episodes ("300, 300" of PPO and FASTER) and figures of each row of the table of the README."""
    plain = text.translate({0x00A0: " ", 0x2011: "-"}).replace("**", "")
    found, road, episodes = [], "", ""
    for line in re.findall(r"^\| (.*) \|$", plain.partition("| road |")[2].partition("\n\n")[0], re.MULTILINE)[1:]:
        first, _, count, *cells = (cell.strip() for cell in line.split(" | "))
        road, episodes = first or road, count or episodes
        found.append((road, episodes, cells))
    return found


def test_the_figures_of_the_readme_are_those_of_the_pages_it_names() -> None:
    """Crash rates with their intervals, and returns, of PPO and FASTER in each row of the table."""
    text = README.read_text(encoding="utf-8")
    results = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    driven = (ROOT / "docs" / "what-it-drives.md").read_text(encoding="utf-8")
    compared = 0
    for road, episodes, (ppo, ppo_return, _, faster, faster_return) in figures(text):
        setting = "highway-fast" if road == "highway" else road
        env_id = setting if "-v" in setting else f"{setting}-v0"
        many = "1,000" in episodes
        for crashes, total, page, pattern in (
            (ppo, ppo_return, results, rf"^\| {setting} \| ppo-{setting} \|.*"),
            (
                faster,
                faster_return,
                driven if many else results,
                # The table of what-it-drives.md has always FASTER alone.
                rf"^\| {env_id} \|.*" if many else rf"^\| {setting} \| faster \|.*",
            ),
        ):
            if crashes == "–":
                continue
            lines = " ".join(re.findall(pattern, page, re.MULTILINE)).replace("**", "")
            returns = {f"{float(number):.1f}" for number in re.findall(r"(?<=\| )-?\d+\.\d+", lines)}
            assert crashes in lines, (road, crashes)
            assert total in returns, (road, total)
            compared += 1
    assert compared >= 20
    for revision in re.findall(r"revision (\w{7})", text):
        assert revision in results + driven
