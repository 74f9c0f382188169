"""Edges: no plan leaves the road, crosses a gap of the map, or reverses."""

from __future__ import annotations

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from clause_scenes import CONFIG, DT, scene_of
from cores import ContinuousCore

from dynamics.scenes.scene import Scene
from shield.certificate.road.clauses.edge import verdicts
from shield.certificate.road.verify import PathVerifier


def along_gap(scene) -> float:
    path = np.repeat(scene.ego_road[None], 2, axis=0)
    lanes = np.zeros(1, dtype=int)
    return float(PathVerifier(scene, CONFIG).clearance(path[None], lanes, lanes).margin[0])


def test_no_plan_leaves_the_road_or_reverses():
    for wheel in np.linspace(-0.1, 0.1, 9):
        scene = scene_of((0, 0, 0, 25), lanes=1)
        plan = ContinuousCore(predictive=False).filter(scene, np.array([0.0, wheel]))[1].plan
        half = 2.5 * np.abs(np.sin(plan[:, 2])) + np.cos(plan[:, 2])
        assert (np.abs(plan[:, 1]) + half <= 2 + 1e-9).all()
    answer, _ = ContinuousCore(predictive=False).filter(scene_of((0, 0, 0, 0.1)), np.array([-5.0, 0.0]))
    assert 0.1 + answer[0] * DT >= -1e-9


@pytest.mark.parametrize(("allowed", "edge", "v"), [(False, 1.0, 1.0), (True, -0.1, 1.0), (True, 1.0, -0.1)])
def test_the_verdict_of_inputs(allowed, edge, v):
    path = np.full((1, 2, 4), v)
    assert verdicts(np.ones(1), np.array([[1.0, edge]]), np.array([allowed]), path, 1)[0] < 0
    assert verdicts(np.ones(1), np.ones((1, 2)), np.ones(1, bool), np.ones((1, 2, 4)), 1)[0] == 1


def test_no_plan_crosses_a_gap_of_the_map():
    env = gym.make("racetrack-v0")
    env.reset(seed=0)
    scene = Scene.from_env(env, curved=True)
    env.close()
    road = scene.road
    place = np.argwhere(np.isfinite(road.gaps.low))[0]
    r = 0.5 * (road.gaps.low[tuple(place)] + road.gaps.high[tuple(place)])
    ego = scene.ego.copy()
    ego[:4] = road.to_world(np.array([(place[0] + 0.5) * 0.1, r, 0.0, 5.0]))
    scene = replace(scene, ego=ego, others=scene.others[:0])
    assert along_gap(scene) == -np.inf
    assert along_gap(replace(scene, road=replace(road, gaps=None))) > -np.inf
