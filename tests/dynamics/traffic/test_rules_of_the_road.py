"""The bound holds for every motion of a vehicle without a violation."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import gymnasium as gym
import highway_env  # noqa: F401
import numpy as np
import pytest
from highway_env.vehicle import behavior
from highway_env.vehicle.kinematics import Vehicle as Simulated
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.roads.path import PathRoad
from dynamics.roads.path_reader import read_network
from dynamics.roads.straight import StraightRoad
from dynamics.scenes.scene import Scene, SceneReader
from dynamics.traffic.assumptions import Assumptions
from dynamics.traffic.occupancy import OtherVehicles
from dynamics.traffic.rules_of_the_road import EgoFootprint, RoadRule, footprint, gap_between, rule_violations

LIMITS = settings(deadline=None, max_examples=60)
FRAMES, HORIZON = 60, 40
ROAD = StraightRoad.from_lanes(3)
FAR = EgoFootprint(1e6, 0.0, 0.0, 20.0, 4.5, 1.3, 2.5, 1.0, False)
RATES = (1 / 5, 1 / 15, 1 / 30)


def corners(row: np.ndarray) -> np.ndarray:
    """Corners of a vehicle (4, 2)."""
    half = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * row[4:6] / 2
    c, s = np.cos(row[2]), np.sin(row[2])
    return half @ np.array([[c, s], [-s, c]]) + row[:2]


def rows_of(vehicles: list[Simulated]) -> np.ndarray:
    return np.array([[*v.position, v.heading, v.speed, v.LENGTH, v.WIDTH, v.crashed] for v in vehicles], dtype=float)


def around(rows: np.ndarray, dt: float, before: OtherVehicles | None = None) -> OtherVehicles:
    return OtherVehicles(rows, rows[:, :4], ROAD, Assumptions.idm(), dt, before)


def random_vehicles(rng: np.random.Generator, count: int) -> list[Simulated]:
    """highway-env's own bicycles, of any size, anywhere, turned and driving or reversing as they like."""
    found = []
    for _ in range(count):
        vehicle = Simulated(None, [rng.uniform(0, 80), rng.uniform(-2, 10)], rng.normal(0, 0.15), rng.uniform(-3, 35))
        vehicle.LENGTH, vehicle.WIDTH = rng.choice([2.0, 5.0, 12.0]), rng.choice([0.8, 2.0, 2.5])
        found.append(vehicle)
    return found


