"""Changes of a scene that change no decision, changes that never help, and a filter that intervenes."""

from __future__ import annotations

from dataclasses import replace

import gymnasium as gym
import highway_env  # noqa: F401
import numpy as np
import pytest
from adversarial_world import Car, World, random_world
from cores import MetaCore, ShieldCore
from hypothesis import HealthCheck, Phase, assume, given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule, run_state_machine_as_test

from dynamics.roads.straight import StraightRoad
from dynamics.scenes.scene import Scene
from dynamics.state import Vehicle
from shield import Buffer, ShieldConfig, ShieldedEnv, Tier

SETTINGS = settings(deadline=None, max_examples=60, suppress_health_check=list(HealthCheck))
SEEDS = st.integers(0, 2**32 - 1)
ACTIONS = st.integers(0, 4)
CORES = st.sampled_from([ShieldCore, MetaCore])


def scene_of(seed: int) -> Scene:
    return random_world(np.random.default_rng(seed)).scene()


def inside(scene: Scene) -> Scene:
    """The scene 1 km down the road: at its very start, rounding decides whether lanes are reachable."""
    ego, others = scene.ego.copy(), scene.others.copy()
    for rows in (ego, others.T):
        rows[Vehicle.X] += 1000.0
    return replace(scene, ego=ego, others=others)


def verdict(core: type, scene: Scene, action: int, config: ShieldConfig | None = None) -> tuple[int, Tier, float]:
    decision = core(config or ShieldConfig()).decide(scene, action)
    return decision.executed, decision.tier, decision.margin


def same(a: tuple[int, Tier, float], b: tuple[int, Tier, float]) -> None:
    assert a[:2] == b[:2]
    np.testing.assert_allclose(a[2], b[2], atol=1e-6)


@SETTINGS
@given(CORES, SEEDS, ACTIONS)
def test_a_verified_proposal_is_returned_unchanged_and_filtering_twice_changes_nothing(
    core: type, seed: int, action: int
) -> None:
    scene = scene_of(seed)
    executed, tier, _ = verdict(core, scene, action)
    if tier is Tier.PASSED:
        assert executed == action
    elif tier is Tier.ALTERNATIVE and core is MetaCore:
        again = verdict(core, scene, executed)
        assert again[:2] == (executed, Tier.PASSED)


@SETTINGS
@given(CORES, SEEDS, ACTIONS)
def test_the_order_of_the_vehicles_changes_nothing(core: type, seed: int, action: int) -> None:
    scene = scene_of(seed)
    order = np.random.default_rng(seed).permutation(len(scene.others))
    same(verdict(core, scene, action), verdict(core, replace(scene, others=scene.others[order]), action))


@SETTINGS
@given(CORES, SEEDS, ACTIONS, st.floats(-500, 500))
def test_shifting_the_road_changes_nothing(core: type, seed: int, action: int, shift: float) -> None:
    base = inside(scene_of(seed))
    moved_ego, moved = base.ego.copy(), base.others.copy()
    moved_ego[Vehicle.X] += shift
    moved[:, Vehicle.X] += shift
    same(verdict(core, base, action), verdict(core, replace(base, ego=moved_ego, others=moved), action))


@SETTINGS
@given(CORES, SEEDS, ACTIONS, st.floats(-3.0, 3.0))
def test_turning_the_world_changes_nothing(core: type, seed: int, action: int, angle: float) -> None:
    scene = inside(scene_of(seed))
    road = StraightRoad(scene.road.centers, scene.road.width, origin=(3.0, -7.0), heading=angle)
    turned = []
    for rows in (scene.ego[None], scene.others):
        out = rows.copy()
        out[:, :4] = road.to_world(rows[:, :4])
        turned.append(out)
    same(
        verdict(core, scene, action),
        verdict(core, replace(scene, ego=turned[0][0], others=turned[1], road=road), action),
    )


@SETTINGS
@given(CORES, SEEDS, ACTIONS)
def test_mirroring_the_lanes_mirrors_the_decision(core: type, seed: int, action: int) -> None:
    scene = scene_of(seed)
    width = scene.road.centers[-1]
    ego, others = scene.ego.copy(), scene.others.copy()
    for rows in (ego, others.T):
        rows[Vehicle.Y] = width - rows[Vehicle.Y]
        rows[Vehicle.HEADING] *= -1
    target = replace(scene.control.target, lane=scene.road.centers.size - 1 - scene.control.target.lane)
    mirrored = replace(scene, ego=ego, others=others, control=replace(scene.control, target=target))
    flip = {0: 2, 2: 0}
    a = verdict(core, scene, action)
    b = verdict(core, mirrored, flip.get(action, action))
    assert a[1] is b[1]
    if a[1] is Tier.PASSED:
        assert flip.get(a[0], a[0]) == b[0]
        np.testing.assert_allclose(a[2], b[2], atol=1e-6)


