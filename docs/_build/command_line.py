"""The commands and options of `shield`, read from the typer application. The site shows them in reference/cli.md."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import typer

from evaluation.commands.cli import app

__all__ = ["commands", "options"]


def commands() -> dict[str, Any]:
    """Every command by its full name, such as "shield dynamics fit", in the order of `shield --help`."""
    return dict(_below("shield", typer.main.get_command(app)))


def options() -> str:
    """A section for each command in Markdown: what it does, its arguments and its options."""
    return "\n".join(line for name, command in commands().items() for line in _section(name, command))


def _below(name: str, command: Any) -> Iterator[tuple[str, Any]]:
    for each, below in command.commands.items():
        full = f"{name} {each}"
        if hasattr(below, "commands"):
            yield from _below(full, below)
        else:
            yield full, below


def _section(name: str, command: Any) -> list[str]:
    rows = [f"| {_spelling(each)} | {_default(each)} | {_cell(each.help)} |" for each in command.params if not getattr(each, "hidden", False)]
    table = ["| argument or option | default | meaning |", "| :-- | :-- | :-- |", *rows, ""] if rows else []
    return [f"### {name}", "", _cell(command.help), "", *table]


def _spelling(parameter: Any) -> str:
    if parameter.param_type_name == "argument":
        return f"`{parameter.name.upper()}`"
    return ", ".join(f"`{each}`" for each in (*parameter.opts, *parameter.secondary_opts))


def _default(parameter: Any) -> str:
    value = parameter.default
    if value is None or isinstance(value, bool) or callable(value):
        return ""
    values = value if isinstance(value, list | tuple) else [value]
    return ", ".join(f"`{getattr(each, 'value', each)}`" for each in values)


def _cell(text: str | None) -> str:
    """On one line, and nothing in it is taken for Markdown but code between backticks."""
    plain = " ".join((text or "").split())
    return plain.replace("|", "\\|").replace("<", "&lt;").replace("*", "\\*").replace("[", "\\[")
