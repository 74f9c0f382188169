"""The short tables of the navigation are rows and columns of the full tables on the lab pages."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "benchmarks"))

from short_tables import first_table, kept, rewritten, short_table, write_all  # noqa: E402
from what_it_drives import CONFIGS, WRAPPERS, Row, env_ids  # noqa: E402
from what_it_drives import short_table as short_table_of_support  # noqa: E402

LAB_PAGE = """# Full

## Roads

| road | bare | return | default | return |
|:--|--:|--:|--:|--:|
| merge | 4.5 [2.4, 8.3] | 13.8 | 0.0 [0.0, 1.9] | 14.0 |
| exit | 0.0 [0.0, 1.9] | 1.8 | 0.0 [0.0, 1.9] | 1.7 |
"""
ENTRY = {"columns": ["road", "default", "return"], "part": [{"below": "Roads", "keep": {"road": ["exit"]}}]}


def text(name: str) -> str:
    return (ROOT / "docs" / name).read_text(encoding="utf-8")


def test_the_short_tables_are_rows_of_the_full_tables() -> None:
    """After a change of a full table, `python benchmarks/short_tables.py` rewrites the short ones."""
    assert write_all(check=True) == []


def test_a_short_table_has_the_chosen_rows_and_columns() -> None:
    short = "| road | default | return |\n|:--|--:|--:|\n| exit | 0.0 [0.0, 1.9] | 1.7 |\n"
    assert short_table(ENTRY, LAB_PAGE) == short
    page = "# Short\n\n<!-- short table: roads -->\n\n| old |\n|:--|\n| 1 |\n\nAfter.\n"
    assert rewritten(page, "roads", short) == f"# Short\n\n<!-- short table: roads -->\n\n{short}\nAfter.\n"


def test_rows_columns_headings_and_marks_that_do_not_exist_are_errors() -> None:
    with pytest.raises(ValueError, match="no row with road"):
        kept(first_table(LAB_PAGE, "Roads"), {"road": ["exit", "u-turn"]})
    with pytest.raises(ValueError, match="no column 'speed'"):
        short_table({**ENTRY, "columns": ["road", "speed"]}, LAB_PAGE)
    with pytest.raises(ValueError, match="no table below"):
        first_table(LAB_PAGE, "Cars")
    with pytest.raises(ValueError, match="no mark"):
        rewritten("# Short\n", "roads", "| road |\n")


def support() -> list[Row]:
    """The rows of the full table of supported environments, in the order of the registry."""
    found = []
    for names, action, *served in first_table(text("lab/what-it-drives.md"), "Every wrapper").rows:
        for name in names.split("; "):
            road, numbers = name.rsplit("-", 1)
            why = tuple("" if cell == "yes" else "refused" for cell in served)
            assert len(why) == len(CONFIGS) * len(WRAPPERS)
            found += [Row(f"{road}-{number}", action.strip("`"), why) for number in numbers.split(", ")]
    order = env_ids()
    return sorted(found, key=lambda row: order.index(row.env_id))


def test_the_short_table_of_supported_environments_is_that_of_the_full_one() -> None:
    assert short_table_of_support(support()) in text("what-it-drives.md")


@pytest.mark.slow
def test_the_tables_of_supported_environments_are_the_output_of_their_script() -> None:
    done = subprocess.run(
        [sys.executable, str(ROOT / "benchmarks" / "what_it_drives.py")],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    )
    full, short = done.stdout.strip().split("\n\n")
    assert full in text("lab/what-it-drives.md")
    assert short in text("what-it-drives.md")
