"""The record names the binding clause, from which the margin comes, and the binding vehicle."""

from __future__ import annotations

import numpy as np
import pytest
from cores import ContinuousCore, ShieldCore

from dynamics.roads.straight import StraightRoad
from dynamics.scenes.scene import EgoControl, Scene, Target
from dynamics.vehicle.actuators import Actuators
from shield import ShieldConfig, Tier


def scene_of(*others: tuple[float, float, float], speed: float = 25.0, r: float = 4.0) -> Scene:
    rows = np.array([[s, y, 0.0, v, 5.0, 2.0, 0.0] for s, y, v in others]).reshape(-1, 7)
    ego = np.array([0.0, r, 0.0, speed, 5.0, 2.0, 0.0])
    return Scene(ego, rows, StraightRoad.from_lanes(3), EgoControl(Target(1, 25.0)), 1 / 15, 15)


def test_the_binding_vehicle_is_named() -> None:
    decision = ShieldCore(ShieldConfig()).decide(scene_of((90.0, 4.0, 25.0), (40.0, 4.0, 20.0)), 1)
    assert decision.tier is Tier.PASSED
    assert (decision.clause, decision.vehicle) == ("separation", 1)


def test_no_vehicle_in_reach_means_no_binding_clause() -> None:
    decision = ShieldCore(ShieldConfig()).decide(scene_of(), 1)
    assert (decision.clause, decision.vehicle) == ("", -1)


def test_the_record_of_a_frame_names_the_binding_vehicle() -> None:
    core = ShieldCore(ShieldConfig())
    _, frame = core.supervise(scene_of((11.5, 4.0, 16.0), (60.0, 0.0, 25.0)))
    assert frame.tier is not Tier.PASSED
    assert (frame.clause, frame.vehicle) == ("separation", 0)


@pytest.mark.parametrize(
    ("scene", "proposal", "clause", "vehicle"),
    [
        (scene_of((20.0, 4.0, 10.0), speed=15.0), (0.0, 0.0), "separation", 0),
        (scene_of(speed=15.0), (0.0, 0.0), "", -1),
    ],
)
def test_the_record_of_inputs_names_the_binding_vehicle(
    scene: Scene, proposal: tuple[float, float], clause: str, vehicle: int
) -> None:
    _, decision = ContinuousCore(ShieldConfig(), Actuators()).filter(scene, np.array(proposal))
    assert decision.tier is Tier.PASSED
    assert (decision.clause, decision.vehicle) == (clause, vehicle)


def test_the_binding_clause_is_edge_off_the_road_and_rollback_in_reverse() -> None:
    core = ContinuousCore(ShieldConfig(), Actuators())
    scene = scene_of(speed=20.0, r=8.4)
    core.filter(scene, np.zeros(2))
    judged = core.judge(scene, np.array([[0.0, 0.5], [0.0, 0.0]]), [2])
    assert judged.bind(0).clause == "edge"
    standing = scene_of(speed=0.0)
    core.reset()
    core.filter(standing, np.zeros(2))
    assert core.judge(standing, np.array([[-5.0, 0.0]]), [1]).bind(0).clause == "rollback"
