"""Former names of public functions, keywords, members and values: they work for one release and warn."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

__all__ = ["RenamedText", "accept_former_fields", "accept_former_keywords", "warn_of_former_name", "with_present_names"]

Function = TypeVar("Function", bound=Callable[..., Any])
Class = TypeVar("Class", bound=type)


class RenamedText(str):
    """A value in records that had another text. Comparing it with the former text warns, and finds them equal.

    Parameters
    ----------
    text : the present text.
    former : the former text.
    """

    __slots__ = ("former",)
    former: str

    def __new__(cls, text: str, former: str) -> RenamedText:
        """Make the text."""
        made = super().__new__(cls, text)
        made.former = former
        return made

    __hash__ = str.__hash__

    def __eq__(self, other: object) -> bool:
        if type(other) is str and other == self.former:
            warn_of_former_name(repr(other), f"compare with {str(self)!r}")
            return True
        return str.__eq__(self, other) if isinstance(other, str) else NotImplemented

    def __getnewargs__(self) -> tuple[str, str]:  # type: ignore[override]
        return str(self), self.former


def warn_of_former_name(former: str, remedy: str, stacklevel: int = 3) -> None:
    """Warn that a name is deprecated, and say what to write.

    Parameters
    ----------
    former : as users write it.
    remedy : a clause such as "write Guarantee.ALL_SEEN".
    stacklevel : frames between this function and the user's line.
    """
    warnings.warn(f"{former} is deprecated: {remedy}", DeprecationWarning, stacklevel=stacklevel)


def with_present_names(
    given: Mapping[str, Any], present: Mapping[str, str], owner: str, stacklevel: int = 4
) -> dict[str, Any]:
    """Keywords or keys with their present names; each former name warns.

    If both names are given, the value of the former name is taken: `dataclasses.replace` adds the present one.

    Parameters
    ----------
    given : values by keyword.
    present : the present name of each former name.
    owner : the function, class or file that takes the keywords, as users write it.
    stacklevel : frames between `warn_of_former_name` and the user's line.
    """
    named = dict(given)
    for former in given.keys() & present.keys():
        warn_of_former_name(f"{former!r} of {owner}", f"write {present[former]!r}", stacklevel)
        named[present[former]] = named.pop(former)
    return named


def accept_former_keywords(present: Mapping[str, str], owner: str = "") -> Callable[[Function], Function]:
    """Decorator of a function that takes former keywords too.

    Parameters
    ----------
    present : the present name of each former keyword.
    owner : as in `with_present_names`; by default the name of the function.
    """

    def decorate(function: Function) -> Function:
        @functools.wraps(function)
        def call(*args: Any, **given: Any) -> Any:
            if not present.keys().isdisjoint(given):
                given = with_present_names(given, present, owner or function.__name__)
            return function(*args, **given)

        return call  # type: ignore[return-value]

    return decorate


def accept_former_fields(present: Mapping[str, str]) -> Callable[[Class], Class]:
    """Decorator of a dataclass whose constructor and attributes have former names too.

    Parameters
    ----------
    present : the present name of each former field.
    """

    def decorate(kind: Class) -> Class:
        settable: Any = kind
        settable.__init__ = accept_former_keywords(present, kind.__name__)(settable.__init__)
        for former, name in present.items():
            setattr(kind, former, _former_attribute(kind.__name__, former, name))
        return kind

    return decorate


def _former_attribute(owner: str, former: str, present: str) -> property:
    """A property that warns and returns the present attribute."""

    def read(instance: Any) -> Any:
        warn_of_former_name(f"{owner}.{former}", f"write {owner}.{present}")
        return getattr(instance, present)

    return property(read, doc=f"The former name of `{present}`.")
