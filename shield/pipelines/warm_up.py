"""Compile the kernels, or load them from the disk, before the first decision."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from dynamics.roads.straight import StraightRoad
from dynamics.scenes.scene import EgoControl, Scene, Target
from shield.certificate.road.memory import Memory
from shield.compiling import announced
from shield.config import ShieldConfig
from shield.pipelines.decide import decide
from shield.pipelines.frames import FramePipeline
from shield.pipelines.inputs import InputPipeline
from shield.pipelines.meta_actions import MetaActionPipeline
from shield.pipelines.screen import MetaActionProposal
from shield.rules import RssRule, TtcRule

__all__ = ["warm_up"]


@cache
def warm_up() -> None:
    """Make some decisions in a small scene, with a progress line if that takes long."""
    with announced("worst case on highways"):
        config = ShieldConfig()
        frames, meta = FramePipeline(config), MetaActionPipeline(config)
        inputs = InputPipeline(config, predictive=False)
        memory: Memory[int] = Memory()
        for k in range(2):
            scene = _scene(k)
            _, memory = decide(memory, scene, MetaActionProposal(2, scene.control.actions), meta)
            _, memory = decide(memory, scene, Target(1, 40.0), frames)
            decide(memory, scene, np.array([5.0, 0.3]), inputs)
            for rule in (RssRule(config), TtcRule(config.time_to_collision)):
                rule.objects(scene, Target(2, 30.0))
            # Kernels that the predictive filter calls.
            verifier = inputs.observe(memory, scene)[0].verifier
            verifier.around.occupancy(2)
            verifier.relevant(50.0)
            # With a stored stop, the next scene computes the followers that have to brake for it.
            memory = replace(memory, stored=1)


def _scene(frame: int) -> Scene:
    """A leader, a vehicle alongside behind a slower one, and a follower with a body that grows by a metre each
    frame."""
    dt = 1 / 15
    x, y, v = np.array([[24.0, 4.0, 15.0], [-1.0, 8.0, 13.0], [14.0, 8.0, 10.0], [-30.0, 4.0, 28.0]]).T
    others = np.zeros((4, 7))
    others[:, 0], others[:, 1], others[:, 3], others[:, 4], others[:, 5] = x + v * dt * frame, y, v, 5.0, 2.0
    others[3, 4] += frame
    ego = np.array([25.0 * dt * frame, 4.3, 0.02, 25.0, 5.0, 2.0, 0.0])
    return Scene(ego, others, StraightRoad.from_lanes(3), EgoControl(Target(1, 25.0)), dt, 15, frame)
