"""Properties of every answer of the predictive filter."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
from highway_env.vehicle.kinematics import Vehicle
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mpc import FilterProblem, FilterSettings, PredictiveFilter, Reference, Status
from mpc.filter.problem import BACKENDS
from mpc.filter.program.road_step import rollout_function
from mpc.filter.solvers.guess import brake_guess, shifted

SETTINGS = FilterSettings()
HALF = (4.5, 1.3)
N, T = SETTINGS.stages, SETTINGS.stage
FILTERS = {backend: PredictiveFilter(replace(SETTINGS, backend=backend)) for backend in BACKENDS}
each = pytest.mark.parametrize("backend", BACKENDS)
floats = st.floats


def moving(boxes, stages=N, duration=T):
    """Rectangles of cars (s, r, v, v of the far end) over the stages, (N, m, 4)."""
    t = duration * np.arange(1, stages + 1)[:, None]
    s, r, v, far = np.array(boxes, dtype=float).reshape(-1, 4).T
    return np.stack([s + v * t - 2.5, s + np.maximum(v, far) * t + 2.5, r - 1 + 0 * t, r + 1 + 0 * t], axis=-1)


cars = st.tuples(floats(-60, 120), st.sampled_from([0.0, 4.0, 8.0]), floats(0, 30), floats(0, 35))
scenes = st.builds(
    lambda state, proposal, boxes: FilterProblem(
        np.array(state), np.array(proposal), moving(boxes), HALF, edges=(-2.0, 10.0)
    ),
    st.tuples(floats(-5, 500), floats(-0.5, 8.5), floats(-0.35, 0.35), floats(0, 32)),
    st.tuples(floats(-5, 5), floats(-0.7, 0.7)),
    st.lists(cars, max_size=8),
)


def separation(problem, states):
    """Least separation from the rectangles and the edges, by numpy, with the corners as they are."""
    s, r, psi, _ = states.T
    lon, lat = problem.half
    along = lon * np.abs(np.cos(psi)) + lat * np.abs(np.sin(psi))
    across = lon * np.abs(np.sin(psi)) + lat * np.abs(np.cos(psi))
    edges = np.minimum(r - across - problem.edges[0], problem.edges[1] - r - across).min()
    if problem.occupancy.shape[1] == 0:
        return edges
    low, high, left, right = np.moveaxis(problem.occupancy, -1, 0)
    s, r, along, across = (v[:, None] for v in (s, r, along, across))
    gaps = np.max([low - s - along, s - along - high, left - r - across, r - across - right], axis=0)
    return min(edges, gaps.min())


@each
@given(scenes)
@settings(max_examples=150, deadline=None)
def test_a_usable_plan_keeps_clear_and_every_plan_keeps_its_bounds(backend, problem):
    FILTERS[backend].reset()
    result = FILTERS[backend].solve(problem)
    assert result.status not in (Status.ERROR, Status.BAD_INPUT)
    assert np.all(np.abs(result.inputs) <= [5.0, np.pi / 4])
    if backend == "daqp":  # OSQP may have met its deadline
        assert result.primal < SETTINGS.accuracy
        assert result.dual < SETTINGS.accuracy
    if result.status.usable:
        assert separation(problem, result.states) >= -SETTINGS.tolerance
        assert (result.states[:, 3] > -1e-6).all()
    else:
        assert result.violation >= SETTINGS.tolerance


@each
@given(scenes)
@settings(max_examples=40, deadline=None)
def test_the_planned_states_are_the_simulators_under_the_planned_inputs(backend, problem):
    FILTERS[backend].reset()
    result = FILTERS[backend].solve(problem)
    s, r, psi, v = problem.state
    vehicle = Vehicle(None, np.array([s, r]), psi, v)
    for (a, delta), got in zip(result.inputs, result.states, strict=True):
        for _ in range(SETTINGS.substeps):
            vehicle.act({"acceleration": a, "steering": delta})
            vehicle.step(SETTINGS.dt)
        np.testing.assert_allclose(got, [*vehicle.position, vehicle.heading, vehicle.speed], atol=1e-9)


@each
@given(floats(-3, 3), floats(-0.01, 0.01), floats(5, 30), st.sampled_from([0.0, 4.0, 8.0]))
@settings(max_examples=60, deadline=None)
def test_an_empty_road_changes_nothing(backend, a, delta, v, r):
    empty = np.zeros((N, 0, 4))
    problem = FilterProblem(np.array([0.0, r, 0.0, v]), np.array([a, delta]), empty, HALF, edges=(-2.0, 10.0))
    FILTERS[backend].reset()
    result = FILTERS[backend].solve(problem)
    assert result.status is Status.SOLVED
    assert result.inputs[0].tolist() == [a, delta]


def standing(gap, v):
    """A standing car ahead, with `gap` from bumper to the buffered bumper [m], in a lane without room beside it."""
    wall = np.tile([gap + HALF[0], gap + HALF[0] + 5, -1.0, 1.0], (N, 1, 1))
    return FilterProblem(np.array([0.0, 0.0, 0.0, v]), np.array([5.0, 0.0]), wall, HALF, edges=(-1.6, 1.6))


def stops_short(a, gap, v):
    """Whether one stage at `a`, then the hardest braking, ends before the gap does, in the simulator's arithmetic."""
    s = 0.0
    for frame in range(2000):
        s += v * SETTINGS.dt
        v += (a if frame < SETTINGS.substeps else max(-SETTINGS.braking, -v / SETTINGS.dt)) * SETTINGS.dt
    return s <= gap


