"""numpy's own random numbers in compiled code: the generator that `env.reset(seed=...)` creates, from the same seed.

`SeedSequence` and PCG64 (O'Neill 2014) as in numpy, which keeps the streams of both stable. A generator is a row of six
numbers: state (high, low), increment (high, low), whether half of a draw is left, and that half.

A longer row continues with a replay of given random numbers: the position of the next number, 0 for none, and then the
numbers. They replace the draws of the generator, so that a scene can be built from chosen numbers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynamics.compiled import kernel_inline, kernel_no_refcount

__all__ = [
    "REPLAY_START",
    "WORDS",
    "below",
    "from_generator",
    "interval",
    "next_64",
    "seed_row",
    "to_generator",
    "uniform",
]

GeneratorRow = NDArray[np.uint64]

WORDS = 6
"""Numbers in the row of a generator."""
REPLAY_START = WORDS + 1
"""Index at which the replayed numbers begin in a longer row."""

_U = np.uint64
_LOW, _32, _16 = _U(0xFFFFFFFF), _U(32), _U(16)
_ONE, _ZERO, _SIXTYTHREE, _FIFTYEIGHT, _SIXTYFOUR, _ELEVEN = _U(1), _U(0), _U(63), _U(58), _U(64), _U(11)
_MULTIPLIER_HIGH, _MULTIPLIER_LOW = _U(2549297995355413924), _U(4865540595714422341)
_INIT_A, _MULT_A, _INIT_B, _MULT_B = _U(0x43B0D7E5), _U(0x931E8875), _U(0x8B51F9DD), _U(0x58F38DED)
_MIX_L, _MIX_R = _U(0xCA01F9DD), _U(0x4973F715)


@kernel_inline
def _times(a: Any, b: Any) -> tuple[Any, Any]:
    """The 128-bit product of two 64-bit numbers, as high and low."""
    a1, a0, b1, b0 = a >> _32, a & _LOW, b >> _32, b & _LOW
    low, middle, other = a0 * b0, a1 * b0, a0 * b1
    carry = (low >> _32) + (middle & _LOW) + (other & _LOW)
    return a1 * b1 + (middle >> _32) + (other >> _32) + (carry >> _32), a * b


@kernel_inline
def _advance(row: GeneratorRow) -> None:
    """Advance the state of the generator by one step."""
    high, low = _times(row[1], _MULTIPLIER_LOW)
    high += row[0] * _MULTIPLIER_LOW + row[1] * _MULTIPLIER_HIGH
    total = low + row[3]
    row[0] = high + row[2] + (_ONE if total < low else _ZERO)
    row[1] = total


@kernel_inline
def next_64(row: GeneratorRow) -> Any:
    """The next 64 random bits."""
    _advance(row)
    mixed, turn = row[0] ^ row[1], row[0] >> _FIFTYEIGHT
    return (mixed >> turn) | (mixed << ((_SIXTYFOUR - turn) & _SIXTYTHREE))


@kernel_inline
def _next_32(row: GeneratorRow) -> Any:
    """The next 32 random bits."""
    if row[4]:
        row[4] = _ZERO
        return row[5]
    drawn = next_64(row)
    row[4], row[5] = _ONE, drawn >> _32
    return drawn & _LOW


@kernel_inline
def _is_replayed(row: GeneratorRow) -> bool:
    """Whether the next draw is a replayed number."""
    return len(row) > WORDS and bool(row[WORDS] > _ZERO) and bool(WORDS + np.int64(row[WORDS]) < len(row))


@kernel_inline
def _share(word: Any) -> float:
    """A word as a number in [0, 1), as of `Generator.random`."""
    return float(word >> _ELEVEN) * (1.0 / 9007199254740992.0)


@kernel_inline
def _next_replayed(row: GeneratorRow) -> float:
    """The next replayed number, in [0, 1)."""
    place = WORDS + np.int64(row[WORDS])
    row[WORDS] += _ONE
    return _share(row[place])


@kernel_inline
def uniform(row: GeneratorRow, low: float, high: float) -> float:
    """`Generator.uniform(low, high)`, or a replayed number."""
    return low + (high - low) * (_next_replayed(row) if _is_replayed(row) else _share(next_64(row)))


@kernel_inline
def below(row: GeneratorRow, n: int) -> Any:
    """`Generator.integers(n)`, n at most 2^32 - 1 (Lemire 2019), or a replayed number."""
    if n <= 1:
        return 0
    if _is_replayed(row):
        return np.int64(_next_replayed(row) * n)
    size = _U(n)
    product = _next_32(row) * size
    if (product & _LOW) < size:
        threshold = (_LOW - (size - _ONE)) % size
        while (product & _LOW) < threshold:
            product = _next_32(row) * size
    return np.int64(product >> _32)


@kernel_inline
def interval(row: GeneratorRow, last: int) -> Any:
    """The draw of `Generator.shuffle`: a number from 0 to `last`, at most 2^32 - 1, by masked rejection."""
    mask = _U(last)
    for shift in range(5):
        mask |= mask >> _U(1 << shift)
    drawn = _next_32(row) & mask
    while drawn > _U(last):
        drawn = _next_32(row) & mask
    return np.int64(drawn)


@kernel_no_refcount
def _hashed(value: Any, constant: Any) -> tuple[Any, Any]:
    value ^= constant
    constant = (constant * _MULT_A) & _LOW
    value = (value * constant) & _LOW
    return value ^ (value >> _16), constant


@kernel_no_refcount
def _mixed(x: Any, y: Any) -> Any:
    mixed = (_MIX_L * x - _MIX_R * y) & _LOW
    return mixed ^ (mixed >> _16)


@kernel_no_refcount
def _word(entropy: Any, constant: Any) -> tuple[Any, Any]:
    value = entropy ^ constant
    constant = (constant * _MULT_B) & _LOW
    value = (value * constant) & _LOW
    return value ^ (value >> _16), constant


@kernel_no_refcount
def seed_row(row: GeneratorRow, seed: int) -> None:
    """The row of `np.random.default_rng(seed)`, of a seed from 0 to 2^63 - 1."""
    constant = _INIT_A
    if len(row) > WORDS:
        row[WORDS] = _ZERO
    # The pool of four words stands in the row itself until it is used up.
    row[0], row[1], row[2], row[3] = _U(seed) & _LOW, _U(seed) >> _32, _ZERO, _ZERO
    for i in range(4):
        row[i], constant = _hashed(row[i], constant)
    for source in range(4):
        for target in range(4):
            if source != target:
                value, constant = _hashed(row[source], constant)
                row[target] = _mixed(row[target], value)
    a, b, c, d = row[0], row[1], row[2], row[3]
    w0, constant = _word(a, _INIT_B)
    w1, constant = _word(b, constant)
    w2, constant = _word(c, constant)
    w3, constant = _word(d, constant)
    w4, constant = _word(a, constant)
    w5, constant = _word(b, constant)
    w6, constant = _word(c, constant)
    w7, constant = _word(d, constant)
    high, low = w0 | (w1 << _32), w2 | (w3 << _32)
    to, last = w4 | (w5 << _32), w6 | (w7 << _32)
    row[0], row[1] = _ZERO, _ZERO
    row[2], row[3] = (to << _ONE) | (last >> _SIXTYTHREE), (last << _ONE) | _ONE
    row[4], row[5] = _ZERO, _ZERO
    _advance(row)
    total = row[1] + low
    row[0] = row[0] + high + (_ONE if total < low else _ZERO)
    row[1] = total
    _advance(row)


def from_generator(generator: np.random.Generator) -> GeneratorRow:
    """The row of a PCG64 generator, (6,) uint64."""
    state: Any = generator.bit_generator.state
    inner = state["state"]
    words = [inner["state"] >> 64, inner["state"], inner["inc"] >> 64, inner["inc"], state["has_uint32"]]
    return np.array([w & (2**64 - 1) for w in (*words, state["uinteger"])], dtype=np.uint64)


def to_generator(row: GeneratorRow, generator: np.random.Generator) -> None:
    """Set the state of a PCG64 generator from a row."""
    words = [int(w) for w in row]
    generator.bit_generator.state = {
        "bit_generator": "PCG64",
        "state": {"state": (words[0] << 64) | words[1], "inc": (words[2] << 64) | words[3]},
        "has_uint32": words[4],
        "uinteger": words[5],
    }
