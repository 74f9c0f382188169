"""The page of a report is self-contained, and has the values of the tables."""

import math
import os
import re
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from evaluation import Result, evaluate
from evaluation.commands.cli import app
from evaluation.measuring.metrics import summarise
from evaluation.replay.run_file import episode_of, write_replay
from evaluation.report.charts import Mark, _ticks, crosses, ranges
from evaluation.report.html_report import write_report
from evaluation.report.table import SUMMARY
from shield.config import Buffer
from shield.errors import ConfigError


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    for name, policies in (("one", ["faster", "slower"]), ("two", "random")):
        evaluate(policies, "highway-fast", episodes=3, output=folder / f"{name}.parquet")
    return [folder / "one.parquet", folder / "two.parquet"]


def test_a_page_has_the_cells_of_the_tables_and_is_self_contained(runs, tmp_path):
    page = write_report(runs, tmp_path / "page.html").read_text(encoding="utf-8")
    for path in runs:
        for row in summarise(Result.read(path).episodes).to_dict("records"):
            for cell in (column.cell(row) for column in SUMMARY[:-1]):
                assert cell in page or not any(map(str.isalnum, cell))
    assert not re.search(r"https?://|src=|@import|url\(", page)
    assert page.count("<svg") == 5
    for picture in re.findall(r"<svg.*?</svg>", page, re.DOTALL):
        ElementTree.fromstring(picture)
    assert "shield replay" in page
    assert write_report(runs, tmp_path / "again.html").read_text(encoding="utf-8") == page


def test_names_are_no_markup(tmp_path):
    result = evaluate("slower", "highway-fast", episodes=1)
    frame = result.episodes.assign(policy="<b>mine</b>")
    page = write_report([Result(frame, result.made).write(tmp_path / "x.parquet")], tmp_path / "x.html").read_text()
    assert "<b>mine" not in page
    assert "&lt;b&gt;mine" in page


def test_the_shielded_and_the_worst_come_first_and_only_shielded_ones_are_replayed(runs, tmp_path):
    page = write_report(runs[:1], tmp_path / "page.html").read_text(encoding="utf-8")
    worst = page.split('<table class="worst">')[1].split("</table>")[0]
    rows = re.findall(r"<tr.*?</tr>", worst, re.DOTALL)[1:]
    crashed = [' class="crashed"' in row for row in rows]
    shielded = ["none, none" not in row for row in rows]
    assert any(crashed)
    assert shielded == sorted(shielded, reverse=True)
    for part in (True, False):
        of_part = [each for each, with_shield in zip(crashed, shielded, strict=True) if with_shield == part]
        assert of_part == sorted(of_part, reverse=True)
    episodes = Result.read(runs[0]).episodes
    for row in rows:
        assert ("shield replay" in row) == ("none, none" not in row)
        for number in re.findall(r"--episode (\d+)</code>", row):
            assert f"<td>{episodes['seed'][int(number)]}</td>" in row


def test_replays_are_written_linked_and_kept_while_they_are_of_the_run(runs, tmp_path):
    """The page links to replays that lie there; one older than the run is written anew, a younger one is kept."""
    run = tmp_path / "one.parquet"
    run.write_bytes(runs[0].read_bytes())
    page = write_report([run], tmp_path / "sub" / "page.html", replays=1, write=write_replay).read_text(
        encoding="utf-8"
    )
    links = re.findall(r'href="([^"]+)"', page)
    assert len(links) == 1
    replay = (tmp_path / "sub" / links[0]).resolve()
    assert replay.parent == tmp_path.resolve()
    assert 'type="application/json"' in replay.read_text(encoding="utf-8")
    os.utime(replay, (2e9, 2e9))
    write_report([run], tmp_path / "page.html", replays=1, write=write_replay)
    assert replay.stat().st_mtime == 2e9
    os.utime(replay, (1e9, 1e9))
    assert "href=" not in write_report([run], tmp_path / "page.html").read_text(encoding="utf-8")
    write_report([run], tmp_path / "page.html", replays=1, write=write_replay)
    assert replay.stat().st_mtime > 1e9


