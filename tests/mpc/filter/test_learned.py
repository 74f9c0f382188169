"""The predictive filter on a learned model: it plans with the model, refuses steps that the model lacks, and
intervenes."""

from __future__ import annotations

import copy
import pickle
from functools import lru_cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.errors import ConfigError
from dynamics.vehicle import bicycle
from mpc import FilterProblem, FilterSettings, PredictiveFilter, Status
from mpc.filter.program.condensed import build
from mpc.filter.program.road_step import stage_expression

SETTINGS = FilterSettings(dt=0.05, substeps=4, stages=8, obstacles=1)
HALF = (4.5, 1.3)
floats = st.floats


class Exact:
    """The bicycle, as a model of stages."""

    def held(self, state, control, duration):
        for _ in range(round(duration / 0.05)):
            state = bicycle.step_expression(state, control[0], control[1], 0.05)
        return state


class Weak(Exact):
    """A car whose brakes and throttle have half the effect."""

    def held(self, state, control, duration):
        return super().held(state, ca.vertcat(0.5 * control[0], control[1]), duration)


class Broken(Exact):
    """A model that answers NaN at speed."""

    def held(self, state, control, duration):
        after = super().held(state, control, duration)
        return after + ca.if_else(state[3] > 1, np.nan, 0)


EXACT, WEAK = Exact(), Weak()


@lru_cache(maxsize=8)
def filter_on(model, config=SETTINGS):
    return PredictiveFilter(config, model)


def standing(gap, v, config=SETTINGS):
    """A standing car ahead, with `gap` from bumper to the buffered bumper [m], in a lane without room beside it."""
    wall = np.tile([gap + HALF[0], gap + HALF[0] + 5, -1.0, 1.0], (config.stages, 1, 1))
    return FilterProblem(np.array([0.0, 0.0, 0.0, v]), np.array([5.0, 0.0]), wall, HALF, edges=(-1.6, 1.6))


@given(
    st.tuples(floats(-50, 50), floats(-6, 6), floats(-1, 1), floats(0, 40)).map(np.array),
    st.tuples(floats(-5, 5), floats(-0.7, 0.7)).map(np.array),
    st.sampled_from([None, -0.02, 0.0, 0.01]),
    st.integers(1, 4),
)
@settings(max_examples=60, deadline=None)
def test_a_stage_of_an_exact_model_is_the_bicycles_frames(state, control, kappa, frames):
    """On an arc too: where a car ends up does not depend on whether it is taken to the road once or at each frame."""
    x, u, k = ca.SX.sym("x", 4), ca.SX.sym("u", 2), ca.SX.sym("k")
    if kappa is not None:
        state = state * [1, 0.5, 1, 1]
    curvature = None if kappa is None else k
    answers = []
    for model in (None, EXACT):
        after = stage_expression(x, u, curvature, 0.05, frames, model)
        answers.append(ca.Function("stage", [x, u, k], [after])(state, control, kappa or 0.0).full().ravel())
    np.testing.assert_allclose(answers[1], answers[0], atol=1e-8)


@given(floats(5, 60), floats(2, 14))
@settings(max_examples=25, deadline=None)
def test_the_answer_on_an_exact_model_is_that_of_the_bicycle(gap, v):
    answers = []
    for model in (None, EXACT):
        solver = filter_on(model)
        solver.reset()
        answers.append(solver.solve(standing(gap, v)))
    own, other = answers
    assert own.status is other.status
    if own.status is Status.SOLVED:
        np.testing.assert_allclose(other.inputs[0], own.inputs[0], atol=0.02)


@given(floats(15, 40), floats(6, 12))
@settings(max_examples=25, deadline=None)
def test_a_plan_is_the_models_own(gap, v):
    """Its states are the model's rollout of its inputs, and not the bicycle's."""
    solver = filter_on(WEAK)
    solver.reset()
    result = solver.solve(standing(gap, v))
    state, exact = np.array([0.0, 0.0, 0.0, v]), np.array([0.0, 0.0, 0.0, v])
    for inputs, got in zip(result.inputs, result.states, strict=True):
        for _ in range(4):
            state = bicycle.step(state, 0.5 * inputs[0], inputs[1], 0.05)
            exact = bicycle.step(exact, inputs[0], inputs[1], 0.05)
        np.testing.assert_allclose(got, state, atol=1e-7)
    if np.abs(result.inputs[:, 0]).max() > 0.5:
        assert np.abs(result.states[:, 3] - exact[3]).max() > 1e-3


def test_the_filter_brakes_earlier_on_a_model_with_weaker_brakes():
    def first(model):
        solver = filter_on(model)
        solver.reset()
        return solver.solve(standing(30.0, 10.0))

    assert first(None).status is first(WEAK).status is Status.SOLVED
    # Half the effect of the throttle too, so the speed that is gained is compared.
    assert 0.5 * first(WEAK).inputs[0, 0] < first(None).inputs[0, 0] - 0.5


def test_a_model_that_answers_nan_gives_no_plan():
    solver = PredictiveFilter(SETTINGS, Broken())
    result = solver.solve(standing(30.0, 10.0))
    assert not result.status.usable
    assert np.isnan(result.inputs).all()


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda f: pickle.loads(pickle.dumps(f))])
def test_a_copy_plans_on_the_same_model(copied):
    solver = PredictiveFilter(SETTINGS, WEAK)
    problem = standing(30.0, 10.0)
    assert copied(solver).solve(problem).inputs.tobytes() == solver.solve(problem).inputs.tobytes()


def test_a_step_that_the_model_lacks_is_refused_at_construction():
    class Half(Exact):
        def held(self, state, control, duration):
            raise ConfigError(f"not for {duration}")

    with pytest.raises(ConfigError, match=r"not for 0\.2"):
        PredictiveFilter(SETTINGS, Half())


def test_the_program_is_built_on_the_model():
    problem, inputs = standing(60.0, 10.0), np.tile([2.0, 0.0], (SETTINGS.stages, 1))
    bicycles, models = build(problem, inputs, SETTINGS), build(problem, inputs, SETTINGS, WEAK)
    assert models.states[-1, 3] == pytest.approx(10 + 0.5 * (bicycles.states[-1, 3] - 10))
