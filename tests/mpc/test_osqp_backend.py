"""The two backends solve the same programs; OSQP's traps are covered by checks outside it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from filter_scenes import record

from dynamics.errors import ConfigError
from mpc import FilterProblem, FilterSettings, PredictiveFilter, Status

SETTINGS = FilterSettings(stages=12, free_moves=6)
OSQP = replace(SETTINGS, backend="osqp")


def leader(front: float = 30.0) -> FilterProblem:
    boxes = np.zeros((12, 1, 4))
    boxes[:, 0] = [front, front + 5, -1.0, 1.0]
    return FilterProblem(np.array([0.0, 0.0, 0.0, 12.0]), np.array([5.0, 0.05]), boxes, (4.5, 1.3), edges=(-2.0, 2.0))


def test_both_backends_agree_on_recorded_questions():
    ours, theirs = PredictiveFilter(SETTINGS), PredictiveFilter(OSQP)
    usable, apart = 0, []
    for problem, first in record(SETTINGS, 30, "weave", seed=40):
        if first:
            ours.reset()
            theirs.reset()
        guess = None if ours._plan is None else ours._plan
        a, b = ours.solve(problem), theirs.solve(problem, guess)
        assert b.status is not Status.ERROR or not np.isfinite(b.inputs).any()
        if a.status.usable and b.status.usable:
            usable += 1
            apart.append(np.abs((a.inputs[0] - b.inputs[0]) / (10.0, np.pi / 2)).max())
    assert usable >= 24
    assert np.median(apart) < 0.01


def test_the_answer_keeps_clear_and_is_repeatable():
    results = [PredictiveFilter(OSQP).solve(leader()) for _ in range(2)]
    assert results[0].status.usable
    assert results[0].states[:, 0].max() + 4.5 < 30.1
    np.testing.assert_array_equal(results[0].inputs, results[1].inputs)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_leaves_nothing_behind(bad):
    solver = PredictiveFilter(OSQP)
    clean = solver.solve(leader())
    broken = replace(leader(), state=np.array([0.0, bad, 0.0, 12.0]))
    result = solver.solve(broken)
    assert result.status is Status.BAD_INPUT
    assert np.isnan(result.inputs).all()
    np.testing.assert_array_equal(solver.solve(leader()).inputs, clean.inputs)


def test_a_program_that_is_poisoned_or_raises_is_an_error_and_the_next_is_clean(monkeypatch):
    solver = PredictiveFilter(OSQP)
    clean = solver.solve(leader())
    slot = next(iter(solver._solver._slots.values()))
    monkeypatch.setattr(slot, "_hessian", lambda: np.full(slot._upper.sum(), np.nan))
    solver._plan = None
    assert not solver.solve(leader()).status.usable
    solver.reset()
    np.testing.assert_array_equal(solver.solve(leader()).inputs, clean.inputs)
    slot = next(iter(solver._solver._slots.values()))

    def raises():
        raise RuntimeError("solver")

    monkeypatch.setattr(slot, "solve", raises)
    solver._plan = None
    assert not solver.solve(leader()).status.usable
    solver.reset()
    np.testing.assert_array_equal(solver.solve(leader()).inputs, clean.inputs)


def test_unknown_backends_are_refused():
    with pytest.raises(ConfigError, match="valid are daqp, osqp"):
        FilterSettings(backend="ipopt")
