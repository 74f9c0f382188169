"""Compiled loops: numba, with the machine code cached on disk.

A *kernel* is a compiled function of arrays and scalars: the loops over vehicles, candidates and frames. numba compiles
a kernel again when its file has changed, and only then. Here a kernel is compiled again when its own bytecode, a kernel
that it calls, or a global value that it reads has changed. So kernels may call kernels of other files, and a copy of
the sources finds the machine code. An edit of a comment or a docstring compiles nothing.
"""

from __future__ import annotations

import builtins
from collections.abc import Callable, Hashable, Iterator, Mapping
from dis import get_instructions
from enum import EnumType
from hashlib import sha256
from inspect import getsourcefile, signature
from pathlib import Path
from pickle import UnpicklingError
from types import CodeType, ModuleType
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit
from numba.extending import overload
from numba.np.unsafe.ndarray import to_fixed_tuple

__all__ = ["compiled", "dispatch_by_field_type", "kernel_inline", "kernel_no_refcount", "row_as_tuple", "source_digest"]

F = TypeVar("F", bound=Callable[..., Any])
row_as_tuple: Any = to_fixed_tuple
"""`row_as_tuple(row, n)` returns the first n numbers of an array as a tuple, inside a kernel. It fills a NamedTuple."""
_MADE_FROM: dict[Any, str] = {}


def compiled(function: F) -> F:
    """Compile a function with numba. The machine code is made at the first call and cached on disk."""
    return _kernel(function)


def kernel_no_refcount(function: F) -> F:
    """Compile a kernel that allocates no arrays, without reference counts of its array arguments, and without the GIL.

    Reference counts take some 10 ns for each array and call, which is more than the work of a small kernel of one
    vehicle. Other threads run meanwhile.
    """
    return _kernel(function, _nrt=False, nogil=True)


def kernel_inline(function: F) -> F:
    """Compile as `kernel_no_refcount` does, and inline the kernel into its callers. For small kernels that run once
    for each vehicle."""
    return _kernel(function, _nrt=False, nogil=True, forceinline=True)


def dispatch_by_field_type(kernels: Mapping[type, Any], field: str) -> Callable[[F], F]:
    """Dispatch to one of several kernels with the same parameters, by the class of a field of the first argument, a
    NamedTuple. numba chooses the kernel when it compiles the caller. The decorated function itself has an empty body.

    Parameters
    ----------
    kernels : the kernel for each class of the field. The classes are NamedTuples.
    field : name of the field.
    """

    def decorate(function: F) -> F:
        def choose(*args: Any) -> Any:
            kernel = kernels[args[0].types[args[0].fields.index(field)].instance_class]
            return kernel.py_func

        # numba requires that the chooser and the chosen kernel have the same signature.
        cast(Any, choose).__signature__ = signature(function)
        cast(Any, overload)(function, jit_options={"_nrt": False, "nogil": True, "error_model": "numpy"})(choose)
        _MADE_FROM[function] = "".join(_MADE_FROM[kernel] for kernel in kernels.values())
        return function

    return decorate


def _kernel(function: F, **options: bool) -> F:
    """Compile a function with numba's cache, stamped with the digest of its sources; without a cache where numba has
    none."""
    made, make = _digest(function), cast(Any, njit)
    try:
        kernel: Any = make(cache=True, error_model="numpy", **options)(function)
        file = kernel._cache._cache_file
        # By default numba stamps a cache file with the time and size of the source file, and names it by the kernel's
        # line.
        file._source_stamp, file._load_index = made, _readable(file._load_index)
        file._load_data = _loadable(file._load_data)
        line = f"-{function.__code__.co_firstlineno}.py"
        file._index_path = file._index_path.replace(line, ".py")
        file._data_name_pattern = file._data_name_pattern.replace(line, ".py")
    except (RuntimeError, AttributeError):  # no writable cache folder, or another cache class
        kernel = make(error_model="numpy", **options)(function)
    _MADE_FROM[kernel] = made
    return cast(F, kernel)


