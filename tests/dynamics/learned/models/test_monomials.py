"""Every monomial up to the degree exists once, with its value."""

from __future__ import annotations

from math import comb

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dynamics.learned.models.monomials import Monomials


@given(st.integers(1, 4), st.integers(0, 5), st.sets(st.integers(0, 3)), st.integers(0, 99))
def test_monomials_are_the_products_of_powers(count, degree, linear, seed):
    basis = Monomials(count, degree, linear)
    rows = {tuple(row) for row in basis.exponents.tolist()}
    assert len(rows) == len(basis)
    assert all(sum(row) <= degree and all(row[i] <= 1 for i in linear if i < count) for row in rows)
    if not linear & set(range(count)):
        assert len(basis) == comb(count + degree, degree)
    x = np.random.default_rng(seed).uniform(-1, 1, (count, 7))
    want = np.prod(x[None] ** basis.exponents[..., None], axis=1)
    np.testing.assert_allclose(basis(x), want, rtol=1e-12, atol=1e-15)


@given(st.integers(0, 6))
def test_a_linear_variable_goes_with_all_powers_of_the_others(degree):
    rows = Monomials(2, degree, {1}).exponents.tolist()
    assert sorted(rows) == sorted([i, j] for i in range(degree + 1) for j in (0, 1) if i + j <= degree)
