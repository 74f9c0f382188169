"""Cut-ins: vehicles alongside that change into the ego's lane."""

from __future__ import annotations

from dataclasses import replace

from clause_scenes import CONFIG, margin, scene_of


def test_a_vehicle_alongside_may_cut_in_behind_a_passing_ego():
    scene = scene_of((100, 0.7, 0, 34), (99, 4, 0, 18.5), (111, 4, 0, 10), lanes=2, dt=0.05)
    off = CONFIG.replace(assumptions=replace(CONFIG.assumptions, cut_in=False))
    assert margin(scene, 0) < 0 <= margin(scene, 0, config=off)
