"""Planning in a roundabout: the costs of clearance and target speed, the observation, and refusals."""

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.errors import ConfigError, DataError
from dynamics.learned.models.linear import LinearStructuredModel
from dynamics.learned.tasks.roundabout_model import EGO, ROW, RoundaboutModel, roundabout_config
from evaluation.running.named_policies import make_policy
from evaluation.running.roundabout_planner import load_roundabout, roundabout_policy
from evaluation.settings import get_setting
from mpc.cem_policy import CEMPolicy
from mpc.sampling.plan import PlanStatus, Trajectories
from mpc.tasks.roundabout import ClearanceCost, RoundaboutTask, TargetCost, roundabout_settings

LEFT, IDLE, RIGHT, FASTER, SLOWER = range(5)
STRICT = ClearanceCost(along=2.0, across=0.8, growth=0.0)


def place(x, y, heading=0.0, speed=10.0):
    way = np.array([np.cos(heading), np.sin(heading)])
    return np.concatenate([[x, y], speed * way, way])


def scene(ego, *others, rows=2):
    state = np.zeros(EGO + ROW * rows, np.float32)
    state[:EGO] = ego
    for i, other in enumerate(others):
        state[EGO + ROW * i :][:ROW] = [1.0, *other, 0.0]
    return state


def along(states, actions=None):
    states = np.asarray(states, np.float32)[None, None]
    steps = states.shape[2] - 1
    numbers = np.zeros(steps) if actions is None else np.asarray(actions, float)
    return Trajectories(states[:, 0, 0], states[:, :, 1:], numbers[None, None, :, None], np.ones(steps, np.float32))


def corners(x, y, heading, length=5.0, width=2.0):
    c, s = np.cos(heading), np.sin(heading)
    box = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * [length / 2, width / 2]
    return box @ np.array([[c, s], [-s, c]]) + [x, y]


def overlap(a, b):
    """Separating axes of two rectangles, all four of them."""
    for box in (a, b):
        for edge in (box[1] - box[0], box[2] - box[1]):
            one, two = a @ edge, b @ edge
            if one.max() < two.min() or two.max() < one.min():
                return False
    return True


@settings(max_examples=150, deadline=None)
@given(st.floats(-9, 9), st.floats(-9, 9), st.floats(-3.1, 3.1), st.floats(-3.1, 3.1))
def test_no_overlap_is_ever_called_clear(dx, dy, one, two):
    standing = [scene(place(0, 0, one, 0.0), place(dx, dy, two, 0.0))] * 2
    cost = STRICT.stages(along(standing))[0, 0, 0]
    if overlap(corners(0, 0, one), corners(dx, dy, two)):
        assert cost == pytest.approx(1.0, abs=1e-5)
    if np.hypot(dx, dy) > 8.5:  # outside a box of 7.2 m and 4.5 m: half a diagonal, the body and the margin
        assert cost == 0.0


@settings(max_examples=60, deadline=None)
@given(st.floats(0, 2 * np.pi), st.floats(0, 30), st.floats(0, 30), st.floats(0, 6))
def test_turning_the_world_changes_no_clearance(angle, a, b, two):
    def turn(vehicle):
        c, s = np.cos(angle), np.sin(angle)
        return (vehicle.reshape(3, 2) @ np.array([[c, s], [-s, c]])).ravel()

    ego, other = (place(0, 0), place(10, 0)), (place(a, b, two), place(b - 5, a - 5, two))
    plain = STRICT.stages(along([scene(e, o) for e, o in zip(ego, other, strict=True)]))
    moved = STRICT.stages(along([scene(turn(e), turn(o)) for e, o in zip(ego, other, strict=True)]))
    assert np.allclose(plain, moved, atol=1e-2)


@settings(max_examples=60, deadline=None)
@given(st.floats(3.0, 20.0), st.floats(0.0, 2.0), st.floats(0.0, 2.0))
def test_less_room_never_costs_less(gap, closer, more):
    ego = place(0, 0)
    cost = [
        ClearanceCost(growth=g).stages(along([scene(ego, place(x, 0.0))] * 3)).sum()
        for x, g in ((gap, 0.0), (gap - closer, 0.0), (gap, more))
    ]
    assert cost[0] <= cost[1] + 1e-5
    assert cost[0] <= cost[2] + 1e-5


def test_a_crash_between_two_looked_at_states_is_seen_and_lasts():
    # Two cars cross: each is far from the other at both ends of the second.
    start, end = scene(place(-8, 0, 0.0, 16.0), place(0, -8, np.pi / 2, 16.0)), None
    end = scene(place(8, 0, 0.0, 16.0), place(0, 8, np.pi / 2, 16.0))
    later = scene(place(24, 0, 0.0, 16.0), place(0, 24, np.pi / 2, 16.0))
    assert STRICT.stages(along([start, end, later]))[0, 0].tolist() == [1.0, 1.0]
    missed = scene(place(8, 0, 0.0, 16.0), place(0, -8 - 16, -np.pi / 2, 16.0))
    behind = scene(place(-8, 0, 0.0, 16.0), place(0, -8, -np.pi / 2, 16.0))
    assert STRICT.stages(along([behind, missed]))[0, 0, 0] == 0.0


def test_between_states_a_circle_is_followed():
    from mpc.tasks.roundabout import _between

    angle = np.array([0.0, -16 / 22])
    states = np.stack([place(22 * np.cos(a), 22 * np.sin(a), a - np.pi / 2, 16.0) for a in angle])
    places, ways = _between(states, np.ones(1))
    assert np.abs(np.hypot(*places[0].T) - 22).max() < 0.03
    tangent = np.stack([places[0][:, 1], -places[0][:, 0]], axis=-1) / 22
    assert np.abs(ways[0] - tangent).max() < 0.05


