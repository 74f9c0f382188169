"""Command-line options from the fields of a dataclass, one option for each field."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, fields
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

import typer

__all__ = ["one_option_a_field", "options_of", "with_options"]


Options = TypeVar("Options")


def one_option_a_field(command: Callable[[Options], None], kind: type[Options]) -> Callable[..., None]:
    """A typer command whose options and arguments are the fields of a dataclass.

    Parameters
    ----------
    command : takes an instance of the dataclass; its docstring is the help of the command.
    kind : the dataclass. Each annotation is `Annotated[type, typer.Option(...)]` or `typer.Argument(...)`.
    """
    hints = get_type_hints(kind, include_extras=True)
    keyword = inspect.Parameter.KEYWORD_ONLY
    parameters = [
        inspect.Parameter(each.name, keyword, default=_default(each), annotation=hints[each.name])
        for each in fields(kind)  # type: ignore[arg-type]
    ]

    def run(**given: Any) -> None:
        command(kind(**given))

    return _signed(run, command, parameters)


def _default(one: Field[Any]) -> Any:
    """The default of a field as a default of a parameter."""
    return inspect.Parameter.empty if one.default is MISSING else one.default


def _signed(
    run: Callable[..., None], command: Callable[..., None], parameters: list[inspect.Parameter]
) -> Callable[..., None]:
    """`run` with the name and docstring of a command, and with these parameters as its signature."""
    run.__doc__, run.__name__ = command.__doc__, command.__name__
    run.__annotations__ = {each.name: each.annotation for each in parameters}
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return run


def options_of(kind: type, help: Mapping[str, str]) -> list[inspect.Parameter]:
    """An option for each field of a dataclass, with the default None, so that a file can set it.

    Parameters
    ----------
    kind : a dataclass with text, numbers, flags, paths, tuples (options with several values) and mappings (files).
    help : help text of each field, by name.

    Returns
    -------
    The options as parameters of a function.
    """
    hints = get_type_hints(kind)
    return [
        inspect.Parameter(
            each.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=None,
            annotation=Annotated[
                _option_type(hints[each.name]) | None,
                typer.Option(help=_help(each, help[each.name]), show_default=False),
            ],
        )
        for each in fields(kind)
    ]


def with_options(command: Callable[..., None], more: list[inspect.Parameter]) -> Callable[..., None]:
    """A command that takes these options too, as keyword arguments.

    Parameters
    ----------
    command : function with its own options, followed by `**given`.
    more : the additional options.
    """
    own = [
        each
        for each in inspect.signature(command, eval_str=True).parameters.values()
        if each.kind is not each.VAR_KEYWORD
    ]
    whole = [*own, *more]

    def run(**given: Any) -> None:
        command(**given)

    return _signed(run, command, [each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in whole])


def _option_type(hint: Any) -> Any:
    """Type of the command-line option of a field."""
    parts = [each for each in get_args(hint) if each is not type(None)] if isinstance(hint, UnionType) else [hint]
    first = str if str in parts else parts[0]
    origin = get_origin(first)
    if origin is tuple:
        return list[get_args(first)[0]]  # type: ignore[misc]
    return Path if origin is not None and issubclass(origin, Mapping) else first


def _help(one: Field[Any], text: str) -> str:
    """Help text of an option, with its default."""
    shown = one.default is not MISSING and one.default not in (None, False, "", (), 0)
    return f"{text} [{one.default}]" if shown else text
