"""A violation in the last frame of an episode is reported in that step, once."""

from __future__ import annotations

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from hand_driven import Driven, drive

from shield import Shield, ShieldConfig, ShieldedEnv


def jumps(at):
    """Keeps its speed, and is put onto the ego in one frame."""

    def act(own, frame):
        if frame == at:
            own.position = own.road.vehicles[0].position + np.array([3.0, 0.0])

    return act


@pytest.mark.parametrize("hz", [5, 15])
@pytest.mark.parametrize("period", [1, 5])
@pytest.mark.parametrize("placement", ["env", "policy"])
def test_a_violation_that_ends_the_episode_is_reported(hz, period, placement):
    """The leader is moved onto the ego in the last frame of a decision."""
    last = 2 * period - 1
    out = drive(lambda road: [Driven(road, 40.0, 1, 25.0, jumps(last))], hz, period, seconds=4.0, placement=placement)
    assert out.verified
    assert out.crashed
    assert out.rules.get("way") == 1
    assert out.violations == 1


@pytest.mark.parametrize("placement", ["env", "policy"])
def test_a_violation_is_reported_once(placement):
    """The leader is faster for a moment than permitted, without consequences."""

    def act(own, frame):
        own.speed += {3: 5.0, 4: -5.0}.get(frame, 0.0)

    out = drive(lambda road: [Driven(road, 80.0, 1, 25.0, act)], 5, 1, seconds=2.0, placement=placement)
    assert out.violations == 1


CASES = {
    "inputs": ("highway-v0", {"action": {"type": "ContinuousAction"}}, ShieldConfig()),
    "simulated": ("highway-v0", {}, ShieldConfig.simulated_traffic()),
    "simulated inputs": ("highway-v0", {"action": {"type": "ContinuousAction"}}, ShieldConfig.simulated_traffic()),
    "network": ("merge-v0", {}, ShieldConfig.for_roads()),
    "simulated network": ("merge-v0", {}, ShieldConfig.simulated_traffic()),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("placement", ["env", "policy"])
def test_a_violation_in_the_last_frame_is_reported_for_every_verification(case, placement):
    """A vehicle is moved onto the ego in the last frame of an episode."""
    name, config, shield = CASES[case]
    env = gym.make(name, config={"policy_frequency": 15, **config}, disable_env_checker=True)
    action = 1 if "action" not in config else np.zeros(2, np.float32)
    wrapped = ShieldedEnv(env, shield) if placement == "env" else env
    obs, _ = wrapped.reset(seed=0)
    base = env.unwrapped
    policy = None if placement == "env" else Shield(lambda _: action, env=env, config=shield)
    told = 0
    for k in range(3):
        chosen = action if policy is None else policy.predict(obs)[0]
        if k == 2:
            ego = base.vehicle
            near = min(
                (v for v in base.road.vehicles if v is not ego), key=lambda v: np.hypot(*(v.position - ego.position))
            )
            own = base.road.step

            def step(dt, own=own, near=near, ego=ego):
                near.position = ego.position + 3.0 * ego.direction
                own(dt)

            base.road.step = step
            base.config["duration"] = base.time
        obs, _, _, _, info = wrapped.step(chosen)
        report = info["shield"] if policy is None else policy.report()
        if k < 2:
            assert report["violations"] == 0
        told += report["violations"]
    assert told >= 1
    wrapped.close()
