"""Syntax nodes that a mutant replaces, named without the names that occur in them.

The *pattern* of a node is its source with `_` for each name and each attribute of a name; names of builtins, numbers
and strings stay. Of a statement with a body it is the header. So a renaming or another layout makes no mutant stale,
and a changed expression does.
"""

from __future__ import annotations

import ast
import builtins
import copy
import re
import textwrap
from pathlib import Path

__all__ = ["StaleEditError", "nodes_of", "path_of", "pattern_of", "replaced", "slots_of"]

_KEPT = frozenset(dir(builtins))


class StaleEditError(Exception):
    """No node, or several, of a module are what an edit names."""


def path_of(module: str, root: Path) -> Path:
    """The source of a module below a folder.

    Parameters
    ----------
    module : dotted name.

    Raises
    ------
    StaleEditError
        If there is no such module.
    """
    stem = root.joinpath(*module.split("."))
    for path in (stem.with_suffix(".py"), stem / "__init__.py"):
        if path.is_file():
            return path
    raise StaleEditError(f"no module named {module}")


def _is_name(node: ast.AST) -> bool:
    """Whether a node is a name or an attribute of one, and no builtin."""
    while isinstance(node, ast.Attribute):
        node = node.value
    return isinstance(node, ast.Name) and node.id not in _KEPT


class _Anonymous(ast.NodeTransformer):
    def generic_visit(self, node: ast.AST) -> ast.AST:
        if _is_name(node):
            return ast.Name("_")
        super().generic_visit(node)
        if isinstance(node, ast.Attribute):
            node.attr = "_"
        if isinstance(node, ast.keyword | ast.arg) and node.arg is not None:
            node.arg = "_"
        return node


def pattern_of(node: ast.AST) -> str:
    """The pattern of a node."""
    bare = copy.deepcopy(node)
    if isinstance(bare, ast.stmt) and hasattr(bare, "body"):
        for block in ("body", "orelse", "handlers", "finalbody"):
            if hasattr(bare, block):
                setattr(bare, block, [])
    return ast.unparse(ast.fix_missing_locations(_Anonymous().visit(bare)))


def slots_of(node: ast.AST) -> list[ast.AST]:
    """The nodes that are `_` in a pattern, in the order of the source."""
    if _is_name(node):
        return [node]
    found = [slot for child in ast.iter_child_nodes(node) for slot in slots_of(child)]
    return sorted(found, key=lambda slot: (slot.lineno, slot.col_offset))  # type: ignore[attr-defined]


def nodes_of(tree: ast.Module, function: str, pattern: str) -> list[ast.AST]:
    """The expressions and statements with a pattern, in the order of the source.

    Parameters
    ----------
    function : qualified name of the function or class that they are in; "" for all of the module.
    """
    scope: ast.AST = tree
    for name in filter(None, function.split(".")):
        scopes = [each for each in getattr(scope, "body", []) if getattr(each, "name", None) == name]
        if len(scopes) != 1:
            raise StaleEditError(f"{len(scopes)} definitions of {function}")
        scope = scopes[0]
    inside = [each for each in ast.walk(scope) if each is not scope and isinstance(each, ast.expr | ast.stmt)]
    found = [each for each in inside if pattern_of(each) == pattern]
    return sorted(found, key=lambda each: (each.lineno, each.col_offset))


def replaced(source: str, function: str, pattern: str, new: str, which: int = 0, reads: str = "") -> str:
    """A source with one node replaced.

    Parameters
    ----------
    pattern : of the node. which : the number of the node among those of this pattern in the function, from 1 on; 0
        where there is one. reads : a part of its source.
    new : what takes its place; `{1}` is the first `_` of the pattern, and `{0}` the node itself. For an `if` statement
        a header, which ends with a colon, takes the place of its header alone.

    Raises
    ------
    StaleEditError
        If there is no such node, or another number of them.
    """
    found = nodes_of(ast.parse(source), function, pattern)
    if not (len(found) == 1 if which == 0 else len(found) >= max(which, 2)):
        raise StaleEditError(f"{len(found)} times {pattern!r} in {function or 'the module'}, asked for number {which}")
    node, lines = found[max(which, 1) - 1], source.splitlines(keepends=True)
    if reads not in (ast.get_source_segment(source, node) or ""):
        raise StaleEditError(f"number {which} of {pattern!r} in {function} does not read {reads!r}")
    texts = [ast.get_source_segment(source, each) for each in (node, *slots_of(node))]
    text = re.sub(r"\{(\d+)\}", lambda match: texts[int(match[1])] or "", new)
    if isinstance(node, ast.If) and text.endswith(":"):
        node, text = node.test, text.removeprefix("if ").removesuffix(":")
    first, last = _offset(lines, node.lineno, node.col_offset), _offset(lines, *_end(node))  # type: ignore[attr-defined]
    indented = textwrap.indent(text, " " * node.col_offset).lstrip()  # type: ignore[attr-defined]
    return source[:first] + (indented if isinstance(node, ast.stmt) else f"({text})") + source[last:]


def _end(node: ast.AST) -> tuple[int, int]:
    """Line and column in bytes after a node."""
    return node.end_lineno, node.end_col_offset  # type: ignore[attr-defined]


def _offset(lines: list[str], line: int, column: int) -> int:
    """Where in the text a line and a column in bytes are."""
    return sum(map(len, lines[: line - 1])) + len(lines[line - 1].encode()[:column].decode())
