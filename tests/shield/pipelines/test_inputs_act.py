"""The shield intervenes on throttle and steering: a policy that rams its leader without the shield does not with it."""

from __future__ import annotations

from itertools import pairwise

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from slowly import later

from shield import Shield, ShieldedEnv, Tier

CONFIG = {
    "action": {"type": "ContinuousAction"},
    "simulation_frequency": 20,
    "policy_frequency": 10,
    "vehicles_count": 30,
    "duration": 15,
}


def ramming(env: gym.Env, rng: np.random.Generator) -> np.ndarray:
    """Full throttle, steering into the nearest vehicle ahead."""
    base = env.unwrapped
    ego = base.vehicle
    ahead = [v for v in base.road.vehicles if v is not ego and v.position[0] > ego.position[0]]
    if not ahead:
        return np.array([1.0, 0.0], dtype=np.float32)
    leader = min(ahead, key=lambda v: np.hypot(*(v.position - ego.position)))
    dx, dy = leader.position - ego.position
    wheel = (np.arctan2(dy, dx) - ego.heading) * min(1.0, 10 / max(ego.speed, 1.0))
    return np.array([1.0, np.clip(wheel / (np.pi / 4), -1, 1)], dtype=np.float32)


def throttle(env: gym.Env, rng: np.random.Generator) -> np.ndarray:
    return np.array([1.0, 0.0], dtype=np.float32)


def at_random(env: gym.Env, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(-1, 1, 2).astype(np.float32)


def drive(policy, seed: int, shielded: bool, duration: int = 15) -> tuple[bool, bool, int, float]:
    """One episode: whether it crashed, whether it left the road, frames overridden, and the mean speed [m/s]."""
    env = gym.make("highway-v0", config=CONFIG | {"duration": duration})
    if shielded:
        env = ShieldedEnv(env)
    env.reset(seed=seed)
    rng, done, overridden, off, speeds = np.random.default_rng(seed), False, 0, False, []
    while not done:
        *_, terminated, truncated, info = env.step(policy(env, rng))
        vehicle = env.unwrapped.vehicle
        off |= not vehicle.on_road
        speeds.append(vehicle.speed)
        overridden += info["shield"]["frames_overridden"] if shielded else 0
        assert vehicle.speed >= -1e-6 or not shielded
        done = terminated or truncated
    env.close()
    return bool(info["crashed"]), off, overridden, float(np.mean(speeds))


@pytest.mark.parametrize("seed", range(3))
def test_the_unshielded_ego_rams_its_leader(seed: int) -> None:
    crashed, *_ = drive(ramming, seed, shielded=False)
    assert crashed


@pytest.mark.parametrize("policy", [ramming, throttle, at_random])
@pytest.mark.parametrize("seed", [0, *later(1, 2)])
def test_the_shielded_ego_is_overridden_and_neither_crashes_nor_leaves_the_road(policy, seed: int) -> None:
    crashed, off, overridden, speed = drive(policy, seed, shielded=True)
    assert not crashed
    assert not off
    assert overridden
    if policy is not at_random:
        assert speed > 15  # it has not merely stopped


@pytest.mark.slow
@pytest.mark.parametrize("policy", [ramming, throttle, at_random])
def test_twenty_long_shielded_episodes_neither_crash_nor_leave_the_road(policy) -> None:
    for seed in range(100, 120):
        crashed, off, *_ = drive(policy, seed, shielded=True, duration=40)
        assert not crashed, seed
        assert not off, seed


@pytest.mark.parametrize("kind", ["racetrack-v0", "racetrack-oval-v0"])
def test_a_filter_of_actions_alone_keeps_the_ego_on_a_curved_road(kind: str) -> None:
    """A random policy with throttle and steering, filtered at its decisions (5 Hz) within its own ranges."""

    class Random:
        def predict(self, observation, state=None, episode_start=None, deterministic=False):
            return rng.uniform(-1, 1, 2).astype(np.float32), None

    rng = np.random.default_rng(1)
    env = gym.make(kind, config={"action": {"type": "ContinuousAction", "longitudinal": True, "lateral": True}})
    observation, _ = env.reset(seed=1)
    shielded, tiers = Shield(Random(), env=env), set()
    for _ in range(60):
        action, _ = shielded.predict(observation)
        assert env.action_space.contains(action)
        observation, _, terminated, truncated, _ = env.step(action)
        tiers.add(shielded.last_decision.tier)
        ego = env.unwrapped.vehicle
        assert ego.on_road
        assert not ego.crashed
        if terminated or truncated:
            break
    assert {Tier.PASSED, Tier.GOVERNED} <= tiers


@pytest.mark.parametrize(("kind", "config"), [("highway-v0", {**CONFIG, "policy_frequency": 5}), ("racetrack-v0", {})])
@pytest.mark.parametrize("policy", ["throttle", "random", "weave"])
def test_the_ego_drives_the_verified_inputs(kind: str, config: dict, policy: str) -> None:
    """In every frame the ego is where the verified plan of the frame before predicted it, with or without overrides."""
    env = ShieldedEnv(gym.make(kind, config=config), "worst-case")
    rng, size = np.random.default_rng(0), env.action_space.shape[0]
    seen: list[tuple[np.ndarray, np.ndarray | None]] = []
    core = env.core
    own = core.decide

    def watched(scene, proposal):
        decision = own(scene, proposal)
        seen.append((scene.ego_road, decision.plan))
        if decision.tier is Tier.PASSED:
            np.testing.assert_array_equal(decision.executed, proposal)
        return decision

    core.decide = watched
    for seed in range(2):
        env.reset(seed=seed)
        seen.clear()
        for k in range(40):
            action = (
                rng.uniform(-1, 1, 2) if policy == "random" else np.array([1.0, 0.3 * np.sin(k) * (policy == "weave")])
            )
            *_, terminated, truncated, _ = env.step(action[-size:].astype(np.float32))
            if terminated or truncated:
                break
        compared = 0
        for (_, plan), (state, _) in pairwise(seen):
            if plan is not None:
                # Not the first entry: it starts anew with each lap.
                np.testing.assert_allclose(state[1:], plan[1][1:], rtol=0, atol=1e-6)
                compared += 1
        assert compared > 100
