"""Functions of `evaluation` take few parameters: related values are one dataclass or NamedTuple."""

import ast
from pathlib import Path

import evaluation

MOST = 7


def parameters(function):
    """The number of parameters, `self` and `cls` not counted."""
    given = function.args
    names = [each.arg for each in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
    return len(names) - (names[:1] in (["self"], ["cls"])) + bool(given.vararg) + bool(given.kwarg)


def is_command(path, function):
    return "commands" in path.parts and (function.name.endswith("_command") or bool(function.decorator_list))


def test_a_function_has_few_parameters():
    root = Path(evaluation.__file__).parent
    found = {}
    for path in root.rglob("*.py"):
        for each in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(each, ast.FunctionDef) and parameters(each) > MOST and not is_command(path, each):
                found[each.name] = parameters(each)
    assert not found