class Driver:
    """Piecewise constant inputs, often at their bounds, now and then beyond them."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng, self.inputs = rng, (0.0, 0.0)
        self.wheel = rng.choice([0.01, 0.05, 0.3, 1.0])
        self.reach = rng.choice([6.0, 6.0, 6.0, 7.0])

    def __call__(self) -> dict[str, float]:
        rng = self.rng
        if rng.random() < 0.15:
            a = rng.choice([-self.reach, self.reach, rng.uniform(-6, 6), 0.0])
            self.inputs = a, rng.choice([0.0, rng.uniform(-self.wheel, self.wheel)])
        return {"acceleration": self.inputs[0], "steering": self.inputs[1]}


@LIMITS
@given(st.integers(0, 2**32 - 1), st.sampled_from(RATES), st.integers(1, 4))
def test_a_permitted_motion_stays_inside_the_bound_and_does_not_extend_it(seed: int, dt: float, count: int) -> None:
    """For any inputs: while a vehicle breaks no rule and takes no more room, its body stays inside the bound, and
    each new bound is part of the one before."""
    rng = np.random.default_rng(seed)
    vehicles = random_vehicles(rng, count)
    drivers = [Driver(rng) for _ in vehicles]
    nobody = np.zeros(count, dtype=bool)
    old = around(rows_of(vehicles), dt)
    for _ in range(FRAMES):
        for vehicle, driver in zip(vehicles, drivers, strict=True):
            vehicle.act(driver())
            vehicle.step(dt)
        rows = rows_of(vehicles)
        new = around(rows, dt, old)
        broken, grown = rule_violations(old, new, dt, nobody, FAR)
        could, can = old.rear(HORIZON + 1), new.rear(HORIZON)
        front, later = old.front(HORIZON + 1), new.front(HORIZON)
        for i in np.flatnonzero((broken == 0) & (grown == 0)):
            body = corners(rows[i])
            assert body[:, 0].min() >= could[i, 0] - 1e-6
            assert body[:, 0].max() <= front[i, 0] + 1e-6
            assert old.low[i] - 1e-6 <= body[:, 1].min()
            assert body[:, 1].max() <= old.high[i] + 1e-6
            assert (can[i] >= could[i, 1:] - 1e-6).all()
            assert (later[i] <= front[i, 1:] + 1e-6).all()
            assert old.low[i] <= new.low[i] + 1e-6
            assert new.high[i] <= old.high[i] + 1e-6
        old = new


@LIMITS
@given(st.integers(0, 2**32 - 1), st.sampled_from(RATES), st.floats(0.0, 0.3))
def test_turning_on_a_bend_stays_inside_the_bound(seed: int, dt: float, lag: float) -> None:
    """On the racetrack a driven metre is 0.7 to 1.5 m of the path. The travel that a vehicle may lose by turning is
    counted in metres of the path."""
    road, rng = racetrack(), np.random.default_rng(seed)
    state = np.array([[rng.uniform(0, road.length), rng.choice(road.centers), 0.0, rng.uniform(3, 15)]])

    def seen(before: OtherVehicles | None) -> OtherVehicles:
        rows = np.concatenate([road.to_world(state), [[5.0, 2.0, 0.0]]], axis=1)
        return OtherVehicles(rows, state.copy(), road, Assumptions.idm(), dt, before)

    old = seen(None)
    for _ in range(FRAMES):
        s, r, _, v = state[0]
        state[0, 0] += v * dt / (1 - float(road.curvature(s)) * r) * (1 - lag * rng.random())
        state[0, 3] = min(max(v + rng.uniform(-6, 6) * dt, 0.0), 20.0)
        new = seen(old)
        found = rule_violations(old, new, dt, np.zeros(1, dtype=bool), FAR)
        if found.broken[0] == 0 and found.grown[0] == 0:
            assert (new.rear(HORIZON) >= old.rear(HORIZON + 1)[:, 1:] - 1e-6).all()
        old = new


@cache
def racetrack() -> PathRoad:
    env = gym.make("racetrack-v0")
    env.reset(seed=0)
    return read_network(env.unwrapped.road.network)


def drive_traffic(rng: np.random.Generator, kind: type, rate: int, dense: float) -> list[Scene]:
    """Scenes of highway-env's own traffic, frame by frame, without an ego to look at."""
    config = {
        "simulation_frequency": rate,
        "lanes_count": 3,
        "vehicles_count": 12,
        "vehicles_density": dense,
        "other_vehicles_type": f"highway_env.vehicle.behavior.{kind.__name__}",
    }
    env = gym.make("highway-v0", config=config)
    env.reset(seed=int(rng.integers(10_000)))
    reader, scenes = SceneReader(env), []
    road = env.unwrapped.road
    ego = env.unwrapped.vehicle
    ego.position = ego.position - np.array([500.0, 0.0])
    for _ in range(12 * rate):
        scenes.append(reader.read())
        road.act()
        road.step(1 / rate)
    return scenes


@pytest.mark.parametrize("rate", [5, 15, 30])
@pytest.mark.parametrize("dense", [1.0, 2.0])
@pytest.mark.parametrize("kind", [behavior.IDMVehicle, behavior.LinearVehicle, behavior.AggressiveVehicle])
def test_highway_envs_own_traffic_keeps_to_the_rules(kind: type, rate: int, dense: float) -> None:
    """But for rules 3 and 4, of which the ego's fail-safe decides, and for crashes among themselves."""
    old, found = None, []
    for scene in drive_traffic(np.random.default_rng(rate), kind, rate, dense):
        new = OtherVehicles(scene.others, scene.others_road, scene.road, Assumptions.idm(), scene.dt, old)
        if old is not None:
            broken, _ = rule_violations(old, new, scene.dt, np.zeros(len(scene.others), dtype=bool), FAR)
            found += [*(broken & ~int(RoadRule.CRASH))]
        if (scene.others[:, 6] > 0).any():
            break  # an impact moves vehicles as no vehicle moves
        old = new
    assert len(found) > 100
    assert sum(map(bool, found)) == 0


