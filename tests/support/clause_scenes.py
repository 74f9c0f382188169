"""Small scenes on a straight road, and plans in them, for the tests of single clauses of the certificate."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from cores import ShieldCore

from dynamics.roads.straight import StraightRoad
from dynamics.scenes.scene import EgoControl, Scene, Target
from dynamics.vehicle.bicycle import step
from dynamics.vehicle.controllers import steering_control
from dynamics.vehicle.rollouts import Rollouts
from shield import Decision, ShieldConfig
from shield.certificate.road.manoeuvres import brake_candidates
from shield.certificate.road.verify import Clearance, PathVerifier, SceneBefore

__all__ = [
    "BODY",
    "CONFIG",
    "DT",
    "after",
    "along",
    "braked",
    "braking",
    "clear",
    "driven",
    "extents",
    "margin",
    "scene_of",
    "verifier_of",
]

CONFIG, DT = ShieldConfig(), 1 / 15
BODY = [5.0, 2.0, 0.0]


def scene_of(ego, *others, lanes=4, lane=None, speed=None, dt=DT) -> Scene:
    """A straight road; the ego and each other as (x, y, heading, speed), lanes 4 m apart."""
    rows = np.array([[*x, *BODY] for x in others]).reshape(-1, 7)
    road = StraightRoad.from_lanes(lanes)
    target = Target(road.lane_at(ego[1]) if lane is None else lane, ego[3] if speed is None else speed)
    return Scene(np.array([*ego, *BODY], dtype=float), rows, road, EgoControl(target), dt, 5)


BEFORE = {field.name for field in fields(SceneBefore)}


def verifier_of(scene, config, **marks) -> PathVerifier:
    """A verifier; `marks` are parameters of `PathVerifier` and of `SceneBefore`."""
    before = SceneBefore(**{name: marks.pop(name) for name in BEFORE & marks.keys()})
    return PathVerifier(scene, config, **marks, before=before)


def braking(scene, lane, fail=None, config=CONFIG, **marks) -> Clearance:
    """One frame on the way to a lane, then a stop in it, or in lane `fail`."""
    fails = [lane if fail is None else fail]
    candidates = brake_candidates(scene, [lane], [scene.ego[3]], fails, 1, config.braking)
    paths = candidates.paths(Rollouts(scene.dt, scene.road), scene.ego_road)
    return verifier_of(scene, config, **marks).clearance(paths, candidates.lanes, candidates.fails)


def braked(scene) -> np.ndarray:
    """The path of braking in lane 0 from now on, (K, 4)."""
    return brake_candidates(scene, [0], [0.0], [0], 0, CONFIG.braking).paths(Rollouts(DT), scene.ego_road)[0]


def margin(scene, lane, fail=None, config=CONFIG, **marks) -> float:
    return float(braking(scene, lane, fail, config, **marks).margin[0])


def clear(scene, lane, fail=None, config=CONFIG, **marks) -> float:
    """Least separation only: whether the plan ends inside its lane is another clause."""
    return float(braking(scene, lane, fail, config, **marks).separations.min(initial=np.inf))


def along(scene, path, lane=0, config=CONFIG, **marks) -> float:
    """Least separation on a given path (K, 4)."""
    lanes = np.array([lane])
    return float(
        verifier_of(scene, config, **marks)
        .clearance(np.array([path], float), lanes, lanes)
        .separations.min(initial=np.inf)
    )


def driven(scene, lane) -> np.ndarray:
    """The same plan by the numpy bicycle, (K, 4)."""
    state, path, b = scene.ego_road, [], CONFIG.braking
    while not path or state[3] > 1e-9:
        a = max(-b if path else 0.0, -state[3] / scene.dt)
        state = step(state, a, float(steering_control(state, scene.road.centers[lane])), scene.dt)
        path.append(state)
    return np.array(path)


def extents(state) -> tuple[float, float]:
    """Half extents of the ego with its buffer along and across the road [m]."""
    sin, cos = abs(np.sin(state[2])), abs(np.cos(state[2]))
    return 4.5 * cos + 1.3 * sin, 4.5 * sin + 1.3 * cos


def after(core, *scenes) -> Decision:
    """The decision of a core in the last of some scenes."""
    for scene in scenes:
        answer = core.supervise(scene) if isinstance(core, ShieldCore) else core.filter(scene, np.zeros(2))
    return answer[1]
