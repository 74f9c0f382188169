"""An action mask changes no decision and no report, in every wrapper that has masks."""

from __future__ import annotations

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import pytest

from shield import ShieldConfig, ShieldedEnv

WORLDS = {
    "certificate": ("highway-fast-v0", ShieldConfig()),
    "simulated": ("highway-fast-v0", ShieldConfig.simulated_traffic()),
    "simulated network": ("roundabout-v1", ShieldConfig.simulated_traffic()),
    "network": ("roundabout-v1", ShieldConfig.for_roads(considers_connected_lanes=True)),
    "right of way": ("roundabout-v1", ShieldConfig.for_roads(considers_connected_lanes=True, gives_way=True)),
}


def told(env_id, shield, asks, within=False):
    """The reports of an episode in which vehicles are pushed now and then, its violations by rule, and the basis of
    the last decision. Masks are requested before each step, and with `within` before each frame."""
    env, reports = ShieldedEnv(gym.make(env_id), shield), []
    env.reset(seed=4)
    if within:
        action_filter, frame = env.filter, env.filter.frame
        action_filter.frame = lambda: (action_filter.mask(), frame())[1]
    for k in range(8):
        if k % 3 == 1:
            for body in env.unwrapped.road.vehicles[1:]:
                body.speed += 4.0
        if asks:
            assert env.action_masks().any()
        *_, terminated, truncated, info = env.step((3, 0, 3, 2)[k % 4])
        reports.append(info["shield"])
        if terminated or truncated:
            break
    places = [(*v.position, v.heading, v.speed) for v in env.unwrapped.road.vehicles]
    if asks:
        env.action_masks()
    foreseen = env.filter.foreseen if hasattr(env.filter, "foreseen") else ()
    return reports, env.filter.violations, env.filter.by_rule, places, str(foreseen)


@pytest.mark.parametrize("world", WORLDS)
def test_masks_before_each_step_change_no_report(world):
    reports, violations, *rest = told(*WORLDS[world], asks=False)
    assert violations > 0
    assert told(*WORLDS[world], asks=True) == (reports, violations, *rest)


@pytest.mark.parametrize("world", ["certificate", "network", "right of way"])
def test_masks_within_a_step_change_no_report(world):
    """On networks, the paths tried for a mask once replaced the path of the decision."""
    assert told(*WORLDS[world], asks=False, within=True) == told(*WORLDS[world], asks=False)
