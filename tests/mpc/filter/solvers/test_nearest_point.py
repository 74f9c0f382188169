"""The nearest point to the origin under linear constraints: against a solver, and the conditions of optimality."""

import casadi as ca
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mpc.filter.solvers.nearest_point import nearest

SOLVER = ca.conic("qp", "daqp", {"h": ca.Sparsity.dense(2, 2), "a": ca.Sparsity.dense(12, 2)}, {"error_on_fail": False})


def problem(seed: int) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(0, 13))
    slopes = rng.normal(size=(n, 2)) * 10 ** rng.uniform(-2, 2, (n, 1))
    if n > 2 and rng.random() < 0.3:
        slopes[1] = slopes[0] * rng.choice([-2.0, 1.0])
    low, high = np.sort(rng.uniform(-1.5, 1.5, (2, 2)), axis=0)
    at = rng.uniform(low, high)
    values = rng.normal(0.3, 1, n) * np.linalg.norm(slopes, axis=1)
    return values, slopes, at, low, high


@settings(max_examples=400, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_nearest_point_is_that_of_a_solver(seed: int) -> None:
    values, slopes, at, low, high = problem(seed)
    mine = nearest(values, slopes, at, low, high)
    size = np.maximum(np.linalg.norm(slopes, axis=1), 1e-12)
    rows, bound = np.zeros((12, 2)), np.full(12, -1e9)
    rows[: len(values)], bound[: len(values)] = slopes / size[:, None], (slopes @ at - values) / size
    found = SOLVER(h=ca.DM.eye(2), a=rows, lba=bound, uba=1e9, lbx=low, ubx=high)
    theirs = np.array(found["x"]).ravel()
    held = (rows @ theirs >= bound - 1e-6).all() and (theirs >= low - 1e-6).all() and (theirs <= high + 1e-6).all()
    if mine is None:
        assert not held or (rows @ theirs - bound).min() < 1e-5
    else:
        assert (values + slopes @ (mine - at) >= -1e-8 * np.maximum(size, 1)).all()
        assert np.abs(np.clip(mine, low, high) - mine).max() <= 1e-9
        if held:
            np.testing.assert_allclose(mine, theirs, atol=1e-6)


def test_constraints_that_are_not_finite_do_not_count() -> None:
    values, slopes = np.array([np.inf, np.nan, -1.0]), np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]])
    found = nearest(values, slopes, np.zeros(2), -np.ones(2), np.ones(2))
    np.testing.assert_allclose(found, [0.0, 0.5])


def test_a_constraint_that_no_point_changes_can_rule_all_out() -> None:
    box = np.ones(2)
    assert nearest(np.array([-1.0]), np.zeros((1, 2)), np.zeros(2), -box, box) is None
    assert nearest(np.array([1.0]), np.zeros((1, 2)), np.zeros(2), -box, box).tolist() == [0.0, 0.0]
