"""Compiled loops: numba, with the machine code kept on disk.

A *kernel* is a function of arrays and scalars that decides nothing: the loops over vehicles, candidates and frames.
The machine code on disk is made again when the kernel's own file has changed, and only then. So a kernel calls
kernels of its own file alone; `compiled` refuses others.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

__all__ = ["compiled"]

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """The function as machine code, made at its first call.

    Raises
    ------
    TypeError
        If it calls a kernel of another file.
    """
    for name in function.__code__.co_names:
        other = getattr(function.__globals__.get(name), "py_func", None)
        if other is not None and other.__module__ != function.__module__:
            raise TypeError(f"{function.__name__} calls {name} of {other.__module__}; kernels call those of their file")
    try:
        kernel = njit(cache=True, error_model="numpy")(function)
    except RuntimeError:  # there is no folder to keep it in
        kernel = njit(error_model="numpy")(function)
    return cast(F, kernel)
