"""To ask which actions verify changes neither what is decided nor what is reported, behind every door that answers."""

from __future__ import annotations

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import pytest

from shield import ShieldConfig, ShieldedEnv

WORLDS = {
    "certificate": ("highway-fast-v0", ShieldConfig()),
    "simulated": ("highway-fast-v0", ShieldConfig.simulated_traffic()),
    "simulated network": ("roundabout-v1", ShieldConfig.simulated_traffic()),
    "network": ("roundabout-v1", ShieldConfig.for_roads(looks_ahead=True)),
    "right of way": ("roundabout-v1", ShieldConfig.for_roads(looks_ahead=True, gives_way=True)),
}


def told(env_id, shield, asks, within=False):
    """What is reported of an episode in which others are pushed now and then, the offences by rule in the end, and what
    the last decision went by. Masks are asked for before each step, and `within` it before each frame."""
    env, reports = ShieldedEnv(gym.make(env_id), shield), []
    env.reset(seed=4)
    if within:
        door, frame = env.door, env.door.frame
        door.frame = lambda: (door.mask(), frame())[1]
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
    foreseen = env.door.foreseen if hasattr(env.door, "foreseen") else ()
    return reports, env.door.violations, env.door.by_rule, places, str(foreseen)


@pytest.mark.parametrize("world", WORLDS)
def test_who_asks_for_masks_is_told_the_same(world):
    reports, violations, *rest = told(*WORLDS[world], asks=False)
    assert violations > 0
    assert told(*WORLDS[world], asks=True) == (reports, violations, *rest)


@pytest.mark.parametrize("world", ["certificate", "network", "right of way"])
def test_masks_that_are_asked_for_within_a_step_change_nothing(world):
    """On networks the paths that a mask tries took the place of the one that the decision had chosen."""
    assert told(*WORLDS[world], asks=False, within=True) == told(*WORLDS[world], asks=False)
