"""Pass NamedTuples of arrays between kernels by pointer instead of by value.

A kernel that is called with a NamedTuple of thirty arrays receives some 250 words. Each word is written to the stack
and read again, whether or not it is used. `address_of(x)` stores the tuple once and returns a pointer to it;
`dereference(pointer)` dereferences it. The callee loads only the fields that it reads. The pointer is valid until the
kernel that called `address_of` returns.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

__all__ = ["Pointer", "address_of", "dereference"]

T = TypeVar("T")
_intrinsic: Any = intrinsic
"""numba's `intrinsic` as `Any`: its type stubs do not describe the decorator."""


class Pointer(Generic[T]):
    """Pointer to a tuple of type T. For type checkers only: inside a kernel it is an address."""


def _write(builder: Any, value: Any, place: Any) -> None:
    """Store a value at an address, field by field for an aggregate."""
    if not isinstance(value.type, ir.Aggregate):
        builder.store(value, place)
        return
    for i in range(len(value.type)):
        _write(builder, builder.extract_value(value, i), cgutils.gep_inbounds(builder, place, 0, i))


@_intrinsic
def _lent(typingctx: Any, value: Any) -> Any:
    """Allocate the tuple on the caller's stack, store it, and return its address."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        model = context.data_model_manager[signature.args[0]]
        place = cgutils.alloca_once(builder, model.get_data_type())
        _write(builder, model.as_data(builder, args[0]), place)
        return place

    return types.CPointer(value)(value), codegen


@_intrinsic
def _held(typingctx: Any, place: Any) -> Any:
    """Load the tuple from its address."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return context.data_model_manager[signature.return_type].load_from_data_pointer(builder, args[0])

    return place.dtype(place), codegen


address_of: Callable[[T], Pointer[T]] = _lent
"""`address_of(x)` returns a pointer to a tuple, valid until the calling kernel returns. In a loop, all iterations
share one stack slot."""
dereference: Callable[[Pointer[T]], T] = _held
"""`dereference(pointer)` dereferences a pointer that `address_of` returned."""
