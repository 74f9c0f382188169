"""Stopping room: a plan ends inside its lane."""

from __future__ import annotations

from clause_scenes import margin, scene_of


def test_a_plan_ends_inside_its_lane():
    assert margin(scene_of((0, 0.6, 0, 0)), 0) >= 0
    assert margin(scene_of((0, 0.8, 0, 0)), 0) < 0
