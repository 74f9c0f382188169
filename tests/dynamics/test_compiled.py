"""Guarantees of `compiled`: kernels are stored on disk, and compiled again when one of their sources changes."""

import os
import subprocess
import sys
from enum import IntEnum
from pathlib import Path

import numpy as np
import pytest

from dynamics.compiled import compiled, source_digest

FILES = {
    "inner.py": "from dynamics.compiled import compiled\nfrom numbers_of import BIAS\n\n"
    "@compiled\ndef inner(x):\n    return x + BIAS\n",
    "numbers_of.py": "BIAS = 1.0\nGAIN = 2.0\n",
    "outer.py": "from dynamics.compiled import compiled\nfrom inner import inner\nfrom numbers_of import GAIN\n\n"
    "@compiled\ndef outer(x):\n    return GAIN * inner(x)\n",
}
PROGRAM = """
from outer import outer
print(outer(3.0), sum(outer.stats.cache_hits.values()))
"""


def half(x):
    return 0.5 * x


half = compiled(half)


def quarter(x):
    return half(half(x))


def test_a_kernel_may_call_a_kernel():
    assert compiled(quarter)(2.0) == 0.5


def test_a_called_kernel_is_part_of_the_digest():
    first = source_digest(compiled(quarter))
    assert first == source_digest(compiled(quarter))
    assert first != source_digest(half)


def run(folder: Path, program: str = PROGRAM) -> tuple[float, int]:
    """The output of a program: a result, and the number of kernels that were found on disk."""
    root = Path(__file__).parents[2]
    paths = os.pathsep.join([str(folder), str(root)])
    env = {**os.environ, "PYTHONPATH": paths, "NUMBA_CACHE_DIR": str(folder / "kept"), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run([sys.executable, "-c", program], env=env, capture_output=True, text=True, check=True)
    value, hits = done.stdout.split()
    return float(value), int(hits)


@pytest.mark.parametrize(("file", "old", "new", "then"), [
    ("inner.py", "x + BIAS", "x - BIAS", 4.0),  # the kernel that it calls
    ("numbers_of.py", "BIAS = 1.0", "BIAS = 2.0", 10.0),  # a number that this one uses
    ("numbers_of.py", "GAIN = 2.0", "GAIN = 3.0", 12.0),  # a number of its own
])  # fmt: skip
def test_code_on_the_disk_is_found_again_and_never_stale(tmp_path, file, old, new, then):
    for name, text in FILES.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    assert run(tmp_path) == (8.0, 0)
    assert run(tmp_path) == (8.0, 1)
    path = tmp_path / file
    path.write_text(path.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    assert run(tmp_path) == (then, 0)


@pytest.mark.parametrize(("old", "new"), [
    ("def outer(x):\n", 'def outer(x):\n    """A docstring."""\n'),
    ("@compiled\n", "# A comment moves the kernel down by a line.\n@compiled\n"),
])  # fmt: skip
def test_an_edit_of_a_docstring_or_a_comment_compiles_nothing(tmp_path, old, new):
    for name, text in FILES.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    assert run(tmp_path) == (8.0, 0)
    path = tmp_path / "outer.py"
    path.write_text(path.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    assert run(tmp_path) == (8.0, 1)


ARRAY = np.array([1.0, 2.0])


class Kind(IntEnum):
    """Members that a kernel reads."""

    A = 1


def reads_array(x):
    return ARRAY[0] * x


def reads_member(x):
    return Kind.A * x


def reads_inside(x):
    return sum([ARRAY[0] for _ in range(x)])


def test_a_global_that_only_a_comprehension_reads_is_part_of_what_a_kernel_is_made_from(monkeypatch):
    first = source_digest(compiled(reads_inside))
    monkeypatch.setitem(globals(), "ARRAY", np.array([3.0, 2.0]))
    assert source_digest(compiled(reads_inside)) != first


def test_a_global_array_is_part_of_the_digest(monkeypatch):
    first = source_digest(compiled(reads_array))
    monkeypatch.setitem(globals(), "ARRAY", np.array([3.0, 2.0]))
    assert source_digest(compiled(reads_array)) != first


def test_the_members_of_an_enumeration_are_part_of_the_digest(monkeypatch):
    first = source_digest(compiled(reads_member))
    monkeypatch.setitem(globals(), "Kind", IntEnum("Kind", {"A": 2}))
    assert source_digest(compiled(reads_member)) != first


MOVED = """
from outer import {0}, outer
print(outer({0}(1.0, 2.0)), sum(outer.stats.cache_hits.values()))
"""


def test_code_for_a_class_that_has_moved_counts_as_none(tmp_path):
    text = "from typing import NamedTuple\n\nclass Pair(NamedTuple):\n    a: float\n    b: float\n"
    head, body = "from dynamics.compiled import compiled\nfrom here import {0}\n\n", "@compiled\ndef outer(x):\n"
    outer = head + body + "    return x.a + x.b\n"
    for name in ("Pair", "Couple"):
        (tmp_path / "here.py").write_text(text.replace("Pair", name), encoding="utf-8")
        (tmp_path / "outer.py").write_text(outer.format(name), encoding="utf-8")
        assert run(tmp_path, MOVED.format(name)) == (3.0, 0)
        assert run(tmp_path, MOVED.format(name)) == (3.0, 1)


def test_code_that_calls_a_kernel_of_a_moved_module_counts_as_none(tmp_path):
    """The caller's bytecode stays the same, and its machine code names the former module."""
    for name, text in FILES.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    assert run(tmp_path) == (8.0, 0)
    (tmp_path / "inner.py").rename(tmp_path / "within.py")
    (tmp_path / "outer.py").write_text(FILES["outer.py"].replace("from inner", "from within"), encoding="utf-8")
    assert run(tmp_path) == (8.0, 0)
    assert run(tmp_path) == (8.0, 1)


def test_a_global_of_a_kernel_has_to_be_defined_before_it():
    with pytest.raises(NameError, match=r"kernel early needs later_on: define that before it"):
        compiled(early)


def early(x):
    return later_on(x)  # noqa: F821
