"""Numbers in compiled code are numpy's own: its random streams, its tangents and powers, its sums of products."""

import numpy as np
import pytest
from highway_env import utils
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from dynamics.highway_simulator.arithmetic import Sums, dot2, dot3, not_zero, sums_of_numpy, wrap_to_pi
from dynamics.highway_simulator.loops import LOOPS, Loop, addresses, apply, apply_two, at, at_two, c_pow
from dynamics.highway_simulator.random import WORDS, below, from_generator, interval, seed_row, to_generator, uniform

ADDRESSES = addresses()
NUMBERS = np.concatenate([np.random.default_rng(0).uniform(-1, 1, 2000), [0.0, -0.0, 1.0, -1.0, 1e-300, 0.5]])


@njit
def one(table, loop, x):
    return at(table[loop, 0], table[loop, 1], x)


@njit
def many(table, loop, x, out):
    apply(table[loop, 0], table[loop, 1], x, out, len(x))


@njit
def power(table, loop, x, y):
    return at_two(table[loop, 0], table[loop, 1], x, y)


@njit
def powers(table, loop, x, y, out):
    apply_two(table[loop, 0], table[loop, 1], x, y, out, len(x))


@njit
def pythons_power(table, loop, x, y):
    return c_pow(table[loop, 0], x, y)


@pytest.mark.parametrize("loop", [Loop.TAN, Loop.ARCTAN, Loop.ARCSIN, Loop.COS, Loop.SIN])
def test_functions_of_a_number_are_numpys_alone_and_together(loop):
    ufunc, out = LOOPS[loop], np.empty_like(NUMBERS)
    many(ADDRESSES, loop, NUMBERS, out)
    expected = [ufunc(float(x)) for x in NUMBERS]
    assert out.tobytes() == np.array(expected).tobytes()
    assert all(one(ADDRESSES, loop, x) == y for x, y in zip(NUMBERS[:200], expected, strict=False))


def test_powers_are_numpys_alone_and_together_and_pythons_are_the_c_librarys():
    rng = np.random.default_rng(1)
    x, y = rng.uniform(0, 1.3, 2000), rng.uniform(3.5, 4.5, 2000)
    out = np.empty_like(x)
    powers(ADDRESSES, Loop.POWER, x, y, out)
    assert out.tobytes() == np.array([np.power(float(a), float(b)) for a, b in zip(x, y, strict=True)]).tobytes()
    for a, b in zip(x[:200].tolist(), y.tolist(), strict=False):
        assert power(ADDRESSES, Loop.POWER, a, b) == np.power(a, b)
        assert pythons_power(ADDRESSES, Loop.C_POW, a * 30, 2.0) == (a * 30) ** 2


def test_sums_of_products_are_numpys():
    sums, _ = sums_of_numpy()
    if sums == Sums.OTHER:
        pytest.skip("this numpy adds in a way that is not known")
    rng = np.random.default_rng(2)
    for _ in range(500):
        a, b = rng.normal(size=(2, 3))
        assert dot2(sums, a[0], b[0], a[1], b[1]) == np.dot(a[:2], b[:2])
        assert dot3(sums, a[0], b[0], a[1], b[1], a[2], b[2]) == np.dot(a, b)


@given(st.floats(-20, 20) | st.sampled_from([np.pi, -np.pi, 0.01, -0.01, 0.0, -0.0]))
def test_small_functions_are_highway_envs(x):
    assert wrap_to_pi(x) == utils.wrap_to_pi(x)
    assert not_zero(x) == utils.not_zero(x)


@settings(max_examples=40)
@given(st.integers(0, 2**63 - 1), st.lists(st.integers(0, 3), max_size=40), st.integers(1, 1000))
def test_a_seed_gives_numpys_stream(seed, draws, n):
    row, generator = np.zeros(WORDS, np.uint64), np.random.default_rng(seed)
    seed_row(row, seed)
    assert np.array_equal(row, from_generator(generator))
    for draw in draws:
        if draw == 0:
            assert uniform(row, 0.9, 1.1) == generator.uniform(0.9, 1.1)
        elif draw == 1:
            assert below(row, n) == generator.integers(n)
        elif draw == 2:
            assert below(row, 4) == generator.choice(4)
        else:
            shuffled = np.arange(6.0)[:, None].repeat(2, axis=1)
            mine = shuffled.copy()
            generator.shuffle(shuffled)
            for k in range(5, 0, -1):
                j = interval(row, k)
                mine[[k, j]] = mine[[j, k]]
            assert np.array_equal(mine, shuffled)
    assert np.array_equal(row, from_generator(generator))
    other = np.random.default_rng(0)
    to_generator(row, other)
    assert other.random() == generator.random()
