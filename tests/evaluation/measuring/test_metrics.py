"""Summaries equal the counts of the episodes, and tables survive a round trip through files."""

import io
import math
import re

import pandas as pd
import pytest
from rich.console import Console

from evaluation.measuring.metrics import compare, summarise
from evaluation.report.table import (
    COMPARISON,
    SUMMARY,
    latex,
    markdown,
    read_episodes,
    rich_table,
    write_table,
)
from evaluation.running.records import EpisodeRecord
from shield.errors import ConfigError


def record(seed, placement, crashed, **changes):
    shielded = placement != "none"
    values = {
        "setting": "highway-fast",
        "policy": "faster",
        "placement": placement,
        "mode": "full" if shielded else "none",
        "seed": seed,
        "crashed": crashed,
        "off_road": False,
        "attribution": "ego_at_fault" if crashed else "none",
        "return_": 10.0 + seed if shielded else 5.0 + seed,
        "steps": 10,
        "duration": 10.0,
        "mean_speed": 25.0,
        "distance": 250.0,
        "lane_changes": 1.0,
        "laps": float("nan"),
        "mean_jerk": 2.0,
        "mean_lateral_acceleration": 0.5,
        "overridden": 4 if shielded else 0,
        "reasons": {"none": 6, "rss": 4} if shielded else {"none": 10},
        "tiers": {"passed": 6, "alternative": 3, "stored_plan": 1} if shielded else {"off": 10},
        "frames": 50,
        "frames_overridden": 5 if shielded else 0,
        "violations": 1 if shielded else None,
        "min_margin": 0.5 + seed if shielded else float("nan"),
        "min_gap": 0.0 if crashed else 3.0,
        "latencies": tuple([1.0] * 9 + [2.0]) if shielded else (),
    }
    return EpisodeRecord(**{**values, **changes}).row()


@pytest.fixture
def episodes():
    rows = [record(seed, "none", crashed=seed < 3) for seed in range(4)]
    rows += [record(seed, "env", crashed=False) for seed in range(4)]
    return pd.DataFrame(rows)


def test_a_summary_counts_crashes_overrides_and_reasons(episodes):
    bare, shielded = summarise(episodes).to_dict("records")
    assert (bare["episodes"], bare["crashes"], bare["crash_rate"]) == (4, 3, 0.75)
    assert bare["crash_rate_low"] < 0.75 < bare["crash_rate_high"]
    assert math.isnan(bare["latency_p50_ms"])
    assert math.isnan(bare["violations"])
    assert shielded["crash_rate"] == 0.0
    assert shielded["override_rate"] == 0.4
    assert shielded["reason_rss"] == 0.4
    assert shielded["fallback_rate"] == 0.1
    assert shielded["frame_override_rate"] == 0.1
    assert shielded["violations"] == 4
    assert shielded["min_margin"] == 0.5
    assert shielded["latency_p50_ms"] == 1.0
    assert shielded["latency_p99_ms"] == 2.0


def test_crashes_that_others_cause_are_not_the_egos(episodes):
    episodes.loc[0, "attribution"] = "struck_from_behind"
    summary = summarise(episodes)
    assert summary.loc[0, "crash_rate"] == 0.75
    assert summary.loc[0, "ego_fault_rate"] == 0.5


def test_leaving_the_road_is_an_outcome_of_its_own(episodes):
    episodes.loc[[0, 3], "off_road"] = True
    summary, (row,) = summarise(episodes), compare(episodes).to_dict("records")
    assert list(summary["off_roads"]) == [2, 0]
    assert summary.loc[0, "off_road_rate"] == 0.5
    assert summary.loc[0, "off_road_rate_low"] < 0.5 < summary.loc[0, "off_road_rate_high"]
    assert summary.loc[0, "crashes"] == 3
    assert row["off_road_rate_difference"] == pytest.approx(-0.5)
    assert "50.0 [" in markdown(summary, SUMMARY)


def test_fault_is_unknown_where_a_crash_could_not_be_attributed(episodes):
    episodes.loc[0, "attribution"] = "unattributed"
    bare, shielded = summarise(episodes).to_dict("records")
    assert bare["crash_rate"] == 0.75
    assert math.isnan(bare["ego_fault_rate"])
    assert shielded["ego_fault_rate"] == 0.0


