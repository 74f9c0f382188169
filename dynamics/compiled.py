"""Compiled loops: numba, with the machine code kept on disk.

A *kernel* is a function of arrays and scalars that decides nothing: the loops over vehicles, candidates and frames.
numba makes the machine code on disk again when the kernel's own file has changed, and only then. Here it is made again
when anything has changed that went into it: its file, the files of the kernels that it calls, and the numbers that it
takes from elsewhere. So kernels may call those of other files, and a copy of the sources finds its code again.
"""

from __future__ import annotations

import builtins
from collections.abc import Callable, Hashable, Mapping
from dis import get_instructions
from hashlib import sha256
from inspect import getsource, getsourcefile, signature
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, TypeVar, cast

from numba import njit
from numba.extending import overload
from numba.np.unsafe.ndarray import to_fixed_tuple

__all__ = ["by_type", "compiled", "inlined", "made_from", "numbers_of", "uncounted"]

F = TypeVar("F", bound=Callable[..., Any])
numbers_of: Any = to_fixed_tuple
"""`numbers_of(row, n)` are the n numbers of an array as a tuple, inside a kernel: what a NamedTuple is made of."""
_MADE_FROM: dict[Any, str] = {}


def compiled(function: F) -> F:
    """The function as machine code, made at its first call."""
    return _kernel(function)


def uncounted(function: F) -> F:
    """The same for kernels that make no arrays: nobody counts who holds those that are handed in and on.

    Counting takes some 10 ns an array and call, which is more than the work of a small function of one vehicle. Other
    threads go on meanwhile.
    """
    return _kernel(function, _nrt=False, nogil=True)


def inlined(function: F) -> F:
    """The same for what is small and called for every vehicle: it becomes a part of the kernels that call it."""
    return _kernel(function, _nrt=False, nogil=True, forceinline=True)


def by_type(kernels: Mapping[type, Any], field: str) -> Callable[[F], F]:
    """What stands for several kernels of the same parameters: numba takes the one for the class of a field of the first
    argument, which is a NamedTuple. There is nothing in the function itself.

    Parameters
    ----------
    kernels : by the class of the field, itself a NamedTuple. field : its name.
    """

    def decorate(function: F) -> F:
        def choose(*args: Any) -> Any:
            kernel = kernels[args[0].types[args[0].fields.index(field)].instance_class]
            return kernel.py_func

        # numba compares the parameters of what chooses with those of what is chosen.
        cast(Any, choose).__signature__ = signature(function)
        cast(Any, overload)(function, jit_options={"_nrt": False, "nogil": True, "error_model": "numpy"})(choose)
        _MADE_FROM[function] = "".join(_MADE_FROM[kernel] for kernel in kernels.values())
        return function

    return decorate


def _kernel(function: F, **options: bool) -> F:
    made, make = _digest(function), cast(Any, njit)
    try:
        kernel: Any = make(cache=True, error_model="numpy", **options)(function)
        file = kernel._cache._cache_file
        # What numba compares with what it finds on the disk: by itself the time and size of the kernel's file.
        file._source_stamp, file._load_index = made, _readable(file._load_index)
    except (RuntimeError, AttributeError):  # there is no folder to keep it in, or it is kept in another way
        kernel = make(error_model="numpy", **options)(function)
    _MADE_FROM[kernel] = made
    return cast(F, kernel)


def _readable(load: Callable[[], dict[Any, Any]]) -> Callable[[], dict[Any, Any]]:
    """numba reads an index whole before it asks how old it is; an old one may name classes that have moved since."""

    def index() -> dict[Any, Any]:
        try:
            return load()
        except (AttributeError, ImportError, UnpicklingError, EOFError):
            return {}

    return index


def made_from(kernel: Any) -> str:
    """What tells whether the machine code of a kernel is that of the present sources."""
    return _MADE_FROM[kernel]


def _digest(function: Callable[..., Any]) -> str:
    file = getsourcefile(function)
    parts = [function.__qualname__, Path(file).read_text(encoding="utf-8") if file else getsource(function)]
    asked = {each.argval for each in get_instructions(function) if each.opname == "LOAD_GLOBAL"}
    later = asked - function.__globals__.keys() - vars(builtins).keys()
    if later - {function.__name__}:
        # What is not there yet could change without anybody noticing.
        raise NameError(f"kernel {function.__qualname__} needs {', '.join(sorted(later))}: define that before it")
    for name in function.__code__.co_names:
        value = function.__globals__.get(name)
        if isinstance(value, bool | int | float | str | tuple):
            parts.append(f"{name}={value!r}")
        elif isinstance(value, type) and issubclass(value, tuple):
            parts.append(f"{name}={getattr(value, '_fields', ())}")
        elif callable(value) and isinstance(value, Hashable) and value in _MADE_FROM:
            parts.append(f"{name}={_MADE_FROM[value]}")
    return sha256("\0".join(parts).encode()).hexdigest()
