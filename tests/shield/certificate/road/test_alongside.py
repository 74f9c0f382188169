"""Cut-ins of vehicles alongside: highway-env's own traffic decides when, and never hits an ego whose plan verified."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.controller import ControlledVehicle
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from dynamics.roads.straight import StraightRoad
from dynamics.scenes.scene import EgoControl, Scene, Target
from dynamics.vehicle.rollouts import BRAKE, Rollouts
from shield import ShieldConfig
from shield.certificate.road.verify import PathVerifier

DT, LANES = 0.05, 2
CONFIG = ShieldConfig()


def scene_of(offset: float, u: float, behind: float, v: float, gap: float, leader: float) -> Scene:
    """The ego in lane 0, a vehicle in lane 1, and that one's leader."""
    body = [5.0, 2.0, 0.0]
    others = np.array([[100 - behind, 4.0, 0.0, v, *body], [100 - behind + gap, 4.0, 0.0, leader, *body]])
    ego = np.array([100.0, offset, 0.0, u, *body])
    return Scene(ego, others, StraightRoad.from_lanes(LANES), EgoControl(Target(0, 25.0)), DT, 1)


def plan(scene: Scene) -> np.ndarray:
    """Brake to a stop in lane 0, (1, K, 4)."""
    frames = int(np.ceil(scene.ego[3] / (CONFIG.braking * DT))) + 1
    command = np.tile([0.0, BRAKE, CONFIG.braking], (1, frames, 1))
    return Rollouts(DT, scene.road).run(scene.ego_road, command)


def judged(scene: Scene, config: ShieldConfig = CONFIG) -> float:
    lanes = np.zeros(1, dtype=np.intp)
    return float(PathVerifier(scene, config).clearance(plan(scene), lanes, lanes).cutting_in.min(initial=np.inf))


def worst_overlap(scene: Scene, beyond: float = 0.2) -> float:
    """How deep highway-env's vehicle comes into the body of an ego that is further than `beyond` off the centre, on its
    plan [m]; -inf if it stays out."""
    road = Road(RoadNetwork.straight_road_network(LANES, length=1000), np_random=np.random.default_rng(0))
    ego = ControlledVehicle(road, scene.ego[:2], 0.0, scene.ego[3], target_speed=30.0)
    car, leader = (
        IDMVehicle(road, row[:2], 0.0, row[3], target_lane_index=("0", "1", 1), target_speed=row[3], timer=0.0)
        for row in scene.others
    )
    road.vehicles = [ego, car, leader]
    worst, began = -np.inf, False
    for state in plan(scene)[0]:
        if not began and car.mobil(("0", "1", 0)):
            car.target_lane_index, began = ("0", "1", 0), True
        car.timer = leader.timer = 0.0  # No other lane change than this one.
        for each in (car, leader):
            each.act()
            each.step(DT)
        ego.position, ego.heading, ego.speed = state[:2].copy(), state[2], state[3]
        if not began:
            continue
        sin, cos = abs(np.sin(car.heading)), abs(np.cos(car.heading))
        along = abs(car.position[0] - state[0]) - 2.5 * (1 + cos) - sin
        across = abs(car.position[1] - state[1]) - 1.0 * (1 + cos) - 2.5 * sin
        if along >= 0:
            break
        if abs(state[1]) > beyond:
            worst = max(worst, -max(along, across))
    return worst


SITUATIONS = st.builds(
    scene_of,
    offset=st.floats(0.3, 1.2),
    u=st.floats(3, 40),
    behind=st.floats(-8, 8),
    v=st.floats(8, 40),
    gap=st.floats(6, 50),
    leader=st.floats(0, 30),
)


@settings(deadline=None, max_examples=400)
@given(SITUATIONS)
def test_no_vehicle_of_the_simulator_cuts_into_a_verified_ego(scene: Scene) -> None:
    (_, _, _, v, *_), (_, _, _, leader, *_) = scene.others
    assume(np.diff(scene.others[:, 0])[0] - 5 > max(v - leader, 0) ** 2 / 6)  # It can still brake behind its leader.
    if judged(scene) >= 0:
        assert worst_overlap(scene) <= 0


def test_cut_ins_into_an_unverified_ego_exist() -> None:
    """Passing at 34 m/s, 0.7 m off the centre, as on highway-v0, seed 300147."""
    scene = scene_of(offset=0.7, u=34.0, behind=1.0, v=18.5, gap=12.0, leader=10.0)
    assert worst_overlap(scene) > 0
    assert judged(scene) < 0


@pytest.mark.parametrize(
    ("offset", "u", "behind", "v", "gap", "leader"),
    [
        (0.1, 34.3, -7.5, 14.0, 33.0, 9.5),
        (0.2, 36.83, -6.81, 18.76, 39.97, 10.57),
        (0.2, 37.61, -11.78, 18.15, 17.78, 13.34),
        (0.2, 36.86, -11.44, 16.38, 25.62, 14.07),
    ],
)
def test_a_vehicle_that_brakes_behind_its_leader_cuts_in_beside_the_ego(
    offset: float, u: float, behind: float, v: float, gap: float, leader: float
) -> None:
    """The ego keeps its lane. The vehicle is faster than its leader when the ego falls back to it, and no longer
    when the ego is alongside."""
    scene = scene_of(offset, u, behind, v, gap, leader)
    assert worst_overlap(scene, beyond=-1.0) > 0
    assert judged(scene) < 0


@pytest.mark.parametrize(
    "change",
    [
        {"offset": 0.0, "u": 27.0, "leader": 18.0, "gap": 30.0},  # keeps its lane, beside one that is hardly blocked
        {"u": 22.0, "leader": 18.0, "gap": 25.0},  # does not pull away
        {"gap": None},  # no vehicle ahead of it
        {"behind": 8.0},  # already past
        {"behind": -70.0},  # far away
    ],
)
def test_an_ego_without_a_possible_cut_in_is_not_refused(change: dict[str, Any]) -> None:
    values = {"offset": 0.7, "u": 34.0, "behind": 1.0, "v": 18.5, "gap": 12.0, "leader": 10.0} | change
    scene = scene_of(**values | {"gap": values["gap"] or 12.0})
    if values["gap"] is None:
        scene = replace(scene, others=scene.others[:1])
    assert judged(scene) >= 0


def test_the_assumption_of_cut_ins_can_be_switched_off() -> None:
    scene = scene_of(offset=0.7, u=34.0, behind=1.0, v=18.5, gap=12.0, leader=10.0)
    off = ShieldConfig(assumptions=replace(CONFIG.assumptions, cut_in=False))
    assert judged(scene, off) == np.inf
