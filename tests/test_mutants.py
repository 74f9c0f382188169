"""The table of mutants fits the sources: each change still applies, and what comes of it is a program."""

from pathlib import Path

import pytest
from mutants import MUTANTS, Edit

ROOT = Path(__file__).parents[1]
EDITS = sorted({edit for mutant in MUTANTS for edit in mutant.edits}, key=lambda edit: (edit.file, edit.old, edit.new))


@pytest.mark.parametrize("edit", EDITS, ids=lambda edit: f"{Path(edit.file).stem}: {edit.old.strip()[:50]}")
def test_an_edit_applies_as_often_as_it_says(edit: Edit) -> None:
    text = (ROOT / edit.file).read_text(encoding="utf-8")
    assert text.count(edit.old) == edit.count, f"{edit.file} has changed: bring tests/support/mutants.py up to date"
    mutated = text.replace(edit.old, edit.new)
    assert mutated != text
    compile(mutated, edit.file, "exec")


def test_names_are_unique_and_targets_exist() -> None:
    names = [mutant.name for mutant in MUTANTS]
    assert len(set(names)) == len(names)
    for mutant in MUTANTS:
        assert mutant.tests, mutant.name
        for target in mutant.tests:
            file, _, test = target.partition("::")
            assert f"def {test.partition('[')[0]}" in (ROOT / file).read_text(encoding="utf-8"), target
