"""The repairs of a frame of a meta-action keep the same guarantee, and differ in how much of the proposal they keep."""

from __future__ import annotations

import gymnasium as gym
import highway_env  # noqa: F401
import numpy as np
import pytest
from adversarial_world import random_world
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from shield import ShieldConfig, ShieldedEnv, Tier
from shield.errors import ConfigError


@pytest.mark.parametrize("repair", ["filter"])
@settings(deadline=None, max_examples=12, suppress_health_check=list(HealthCheck))
@given(seed=st.integers(0, 10_000))
def test_the_buffer_holds_for_every_repair_of_a_frame(repair: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    world = random_world(rng, ShieldConfig(repair=repair))
    if world.core.decide(world.scene(), 1).tier.fallback:
        return
    world.core.reset()
    for k in range(60):
        scene = world.scene()
        if k % world.period == 0:
            world.target = scene.target_of(world.core.decide(scene, int(rng.integers(5))).executed)
        command, decision = world.core.supervise(world.scene())
        assert command is None or decision.tier is not Tier.PASSED
        world.move_cars([(float(rng.uniform(-9, 9)), int(rng.integers(-1, 2))) for _ in world.cars])
        world.move_ego(command)
        assert world.kept()


def test_an_unknown_repair_is_refused() -> None:
    with pytest.raises(ConfigError, match="valid are hold, filter"):
        ShieldConfig(repair="swerve")


def test_real_episodes_end_well() -> None:
    for repair in ("hold", "filter"):
        env = ShieldedEnv(gym.make("highway-fast-v0", config={"duration": 12}), ShieldConfig(repair=repair))
        mended = 0
        for seed in range(2):
            env.reset(seed=seed)
            done = False
            while not done:
                _, _, terminated, truncated, info = env.step(3)
                mended += info["shield"]["frames_overridden"]
                done = terminated or truncated
            assert not info["crashed"]
        assert mended > 0
        env.close()