def _readable(load: Callable[[], dict[Any, Any]]) -> Callable[[], dict[Any, Any]]:
    """Wrap numba's loader of a cache index, so that an index it cannot unpickle counts as empty.

    numba unpickles the whole index before it compares the stamps. An old index may name classes that have moved since.
    """

    def index() -> dict[Any, Any]:
        try:
            return load()
        except (AttributeError, ImportError, UnpicklingError, EOFError):
            return {}

    return index


def _loadable(load: Callable[[str], Any]) -> Callable[[str], Any]:
    """Wrap numba's loader of machine code, so that code it cannot unpickle counts as missing, and is compiled again.

    Machine code names the modules of the kernels that it calls. They may have moved since, with the same bytecode.
    """

    def data(name: str) -> Any:
        try:
            return load(name)
        except (AttributeError, ImportError, UnpicklingError, EOFError) as error:
            raise FileNotFoundError(name) from error

    return data


def source_digest(kernel: Any) -> str:
    """Digest of the sources of a kernel [hex]. The machine code in the cache is current where its stamp equals this
    digest."""
    return _MADE_FROM[kernel]


def _digest(function: Callable[..., Any]) -> str:
    """SHA-256 of the bytecode of a function, and of the kernels and global values that it reads [hex].

    Raises
    ------
    NameError
        If the function reads a global name that is not defined yet: a later change of its value would not be noticed.
    """
    read_names = set(_globals_read(function.__code__))
    later = read_names - function.__globals__.keys() - vars(builtins).keys()
    if later - {function.__name__}:
        # The value of a name that is not defined yet cannot be part of the digest.
        raise NameError(f"kernel {function.__qualname__} needs {', '.join(sorted(later))}: define that before it")
    parts = [function.__qualname__, repr(function.__defaults__), *_bytecode(function.__code__)]
    for name in sorted(read_names & function.__globals__.keys()):
        parts.append(f"{name}={_value_digest(function.__globals__[name], function)}")
    return sha256("\0".join(parts).encode()).hexdigest()


def _globals_read(code: CodeType) -> Iterator[str]:
    """Names of the global values that a function reads, and the functions inside it."""
    yield from (each.argval for each in get_instructions(code) if each.opname == "LOAD_GLOBAL")
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _globals_read(constant)


def _bytecode(code: CodeType) -> Iterator[str]:
    """The bytecode of a function and of the functions inside it, without docstrings and line numbers."""
    yield code.co_code.hex()
    yield code.co_exceptiontable.hex()
    yield repr((code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars, code.co_argcount, code.co_flags))
    # The first constant of a function is its docstring or None; lambdas and comprehensions have neither.
    is_named = not code.co_name.startswith("<")
    for constant in code.co_consts[is_named:]:
        if isinstance(constant, CodeType):
            yield from _bytecode(constant)
        else:
            yield repr(sorted(constant, key=repr) if isinstance(constant, frozenset) else constant)


def _value_digest(value: Any, function: Callable[..., Any]) -> str:
    """A text that changes when a global value changes.

    For an intrinsic, the text of the file that defines it. For an unknown kind of value, the text of the kernel's file.
    """
    if isinstance(value, Hashable) and value in _MADE_FROM:
        return _MADE_FROM[value]
    if isinstance(value, bool | int | float | str | tuple | np.generic):
        return repr(value)
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {value.tobytes().hex()}"
    if isinstance(value, type) and issubclass(value, tuple):
        return repr(getattr(value, "_fields", ()))
    if isinstance(value, EnumType):
        return repr({name: getattr(value, name).value for name in value.__members__})
    if isinstance(value, ModuleType) or getattr(value, "__module__", "").partition(".")[0] in (
        "numpy",
        "numba",
        "math",
    ):
        return str(value.__name__)
    return Path(getsourcefile(getattr(value, "_defn", function)) or "").read_text(encoding="utf-8")
