"""Driving a plan in highway-env, to see what comes of it."""

from __future__ import annotations

import numpy as np

from evaluation.measuring.rectangles import separation

__all__ = ["least_clearance"]


def least_clearance(env, actions, buffer):
    """Drive a plan in highway-env: the smallest distance between the ego with its buffer and any body [m].

    Where the ego's road ends, and no other goes on from there, nothing more is asked.
    """
    least, advance, ended = [], env.road.step, False

    def step(dt):
        nonlocal ended
        advance(dt)
        if ended:
            return
        ego, (_, node, _) = env.vehicle, env.vehicle.lane_index
        onward = env.spec.id != "two-way-v0" and env.road.network.graph.get(node)
        ended = not onward and ego.lane.local_coordinates(ego.position)[0] > ego.lane.length - 2.5
        wide = [ego.LENGTH + 2 * buffer.longitudinal, ego.WIDTH + 2 * buffer.lateral]
        mine = np.array([*ego.position, ego.heading, 0.0, *wide])
        for body in [*env.road.vehicles[1:], *env.road.objects]:
            row = np.array([*body.position, body.heading, 0.0, body.LENGTH, body.WIDTH])
            least.append(float(separation(mine, row)))

    env.road.step = step
    for action in actions:
        env._simulate(action)
        if ended:
            break
        assert not env.vehicle.crashed
    return min(least)
