"""The docstrings of this project as griffe's numpy parser wants them.

Here an entry is `name : what it is`, and types are in the signature. The parser takes what follows the colon for a
type, and has no option to be told otherwise. Several names share an entry where they share its text, and short entries
share a line:

    n, k : how many.            n
    dt : of a frame. t : now.       how many.
                                k
                         ->         how many.
                                dt
                                    of a frame.
                                t
                                    now.

What is returned is in the signature as well: the text under Returns becomes a description without a name.
"""

from __future__ import annotations

import re
from typing import Any

from griffe import Class, Extension, Object

__all__ = ["NumpyDescriptions", "rewritten", "with_members"]

_HEADING = re.compile(r"(?m)^(\w[\w ]*)\n(-{3,})\n")
_NAMES = r"\*{0,2}\w+(?:, \*{0,2}\w+)*"
_ENTRY = re.compile(rf"(?P<names>{_NAMES}) : (?P<text>.*)")
_NEXT = re.compile(rf"(?<=\.) (?={_NAMES} : )")
_DOCTEST = re.compile(r"(?m)^>>> (?:.+\n?)+")
_ENUMS = {"Enum", "IntEnum", "StrEnum"}


class NumpyDescriptions(Extension):
    """Rewrites every docstring when it is loaded."""

    def on_instance(self, *, obj: Object, **_: Any) -> None:
        if obj.docstring:
            obj.docstring.value = rewritten(obj.docstring.value)

    def on_class_members(self, *, cls: Class, **_: Any) -> None:
        """The members of an enumeration have no docstrings, and would not be shown."""
        if _ENUMS & {str(base).rpartition(".")[2] for base in cls.bases}:
            values = {name: str(m.value) for name, m in cls.attributes.items() if not name.startswith("_")}
            if cls.docstring:
                cls.docstring.value = with_members(cls.docstring.value, values)


def rewritten(text: str) -> str:
    """The docstring with the entries of its sections as numpydoc has them, and doctests in its text as code blocks.

    Examples
    --------
    >>> print(rewritten("Add.\\n\\nParameters\\n----------\\na, b : what is added [m]."))
    Add.
    <BLANKLINE>
    Parameters
    ----------
    a
        what is added [m].
    b
        what is added [m].
    """
    start, *rest = _HEADING.split(text)
    out = [_fenced(start)]
    for title, dashes, body in zip(*(iter(rest),) * 3, strict=True):
        change = _SECTIONS.get(title, _fenced if title not in _PARSED else str)
        out.append(f"{title}\n{dashes}\n{change(body)}")
    return "".join(out)


def with_members(text: str, values: dict[str, str]) -> str:
    """The docstring of an enumeration with its members and their values, where it does not describe them itself."""
    if not values or "\nAttributes\n---" in text:
        return text
    entries = "\n".join(f"{name}\n    `{value}`" for name, value in values.items())
    return f"{text.rstrip()}\n\nAttributes\n----------\n{entries}"


def _entries(body: str) -> str:
    """Of Parameters and Attributes."""
    out: list[str] = []
    names: list[str] = []
    text: list[str] = []

    def close() -> None:
        for name in names:
            out.extend([name, *text])

    for line in body.split("\n"):
        for part in _NEXT.split(line):
            match = _ENTRY.fullmatch(part)
            if match:
                close()
                names, text = match["names"].split(", "), [f"    {match['text']}"]
            else:
                (text if names else out).append(part if part[:1] in ("", " ") else f"    {part}")
    close()
    return "\n".join(out)


def _returned(body: str) -> str:
    indented = "\n".join(f"    {line}" if line.strip() else line for line in body.rstrip().split("\n"))
    return f":\n{indented}\n\n"


def _fenced(text: str) -> str:
    """Three signs of greater-than begin nested quotations in Markdown."""
    return _DOCTEST.sub(lambda m: f"```pycon\n{m[0].rstrip()}\n```\n", text)


_SECTIONS = {"Parameters": _entries, "Attributes": _entries, "Returns": _returned}
_PARSED = {"Raises", "Examples"}