@each
@given(floats(15, 60), floats(2, 14))
@example(21.0, 14.0)  # at rest within a move of four stages
@example(19.5, 12.0)
@settings(max_examples=60, deadline=None)
def test_the_answer_is_as_near_to_the_proposal_as_a_stop_allows(backend, gap, v):
    low, high = -5.0, 5.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stops_short(middle, gap, v) else (low, middle)
    FILTERS[backend].reset()
    result = FILTERS[backend].solve(standing(gap, v))
    if not stops_short(-5.0, gap - SETTINGS.tolerance, v):
        assert not result.status.usable or stops_short(-5.0, gap, v)
    else:
        assert result.status.usable
        assert low - 0.15 < result.inputs[0, 0] < low + 0.1
        assert result.states[:, 3].min() > -1e-9


@each
@given(scenes)
@settings(max_examples=30, deadline=None)
def test_two_filters_agree_bitwise_and_a_reset_forgets_everything(backend, problem):
    one, two = (PredictiveFilter(replace(SETTINGS, backend=backend)) for _ in range(2))
    answers = [f.solve(problem) for f in (one, two)]
    again = [f.solve(problem) for f in (one, two)]
    one.reset()
    fresh = one.solve(problem)
    for left, right in (answers, again, (answers[0], fresh)):
        assert left.inputs.tobytes() == right.inputs.tobytes()
        assert left.states.tobytes() == right.states.tobytes()
        assert (left.status, left.sides.tobytes()) == (right.status, right.sides.tobytes())


@each
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda f: pickle.loads(pickle.dumps(f))])
def test_a_copy_starts_fresh(backend, copied):
    problem = standing(30.0, 10.0)
    used = PredictiveFilter(replace(SETTINGS, backend=backend))
    first = used.solve(problem)
    used.solve(problem)
    assert copied(used).solve(problem).inputs.tobytes() == first.inputs.tobytes()


@each
@given(floats(10, 60), floats(2, 14))
@settings(max_examples=30, deadline=None)
def test_warm_and_cold_agree(backend, gap, v):
    problem = standing(gap, v)
    FILTERS[backend].reset()
    cold = FILTERS[backend].solve(problem)
    warm = [FILTERS[backend].solve(problem, elapsed=0) for _ in range(3)][-1]
    if cold.status is Status.SOLVED:
        assert warm.status.usable
        assert np.all(np.abs(warm.inputs[0] - cold.inputs[0]) <= 0.01 * np.array([10.0, np.pi / 2]))


