"""Planners find known optima, stay inside bounds, are repeatable, plan batches as single problems, keep time limits,
and never return values that are not finite."""

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.errors import ConfigError, ModelError
from dynamics.learned.models.bicycle import BicycleModel
from mpc.sampling.categorical import CategoricalCEM, CategoricalSettings
from mpc.sampling.cem import CEM
from mpc.sampling.mppi import MPPI
from mpc.sampling.noise import coloured
from mpc.sampling.plan import PlanStatus
from mpc.sampling.sampler_settings import PlannerSettings

KINDS = {
    "plain": PlannerSettings.notebook(blocks=3, hold=1),
    "icem": PlannerSettings.icem(blocks=3, hold=1),
    "multistart": PlannerSettings.multistart(blocks=3, hold=1),
    "mean": PlannerSettings.icem(blocks=3, hold=1, answer="mean"),
}


class Echo:
    """The state that follows is the action."""

    state_dim = action_dim = 2

    def step(self, states, actions):
        return np.array(actions)


class Broken(Echo):
    """Some or all of the predicted states are NaN."""

    def __init__(self, share):
        self.share, self.generator = share, np.random.default_rng(0)

    def step(self, states, actions):
        out = np.array(actions)
        out[self.generator.random(len(out)) < self.share] = np.nan
        return out


class Slow(Echo):
    calls = 0

    def step(self, states, actions):
        self.calls += 1
        time.sleep(0.01)
        return np.array(actions)


def quadratic(targets):
    """Squared distance to targets (B, m) or (E, B, m): its minimum inside the bounds is the targets, cut down."""
    goal = np.asarray(targets)
    goal = goal[:, None] if goal.ndim == 3 else goal
    return lambda t: np.square(t.states - goal).sum(axis=(2, 3))


targets = st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6).map(lambda x: np.array(x).reshape(3, 2))
kinds = st.sampled_from(sorted(KINDS))


@settings(max_examples=25, deadline=None)
@given(targets, kinds)
def test_the_optimum_of_a_quadratic_is_found(goal, kind):
    planner = CEM(Echo(), KINDS[kind].replace(iterations=12, samples=200, decay=1.0, min_std=0.01))
    plan = planner.plan(np.zeros(2), quadratic(goal))
    best = np.clip(goal, -1, 1)
    assert plan.cost <= np.square(goal - best).sum() + 0.05
    assert np.abs(plan.inputs - best).max() < 0.2
    assert plan.status == (PlanStatus.PLANNED,)


@settings(max_examples=10, deadline=None)
@given(targets)
def test_mppi_comes_near_the_optimum(goal):
    chosen = PlannerSettings(blocks=3, hold=1, iterations=10, samples=400, std=0.3)
    plan = MPPI(Echo(), chosen, temperature=0.02).plan(np.zeros(2), quadratic(goal))
    best = np.clip(goal, -1, 1)
    assert plan.cost <= np.square(goal - best).sum() + 0.3


@settings(max_examples=40, deadline=None)
@given(
    kinds,
    st.integers(0, 5),
    st.tuples(st.floats(-1, -0.1), st.floats(-1, -0.1)),
    st.tuples(st.floats(0.1, 1), st.floats(0.1, 1)),
)
def test_inputs_never_leave_their_bounds(kind, seed, low, high):
    planner = CEM(Echo(), KINDS[kind].replace(seed=seed, std=3.0), low=low, high=high)
    memory = None
    for goal in ([[9.0, -9.0]] * 3, [[-9.0, 9.0]] * 3):
        plan = planner.plan(np.zeros(2), quadratic(goal), memory)
        memory = plan.memory
        for inputs in (plan.action, plan.inputs, plan.elites, plan.memory.mean):
            assert np.all(inputs >= np.float32(low))
            assert np.all(inputs <= np.float32(high))


@settings(max_examples=15, deadline=None)
@given(targets, kinds, st.integers(0, 1000))
def test_the_same_seed_gives_the_same_plans(goal, kind, seed):
    memories, plans = [None, None], []
    planners = [CEM(Echo(), KINDS[kind].replace(seed=seed)) for _ in range(2)]
    for _ in range(3):
        np.random.seed(np.random.randint(1000))  # noqa: NPY002 (other random numbers must not matter)
        plans = [p.plan(np.zeros(2), quadratic(goal), m) for p, m in zip(planners, memories, strict=True)]
        memories = [p.memory for p in plans]
        assert np.array_equal(plans[0].inputs, plans[1].inputs)
    first, other = (
        CEM(Echo(), KINDS[kind].replace(seed=s)).plan(np.zeros(2), quadratic(goal)).elites for s in (seed, seed + 1)
    )
    assert not np.array_equal(first, other)


