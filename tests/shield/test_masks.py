"""To ask which actions verify changes neither what is decided nor what is reported, behind every door that answers."""

from __future__ import annotations

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import pytest

from shield import ShieldConfig, ShieldedEnv

WORLDS = {
    "certificate": ("highway-fast-v0", ShieldConfig()),
    "simulated": ("highway-fast-v0", ShieldConfig.exact()),
    "simulated network": ("roundabout-v1", ShieldConfig.exact()),
    "network": ("roundabout-v1", ShieldConfig.for_roads(looks_ahead=True)),
    "right of way": ("roundabout-v1", ShieldConfig.for_roads(looks_ahead=True, gives_way=True)),
}


def told(env_id, shield, asks):
    """What is reported of an episode in which others are pushed now and then, and the offences by rule in the end."""
    env, reports = ShieldedEnv(gym.make(env_id), shield), []
    env.reset(seed=4)
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
    return reports, env.door.violations, env.door.by_rule


@pytest.mark.parametrize("world", WORLDS)
def test_who_asks_for_masks_is_told_the_same(world):
    reports, violations, rules = told(*WORLDS[world], asks=False)
    assert violations > 0
    assert told(*WORLDS[world], asks=True) == (reports, violations, rules)