def two(first: tuple[float, ...], second: tuple[float, ...], dt: float = 0.1) -> tuple[int, int]:
    """The result for one vehicle, (s, r, heading, speed) before and after."""
    rows = [np.array([[*x, 5.0, 2.0, 0.0]]) for x in (first, second)]
    old = around(rows[0], dt)
    found = rule_violations(old, around(rows[1], dt, old), dt, np.zeros(1, dtype=bool), FAR)
    return int(found.broken[0]), int(found.grown[0])


@pytest.mark.parametrize(
    ("before", "after", "broken", "grown"),
    [
        ((0, 4, 0, 20), (2, 4, 0, 19.7), 0, 0),
        ((0, 4, 0, 20), (2, 4, 0, 19.6), 0, RoadRule.BRAKING),  # for nothing
        ((0, 4, 0, 20), (2, 4, 0, 19.4), 0, RoadRule.BRAKING),
        ((0, 4, 0, 20), (2, 4, 0, 19.3), RoadRule.SPEED, None),
        ((0, 4, 0, 20), (2, 4, 0, 20.7), RoadRule.SPEED, None),
        ((0, 4, 0, -5.8), (-0.58, 4, 0, -6.3), RoadRule.SPEED, None),
        ((0, 4, 0, 20), (2.1, 4, 0, 20), RoadRule.WAY, None),
        ((0, 4, 0, 20), (1.53, 4, 0, 20), 0, None),  # the permitted loss by turning
        ((0, 4, 0, 20), (1.52, 4, 0, 20), RoadRule.WAY, None),
        ((0, 4, 0, 12), (0.42, 4, 0, 12), 0, None),
        ((0, 4, 0, 12), (0.4, 4, 0, 12), RoadRule.WAY, None),
        ((0, 4, 0, 5), (-0.1, 4, 0, 5), RoadRule.WAY, None),
        ((0, 4, 0, 2), (0, 4.2, 0, 2), 0, None),
        ((0, 4, 0, 2), (0, 4.3, 0, 2), RoadRule.WAY, None),
        # In its lane it may waver, and lean over the marking by a hand's breadth.
        ((0, 4, 0, 20), (2, 4.2, 0, 20), 0, 0),
        ((0, 4, 0, 20), (2, 4.3, 0, 20), 0, RoadRule.LANES),
        ((0, 4.9, 0, 20), (2, 5.1, 0, 20), 0, 0),
        ((0, 4.9, 0, 20), (2, 5.2, 0, 20), 0, RoadRule.LANES),
        # In two lanes it may go on or back.
        ((0, 5.9, 0, 20), (2, 6.1, 0, 20), 0, 0),
        ((0, 6.1, 0, 20), (2, 5.9, 0, 20), 0, 0),
        # Nothing is ahead that it could reverse from.
        ((0, 4, 0, 0), (0, 4, 0, -0.3), 0, RoadRule.REVERSING),
    ],
)
def test_each_rule_has_its_threshold(before, after, broken, grown):
    found = two(before, after)
    assert found[0] == int(broken)
    if grown is not None:
        assert found[1] == int(grown)


@pytest.mark.parametrize(
    ("speed", "lost", "frames"), [(20.0, 0.1, 5), (20.0, 0.04, 44), (12.0, 0.1, 9), (6.0, 0.1, 31)]
)
def test_the_permitted_loss_by_turning_is_used_up(speed: float, lost: float, frames: int) -> None:
    """Within a second, or over a longer time."""
    dt, row = 0.1, np.array([[0.0, 4.0, 0.0, speed, 5.0, 2.0, 0.0]])
    old, count = around(row, dt), 0
    while True:
        row = row + np.array([speed * dt - lost, 0, 0, 0, 0, 0, 0])
        new = around(row, dt, old)
        if rule_violations(old, new, dt, np.zeros(1, dtype=bool), FAR).broken[0]:
            break
        old, count = new, count + 1
    assert count == frames