@given(st.integers(0, 200), st.integers(1, 6), st.data())
def test_shifting_keeps_what_is_in_force_at_each_stage_start(frames, substeps, data):
    hold = data.draw(st.one_of(st.none(), st.integers(1, substeps)))
    config = FilterSettings(substeps=substeps, hold=hold)
    plan = np.arange(40.0).reshape(20, 2)
    frame_by_frame = np.repeat(plan, config.frames, axis=0)
    begins = np.array(config.ends) - config.frames
    frame_by_frame = np.vstack([frame_by_frame, np.tile(plan[-1], (frames + 20 * substeps, 1))])
    np.testing.assert_array_equal(shifted(plan, frames, config), frame_by_frame[frames + begins])


@given(scenes)
def test_the_braking_guess_stops_and_turns_along_the_road(problem):
    inputs = brake_guess(problem, SETTINGS)
    assert (inputs[1:, 0] == SETTINGS.acceleration[0]).all()
    speed = problem.state[3]
    for k in range(N):  # braking in a stage ends at a standstill
        inputs[k, 0] = max(inputs[k, 0], -max(speed, 0.0) / T)
        speed += T * inputs[k, 0]
    states = rollout_function(N, SETTINGS.substeps, SETTINGS.dt)(problem.state, inputs.T, np.zeros((1, N))).full().T
    speed = max(problem.state[3] + T * problem.proposal[0], 0.0) - 5.0 * T * (N - 1)
    assert abs(states[-1, 3] - max(speed, 0.0)) < 1e-9
    assert abs(states[-1, 2]) <= max(abs(problem.state[2]) + 0.1, 0.11)


@each
def test_the_filter_overrides_full_throttle_towards_a_leader_that_stops(backend):
    """A filter that is never called, or always passes, fails this test."""
    leader, v_leader, brake = 40.0, 20.0, 0.0
    vehicle = Vehicle(None, np.array([0.0, 0.0]), 0.0, 25.0)
    FILTERS[backend].reset()
    overridden = 0
    for step in range(100):
        t = T * np.arange(1, N + 1)
        way = np.minimum(t, v_leader / 6)
        rectangle = np.empty((N, 1, 4))
        rectangle[:, 0, 0] = leader + v_leader * way - 3 * way**2 - 2.5
        rectangle[:, 0, 1:] = [1e4, -1, 1]
        state = np.array([*vehicle.position, vehicle.heading, vehicle.speed])
        rest = np.array([leader + v_leader**2 / 12 - 2.5])
        problem = FilterProblem(state, np.array([5.0, 0.0]), rectangle, HALF, (-1.6, 1.6), rest=rest)
        result = FILTERS[backend].solve(problem)
        assert result.status.usable, (step, result)
        overridden += result.inputs[0, 0] < 4.9
        brake = 6.0 if step > 20 else 0.0
        for _ in range(SETTINGS.substeps):
            vehicle.act({"acceleration": result.inputs[0, 0], "steering": result.inputs[0, 1]})
            vehicle.step(SETTINGS.dt)
            leader, v_leader = leader + v_leader * SETTINGS.dt, max(v_leader - brake * SETTINGS.dt, 0.0)
            assert leader - vehicle.position[0] > 5.0 + 2.0 - 2 * SETTINGS.tolerance - v_leader * SETTINGS.dt
    assert overridden > 20
    assert vehicle.speed < 0.5


@each
@pytest.mark.parametrize("curvature", [0.0, 0.05, -0.03])
def test_the_filter_drives_to_a_reference_lane_and_speed(backend, curvature):
    state = np.array([0.0, 0.0, 0.0, 5.0])
    driver = PredictiveFilter(replace(SETTINGS, backend=backend))
    bend = None if curvature == 0 else np.full(N, curvature)
    step = rollout_function(1, SETTINGS.substeps, SETTINGS.dt)
    for _ in range(75):
        aim = Reference(r=4.0, v=10.0)
        empty = np.zeros((N, 0, 4))
        problem = FilterProblem(state, None, empty, HALF, (-2.0, 6.0), curvature=bend, reference=aim)
        result = driver.solve(problem)
        assert result.status.usable
        state = step(state, result.inputs[0], curvature).full().ravel()
        assert -2.0 < state[1] < 6.0
    np.testing.assert_allclose(state[1:], [4.0, 0.0, 10.0], atol=0.15)
