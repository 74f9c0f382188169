"""The table of mutants fits the sources: each change still applies to one syntax node, and a program comes of it."""

import ast
import builtins
import keyword
import re
from pathlib import Path

import numpy as np
import pytest
from mutants import MUTANTS, Mutant
from mutants.nodes import StaleEditError, pattern_of, replaced

ROOT = Path(__file__).parents[1]
SOURCE = """
def far(gap, other):
    if gap.now >= 0 and other:
        least = min(gap.now, 3.0)
        return least
    return gap.now >= 0
"""


def names(source: str) -> set[str]:
    """The names in a piece of source that a renaming can change."""
    return set(re.findall(r"\b[A-Za-z_]\w*", source)) - {*keyword.kwlist, *dir(builtins), *dir(np.ndarray)}


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_the_edits_of_a_mutant_apply_and_change_the_program(mutant: Mutant, tmp_path: Path) -> None:
    """One after another, as `mutation_check.py` applies them; each names one node, and adds no name to the module."""
    for edit in mutant.edits:
        target = tmp_path.joinpath(*edit.module.split(".")).with_suffix(".py")
        if not target.exists():
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(ROOT.joinpath(*edit.module.split(".")).with_suffix(".py").read_bytes())
        before = target.read_text(encoding="utf-8")
        assert names(edit.new) <= names(before)
        path, after = edit.apply(tmp_path)
        assert path == target
        assert ast.dump(ast.parse(after)) != ast.dump(ast.parse(before))
        compile(after, str(path), "exec")
        path.write_text(after, encoding="utf-8")


def test_names_are_unique_and_targets_exist() -> None:
    names = [mutant.name for mutant in MUTANTS]
    assert len(set(names)) == len(names)
    for mutant in MUTANTS:
        assert mutant.tests, mutant.name
        for target in mutant.tests:
            file, _, test = target.partition("::")
            assert f"def {test.partition('[')[0]}" in (ROOT / file).read_text(encoding="utf-8"), target


def test_a_renaming_or_another_layout_leaves_a_pattern_as_it_is() -> None:
    """Another number, operator or builtin does not."""
    pattern = "_ >= 0 and min(_[_, 1], 3.0)"
    for text in ("a >= 0 and min(b.c[d, 1], 3.0)", "(x.y\n >= 0) and min(z[w, 1], 3.0)"):
        assert pattern_of(ast.parse(text, mode="eval").body) == pattern
    for text in ("a > 0 and min(b[d, 1], 3.0)", "a >= 1 and min(b[d, 1], 3.0)", "a >= 0 and max(b[d, 1], 3.0)"):
        assert pattern_of(ast.parse(text, mode="eval").body) != pattern


@pytest.mark.parametrize(
    ("pattern", "new", "which", "line"),
    [
        ("_ >= 0", "{1} >= -0.3", 2, "    return (gap.now >= -0.3)"),
        ("_ >= 0 and _", "{2}", 0, "    if (other):"),
        ("if _ >= 0 and _:", "if False:", 0, "    if (False):"),
        ("_ = min(_, 3.0)", "pass", 0, "        pass"),
        ("return _", "print({1})\n{0}", 0, "        print(least)\n        return least"),
    ],
)
def test_a_node_alone_is_replaced(pattern: str, new: str, which: int, line: str) -> None:
    found = replaced(SOURCE, "far", pattern, new, which)
    assert line in found
    assert len(set(found.splitlines()) - set(SOURCE.splitlines())) == len(
        set(line.splitlines()) - set(SOURCE.splitlines())
    )


@pytest.mark.parametrize(
    ("function", "pattern", "which", "reads"),
    [
        ("far", "_ >= 0", 0, ""),  # two of them
        ("far", "_ >= 0", 3, ""),
        ("far", "_ > 0", 0, ""),
        ("near", "_ >= 0", 1, ""),
        ("far", "_ >= 0", 1, "other"),
    ],
)
def test_an_edit_that_names_no_node_or_several_is_stale(function: str, pattern: str, which: int, reads: str) -> None:
    with pytest.raises(StaleEditError):
        replaced(SOURCE, function, pattern, "True", which, reads)