def test_comfort_and_laps_are_means_over_episodes(episodes):
    episodes.loc[0, ["mean_jerk", "laps"]] = [6.0, 1.5]
    summary = summarise(episodes)
    assert summary.loc[0, "mean_jerk"] == pytest.approx(3.0)
    assert summary.loc[0, "laps"] == pytest.approx(1.5)
    assert summary.loc[0, "mean_lateral_acceleration"] == pytest.approx(0.5)
    assert math.isnan(summary.loc[1, "laps"])


def test_a_column_is_shown_if_any_row_has_a_figure(episodes):
    episodes.loc[0, "laps"] = 1.5
    heading, _, *rows = (re.split(r"\s+\|\s+", line) for line in markdown(summarise(episodes), SUMMARY).splitlines())
    at = heading.index("laps")
    assert [row[at] for row in rows] == ["1.50", "–"]


def test_a_comparison_is_paired_by_seed(episodes):
    shuffled = episodes.sample(frac=1.0, random_state=0)
    (row,) = compare(shuffled).to_dict("records")
    assert row["pairs"] == 4
    assert row["return_difference"] == pytest.approx(5.0)
    assert row["return_difference_low"] == pytest.approx(5.0)
    assert (row["crashes_prevented"], row["crashes_added"]) == (3, 0)
    assert row["mcnemar_p"] == pytest.approx(0.25)
    assert row["crash_rate_difference"] == pytest.approx(-0.75)


def test_a_comparison_needs_unshielded_rows(episodes):
    assert compare(episodes[episodes["placement"] == "env"]).empty


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_files_preserve_the_measurements(episodes, tmp_path, ending):
    path = write_table(episodes, tmp_path / "deep" / f"episodes.{ending}")
    again = read_episodes(path)
    pd.testing.assert_frame_equal(summarise(again), summarise(episodes))
    pd.testing.assert_frame_equal(compare(again), compare(episodes))


def test_other_files_and_other_tables_are_refused(episodes, tmp_path):
    with pytest.raises(ConfigError, match=r"\.csv or \.parquet"):
        write_table(episodes, tmp_path / "episodes.xlsx")
    with pytest.raises(ConfigError, match="column 'seed' is missing"):
        summarise(episodes.drop(columns="seed"))
    with pytest.raises(ConfigError, match="twice"):
        summarise(pd.concat([episodes, episodes]))


def test_latex_has_the_cells_of_markdown_with_special_characters_escaped(episodes):
    summary = summarise(episodes.assign(setting="a_b & c"))
    lines = latex(summary).splitlines()
    (columns,) = re.fullmatch(r"\\begin\{tabular\}\{(lllr+)\}", lines[0]).groups()
    assert len(columns) == len(lines[2].split(" & "))
    assert r"crashes \%" in lines[2]
    assert all(line.startswith(r"a\_b \& c & ") and line.endswith(r" \\") for line in lines[4:-2])
    assert len(lines) == len(summary) + 6
    unescaped = re.sub(r"\\[&%$#_{}\\]", "", "\n".join(lines[4:-2]))
    assert not set(unescaped) & set("%#_{}\\")
    assert r"$\Delta$ return" in latex(compare(episodes), COMPARISON)


def test_the_terminal_and_markdown_show_the_same_cells(episodes):
    for frame, columns in ((summarise(episodes), SUMMARY), (compare(episodes), COMPARISON)):
        text = markdown(frame, columns)
        lines = text.splitlines()
        assert len(lines) == 2 + len(frame)
        assert len({line.count("|") for line in lines}) == 1
        console = Console(file=io.StringIO(), width=200)
        console.print(rich_table(frame, columns))
        shown = console.file.getvalue()
        for column in columns[3:]:
            cells = [column.cell(row) for row in frame.to_dict("records")]
            if column.heading in ("verified against", "success %", "stopped %", "laps"):  # of which no row has any
                assert column.heading not in shown
                assert column.heading not in lines[0]
            else:
                assert column.heading in shown
                assert all(cell in shown for cell in cells)
        assert "highway-fast" in shown
