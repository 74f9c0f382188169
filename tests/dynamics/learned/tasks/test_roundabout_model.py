"""Motion in a roundabout: quarter turns change nothing, absent vehicles stay absent, motions are the simulator's."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.errors import ConfigError, ModelError
from dynamics.learned.models.linear import LinearStructuredModel
from dynamics.learned.tasks.roundabout_model import (
    ALPHA,
    EGO,
    ROW,
    RoundaboutModel,
    arm_of,
    collect_roundabout,
    next_exit,
    roundabout_config,
)
from evaluation.settings import get_setting

NORTH = 3


def model(rows=4, exit_arm=NORTH, seed=0):
    """A model with random weights; the tested properties hold for all weights."""
    return RoundaboutModel(
        LinearStructuredModel(roundabout_config(6, 1.0, seed)),
        LinearStructuredModel(roundabout_config(2, 1.0, seed + 1)),
        rows,
        exit_arm,
    )


def vehicle(angle, radius=22.0, speed=10.0, way=None):
    """(x, y, vx, vy, c, s) of a vehicle that circles there, towards smaller angles."""
    way = angle - np.pi / 2 if way is None else way
    unit = np.array([np.cos(way), np.sin(way)])
    return np.concatenate([radius * np.array([np.cos(angle), np.sin(angle)]), speed * unit, unit])


def scene(ego, *others, rows=4):
    state = np.zeros(EGO + ROW * rows, np.float32)
    state[:EGO] = ego
    for i, (other, leaves) in enumerate(others):
        state[EGO + ROW * i :][:ROW] = [1.0, *other, leaves]
    return state


def turned(state, quarters):
    """The scene after quarter turns of the world."""
    c, s = [(1, 0), (0, 1), (-1, 0), (0, -1)][quarters % 4]
    out = state.copy()
    views = [out[:EGO].reshape(3, 2), *(row[1:7].reshape(3, 2) for row in out[EGO:].reshape(-1, ROW))]
    for pairs in views:
        pairs[:] = pairs @ np.array([[c, s], [-s, c]])
    return out


@settings(max_examples=40, deadline=None)
@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.integers(0, 3), st.integers(0, 4), st.booleans())
def test_the_step_commutes_with_quarter_turns(a, b, quarters, action, leaves):
    for angle in (a, b):
        edges = np.array([angle - ALPHA, angle - np.pi / 4]) / (np.pi / 2)
        if np.abs(edges - np.round(edges)).min() < 1e-3:
            return  # on the border of two frames either is right
    start = scene(vehicle(a, speed=8.0), (vehicle(b, radius=25.0), float(leaves)))
    after = model().step(start[None], [[action]])[0]
    other = model(exit_arm=(NORTH + quarters) % 4).step(turned(start, quarters)[None], [[action]])[0]
    assert np.allclose(other, turned(after, quarters), atol=1e-3)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 3), st.floats(0.01, np.pi / 2 - 0.01), st.floats(5, 90))
def test_the_next_exit_is_the_nearest_exit_ahead(arm, before, radius):
    angle = arm * np.pi / 2 + ALPHA + before
    assert next_exit(radius * np.cos(angle), radius * np.sin(angle)) == arm
    away = arm * np.pi / 2 + before - np.pi / 4
    assert arm_of(radius * np.cos(away), radius * np.sin(away)) == arm


@settings(max_examples=30, deadline=None)
@given(st.permutations(range(3)), st.integers(0, 4))
def test_the_order_of_the_vehicles_does_not_matter(order, action):
    rows = [(vehicle(0.3), 0.0), (vehicle(0.3), 1.0), (vehicle(-2.0, radius=24.0), 0.0)]
    ego, it = vehicle(np.pi / 2, radius=45.0, way=-np.pi / 2), model(rows=3)
    plain, mixed = (it.step(scene(ego, *s, rows=3)[None], [[action]])[0] for s in (rows, [rows[i] for i in order]))
    assert np.allclose(plain[:EGO], mixed[:EGO], atol=1e-4)
    assert np.allclose(plain[EGO:].reshape(3, ROW)[list(order)], mixed[EGO:].reshape(3, ROW), atol=1e-4)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(0, 4), min_size=1, max_size=6), st.integers(0, 3))
def test_a_step_of_many_plans_is_each_plans_step(actions, scenes):
    it = model()
    states = np.stack([scene(vehicle(0.1 * i), (vehicle(1.0 + 0.2 * (i % (scenes + 1))), 1.0)) for i in range(6)])
    states, numbers = states[: len(actions)], np.array(actions, float)[:, None]
    together = it.step(states, numbers)
    alone = np.concatenate([it.step(states[i : i + 1], numbers[i : i + 1]) for i in range(len(actions))])
    assert np.allclose(together, alone, atol=1e-3)


@settings(max_examples=30, deadline=None)
@given(st.floats(-3, 3), st.integers(0, 4))
def test_an_absent_vehicle_stays_absent_and_directions_have_length_one(angle, action):
    after = model().step(scene(vehicle(angle), (vehicle(1.0), 0.0))[None], [[action]])[0]
    rows = after[EGO:].reshape(4, ROW)
    assert rows[1:].tolist() == np.zeros((3, ROW)).tolist()
    assert rows[0, 0] == 1.0
    assert rows[0, 7] == 0.0
    for way in (after[4:6], rows[0, 5:7]):
        assert np.hypot(*way) == pytest.approx(1.0, abs=1e-5)


def test_motions_are_the_simulators_seen_from_the_nearest_arm():
    env = get_setting("roundabout").make()
    ego, others = collect_roundabout(env, 25, seed=1, first_reset=8000)
    assert ego.dt == others.dt == 1.0
    assert ego.actions.shape[1] == 6
    assert others.actions.shape[1] == 2
    assert others.actions.sum(axis=1).tolist() == [1.0] * len(others)
    assert np.abs(others.states[:, 4:]).max() <= 15.0  # as observations are clipped
    for part in (ego, others):
        angle = np.arctan2(part.states[:, 3], part.states[:, 2])
        assert np.abs(angle).max() <= np.pi / 4 + 1e-6
    # A vehicle inside circles towards smaller angles.
    inside = np.hypot(*others.states[:, 2:4].T) < 26
    x, y, vx, vy = others.states[inside, 2:].T
    assert np.mean(x * vy - y * vx < 0) > 0.95


def test_other_environments_and_invalid_scenes_are_refused():
    with pytest.raises(ConfigError, match="RoundaboutEnv"):
        collect_roundabout(get_setting("highway-fast").make(), 5)
    with pytest.raises(ModelError, match="whole numbers"):
        model().step(scene(vehicle(0.0))[None], [[7.0]])
    with pytest.raises(ModelError, match="shape"):
        model().step(np.zeros((1, 5)), [[1.0]])
    with pytest.raises(ConfigError, match="exit arm"):
        model(exit_arm=4)
    with pytest.raises(ConfigError, match="state variables"):
        RoundaboutModel(*(LinearStructuredModel(roundabout_config(n, 1.0)) for n in (6, 3)), 4, 0)
