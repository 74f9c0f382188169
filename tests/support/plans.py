"""Execution of a plan in highway-env, to measure its result."""

from __future__ import annotations

import numpy as np

from evaluation.measuring.rectangles import separation

__all__ = ["least_clearance"]


def least_clearance(env, actions, buffer):
    """Drive a plan in highway-env: the smallest distance between the ego with its buffer and any body [m].

    Where the ego's road ends, and no other goes on from there, nothing more is asked. Nobody comes who is not there.
    """
    least, advance, ended = [], env.road.step, False

    def step(dt):
        nonlocal ended
        advance(dt)
        if ended:
            return
        ego, (_, node, _) = env.vehicle, env.vehicle.lane_index
        at_end = ego.lane.heading_at(ego.lane.length)
        following = [lane for road in env.road.network.graph.get(node, {}).values() for lane in road]
        onward = any(np.cos(lane.heading_at(0.0) - at_end) > 0 for lane in following)
        ended = not onward and ego.lane.local_coordinates(ego.position)[0] > ego.lane.length - 2.5
        wide = [ego.LENGTH + 2 * buffer.longitudinal, ego.WIDTH + 2 * buffer.lateral]
        mine = np.array([*ego.position, ego.heading, 0.0, *wide])
        for body in [*(v for v in env.road.vehicles if v is not ego), *env.road.objects]:
            row = np.array([*body.position, body.heading, 0.0, body.LENGTH, body.WIDTH])
            least.append(float(separation(mine, row)))

    env.road.step = step
    for action in actions:
        env._simulate(action)
        if ended:
            break
        assert not env.vehicle.crashed
        if hasattr(env, "_clear_vehicles"):
            env._clear_vehicles()
    return min(least)
