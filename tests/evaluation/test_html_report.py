"""The page of a report: it needs nothing but itself, and says what the tables say."""

import math
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
from evaluation.report.charts import Mark, _ticks, crosses, ranges
from evaluation.report.html_report import write_report
from evaluation.report.table import SUMMARY
from shield.errors import ConfigError


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    for name, policies in (("one", ["faster", "slower"]), ("two", "random")):
        evaluate(policies, "highway-fast", episodes=3, output=folder / f"{name}.parquet")
    return [folder / "one.parquet", folder / "two.parquet"]


def test_a_page_says_what_the_tables_say_and_needs_nothing_else(runs, tmp_path):
    page = write_report(runs, tmp_path / "page.html").read_text(encoding="utf-8")
    for path in runs:
        for row in summarise(Result.read(path).episodes).to_dict("records"):
            for cell in (column.cell(row) for column in SUMMARY[:-1]):
                assert cell in page or not any(map(str.isalnum, cell))
    assert not re.search(r"https?://|src=|@import|url\(", page)
    assert page.count("<svg") == 3
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


def test_the_worst_come_first_and_only_shielded_ones_are_replayed(runs, tmp_path):
    page = write_report(runs[:1], tmp_path / "page.html").read_text(encoding="utf-8")
    worst = page.split('<table class="worst">')[1].split("</table>")[0]
    rows = re.findall(r"<tr.*?</tr>", worst, re.DOTALL)[1:]
    crashed = [' class="crashed"' in row for row in rows]
    assert any(crashed)
    assert crashed == sorted(crashed, reverse=True)
    episodes = Result.read(runs[0]).episodes
    for row in rows:
        assert ("shield replay" in row) == ("none, none" not in row)
        for number in re.findall(r"--episode (\d+)</code>", row):
            assert f"<td>{episodes['seed'][int(number)]}</td>" in row


def test_mistakes_are_told(runs, tmp_path):
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