def test_an_absent_vehicle_costs_nothing():
    gone = scene(place(0, 0), place(1, 0))
    gone[EGO] = 0.0
    assert STRICT.stages(along([gone, gone]))[0, 0, 0] == 0.0


@settings(max_examples=60, deadline=None)
@given(st.sampled_from([0.0, 8.0, 16.0]), st.floats(-1.5, 1.5), st.sampled_from([IDLE, FASTER, SLOWER, LEFT]))
def test_the_target_cost_is_that_of_the_commanded_speed(target, off, action):
    speed = max(target + off, 0.0)
    state = scene(place(0, 0, 0.3, speed))
    cost = TargetCost((0.0, 8.0, 16.0), FASTER, SLOWER).stages(along([state, state], [action]))[0, 0, 0]
    index = np.clip(target / 8 + {FASTER: 1, SLOWER: -1}.get(action, 0), 0, 2)
    assert cost == (2 - index) / 2


def test_states_are_the_simulators():
    env = get_setting("roundabout").make()
    observation, _ = env.reset(seed=5)
    states, _, single = RoundaboutTask(env).read(observation)
    ego, others = env.unwrapped.vehicle, states[0, EGO:].reshape(-1, ROW)
    assert single
    assert states[0, :4] == pytest.approx([*ego.position, *ego.velocity], abs=1e-4)
    assert states[0, 4:EGO] == pytest.approx([np.cos(ego.heading), np.sin(ego.heading)], abs=1e-4)
    assert others[0::2, :7].tolist() == others[1::2, :7].tolist()
    assert others[:, 7].tolist() == [0.0, 1.0] * 4
    places = np.array([v.position for v in env.unwrapped.road.vehicles[1:]])
    for row in others[others[:, 0] > 0]:
        away = np.abs(np.clip(places, -100, 100) - row[1:3]).max(axis=1)
        assert away.min() < 1e-3


def test_a_standing_ego_has_a_heading():
    task = RoundaboutTask(get_setting("roundabout").make())
    observation = np.zeros((5, 5))
    observation[0] = [1.0, 0.02, 0.45, 0.0, 0.0]
    states, _, _ = task.read(observation)
    assert np.hypot(*states[0, 4:EGO]) == pytest.approx(1.0, abs=1e-5)
    assert states[0, 5] < 0


def test_the_planner_drives_and_is_repeatable():
    env = get_setting("roundabout").make()
    taken = []
    for _ in range(2):
        observation, _ = env.reset(seed=3001)
        policy, state, actions, done = roundabout_policy(env), None, [], False
        while not done and len(actions) < 5:
            action, state = policy.predict(observation, state, np.array([not actions]))
            assert env.action_space.contains(action)
            observation, _, terminated, truncated, _ = env.step(int(action))
            actions.append(int(action))
            done = terminated or truncated
        assert policy.fallbacks == 0
        assert not env.unwrapped.vehicle.crashed
        assert env.unwrapped.vehicle.position[1] < 45.0 - 8.0  # it has gone in
        taken.append(actions)
    assert taken[0] == taken[1]


def test_an_observation_that_is_not_finite_ends_in_slower():
    env = get_setting("roundabout").make()
    observation, _ = env.reset(seed=5)
    policy = roundabout_policy(env)
    action, _ = policy.predict(observation * np.nan)
    assert policy.last_plan.status == (PlanStatus.FALLBACK,)
    assert int(action) == SLOWER


def test_the_bundled_models_predict_the_effect_of_meta_actions():
    ego, others = load_roundabout()
    model = RoundaboutModel(ego, others, 2, 3)
    start = scene(place(2, 40, -np.pi / 2, 8.0))
    speed = {a: np.hypot(*model.step(start[None], [[a]])[0, 2:4]) for a in (IDLE, FASTER, SLOWER)}
    assert speed[SLOWER] < 3.0 < 7.0 < speed[IDLE] < 9.0 < 12.0 < speed[FASTER]
    # A vehicle that stays circles at its radius; one that leaves is farther out a second later.
    circling = place(22 * np.cos(0.7), 22 * np.sin(0.7), 0.7 - np.pi / 2, 14.0)
    state = scene(place(2, 100, -np.pi / 2, 0.0), circling, circling)
    state[EGO + ROW + 7] = 1.0
    after = model.step(state[None], [[SLOWER]])[0, EGO:].reshape(2, ROW)
    radius = np.hypot(after[:, 1], after[:, 2])
    assert 20 < radius[0] < 26
    assert radius[1] > radius[0] + 1.5


def test_the_planner_has_a_name_and_refuses_unsupported_environments():
    assert isinstance(make_policy("cem", get_setting("roundabout").make()), CEMPolicy)
    assert roundabout_settings().blocks >= 4
    env = get_setting("roundabout").make()
    slow = gym.make("roundabout-v0", config={"action": {"type": "DiscreteMetaAction", "target_speeds": [0, 5, 10]}})
    with pytest.raises(ConfigError, match="target speeds"):
        make_policy("cem", slow)
    with pytest.raises(ConfigError, match="RoundaboutEnv"):
        RoundaboutTask(get_setting("highway-fast").make())
    relative = gym.make("roundabout-v0", config={"observation": {"type": "Kinematics"}})
    with pytest.raises(ConfigError, match="absolute"):
        make_policy("cem", relative)
    task = RoundaboutTask(env)
    with pytest.raises(DataError, match="shape"):
        task.read(np.zeros((4, 5)))
    models = [LinearStructuredModel(roundabout_config(n, 1.0)) for n in (6, 2)]
    with pytest.raises(ConfigError, match="arm"):
        CEMPolicy.roundabout(env, RoundaboutModel(*models, task.rows, 0))