@SETTINGS
@given(CORES, SEEDS, ACTIONS, st.floats(0, 5), st.floats(0, 0.4))
def test_a_larger_buffer_never_verifies_more(core: type, seed: int, action: int, lon: float, lat: float) -> None:
    scene = scene_of(seed)
    small = ShieldConfig(buffer=Buffer(1.0, 0.1))
    large = ShieldConfig(buffer=Buffer(1.0 + lon, 0.1 + lat))
    if verdict(core, scene, action, large)[1] is Tier.PASSED:
        assert verdict(core, scene, action, small)[1] is Tier.PASSED


@SETTINGS
@given(CORES, SEEDS, ACTIONS, st.sampled_from([-190.0, 199.0, 1000.0, -1000.0]), st.integers(0, 1))
def test_a_vehicle_out_of_reach_changes_no_verdict(core: type, seed: int, action: int, ds: float, lane: int) -> None:
    scene = scene_of(seed)
    far = Car(scene.ego[Vehicle.X] + ds, 4.0 * lane, 20.0, lane).row()
    more = replace(scene, others=np.vstack([scene.others, far]))
    assume(ds != 199.0 or scene.ego[Vehicle.SPEED] < 28)
    a, b = verdict(core, scene, action), verdict(core, more, action)
    if abs(ds) > 200 and a[1] is Tier.PASSED:
        assert a[:2] == b[:2]
        np.testing.assert_allclose(a[2], b[2])
    elif ds == -190.0 and a[1] is Tier.PASSED and core is ShieldCore and scene.ego[Vehicle.SPEED] > 20:
        assert a[0] == b[0]


class Traffic(RuleBasedStateMachine):
    """Hypothesis plays the traffic: each frame it draws any inputs, clipped to the assumptions."""

    world: World

    @initialize(seed=st.integers(0, 10_000))
    def start(self, seed: int) -> None:
        self.world = random_world(np.random.default_rng(seed))
        self.frame = 0
        self.safe = not self.world.core.decide(self.world.scene(), 1).tier.fallback
        self.world.core.reset()

    @rule(action=ACTIONS, wish=st.floats(-9, 9), turns=st.lists(st.integers(-1, 1), min_size=8, max_size=8))
    def second(self, action: int, wish: float, turns: list[int]) -> None:
        if not self.safe:
            return
        world = self.world
        for k in range(world.period):
            scene = world.scene()
            if k == 0:
                decision = world.core.decide(scene, action)
                world.target = scene.target_of(decision.executed)
                command, _ = world.core.supervise(world.scene())
            else:
                command, _ = world.core.supervise(scene)
            world.move_cars([(wish, turns[i % 8]) for i in range(len(world.cars))])
            world.move_ego(command)
            self.check()

    def check(self) -> None:
        assert self.world.kept()

    @invariant()
    def the_buffer_holds(self) -> None:
        if hasattr(self, "world") and getattr(self, "safe", False):
            self.check()


Traffic.TestCase.settings = settings(
    deadline=None, max_examples=15, stateful_step_count=40, suppress_health_check=list(HealthCheck)
)
TestTraffic = Traffic.TestCase


@pytest.mark.slow
def test_long_searches_find_no_traffic_that_comes_nearer_than_the_buffer() -> None:
    more = settings(Traffic.TestCase.settings, max_examples=1500, phases=[Phase.generate, Phase.target])
    run_state_machine_as_test(Traffic, settings=more)


def test_a_leader_that_starts_to_turn_away_swings_its_tail_towards_the_ego() -> None:
    """Found by the search: a close leader that had kept its lane so far left it, and lost ground doing so."""
    traffic, still = Traffic(), [0] * 8
    traffic.start(seed=716)
    assert traffic.safe
    traffic.second(action=0, turns=[0, 0, -1, 0, 0, 0, 0, 0], wish=-5.0)
    for wish in (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 3.0):
        traffic.second(action=0, turns=still, wish=wish)
    traffic.second(action=0, turns=[-1, 0, 0, 0, 0, 0, 0, 0], wish=0.0)


@pytest.mark.parametrize("seed", [5001, 5030, 5056])
def test_random_driving_that_once_crashed_does_not(seed: int) -> None:
    """Lane changes that highway-env's look-ahead collision, or a merge into the fail-safe's lane, once defeated."""
    env = ShieldedEnv(gym.make("highway-fast-v0"))
    env.reset(seed=seed)
    rng, done = np.random.default_rng(seed), False
    while not done:
        _, _, terminated, truncated, info = env.step(int(rng.integers(5)))
        done = terminated or truncated
    assert not info["crashed"]
