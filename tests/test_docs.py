"""The commands, tables and settings that the pages name exist, and a policy may observe lidar and images."""

from __future__ import annotations

import re
import textwrap
from dataclasses import fields
from itertools import takewhile
from pathlib import Path
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import pytest
from typer.testing import CliRunner

import evaluation.scenarios
import evaluation.wrappers  # noqa: F401  (registers the -continuous ones)
from dynamics.traffic.assumptions import Assumptions
from evaluation.commands.cli import app
from shield import ShieldedEnv
from shield.config import PROFILES, Buffer, ShieldConfig

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
TEXT = {page.relative_to(ROOT).as_posix().removeprefix("docs/"): page.read_text(encoding="utf-8") for page in PAGES}
COMMANDS = sorted({line for text in TEXT.values() for line in re.findall(r"^ *(shield .*)$", text, re.MULTILINE)})


def test_a_policy_may_observe_lidar_and_images(capsys: pytest.CaptureFixture[str]) -> None:
    (block,) = re.findall(r"```python\n(.*?)```", TEXT["lab/what-it-drives.md"], re.DOTALL)
    exec(compile(block, "lab/what-it-drives.md", "exec"), {})
    lines = capsys.readouterr().out.splitlines()
    assert [line.rpartition(" ")[0] for line in lines] == ["(64, 2)"] * 2 + ["(4, 128, 64)"] * 2
    assert {line.rpartition(" ")[2] for line in lines} <= {"none", "unverified"}


@pytest.mark.parametrize("page", ["observations-alone", "add-a-road"])
def test_the_steps_of_a_how_to_run(page: str) -> None:
    """The Python of a page is one script, block after block."""
    blocks = re.findall(r"^ *```python\n(.*?)^ *```", TEXT[f"how-to/{page}.md"], re.DOTALL | re.MULTILINE)
    names: dict[str, Any] = {"__name__": page}
    exec(compile("".join(textwrap.dedent(block) for block in blocks), f"{page}.md", "exec"), names)
    env = names["shielded"] if page == "observations-alone" else ShieldedEnv(gym.make("Bend-v0"))
    env.reset(seed=0)
    for _ in range(3):
        *_, info = env.step(3)
        assert info["shield"]["guarantee"] in {"all vehicles seen", "assumed"}
    assert not env.unwrapped.vehicle.crashed


def test_every_environment_is_in_the_table_of_supported_environments() -> None:
    rows = re.findall(r"^\| (\S+-v\d.*?) \|", TEXT["what-it-drives.md"], re.MULTILINE)
    listed = set()
    for name in (name for row in rows for name in row.split("; ")):
        road, versions = name.rsplit("-", 1)
        listed |= {f"{road}-{version}" for version in versions.split(", ")}
    homes = ("highway_env.", "evaluation.")
    assert listed == {name for name, spec in gym.registry.items() if str(spec.entry_point).startswith(homes)}


@pytest.mark.parametrize("command", COMMANDS)
def test_every_option_of_every_command_exists(command: str) -> None:
    words = command.split(">")[0].split()[1:]
    names = list(takewhile(lambda word: not word.startswith("-"), words))
    help_text = CliRunner().invoke(app, [*names, "--help"], env={"COLUMNS": "200"}).output
    for option in (word for word in words if word.startswith("--")):
        assert option in help_text, f"{option} of `{command}`"


def test_the_pages_on_configuration_have_every_setting_and_every_profile() -> None:
    text = TEXT["configuration.md"].split("| configuration |")[0] + TEXT["lab/assumptions.md"]
    rows = {name for line in re.findall(r"^\| (`.*?) \|", text, re.MULTILINE) for name in re.findall(r"`(.*?)`", line)}
    buffer = {f"buffer.{each.name}" for each in fields(Buffer)}
    settings = {each.name for each in fields(ShieldConfig)} - {"buffer", "assumptions"}
    assert rows == buffer | settings | {each.name for each in fields(Assumptions)}
    for name in (*PROFILES, "idm", "moderate", "rss"):
        assert f"`{name}`" in text, name


def test_the_page_on_assumptions_states_the_defaults() -> None:
    """Each assumption has a default in the profiles "idm" and "rss"; the page may say that both are the same."""
    table = TEXT["lab/assumptions.md"].split("| assumption |")[1].split("\n\n")[0]
    for row in re.findall(r"^\| `.*\|$", table, re.MULTILINE):
        names, idm, rss, _ = (cell.strip() for cell in row.strip("|").split(" | "))
        own, other = (idm, rss) if rss != "the same" else (idm, idm)
        for profile, cell in ((Assumptions.idm(), own), (Assumptions.rss(), other)):
            numbers = [word for word in re.split(r"[ ,]+", cell) if re.fullmatch(r"[\d.]+|true|false", word)]
            said = [word == "true" if word.isalpha() else float(word) for word in numbers]
            assert said == [getattr(profile, name) for name in re.findall(r"`(.*?)`", names)], names
