"""After any fault no plan leaves the filter, and the next clean call is unaffected."""

from dataclasses import replace

import numpy as np
import pytest

from dynamics.errors import ConfigError, SceneError, ShieldError
from mpc import FilterProblem, FilterSettings, PredictiveFilter, Reference, Status
from mpc.filter.program.condensed import build
from mpc.filter.solvers.daqp import QpSolution, Solver, residuals

SETTINGS = FilterSettings()
N = SETTINGS.stages


def clean():
    wall = np.tile([40.0, 45.0, -1.0, 1.0], (N, 1, 1))
    return FilterProblem(
        np.array([0.0, 0.0, 0.0, 12.0]), np.array([5.0, 0.0]), wall, (4.5, 1.3), (-2.0, 2.0), rest=np.array([40.0])
    )


@pytest.fixture(scope="module")
def expected():
    return PredictiveFilter(SETTINGS).solve(clean())


def no_plan(result, problem):
    assert np.isnan(result.inputs).all()
    assert np.isnan(result.states).all()
    assert result.inputs.shape == (N, 2)
    assert result.sides.shape == problem.occupancy.shape[:2]
    assert not result.status.usable


def recovers(used, expected):
    used.reset()
    again = used.solve(clean())
    assert again.status is Status.SOLVED
    assert again.inputs.tobytes() == expected.inputs.tobytes()


def with_value(problem, name, value):
    """The problem with one entry of one field replaced."""
    kept = getattr(problem, name)
    if isinstance(kept, np.ndarray):
        array = kept.copy()
        array.flat[-1] = value
        return replace(problem, **{name: array})
    if isinstance(kept, tuple):
        return replace(problem, **{name: (value, kept[1])})
    return replace(problem, **{name: value})


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["state", "proposal", "half"])
def test_values_that_are_not_finite_are_bad_input(name, bad, expected):
    used, problem = PredictiveFilter(SETTINGS), with_value(clean(), name, bad)
    result = used.solve(problem)
    assert result.status is Status.BAD_INPUT
    no_plan(result, problem)
    after = used.solve(clean())  # without a reset
    assert after.inputs.tobytes() == expected.inputs.tobytes()


@pytest.mark.parametrize("name", ["occupancy", "rest", "edges", "corridor", "stop"])
def test_nan_is_bad_input_where_infinity_stands_for_unbounded(name):
    used = PredictiveFilter(SETTINGS)
    problem = with_value(clean(), name, np.nan)
    assert used.solve(problem).status is Status.BAD_INPUT
    no_plan(used.solve(problem), problem)
    open_ended = used.solve(with_value(clean(), name, -np.inf if name in ("edges", "corridor") else np.inf))
    assert open_ended.status not in (Status.BAD_INPUT, Status.ERROR)
    assert np.isfinite(open_ended.inputs).all()


@pytest.mark.parametrize(
    "problem",
    [
        replace(clean(), occupancy=clean().occupancy[..., [1, 0, 2, 3]]),
        replace(clean(), occupancy=np.tile(clean().occupancy, (1, 97, 1)), rest=None),
        replace(clean(), half=(-1.0, 1.0)),
        replace(clean(), limits=np.array([[1.0, -1.0], [0.0, 0.0]])),
        replace(clean(), reference=Reference(0.0, np.nan)),
        replace(clean(), reference=Reference(0.0, 1.0, speed=-1.0)),
        replace(clean(), state=np.array([0.0, 0.0, 0.0, 1e6])),
    ],
)
def test_a_value_out_of_range_is_bad_input(problem):
    result = PredictiveFilter(SETTINGS).solve(problem)
    assert result.status is Status.BAD_INPUT
    no_plan(result, problem)


def test_a_guess_that_is_not_finite_is_bad_input():
    guess = np.zeros((N, 2))
    guess[3, 1] = np.nan
    assert PredictiveFilter(SETTINGS).solve(clean(), guess=guess).status is Status.BAD_INPUT


