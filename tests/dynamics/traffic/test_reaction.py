"""Braking limits of a vehicle follow from the vehicles ahead of it, in highway-env's own traffic as well."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynamics.roads.straight import StraightRoad
from dynamics.scenes.scene import SceneReader
from dynamics.traffic.assumptions import Assumptions
from dynamics.traffic.occupancy import OtherVehicles

DT = 0.1
IDM = Assumptions.idm()


def brakes(*vehicles: tuple[float, ...], assumptions: Assumptions = IDM, ego: float = np.nan) -> np.ndarray:
    """Permitted braking of vehicles at (s, r, speed), and perhaps crashed, in the coming frames, (m, K)."""
    rows = np.array([[s, r, 0.0, v, 5.0, 2.0, *(crashed or [0.0])] for s, r, v, *crashed in vehicles])
    road = StraightRoad.from_lanes(3)
    return OtherVehicles(rows, rows[:, :4], road, assumptions, DT, None, ego).bodies.brakes


def test_no_vehicle_brakes_hard_on_a_free_road() -> None:
    assert (brakes((0.0, 0.0, 25.0))[0] == IDM.comfortable_braking).all()
    assert (brakes((0.0, 0.0, 25.0), (-9.0, 0.0, 30.0), (300.0, 0.0, 25.0))[0] == IDM.comfortable_braking).all()
    assert (brakes((0.0, 0.0, 25.0), (610.0, 0.0, 0.0))[0] == IDM.comfortable_braking).all()


def test_a_nearer_or_slower_leader_permits_harder_and_earlier_braking() -> None:
    bounds = [brakes((0.0, 0.0, 20.0), (s, 0.0, 20.0))[0] for s in (25.0, 35.0, 45.0, 60.0, 90.0)]
    bounds += [brakes((0.0, 0.0, 20.0), (90.0, 0.0, v))[0] for v in (25.0, 30.0)]
    for near, far in pairwise(bounds):
        assert (near >= far).all()
        assert near.sum() > far.sum()
    assert (bounds[0] == IDM.braking).all()
    assert bounds[2][0] == pytest.approx(1.1 * 3 * (40 / (45 - 1.2 * 1.35)) ** 2 + 0.5)
    assert all((np.diff(bound) >= -1e-9).all() for bound in bounds)


def test_a_follower_of_a_free_leader_brakes_later_than_one_of_a_blocked_leader() -> None:
    free = brakes((0.0, 0.0, 20.0), (60.0, 0.0, 20.0))[0]
    held_up = brakes((0.0, 0.0, 20.0), (60.0, 0.0, 20.0), (80.0, 0.0, 5.0))[0]
    assert held_up.sum() > free.sum() + 1


def test_a_vehicle_in_another_lane_permits_braking_once_it_may_enter() -> None:
    alone = IDM.comfortable_braking * 30
    ahead = brakes((0.0, 0.0, 20.0), (30.0, 4.0, 20.0))[0]
    assert ahead[0] == IDM.braking  # MOBIL lets it come in at once
    beside = brakes((0.0, 0.0, 20.0), (2.0, 4.0, 20.0))[0]
    assert beside[0] == IDM.comfortable_braking
    assert beside.sum() > alone  # once it has got ahead
    beyond = brakes((0.0, 0.0, 20.0), (30.0, 8.0, 20.0))[0]
    assert beyond[0] == IDM.comfortable_braking
    assert beside.sum() < ahead.sum()
    assert alone < beyond.sum() < ahead.sum()
    assert brakes((0.0, 0.0, 20.0), (-60.0, 4.0, 20.0))[0].sum() == pytest.approx(alone)


def test_a_vehicle_two_lanes_over_does_not_consider_entrants_of_the_lane_between() -> None:
    next_to = brakes((0.0, 0.0, 20.0), (12.0, 4.0, 20.0))[0]
    assert (next_to[:6] == IDM.comfortable_braking).all()  # too near for MOBIL to let it in
    beyond = brakes((0.0, 0.0, 20.0), (12.0, 8.0, 20.0))[0]
    assert beyond[1] == IDM.comfortable_braking  # it has to come nearer first
    assert beyond[2] == IDM.braking


def test_cases_in_which_the_hardest_braking_is_permitted() -> None:
    assert (brakes((0.0, 0.0, 20.0), ego=1.0) == IDM.braking).all()  # it may have the ego to brake for
    assert (brakes((0.0, 0.0, 20.0), ego=-1.0) == IDM.comfortable_braking).all()
    assert (brakes((0.0, 0.0, 20.0, 1.0)) == IDM.braking).all()
    assert (brakes((0.0, 0.0, 20.0), assumptions=replace(IDM, comfortable_braking=6.0)) == 6.0).all()
    assert (brakes((0.0, 0.0, 20.0), assumptions=Assumptions.rss()) == 8.0).all()


@pytest.mark.parametrize("rate", [5, 15])
def test_highway_envs_own_traffic_brakes_no_harder_than_permitted(rate: int) -> None:
    """Except after the rare lane changes that make a vehicle brake harder than MOBIL checks. Each bound also covers
    the later ones."""
    config = {"simulation_frequency": rate, "lanes_count": 3, "vehicles_count": 20, "vehicles_density": 1.5}
    frames, hard, harder, grown = 0, 0, 0, 0
    for seed in range(3):
        env = gym.make("highway-v0", config=config)
        env.reset(seed=seed)
        reader, old = SceneReader(env), None
        road, ego = env.unwrapped.road, env.unwrapped.vehicle
        ego.position = ego.position - np.array([500.0, 0.0])
        for _ in range(10 * rate):
            scene = reader.read()
            new = OtherVehicles(scene.others, scene.others_road, scene.road, IDM, scene.dt, old)
            if old is not None:
                slowed = (old.states[:, 3] - new.states[:, 3]) / scene.dt
                frames, hard = frames + len(slowed), hard + int((slowed > IDM.comfortable_braking).sum())
                harder += int((slowed > old.bodies.brakes[:, 0] + 1e-6).sum())
                grown += int((new.bodies.brakes[:, :-1] > old.bodies.brakes[:, 1:] + 1e-6).any(axis=1).sum())
            road.act()
            road.step(scene.dt)
            old = new
    assert hard > 20
    assert harder <= 0.02 * hard
    assert grown <= 0.02 * frames


@pytest.mark.parametrize("speed", [20.0, 30.0, 40.0])
def test_a_distant_standing_vehicle_is_covered_by_the_bound_in_advance(speed: float) -> None:
    """From one frame to the next the permitted braking does not exceed the prediction, also from a distance."""
    old = brakes((0.0, 0.0, speed), (620.0, 0.0, 0.0))[0]
    for at in np.arange(speed * DT, 620.0, speed * DT):
        new = brakes((at, 0.0, speed), (620.0, 0.0, 0.0))[0]
        assert (new[:-1] <= old[1:] + 1e-9).all()
        old = new
    assert (old == IDM.braking).all()


def asked_of_everybody(rows: np.ndarray, ego: float) -> np.ndarray:
    """The permitted braking, (m, K), evaluated for each vehicle and frame: the formulas of
    `dynamics.traffic.reaction`."""
    a, m, frames = IDM, len(rows), 30
    s, r, v, wrecked = rows[:, 0], rows[:, 1], rows[:, 3], rows[:, 6] > 0

    def course(v0: float, change: Any) -> tuple[np.ndarray, np.ndarray]:
        speeds = [v0]
        for k in range(frames - 1):
            speeds.append(change(speeds[-1], k))
        return np.array(speeds), np.concatenate([[0.0], np.cumsum(speeds[:-1]) * DT])

    def least(i: int, speed: float, brake: float) -> float:
        kept = 1 - DT if wrecked[i] else 1.0
        back = min(v[i], 0.0 if wrecked[i] else -a.reversing_speed)
        return max(min(speed - brake * DT, speed * kept), back)

    top = np.maximum(v, a.max_speed)
    fast = [
        course(max(v[i], 0), lambda u, k, i=i: min(u + min(a.acceleration, a.power / max(u, 1e-3)) * DT, top[i]))
        for i in range(m)
    ]
    slow = [course(max(v[i], 0), lambda u, k, i=i: least(i, u, a.braking)) for i in range(m)]
    lowest = [course(max(v[i], 0), lambda u, k: max(u - a.braking * DT, 0.0)) for i in range(m)]
    out = np.full((m, frames), a.braking)
    around = OtherVehicles(rows, rows[:, :4], StraightRoad.from_lanes(3), a, DT, None, ego).bodies
    for i in np.argsort(-s, kind="stable"):
        if ego > s[i] or wrecked[i]:
            continue
        brakes = np.full(frames, a.comfortable_braking)
        for j in range(m):
            if j == i or not abs(s[j] - s[i]) <= 600:
                continue
            elsewhere = around.first[j] > around.last[i] or around.last[j] < around.first[i]
            if not elsewhere and s[j] < s[i]:
                continue
            near = s[j] - s[i] - max(around.budget[j], 0.0)
            d = near + slow[j][1] - fast[i][1] - a.turning_loss_back * DT * np.arange(frames)
            gap = 10 + 1.5 * fast[i][0] + fast[i][0] * np.maximum(fast[i][0] - slow[j][0], 0) / (2 * np.sqrt(15))
            rates = np.where(d > 1, np.minimum(1.1 * 3 * (gap / np.maximum(d, 1)) ** 2 + 0.5, a.braking), a.braking)
            begin = 0
            if elsewhere:
                first = max(int((abs(r[j] - r[i]) - 5.0) / (14.0 * DT)), 0)
                far, u = s[j] - s[i] + fast[j][1] - lowest[i][1], lowest[i][0]
                may = (far > 0) & ((first > 0) | (10 + 1.5 * u + u * (u - fast[j][0]) / (2 * np.sqrt(15)) <= 1.5 * far))
                may &= np.arange(frames) >= first
                begin = int(may.argmax()) if may.any() else frames
            brakes[begin:] = np.maximum(brakes[begin:], rates[begin:])
            if (rates[begin:] >= a.braking).any():
                brakes[begin + int((rates[begin:] >= a.braking).argmax()) :] = a.braking
        out[i] = brakes
        back = min(v[i], -a.reversing_speed)
        slow[i] = course(v[i], lambda u, k, b=brakes, back=back: max(min(u - b[k] * DT, u), back))
    return out


@given(st.integers(0, 2**32 - 1), st.integers(1, 9))
def test_vehicles_skipped_by_the_search_do_not_change_the_bound(seed: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    rows = np.zeros((m, 7))
    rows[:, 0], rows[:, 1] = rng.uniform(0, rng.choice([40.0, 120.0, 400.0]), m), 4.0 * rng.integers(0, 3, m)
    rows[:, 3], rows[:, 4:6], rows[:, 6] = rng.uniform(-3, 40, m), (5.0, 2.0), rng.random(m) < 0.1
    ego = float(rng.uniform(-20, 100))
    got = OtherVehicles(rows, rows[:, :4], StraightRoad.from_lanes(3), IDM, DT, None, ego).bodies.brakes
    np.testing.assert_allclose(got, asked_of_everybody(rows, ego), rtol=0, atol=1e-9)