@settings(max_examples=15, deadline=None)
@given(st.lists(targets, min_size=2, max_size=4), kinds)
def test_a_batch_is_planned_for_as_each_alone(goals, kind):
    planner, goals = CEM(BicycleModel(), KINDS[kind].replace(hold=2, look=1)), np.array(goals)
    states = np.zeros((len(goals), 6))
    states[:, 4], states[:, 2] = 1, np.arange(len(goals))

    def cost(rows):
        aim = 10 * goals[rows, 0]
        return lambda t: np.square(t.states[..., :2] - aim[:, None, None]).sum(axis=(2, 3))

    together = alone = None
    for _ in range(2):
        together = planner.plan(states, cost(slice(None)), together and together.memory)
        alone = [
            planner.plan(states[i : i + 1], cost(slice(i, i + 1)), alone and alone[i].memory) for i in range(len(goals))
        ]
        for i, plan in enumerate(alone):
            assert np.array_equal(together.inputs[i], plan.inputs[0])
            assert together.cost[i] == plan.cost[0]


def test_episodes_that_begin_leave_the_others_alone():
    planner, goal = CEM(Echo(), KINDS["multistart"]), quadratic(np.full((3, 2), 0.3))
    first = planner.plan(np.zeros((2, 2)), goal)
    second = planner.plan(np.zeros((2, 2)), goal, first.memory.forget([True, False]))
    carried_on = planner.plan(np.zeros((2, 2)), goal, first.memory)
    assert np.array_equal(second.inputs[0], first.inputs[0])
    assert np.array_equal(second.inputs[1], carried_on.inputs[1])


@pytest.mark.parametrize("limit", [0.05, 0.1])
def test_a_time_limit_is_kept_and_said(limit):
    model = Slow()
    plan = CEM(model, PlannerSettings.icem(blocks=1, hold=1, iterations=200, time_limit=limit)).plan(
        np.zeros(2), quadratic(np.zeros((1, 2)))
    )
    assert plan.status == (PlanStatus.TIME_LIMIT,)
    assert 1 <= plan.iterations == model.calls < 200
    # One iteration takes 10 ms; a busy machine may add to the last.
    assert plan.time < limit + 0.05
    assert np.isfinite(plan.action).all()


@settings(max_examples=20, deadline=None)
@given(st.floats(0.05, 0.95), kinds)
def test_samples_that_are_not_finite_are_never_chosen(share, kind):
    plan = CEM(Broken(share), KINDS[kind]).plan(np.zeros(2), quadratic(np.zeros((3, 2))))
    assert np.isfinite(plan.action).all()
    if plan.status[0] is not PlanStatus.FALLBACK:
        assert np.isfinite(plan.cost)
        assert np.isfinite(plan.trajectory).all()


@pytest.mark.parametrize("planner", [CEM, MPPI])
def test_the_labelled_fallback_acts_without_any_finite_cost(planner):
    states = np.zeros((3, 2))
    for fallback, expected in ((None, 0.0), (lambda s: np.full((3, 2), 0.7), 0.7), (lambda s: s * np.nan, 0.0)):
        plan = planner(Broken(1.0), fallback=fallback).plan(states, quadratic(np.zeros((5, 2))))
        assert plan.status == (PlanStatus.FALLBACK,) * 3
        assert np.allclose(plan.action, expected)
        assert np.isinf(plan.cost).all()
        again = planner(Broken(1.0), fallback=fallback).plan(states, quadratic(np.zeros((5, 2))), plan.memory)
        assert np.isfinite(again.action).all()
        assert not again.memory.warm.any()
    bad_cost = CEM(Echo()).plan(np.zeros(2), lambda t: np.full(t.states.shape[:2], np.nan))
    assert bad_cost.status == (PlanStatus.FALLBACK,)


def test_a_state_that_is_not_finite_ends_in_the_fallback():
    plan = CEM(BicycleModel()).plan(np.full(6, np.nan), lambda t: t.states[..., 0].sum(axis=2))
    assert plan.status == (PlanStatus.FALLBACK,)
    assert np.isfinite(plan.action).all()


def test_a_bad_row_does_not_affect_the_others():
    goal = quadratic(np.full((3, 2), 0.4))

    def cost(t):
        out = goal(t)
        out[1] = np.nan
        return out

    plan = CEM(Echo(), KINDS["icem"]).plan(np.zeros((3, 2)), cost)
    assert [s is PlanStatus.FALLBACK for s in plan.status] == [False, True, False]
    assert np.array_equal(plan.inputs[0], CEM(Echo(), KINDS["icem"]).plan(np.zeros(2), goal).inputs)