@pytest.mark.parametrize("v", [5.0, 25.0])
@pytest.mark.parametrize("gap", [-3.0, 0.0, 1.0])
def test_a_scene_without_a_way_out_says_so_and_brakes(v, gap, expected):
    wall = np.tile([4.5 + gap, 12.0 + gap, -50.0, 50.0], (N, 1, 1))
    problem = replace(clean(), state=np.array([0.0, 0.0, 0.0, v]), occupancy=wall, rest=None)
    used = PredictiveFilter(SETTINGS)
    result = used.solve(problem)
    assert result.status in (Status.SLACK, Status.UNSETTLED)
    assert result.violation > SETTINGS.tolerance
    assert result.inputs[0, 0] < -4.9
    recovers(used, expected)


@pytest.mark.parametrize("edges", [(1.0, -1.0), (3.0, 3.0), (5.0, np.inf)])
def test_a_road_that_is_too_narrow_says_so(edges):
    result = PredictiveFilter(SETTINGS).solve(replace(clean(), edges=edges))
    assert not result.status.usable
    assert np.isfinite(result.inputs).all()


def test_the_iteration_limit_leaves_no_plan_that_violates(expected):
    strict = PredictiveFilter(FilterSettings(max_iter=1))
    result = strict.solve(clean())
    assert result.status is Status.ERROR
    no_plan(result, clean())


def test_the_time_limit_leaves_no_plan_that_violates():
    hasty = PredictiveFilter(FilterSettings(time_limit=1e-9))
    result = hasty.solve(clean())
    assert result.status is Status.TIME_LIMIT
    no_plan(result, clean())
    assert result.sweeps == 0


class Broken:
    """A solver that misbehaves once, and is well after a reset."""

    def __init__(self, how):
        self.how, self.well, self.resets = how, Solver(SETTINGS), 0

    def reset(self):
        self.resets, self.how = self.resets + 1, None

    def prepare(self, program):
        self.well.prepare(program)

    def begin(self, frames):
        pass

    def solve(self, program):
        answer = self.well.solve(program)
        return answer if self.how is None else self.how(answer)


def raising(answer):
    raise RuntimeError("the solver has raised")


@pytest.mark.parametrize(
    "how",
    [
        raising,
        lambda a: QpSolution(None, np.inf, np.inf, 0),
        lambda a: QpSolution(np.full_like(a.x, np.nan), 0.0, 0.0, 0),
        lambda a: QpSolution(np.full_like(a.x, np.inf), 0.0, 0.0, 0),
    ],
    ids=["raises", "fails", "claims NaN solved", "claims infinity solved"],
)
def test_a_broken_solver_is_reset_and_leaves_no_plan(how, expected):
    used = PredictiveFilter(SETTINGS)
    used._solver = broken = Broken(how)
    result = used.solve(clean())
    assert result.status is Status.ERROR
    no_plan(result, clean())
    assert broken.resets == 1
    assert used.solve(clean()).inputs.tobytes() == expected.inputs.tobytes()


def test_a_solver_that_claims_nonsense_is_found_out_by_the_rollout(expected):
    used = PredictiveFilter(SETTINGS)
    used._solver = Broken(lambda a: QpSolution(-a.x, 0.0, 0.0, 0))
    result = used.solve(clean())
    if result.status.usable:
        assert result.violation < SETTINGS.tolerance
    used._solver = Solver(SETTINGS)
    recovers(used, expected)


