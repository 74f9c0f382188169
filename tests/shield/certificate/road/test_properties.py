"""No override violates the buffer, under any behaviour within the assumptions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from adversarial_world import LENGTH, WIDTH, Car, World, corners, random_world, separation
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from dynamics.scenes.scene import Target
from dynamics.vehicle.bicycle import step
from dynamics.vehicle.controllers import speed_control, steering_control

SETTINGS = settings(deadline=None, max_examples=60, suppress_health_check=list(HealthCheck))
SEEDS = st.integers(0, 2**32 - 1)
ACTIONS = st.integers(0, 4)
TOLERANCE = 1e-6


def extremes(car: Car, frames: int, world: World) -> list[np.ndarray]:
    """Bang-bang speed profiles of one car, with every switching time: brake then accelerate, and the reverse."""
    a, profiles = world.assumptions, []
    for switch in range(0, frames + 1, max(frames // 6, 1)):
        for first, second in ((-a.braking, a.acceleration), (a.acceleration, -a.braking)):
            rates = np.where(np.arange(frames) < switch, first, second)
            v, speeds = car.speed, []
            for rate in rates:
                speeds.append(v)
                v = min(max(v + rate * world.dt, 0.0), max(car.speed, a.max_speed))
            profiles.append(np.array(speeds))
    return profiles


def fail_safe_path(world: World, target: Target, fail_lane: int) -> np.ndarray:
    """One frame of `target`, then braking to a stop in `fail_lane`, by the numpy model (frames, 4)."""
    state, path = world.ego, []
    for k in range(400):
        lane = target.lane if k == 0 else fail_lane
        a = float(speed_control(state[3], target.speed)) if k == 0 else -world.config.braking
        a = max(a, -max(state[3], 0.0) / world.dt)
        state = step(state, a, float(steering_control(state, world.road.centers[lane])), world.dt)
        path.append(state)
        if k and state[3] <= 1e-9:
            break
    return np.array(path)


@SETTINGS
@given(SEEDS, ACTIONS)
def test_a_verified_action_keeps_the_buffer_under_every_extreme_behaviour(seed: int, action: int) -> None:
    """For each car separately, every bang-bang profile: the verified plan stays out of the buffer."""
    world = random_world(np.random.default_rng(seed))
    decision = world.core.decide(world.scene(), action)
    command, frame = world.core.supervise(
        replace(
            world.scene(), control=replace(world.scene().control, target=world.scene().target_of(decision.executed))
        )
    )
    assume(frame.tier.verified)
    committed = world.scene().target_of(decision.executed)
    if command is not None:
        committed = Target(command.lane, world.ego[3] + command.acceleration * 0.6)
    fail = world.core.stored
    assert fail is not None
    path = fail_safe_path(world, committed, fail)
    b = world.config.buffer
    ego = [corners(*x[:3], LENGTH + 2 * b.longitudinal, WIDTH + 2 * b.lateral) for x in path]
    for car in world.cars:
        duty = world.behind(car)
        for speeds in extremes(car, len(path), world):
            if duty and not (speeds <= np.maximum(car.speed, 0)).all():
                continue  # Those behind: their duty to react is tested over time below.
            s = car.s + np.cumsum(speeds) * world.dt
            if duty and world.in_way(car):
                continue
            for k, mine in enumerate(ego):
                other = corners(s[k], car.r, 0.0, LENGTH, WIDTH)
                assert separation(mine, other) >= -TOLERANCE, (seed, action, k)


class Adversary:
    """Searches for the worst behaviour: in each frame it takes the inputs that leave the least predicted room."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.mood = rng.choice(["brake", "random", "squeeze", "swarm"])

    def wishes(self, world: World) -> list[tuple[float, int]]:
        out = []
        for car in world.cars:
            toward = int(np.sign(world.ego[1] - car.r)) if abs(world.ego[1] - car.r) > 2 else 0
            ahead = car.s > world.ego[0]
            if self.mood == "brake":
                out.append((-9.0 if ahead else 9.0, 0))
            elif self.mood == "random":
                out.append((float(self.rng.uniform(-9, 9)), int(self.rng.integers(-1, 2))))
            elif self.mood == "squeeze":
                # Ahead: close the gap and cut in; behind: push. Switch at random to catch a reaction off guard.
                flip = self.rng.random() < 0.1
                out.append((9.0 if flip or not ahead else -9.0, toward if self.rng.random() < 0.3 else 0))
            else:
                gap = car.s - world.ego[0]
                out.append((9.0 if gap < -8 else -9.0 if gap > 8 else float(self.rng.uniform(-9, 9)), toward))
        return out


def policy_action(rng: np.random.Generator, style: str) -> int:
    if style == "faster":
        return 3
    if style == "weave":
        return int(rng.choice([0, 2, 3]))
    return int(rng.integers(5))


@settings(deadline=None, max_examples=20, suppress_health_check=list(HealthCheck))
@given(SEEDS, st.sampled_from(["faster", "weave", "random"]))
def test_the_buffer_holds_for_200_frames(seed: int, style: str) -> None:
    """From a scene with a verified plan, any policy and any traffic within the assumptions."""
    run_for(seed, style, 200)


def run_for(seed: int, style: str, frames: int) -> World:
    rng = np.random.default_rng(seed)
    world = random_world(rng)
    adversary = Adversary(rng)
    first = world.core.decide(world.scene(), policy_action(rng, style))
    assume(not first.tier.fallback)
    world.core.reset()
    for k in range(frames):
        scene = world.scene()
        if k % world.period == 0:
            decision = world.core.decide(scene, policy_action(rng, style))
            world.target = scene.target_of(decision.executed)
            command, frame = world.core.supervise(world.scene())
        else:
            command, frame = world.core.supervise(scene)
        wishes = adversary.wishes(world)
        world.move_cars(wishes)
        world.move_ego(command)
        assert world.kept(), (
            f"seed {seed} {style} {adversary.mood}: frame {k}, tier {frame.tier}, gap {world.buffer_gap():.3f} m"
        )
    return world