def test_the_answer_may_be_configured_to_be_the_mean():
    chosen = KINDS["plain"].replace(iterations=3)
    best, mean = (
        CEM(Echo(), chosen.replace(answer=a)).plan(np.zeros(2), quadratic(np.zeros((3, 2)))) for a in ("best", "mean")
    )
    assert np.allclose(mean.inputs, mean.elites.mean(axis=0), atol=1e-6)
    assert not np.array_equal(best.inputs, mean.inputs)


def test_coarse_and_close_looks_agree_where_both_look():
    model, goal = BicycleModel(), np.array([5.0, 1.0])
    seen = {}

    def cost(name):
        def end(t):
            seen[name] = t.spans.tolist()
            return np.square(t.states[:, :, -1, :2] - goal).sum(axis=2)

        return end

    chosen = PlannerSettings.icem(blocks=4, hold=4)
    start = np.array([0.0, 0, 1, 0, 1, 0])
    close = CEM(model, chosen.replace(look=2, fine=1)).plan(start, cost("close"))
    coarse = CEM(model, chosen).plan(start, cost("coarse"))
    assert seen == {"close": [2, 2, 4, 4, 4], "coarse": [4, 4, 4, 4]}
    assert np.allclose(close.inputs, coarse.inputs, atol=1e-6)


@settings(max_examples=30, deadline=None)
@given(st.integers(2, 12), st.floats(0, 4), st.integers(0, 99))
def test_coloured_noise_has_unit_variance(length, exponent, seed):
    noise = coloured(np.random.default_rng(seed), (20_000, length, 1), exponent)
    assert noise.shape == (20_000, length, 1)
    assert noise.var() == pytest.approx(1.0, rel=0.06)


def test_choices_are_found_by_search_as_by_looking_at_all():
    class Sum:
        state_dim = action_dim = 1

        def step(self, states, actions):
            return 3 * states + actions

    word = np.array([4, 0, 3, 1, 2])

    def cost(t):
        return np.abs(t.actions[..., 0] - word).sum(axis=2)

    searched = CategoricalCEM(Sum(), 5, CategoricalSettings(blocks=5, iterations=8, samples=300, elites=20))
    complete = CategoricalCEM(Sum(), 5, CategoricalSettings(blocks=5, samples=5**5))
    for plan in (searched.plan(np.zeros(1), cost), complete.plan(np.zeros(1), cost)):
        assert plan.inputs[:, 0].astype(int).tolist() == word.tolist()
        assert int(plan.action) == 4
    batch = searched.plan(np.zeros((3, 1)), cost)
    assert np.array_equal(batch.inputs[2], searched.plan(np.zeros(1), cost).inputs)
    broken = CategoricalCEM(Sum(), 5, fallback=lambda s: np.full(len(s), 4))
    failed = broken.plan(np.zeros(1), lambda t: np.full(t.states.shape[:2], np.inf))
    assert failed.status == (PlanStatus.FALLBACK,)
    assert int(failed.action) == 4


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"blocks": 0}, "blocks"),
        ({"samples": 3}, "samples"),
        ({"look": 2, "hold": 5}, "look"),
        ({"fine": 9}, "fine"),
        ({"time_limit": 0.0}, "time_limit"),
        ({"keep": 2.0}, "keep"),
        ({"decay": 0.5}, "decay"),
        ({"answer": "worst"}, "answer"),
    ],
)
def test_settings_out_of_range_are_refused(changes, message):
    with pytest.raises(ConfigError, match=message):
        PlannerSettings(**changes)


def test_wrong_shapes_are_refused_where_they_come_in():
    planner, goal = CEM(Echo(), KINDS["icem"]), quadratic(np.zeros((3, 2)))
    with pytest.raises(ModelError, match=r"\(2,\) or \(E, 2\)"):
        planner.plan(np.zeros(3), goal)
    with pytest.raises(ConfigError, match="the cost must have shape"):
        planner.plan(np.zeros(2), lambda t: 0.0)
    with pytest.raises(ConfigError, match="memory is of other plans"):
        planner.plan(np.zeros(2), goal, CEM(Echo(), KINDS["plain"]).plan(np.zeros((2, 2)), goal).memory)
    with pytest.raises(ConfigError, match="low < high"):
        CEM(Echo(), low=0.5, high=0.5)
    with pytest.raises(ConfigError, match="low < high"):
        CEM(Echo(), high=2.0)

    class Short(Echo):
        def rollout_held(self, states, actions, hold):
            return np.zeros((len(states), 1, 2))

    with pytest.raises(ModelError, match="rollout must be"):
        CEM(Short(), KINDS["icem"]).plan(np.zeros(2), goal)