@pytest.mark.parametrize("where", ["g", "A", "H", "lower", "high"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_the_solver_refuses_poisoned_data_and_is_well_afterwards(where, bad):
    program = build(clean(), np.zeros((N, 2)), SETTINGS)
    solver = Solver(SETTINGS)
    before = solver.solve(program)
    array = getattr(program, where)
    kept = array.flat[0]
    array.flat[0] = bad
    poisoned = solver.solve(program)
    if where == "high" and bad == np.inf:
        assert poisoned.x is not None  # an input without an upper bound is no fault
    else:
        assert poisoned.x is None
    array.flat[0] = kept
    after = solver.solve(program)
    assert after.x.tobytes() == before.x.tobytes()


def test_the_solver_refuses_bounds_in_the_wrong_order():
    program = build(clean(), np.zeros((N, 2)), SETTINGS)
    program.low[0], program.high[0] = 1.0, -1.0
    assert Solver(SETTINGS).solve(program).x is None


def test_a_poisoned_object_is_thrown_away():
    program = build(clean(), np.zeros((N, 2)), SETTINGS)
    solver = Solver(SETTINGS)
    good = solver.solve(program)
    slot = solver._slots[id(program)]

    class Dead:
        program, x, bounds, rows = slot.program, slot.x, slot.bounds, slot.rows

        @staticmethod
        def call():
            raise SystemError("gone")

    solver._slots[id(program)] = Dead
    assert solver.solve(program).x is None
    assert solver.solve(program).x.tobytes() == good.x.tobytes()


def test_a_solver_that_does_nothing_is_noticed():
    program = build(clean(), np.zeros((N, 2)), SETTINGS)
    solver = Solver(SETTINGS)
    solver.solve(program)
    slot = solver._slots[id(program)]

    class Idle:
        program, x, bounds, rows = slot.program, slot.x, slot.bounds, slot.rows

        @staticmethod
        def call():
            return None

    solver._slots[id(program)] = Idle
    assert solver.solve(program).x is None


def test_residuals_detect_violated_constraints():
    program = build(clean(), np.zeros((N, 2)), SETTINGS)
    rows, columns = program.A.shape
    x = np.zeros(columns)
    x[0] = 3.0
    primal, dual = residuals(program, x, np.zeros(columns), np.zeros(rows))
    assert primal >= 3.0 - program.high[0]
    assert dual > 1.0


@pytest.mark.parametrize(
    "change",
    [
        {"state": np.zeros(3)},
        {"proposal": np.zeros(3)},
        {"occupancy": np.zeros((N, 4))},
        {"occupancy": np.zeros((N, 1, 3))},
        {"rest": np.zeros(2)},
        {"curvature": np.zeros(N + 1)},
        {"limits": np.zeros(4)},
        {"proposal": None},
    ],
)
def test_wrong_shapes_are_refused_by_name(change):
    name = next(iter(change))
    with pytest.raises(SceneError, match=name if change[name] is not None else "reference"):
        replace(clean(), **change)


@pytest.mark.parametrize(
    "change",
    [
        {"dt": 0.0},
        {"substeps": 0},
        {"stages": 1},
        {"stages": 20.0},
        {"obstacles": 1000},
        {"acceleration": (1.0, 5.0)},
        {"steering": 2.0},
        {"penalty": np.nan},
        {"free_moves": 21},
        {"time_limit": -1.0},
        {"sweeps": True},
    ],
)
def test_settings_out_of_range_are_refused_by_name(change):
    with pytest.raises(ConfigError, match=next(iter(change))):
        FilterSettings(**change)


def test_calls_that_do_not_fit_are_refused():
    short = FilterProblem(np.zeros(4), np.zeros(2), np.zeros((3, 0, 4)), (4.5, 1.3))
    with pytest.raises(ConfigError, match="3 stages"):
        PredictiveFilter(SETTINGS).solve(short)
    with pytest.raises(ConfigError, match="guess"):
        PredictiveFilter(SETTINGS).solve(clean(), guess=np.zeros((3, 2)))
    with pytest.raises(ShieldError, match="FilterSettings"):
        PredictiveFilter({"stages": 20})


def test_more_obstacles_than_it_was_compiled_for_are_all_kept_clear_of():
    walls = np.tile([200.0, 205.0, -1.0, 1.0], (N, 20, 1))
    walls[:, 17, :2] = [40.0, 45.0]
    few, many = clean(), replace(clean(), occupancy=walls, rest=None)
    one = PredictiveFilter(SETTINGS).solve(replace(few, rest=None))
    other = PredictiveFilter(SETTINGS).solve(many)
    np.testing.assert_allclose(one.inputs, other.inputs, atol=1e-6)
