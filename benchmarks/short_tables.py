"""Writes the short tables of the navigation: chosen rows and columns of the full tables on pages of docs/lab.

    python benchmarks/short_tables.py              # rewrites the tables below the marks in docs/
    python benchmarks/short_tables.py --check      # changes nothing, and fails where a table differs

`short_tables.toml` names the rows and columns. A mark is the comment `<!-- short table: NAME -->`. No episode is
driven: a short table changes with the full table that it comes from, and only with that.
"""

from __future__ import annotations

import argparse
import re
import sys
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"


class Table(NamedTuple):
    """A Markdown table: its heading, its alignments and its rows, as cells."""

    heading: list[str]
    alignments: list[str]
    rows: list[list[str]]


def cells(line: str) -> list[str]:
    """
    >>> cells("| merge | 4.5 [2.4, 8.3] |")
    ['merge', '4.5 [2.4, 8.3]']
    """
    return [cell.strip() for cell in line.strip().strip("|").split(" | ")]


def first_table(page: str, heading: str) -> Table:
    """The first table below a heading of a page."""
    _, found, below = page.partition(f"# {heading}\n")
    table = re.search(r"(?:^\|.*\n)+", below, re.MULTILINE)
    if not found or table is None:
        raise ValueError(f"no table below the heading {heading!r}")
    first, second, *rows = table[0].splitlines()
    return Table(cells(first), [cell.strip() for cell in second.strip("|").split("|")], [cells(row) for row in rows])


def positions(heading: Sequence[str], columns: Sequence[str]) -> list[int]:
    """Of columns, each right of the one before: a heading may appear twice.

    >>> positions(["road", "bare", "return", "default", "return"], ["road", "default", "return"])
    [0, 3, 4]
    """
    found, after = [], 0
    for column in columns:
        if column not in heading[after:]:
            raise ValueError(f"no column {column!r} among {list(heading[after:])}")
        found.append(heading.index(column, after))
        after = found[-1] + 1
    return found


def kept(table: Table, keep: Mapping[str, Sequence[str]]) -> list[list[str]]:
    """The rows whose cells in the columns of `keep` are among its values. Every value has to occur."""
    rows = table.rows
    for column, values in keep.items():
        at = table.heading.index(column)
        if missing := set(values) - {row[at] for row in table.rows}:
            raise ValueError(f"no row with {column} in {sorted(missing)}")
        rows = [row for row in rows if row[at] in values]
    return rows


def short_table(each: Mapping[str, Any], page: str) -> str:
    """The Markdown of one entry of short_tables.toml, from the text of its lab page.

    Each part is a heading of that page, and the rows of its table that are kept: all of them without `keep`.
    """
    lines: list[str] = []
    for part in each["part"]:
        table = first_table(page, part["below"])
        chosen = positions(table.heading, each["columns"])
        if not lines:
            lines.append(f"| {' | '.join(table.heading[at] for at in chosen)} |")
            lines.append(f"|{'|'.join(table.alignments[at] for at in chosen)}|")
        lines += [f"| {' | '.join(row[at] for at in chosen)} |" for row in kept(table, part.get("keep", {}))]
    return "\n".join(lines) + "\n"


def rewritten(page: str, name: str, table: str) -> str:
    """A page with the table below its mark in place of the former one."""
    mark = f"<!-- short table: {name} -->\n\n"
    before, found, after = page.partition(mark)
    if not found:
        raise ValueError(f"no mark {mark.strip()}")
    rest = re.sub(r"\A(?:\|.*\n)*\n*", "", after)
    return f"{before}{mark}{table}\n{rest}"


def write_all(check: bool = False) -> list[str]:
    """Rewrite the tables, unless `check`. Returns the names of those that differ."""
    changed = []
    for each in tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))["table"]:
        path = DOCS / each["page"]
        page = path.read_text(encoding="utf-8")
        table = short_table(each, (DOCS / each["from"]).read_text(encoding="utf-8"))
        if (new := rewritten(page, each["name"], table)) != page:
            changed.append(each["name"])
            if not check:
                path.write_text(new, encoding="utf-8")
    return changed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="change nothing; exit 1 where a table differs")
    asked = parser.parse_args()
    changed = write_all(asked.check)
    print("\n".join(changed) or "no table differs")
    if asked.check and changed:
        sys.exit(1)


if __name__ == "__main__":
    main()