def test_a_replay_that_cannot_be_written_says_why(tmp_path):
    """A policy that was handed in as an object has no file to drive again."""
    result = evaluate({"mine": lambda observation: 4}, "highway-fast", shield="full", episodes=1)
    page = write_report(
        [result.write(tmp_path / "x.parquet")], tmp_path / "x.html", replays=1, write=write_replay
    ).read_text()
    assert "no replay: " in page
    assert "href=" not in page


def test_buffers_are_rows_of_their_own(tmp_path):
    """A sweep of buffers keeps its rows apart, gives each its buffer, and is replayed with it."""
    result = evaluate("faster", "highway-fast", episodes=2, buffer=[1, 6], output=tmp_path / "x.parquet")
    assert list(result.summary["mode"]) == ["none", "full, buffer 1 m", "full, buffer 6 m"]
    driven = result.episodes.groupby("mode", sort=False)["overridden"].sum()
    assert driven["full, buffer 1 m"] < driven["full, buffer 6 m"]
    recorded = episode_of(tmp_path / "x.parquet", 5)
    assert recorded.request.variant.config.buffer == Buffer(6.0)
    assert recorded.request.variant.mode == "full, buffer 6 m"
    with pytest.raises(ConfigError, match="longitudinal"):
        evaluate("faster", "highway-fast", buffer=-1)
    asked = [
        "evaluate",
        "--policy",
        "faster",
        "--episodes",
        "1",
        "--jobs",
        "1",
        "--output",
        str(tmp_path / "y.parquet"),
    ]
    assert CliRunner().invoke(app, [*asked, "--buffer", "1,6"]).exit_code == 0
    assert list(Result.read(tmp_path / "y.parquet").summary["mode"]) == ["none", "full, buffer 1 m", "full, buffer 6 m"]
    assert "lengths are numbers" in str(CliRunner().invoke(app, [*asked, "--force", "--buffer", "wide"]).exception)


def test_invalid_reports_are_refused(runs, tmp_path):
    with pytest.raises(ConfigError, match="at least one run"):
        write_report([], tmp_path / "a.html")
    with pytest.raises(ConfigError, match="no file"):
        write_report([tmp_path / "none.parquet"], tmp_path / "a.html")
    with pytest.raises(ConfigError, match="two runs are called 'one'"):
        write_report([runs[0], runs[0]], tmp_path / "a.html")
    with pytest.raises(ConfigError, match="html"):
        write_report(runs, tmp_path / "a.pdf")
    done = CliRunner().invoke(app, ["report", str(runs[0]), "--output", str(tmp_path / "c.html")])
    assert done.exit_code == 0
    assert (tmp_path / "c.html").stat().st_size > 10_000
    again = CliRunner().invoke(app, ["report", str(runs[0]), "--output", str(tmp_path / "c.html")])
    assert "--force overwrites" in str(again.exception)


@given(low=st.floats(-1e6, 1e6), span=st.floats(1e-3, 1e6))
def test_ticks_span_the_values_and_are_few(low, span):
    ticks = _ticks(low, low + span)
    assert ticks[0] <= low + 1e-6 * max(abs(low), span)
    assert ticks[-1] >= low + span - 1e-6 * max(abs(low), span)
    assert 2 <= len(ticks) <= 8


@given(values=st.lists(st.floats(0, 100), min_size=3, max_size=3), unknown=st.booleans())
def test_marks_are_inside_their_pictures(values, unknown):
    low, middle, high = sorted(values)
    marks = [Mark("a & b", 7, (middle, low, high), (math.nan if unknown else high, low, high))]
    for picture in (crosses(marks, "x", "y"), ranges(marks, "x")):
        root = ElementTree.fromstring(picture)
        _, _, width, height = map(float, root.attrib["viewBox"].split())
        for circle in root.iter("circle"):
            assert 0 <= float(circle.attrib["cx"]) <= width
            assert 0 <= float(circle.attrib["cy"]) <= height


def test_an_episode_without_latencies_has_no_chart_of_them(tmp_path):
    result = evaluate("slower", "highway-fast", shield="none", episodes=2)
    assert all(len(each) == 0 for each in result.episodes["latencies_ms"])
    assert isinstance(result.episodes, pd.DataFrame)
    assert np.isfinite(result.episodes["return"]).all()
    page = write_report([result.write(tmp_path / "x.csv")], tmp_path / "x.html").read_text(encoding="utf-8")
    assert page.count("<svg") == 2
