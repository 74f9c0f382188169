"""Vehicles that may be present unseen."""

from __future__ import annotations

import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from observed_roads import ROAD

from dynamics.scenes.scene import EgoControl, Target
from shield import ConfigError
from shield.perception.perceiving import ObservationPerception, PerceptionConfig
from shield.perception.sighting import decode
from shield.perception.spec import ObservationSpec
from shield.perception.unseen import Unseen, UnseenBehind, edges, unseen_ahead


def test_a_slow_vehicle_may_be_beyond_the_last_row_in_every_lane():
    spec = ObservationSpec(rows=3)
    ego, others = np.array([100.0, 4.0, 0.0, 25.0]), np.array([[130.0, 4.0, 0.0, 20.0], [150.0, 8.0, 0.0, 12.0]])
    states = unseen_ahead(spec, 50.0, Unseen(slowest=15.0), ROAD, ego, others)
    assert states[:, 0].tolist() == [150.0, 150.0, 155.5, 150.0]
    assert states[:, 1].tolist() == [0.0, 4.0, 8.0, 12.0]
    assert set(states[:, 3].tolist()) == {12.0}
    assert not len(unseen_ahead(spec, spec.distance, Unseen(), ROAD, ego, others))


@given(st.lists(st.tuples(st.floats(15, 30), st.floats(-3, 3)), min_size=1, max_size=40), st.floats(15, 28))
def test_a_passed_vehicle_is_never_nearer_than_its_bound(steps, speed):
    """For any motion below the assumed speed, and any motion of the ego."""
    unseen, behind, nobody = Unseen(), UnseenBehind(), np.zeros((0, 3))
    behind.go_on(unseen, 10.0, 25.0, 0.0, nobody, nobody)
    behind.go_on(unseen, 10.0, 25.0, 0.2, np.array([[-10.5, 4.0, speed]]), nobody)
    place, now = -10.5, speed
    for ego_speed, push in steps:
        now = min(max(now + min(push, unseen.acceleration) * 0.2, 0.0), speed + unseen.speed_gain)
        place += (now - ego_speed) * 0.2
        behind.go_on(unseen, 10.0, ego_speed, 0.2, nobody, nobody)
        if place > -10.0:
            return  # in sight
        assert behind.passed[0, 0] >= place - 1e-9
        assert behind.passed[0, 0] <= -10.0


def test_a_vehicle_back_in_sight_is_no_longer_unseen():
    unseen, behind, nobody = Unseen(), UnseenBehind(), np.zeros((0, 3))
    behind.go_on(unseen, 10.0, 25.0, 0.0, nobody, nobody)
    behind.go_on(unseen, 10.0, 25.0, 0.2, np.array([[-10.5, 4.0, 24.0], [-11.0, 8.0, 24.0]]), nobody)
    assert len(behind.passed) == 2
    behind.go_on(unseen, 10.0, 20.0, 0.2, nobody, np.array([[-9.9, 4.1, 24.0]]))
    assert behind.passed[:, 1].tolist() == [8.0]


def test_the_worst_case_has_a_fast_vehicle_right_behind_the_ego():
    spec, perception = ObservationSpec(), PerceptionConfig(Unseen.worst())
    seen = np.zeros((5, 5))
    seen[0] = [1, 0.1, 4 / 16, 25 / 80, 0]
    control = EgoControl(Target(1, 25.0))
    scene = ObservationPerception(
        ObservationSpec(ranges={"x": (-200, 200), "y": (-16, 16), "vx": (-80, 80), "vy": (-80, 80)}),
        ROAD,
        (0.2, 5),
        perception,
    ).see(seen, 0, control)
    assert spec.behind == 10.0
    assert (scene.others_road[:, 0] - scene.ego_road[0]).tolist() == [-10.0] * 4
    assert set(scene.others_road[:, 3].tolist()) == {40.0}
    assert scene.ids.tolist() == [-1] * 4


@pytest.mark.parametrize(
    "bad", [{"slowest": -1.0}, {"slowest": 31.0}, {"clear_behind": float("nan")}, {"speed_gain": True}]
)
def test_assumptions_about_the_unseen_are_checked(bad):
    with pytest.raises(ConfigError):
        Unseen(**bad)


def test_an_unseen_vehicle_approaches_at_its_assumed_limit():
    unseen, behind, nobody = Unseen(fastest=30.0, clear_behind=100.0), UnseenBehind(), np.zeros((0, 3))
    behind.go_on(unseen, 10.0, 20.0, 0.0, nobody, nobody)
    for _ in range(20):
        behind.go_on(unseen, 10.0, 20.0, 0.2, nobody, nobody)
    assert behind.nearest_unseen == pytest.approx(-60.0)
    states = behind.states(unseen, ROAD, np.array([500.0, 4.0, 0.0, 20.0]), 200.0)
    assert states[:, 0].tolist() == pytest.approx([440.0] * 4)
    assert not len(behind.states(unseen, ROAD, np.array([500.0, 4.0, 0.0, 20.0]), 50.0))
    for _ in range(100):
        behind.go_on(unseen, 10.0, 20.0, 0.2, nobody, nobody)
    assert behind.nearest_unseen == -10.0


def test_a_full_shuffled_observation_gives_no_edge():
    seen = np.zeros((3, 5))
    seen[:, 0], seen[1:, 1] = 1, [60.0, -40.0]
    known, shuffled = ObservationSpec(rows=3, see_behind=True), ObservationSpec(rows=3, see_behind=True, sorted=False)
    assert edges(known, decode(known, seen)) == (60.0, 60.0)
    assert edges(shuffled, decode(shuffled, seen)) == (5.0, 5.0)
    seen[2] = 0.0
    assert edges(shuffled, decode(shuffled, seen)) == (200.0, 200.0)


def test_a_slow_vehicle_beyond_the_edge_is_in_the_scene():
    seen = np.zeros((2, 5))
    seen[:, 0], seen[0, 2:4], seen[1, 1:4] = 1, [4.0, 25.0], [50.0, 0.0, -3.0]
    spec, control = ObservationSpec(rows=2, see_behind=True), EgoControl(Target(1, 25.0))
    scene = ObservationPerception(spec, ROAD, (0.2, 5)).see(seen, 0, control)
    far = scene.others[(scene.ids < 0) & (scene.others[:, 0] > scene.ego[0])]
    assert sorted(far[:, 0].tolist()) == pytest.approx([50.0, 50.0, 50.0, 55.5])
    assert set(far[:, 3].tolist()) == {18.0}
    assert (scene.ids >= 0).sum() == 1
