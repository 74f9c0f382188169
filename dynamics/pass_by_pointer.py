"""Tuples of arrays that kernels hand on by where they are, and not word by word.

A kernel that is called with a NamedTuple of thirty arrays gets some 250 words, and each of them is written to the stack
and read again, whether or not it is used. A tuple that is `lent` stays where it is for as long as the kernel that lends
it has not returned; whoever is handed it reads of it what is `held` there, and that is what is used of it and no more.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

__all__ = ["Lent", "held", "lent"]

T = TypeVar("T")
_built_in: Any = intrinsic
"""What makes LLVM code of a call, for type checkers that do not know the decorator."""


class Lent(Generic[T]):
    """Where a tuple is, for type checkers: in a kernel it is an address."""


def _write(builder: Any, value: Any, place: Any) -> None:
    if not isinstance(value.type, ir.Aggregate):
        builder.store(value, place)
        return
    for i in range(len(value.type)):
        _write(builder, builder.extract_value(value, i), cgutils.gep_inbounds(builder, place, 0, i))


@_built_in
def _lent(typingctx: Any, value: Any) -> Any:
    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        model = context.data_model_manager[signature.args[0]]
        place = cgutils.alloca_once(builder, model.get_data_type())
        _write(builder, model.as_data(builder, args[0]), place)
        return place

    return types.CPointer(value)(value), codegen


@_built_in
def _held(typingctx: Any, place: Any) -> Any:
    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return context.data_model_manager[signature.return_type].load_from_data_pointer(builder, args[0])

    return place.dtype(place), codegen


lent: Callable[[T], Lent[T]] = _lent
"""`lent(x)` is where a tuple is that a kernel hands on, good until that kernel returns. In a loop it is one place."""
held: Callable[[Lent[T]], T] = _held
"""`held(x)` is the tuple itself."""