@pytest.mark.parametrize(("length", "frames"), [(5.0, 6), (12.0, 14)])
def test_a_long_vehicle_may_lose_more_by_turning(length: float, frames: int) -> None:
    dt, row = 0.1, np.array([[0.0, 4.0, 0.0, 20.0, length, 2.0, 0.0]])
    old, count = around(row, dt), 0
    while count < 100:
        row = row + np.array([1.905, 0, 0, 0, 0, 0, 0])
        new = around(row, dt, old)
        if rule_violations(old, new, dt, np.zeros(1, dtype=bool), FAR).broken[0]:
            break
        old, count = new, count + 1
    assert count == frames


def test_a_vehicle_behind_a_cut_in_may_brake_and_the_bound_grows() -> None:
    """The vehicle ahead cuts in nearer than MOBIL permits. At a larger distance the braking was predicted."""
    for gap, grown in ((6.0, int(RoadRule.BRAKING)), (35.0, 0)):
        rows = np.array([[0.0, 4.0, 0.0, 20.0, 5.0, 2.0, 0.0], [gap, 0.9, 0.0, 20.0, 5.0, 2.0, 0.0]])
        old = around(rows, 0.1)
        later = rows + np.array([[2.0, 0, 0, 0, 0, 0, 0], [1.95, 0.45, 0, 0, 0, 0, 0]])
        new = around(later, 0.1, old)
        assert old.bodies.last[1] == 0
        assert new.bodies.last[1] == 1
        assert rule_violations(old, new, 0.1, np.zeros(2, dtype=bool), FAR).grown[0] == grown


def test_a_follower_with_an_obligation_stays_behind_the_buffer():
    row = np.array([0.0, 0.0, 0.0, 20.0, 5.0, 2.0, 0.0])
    old = around(row[None], 0.1)
    new = around(row[None] + np.array([2.0, 0, 0, 0, 0, 0, 0]), 0.1, old)
    for gap, broken in ((0.01, 0), (-0.01, int(RoadRule.DISTANCE))):
        ego = footprint(np.array([2.0 + 2.5 + 4.5 + gap, 0.0, 0.0, 20.0, 5.0, 2.0, 0.0]), 2.0, 0.3)
        assert rule_violations(old, new, 0.1, np.ones(1, dtype=bool), ego).broken[0] == broken
        assert rule_violations(old, new, 0.1, np.zeros(1, dtype=bool), ego).broken[0] == 0


def test_a_crash_breaks_a_rule_unless_the_ego_caused_it():
    row = np.array([0.0, 0.0, 0.0, 20.0, 5.0, 2.0, 0.0])
    old = around(row[None], 0.1)
    new = around(row[None] + np.array([2.0, 0, 0, 0, 0, 0, 1.0]), 0.1, old)
    for crashed, x, broken in ((False, -2.5, int(RoadRule.CRASH)), (True, -2.5, 0), (True, -9.0, int(RoadRule.CRASH))):
        ego = footprint(np.array([x, 0.0, 0.0, 20.0, 5.0, 2.0, 1.0]), 2.0, 0.3, crashed)
        assert rule_violations(old, new, 0.1, np.zeros(1, dtype=bool), ego).broken[0] == broken


@LIMITS
@given(st.integers(0, 2**32 - 1))
def test_rectangles_are_apart_exactly_where_an_axis_separates_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ego = np.array([0.0, 0.0, rng.uniform(-3, 3), 20.0, 5.0, 2.0, 0.0])
    row = np.array([*rng.uniform(-9, 9, 2), rng.uniform(-3, 3), 20.0, rng.uniform(2, 12), rng.uniform(0.5, 3), 0.0])
    a, b = corners(ego + np.array([0, 0, 0, 0, 4.0, 0.6, 0])), corners(row)
    sides = np.array([q - p for shape in (a, b) for p, q in pairwise(shape)])
    normals = np.stack([-sides[:, 1], sides[:, 0]], axis=1) / np.hypot(*sides.T)[:, None]
    pa, pb = a @ normals.T, b @ normals.T
    gap = np.maximum(pa.min(axis=0) - pb.max(axis=0), pb.min(axis=0) - pa.max(axis=0)).max()
    seen = footprint(ego, 2.0, 0.3)
    assert gap_between(seen, seen.along, seen.across, row[None], 0, 0.0) == pytest.approx(gap, abs=1e-9)
