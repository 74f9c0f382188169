"""Meta-actions among traffic: the model and the costs in simple scenes, and refusals."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from policies import Always

from dynamics.errors import ConfigError, DataError, ModelError
from dynamics.learned.models.linear import LinearStructuredModel
from dynamics.learned.tasks.traffic_model import EGO, VEHICLE, TrafficModel, collect_traffic, traffic_config
from evaluation.running.highway_planner import highway_policy, load_traffic
from evaluation.running.named_policies import make_policy
from evaluation.settings import get_setting
from mpc.cem_policy import CEMPolicy
from mpc.sampling.plan import PlanStatus, Trajectories
from mpc.tasks.highway import ChangeCost, ContactCost, HighwayTask, LaneCost, PaceCost

IDLE, FASTER, SLOWER = 1, 3, 4


def scene(*vehicles, y=4.0, speed=25.0, rows=4):
    state = np.zeros(EGO + VEHICLE * rows, np.float32)
    state[:EGO] = y, 0.0, speed
    for i, (dx, dy, dv) in enumerate(vehicles):
        state[EGO + VEHICLE * i :][:VEHICLE] = 1.0, dx, dy, dv, 0.0
    return state


def along(states, actions=None):
    states = np.asarray(states, np.float32)[None, None]
    actions = (
        np.zeros((1, 1, states.shape[2] - 1, 1)) if actions is None else np.asarray(actions, float)[None, None, :, None]
    )
    return Trajectories(states[:, 0, 0], states[:, :, 1:], actions, np.ones(states.shape[2] - 1, np.float32))


@settings(max_examples=30, deadline=None)
@given(st.permutations(range(3)), st.integers(0, 4), st.floats(20, 30))
def test_the_order_of_the_vehicles_does_not_matter(order, action, speed):
    model, rows = TrafficModel(load_traffic(), 3), [(20.0, 0.0, -3.0), (35.0, -4.0, 1.0), (-8.0, 4.0, 0.0)]
    plain, mixed = scene(*rows, speed=speed, rows=3), scene(*(rows[i] for i in order), speed=speed, rows=3)
    after, other = (model.step(s[None], np.array([[float(action)]]))[0] for s in (plain, mixed))
    assert np.allclose(after[:EGO], other[:EGO], atol=1e-4)
    assert np.allclose(after[EGO:].reshape(3, 5)[list(order)], other[EGO:].reshape(3, 5), atol=1e-3)


@settings(max_examples=30, deadline=None)
@given(st.floats(-20, 90), st.floats(-5, 5), st.integers(0, 4))
def test_an_absent_vehicle_stays_absent(dx, dv, action):
    model = TrafficModel(load_traffic(), 4)
    after = model.step(scene((dx, 0.0, dv))[None], np.array([[float(action)]]))[0, EGO:].reshape(4, 5)
    assert after[:, 0].tolist() == [1.0, 0.0, 0.0, 0.0]
    alone = model.step(scene()[None], np.array([[float(action)]]))
    assert np.isfinite(alone).all()


def test_the_model_predicts_the_effect_of_meta_actions():
    model = TrafficModel(load_traffic(), 4)
    speeds = {a: model.step(scene((40.0, 0.0, 0.0))[None], np.array([[float(a)]]))[0, 2] for a in range(5)}
    assert speeds[FASTER] > speeds[IDLE] + 1.5
    assert speeds[SLOWER] < speeds[IDLE] - 1.5
    left, right = (model.step(scene()[None], np.array([[a]]))[0, 0] for a in (0.0, 2.0))
    assert left < 4.0 - 0.5
    assert right > 4.0 + 0.5
    closing = model.step(scene((40.0, 0.0, -5.0))[None], np.array([[float(IDLE)]]))[0, EGO + 1]
    assert closing == pytest.approx(35.0, abs=1.5)


def test_a_step_of_the_model_is_about_one_decision_of_the_simulator():
    env = get_setting("highway-fast").make()
    data = collect_traffic(env, 25, seed=3, first_reset=8000)
    error = load_traffic().step(data.states, data.actions) - data.next_states
    assert np.median(np.abs(error[:, 5])) < 0.5
    assert np.median(np.abs(error[:, 6])) < 0.5


def test_the_same_seeds_collect_the_same():
    """Row by row, random actions among the policy's and the vehicles' order included."""
    first, second = (
        collect_traffic(get_setting("highway-fast").make(), 40, 3, Always(FASTER), explore=0.5, first_reset=8000)
        for _ in range(2)
    )
    assert first.episodes.max() > 0
    for name in ("states", "actions", "next_states", "episodes"):
        assert np.array_equal(getattr(first, name), getattr(second, name))


@settings(max_examples=60, deadline=None)
@given(st.floats(-30, 30), st.floats(-30, 30), st.floats(-8, 8))
def test_passing_through_a_vehicle_is_contact(dx0, dx1, dy):
    cost = ContactCost(soft=0.0).stages(along([scene((dx0, dy, 0.0)), scene((dx1, dy, 0.0))]))[0, 0, 0]
    moments = dx0 + (dx1 - dx0) * np.array([0.25, 0.5, 0.75, 1.0])
    assert (cost > 0) == bool(np.any(np.abs(moments) < 7.0 - 1e-5) and abs(dy) < 2.8 - 1e-5)
    assert cost == 1.0 or not (np.any(np.abs(moments) < 4.999) and abs(dy) < 1.999)
    assert cost == 0 or 0.3 <= cost <= 1.0


@settings(max_examples=60, deadline=None)
@given(st.floats(5, 7), st.floats(5, 7), st.floats(-1.9, 1.9))
def test_farther_inside_the_margins_costs_more(a, b, dy):
    near, far = min(a, b), max(a, b)
    costs = [ContactCost(soft=0.0).stages(along([scene((d, dy, 0.0))] * 2))[0, 0, 0] for d in (near, far)]
    assert costs[0] >= costs[1] - 1e-6


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 4), st.integers(1, 4))
def test_driving_through_a_vehicle_does_not_pay(first, second):
    # After a crash nothing else counts: the same clear places cost 1 each.
    def plan(at):
        return along([scene((20.0, 0.0, 0.0))] + [scene((-20.0 if i > at else 3.0, 0.0, 0.0)) for i in range(1, 6)])

    cost = ContactCost(soft=0.0)
    assert cost.stages(plan(first)).tolist() == [[[1.0] * 5]]
    late = along([scene((20.0, 0.0, 0.0))] * (1 + second) + [scene((3.0, 0.0, 0.0))] * (5 - second))
    assert cost.stages(late).sum() == pytest.approx(5 - second)


def test_an_absent_vehicle_has_no_contact_cost():
    gone = scene((5.0, 0.0, 0.0))
    gone[EGO] = 0.0
    assert ContactCost().stages(along([gone, gone]))[0, 0, 0] == 0.0


def test_pace_lane_and_changes():
    seen = along([scene(), scene(y=8.0, speed=30.0), scene(y=0.0, speed=20.0)], actions=[0, IDLE])
    assert PaceCost(20.0, 30.0).stages(seen)[0, 0].tolist() == [0.0, 1.0]
    assert LaneCost(right=8.0).stages(seen)[0, 0].tolist() == [0.0, 1.0]
    assert ChangeCost((0, 2)).stages(seen)[0, 0].tolist() == [1.0, 0.0]


def test_states_are_the_simulators():
    env = get_setting("highway-fast").make()
    observation, _ = env.reset(seed=5)
    states, _, single = HighwayTask(env).read(observation)
    ego = env.unwrapped.vehicle
    assert single
    assert states[0, :EGO] == pytest.approx([ego.position[1], ego.velocity[1], ego.velocity[0]], abs=1e-4)
    nearest = min(
        (v for v in env.unwrapped.road.vehicles if v is not ego and v.position[0] > ego.position[0] - 10),
        key=lambda v: abs(v.position[0] - ego.position[0]),
    )
    assert states[0, EGO + 1] == pytest.approx(nearest.position[0] - ego.position[0], abs=1e-3)


def test_the_planner_drives_without_a_crash_and_is_repeatable():
    env = get_setting("highway-fast").make()
    taken = []
    for _ in range(2):
        observation, _ = env.reset(seed=3001)
        policy, state, actions, done = highway_policy(env), None, [], False
        while not done and len(actions) < 12:
            action, state = policy.predict(observation, state, np.array([not actions]))
            assert env.action_space.contains(action)
            observation, _, terminated, truncated, _ = env.step(int(action))
            actions.append(int(action))
            done = terminated or truncated
        assert policy.fallbacks == 0
        assert not env.unwrapped.vehicle.crashed
        taken.append(actions)
    assert taken[0] == taken[1]


def test_an_observation_that_is_not_finite_ends_in_slower():
    env = get_setting("highway-fast").make()
    observation, _ = env.reset(seed=5)
    policy = highway_policy(env)
    action, _ = policy.predict(observation * np.nan)
    assert policy.last_plan.status == (PlanStatus.FALLBACK,)
    assert int(action) == SLOWER


def test_actions_and_settings_that_the_model_lacks_are_refused():
    with pytest.raises(ConfigError, match="target speeds"):
        make_policy("cem", get_setting("abz").make())
    env = get_setting("highway-fast").make()
    with pytest.raises(ConfigError, match="meta-actions"):
        CEMPolicy.highway(env, TrafficModel(LinearStructuredModel(traffic_config(3, 1.0)), 4))
    with pytest.raises(ConfigError, match="meta-actions"):
        CEMPolicy.highway(env, TrafficModel(load_traffic(), 7))
    with pytest.raises(ModelError, match="whole numbers"):
        TrafficModel(load_traffic(), 4).step(scene()[None], np.array([[1.5]]))
    with pytest.raises(ConfigError, match="Kinematics"):
        HighwayTask(get_setting("racetrack").make())
    with pytest.raises(DataError, match="shape"):
        highway_policy(env).predict(np.zeros(7))
