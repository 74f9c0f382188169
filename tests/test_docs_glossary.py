"""The glossary is in alphabetical order, and the names of the code that it gives exist."""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from typing import Any

import pytest

PAGE = Path(__file__).parents[1] / "docs" / "reference" / "glossary.md"
ROWS = re.findall(
    r"^- \*\*([a-z][^*]*)\*\*: (.+[.]) (`[\w.]+`(?:, `[\w.]+`)*)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE
)
"""The term, the meaning and the names in the code of each entry."""
NAMES = sorted({name for *_, names in ROWS for name in re.findall(r"`([\w.]+)`", names)})


def found(name: str) -> Any:
    """The module, or the attribute of a module or class, with this name; a field of a dataclass counts too."""
    module, rest = name, list[str]()
    while True:
        try:
            thing: Any = importlib.import_module(module)
            break
        except ModuleNotFoundError:
            module, _, last = module.rpartition(".")
            rest.insert(0, last)
    for each in rest:
        fields = getattr(thing, "__dataclass_fields__", {})
        thing = fields[each] if each in fields else getattr(thing, each)
    return thing


@pytest.mark.parametrize("name", NAMES)
def test_a_name_of_the_glossary_exists(name: str) -> None:
    assert found(name) is not None


def test_terms_are_unique_and_in_order() -> None:
    terms = [term for term, *_ in ROWS]
    assert len(terms) == PAGE.read_text(encoding="utf-8").count("\n- ")
    assert len(terms) >= 50
    assert terms == sorted(set(terms))


def test_a_meaning_is_short() -> None:
    for term, meaning, _ in ROWS:
        assert all(len(sentence.split()) < 25 for sentence in re.split(r"(?<=[.;:])\s", meaning)), term
