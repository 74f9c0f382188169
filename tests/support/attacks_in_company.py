"""Attacks by several vehicles, cut-ins, blind merges, tailgaters, random inputs and highway-env's own traffic."""

from __future__ import annotations

import numpy as np
from attack_drivers import at_ego, change, constant, controller, cruise, hound, keep, noise, swing, then, waver
from attack_kit import CAR, MIDDLE, MOTORCYCLE, SIDE, SLOW, TRUCK, Numbers, attack, pick, policy, side
from driven_traffic import LANE, Car, Scenario


@attack(
    {
        "ds": (2, 40), "dv": (-8, 8), "start": (0, 2), "limit": (0.05, 0.35), "gain": (1, 4), "brake_at": (0, 2),
        "brake": (2, 6), "ego_speed": (12, 30), "side": SIDE, "trigger": (0, 2), "near": (4, 25), "half": (0, 2),
    }
)  # fmt: skip
def cut_in_and_brake(p: Numbers) -> Scenario:
    """A car cuts in at a gap and brakes right after, or stays between the lanes."""
    lane = MIDDLE + side(p) * LANE
    to = MIDDLE + (side(p) * 1.3 if p["half"] < 0.5 else 0.0)
    if p["trigger"] < 1:
        wheel = change(lane, to, lambda m: m.time >= p["start"], p["limit"], p["gain"])
    else:
        wheel = change(lane, to, lambda m: m.ds <= p["near"], p["limit"], p["gain"])
    speed = max(p["ego_speed"] + p["dv"], 3.0)
    throttle = then(p["start"] + p["brake_at"], cruise(speed), constant(-p["brake"]))
    return Scenario([Car(p["ds"], lane, speed, controller(throttle, wheel))], policy(p), 3, MIDDLE, p["ego_speed"])


@attack(
    {
        "gap": (9, 45), "rear": (-45, -9), "ego_speed": (12, 30), "dv": (-4, 4), "dv2": (-4, 6), "brake_at": (0, 3),
        "brake": (2, 6), "push": (0, 3), "near": (8, 25), "beside": (-8, 8), "boxed": (0, 2), "side": SIDE,
    }
)  # fmt: skip
def brake_and_push(p: Numbers) -> Scenario:
    """One brakes in front, one pushes from behind, and perhaps one boxes the ego in."""
    v = p["ego_speed"]
    front = Car(p["gap"], MIDDLE, v + p["dv"])
    front.controller = controller(then(p["brake_at"], cruise(v + p["dv"]), constant(-p["brake"])), keep(MIDDLE))
    rear = Car(p["rear"], MIDDLE, v + p["dv2"])
    rear.controller = controller(at_ego(p["near"], cruise(v + p["dv2"]), constant(p["push"])), keep(MIDDLE))
    lane = MIDDLE + side(p) * LANE
    box = Car(p["beside"], lane, v, controller(hound(p["beside"]), keep(lane)))
    return Scenario([front, rear, box][: 2 + (p["boxed"] < 1)], policy(p), 3, MIDDLE, v, goal=lane)


@attack(
    {
        "beside": (-7, 7), "ds": (-6, 30), "dv": (-6, 6), "start": (0, 2.5), "limit": (0.08, 0.35),
        "ego_speed": (12, 30), "brake": (0, 6), "then": (0, 2), "leader": (15, 60), "side": SIDE,
    }
)  # fmt: skip
def box_and_cut_in(p: Numbers) -> Scenario:
    """One boxes the ego in, another cuts in from the other side while the leader brakes."""
    v, sign = p["ego_speed"], side(p)
    left, right = MIDDLE - sign * LANE, MIDDLE + sign * LANE
    box = Car(p["beside"], left, v, controller(hound(p["beside"]), keep(left)))
    wheel = change(right, MIDDLE, lambda m: m.time >= p["start"], p["limit"])
    throttle = then(p["start"] + p["then"], cruise(v + p["dv"]), constant(-p["brake"]))
    cutter = Car(p["ds"], right, v + p["dv"], controller(throttle, wheel))
    leader = Car(max(p["leader"], p["ds"] + 8), MIDDLE, v)
    leader.controller = controller(then(p["start"], cruise(v), constant(-6.0)), keep(MIDDLE))
    return Scenario([box, cutter, leader], policy(p), 3, MIDDLE, v, goal=right)


@attack(
    {
        "ds": (-14, 14), "dv": (-6, 6), "start": (-0.5, 2), "limit": (0.05, 0.35), "gain": (1, 4),
        "ego_speed": (12, 30), "a": (-4, 3), "side": SIDE, "kind": (0, 3), "ds2": (-40, 40),
    }
)  # fmt: skip
def blind_merge(p: Numbers) -> Scenario:
    """The ego and another car go for the middle lane from both sides."""
    lane, v = MIDDLE + side(p) * LANE, p["ego_speed"]
    wheel = change(lane, MIDDLE, lambda m: m.time >= p["start"], p["limit"], p["gain"])
    if p["kind"] >= 2:
        wheel = change(lane, MIDDLE, lambda m: abs(m.ego.r - MIDDLE) < 3.9 - p["start"], p["limit"], p["gain"])
    throttle = then(p["start"] + 0.5, cruise(v + p["dv"]), constant(p["a"]))
    rival = Car(p["ds"], lane, v + p["dv"], controller(throttle, wheel))
    third = Car(p["ds2"], MIDDLE, v, controller(cruise(v), keep(MIDDLE)))
    cars = [rival, third] if p["kind"] < 1 and abs(p["ds2"]) > 10 else [rival]
    return Scenario(cars, policy(p), 3, MIDDLE - side(p) * LANE, v, goal=MIDDLE)


@attack(
    {
        "rear": (-40, -9), "dv": (-3, 10), "ego_speed": (10, 30), "gap": (10, 50), "brake_at": (0, 2), "push": (-2, 3),
        "law": (0, 3), "late": (0, 1.5), "r": (-0.8, 0.8), "goal": (0, 2), "side": SIDE,
    }
)  # fmt: skip
def tailgater(p: Numbers) -> Scenario:
    """A follower that pushes on, or brakes late, when the ego brakes for its leader or comes into its lane."""
    v, lane = p["ego_speed"], MIDDLE + (side(p) * LANE if p["goal"] < 1 else 0.0)
    law = pick(("push", "late", "creep"), p["law"])
    braking = then(p["brake_at"] + p["late"], constant(p["push"]), constant(-6.0))
    throttle = {"push": constant(p["push"]), "late": braking, "creep": hound(-5.5)}[law]
    rear = Car(p["rear"], lane + p["r"], v + p["dv"], controller(throttle, keep(lane + p["r"])))
    leader = Car(p["gap"], MIDDLE, v)
    leader.controller = controller(then(p["brake_at"], cruise(v), constant(-6.0)), keep(MIDDLE))
    return Scenario([rear, leader], policy(p), 3, MIDDLE, v, goal=lane)


@attack(
    {
        "seed": (0, 1e6), "cars": (1, 8), "hold": (0.2, 2), "brake": (2, 6), "push": (1, 3), "wheel": (0.02, 0.5),
        "speed": (2, 30), "spread": (0, 6), "lanes": (2, 5),
    }
)  # fmt: skip
def random_inputs(p: Numbers) -> Scenario:
    """All vehicles at random, in any size."""
    rng = np.random.default_rng(int(p["seed"]))
    lanes = int(p["lanes"])
    ego_r = LANE * int(rng.integers(lanes))
    cars: list[Car] = []
    for i in range(int(p["cars"])):
        length, width = (CAR, CAR, TRUCK, MOTORCYCLE)[rng.integers(4)]
        r = LANE * int(rng.integers(lanes))
        ds = float(rng.uniform(-40, 50))
        near = abs(r - ego_r) < 1
        room = 10.0 + 0.5 * length if near else 0.5 * length
        if (
            any(abs(c.r - r) < 1 and abs(c.ds - ds) < 3 + 0.5 * (c.length + length) for c in cars)
            or abs(ds) < room * near
        ):
            continue
        speed = max(p["speed"] + float(rng.normal(0, p["spread"])), 0.0)
        act = noise(int(p["seed"]) + i, p["hold"], p["brake"], p["push"], p["wheel"], lanes)
        cars.append(Car(ds, r + float(rng.uniform(-0.4, 0.4)), speed, act, 0.0, length, width))
    slow = SLOW if p["speed"] < 18 else None
    return Scenario(cars, policy(p), lanes, ego_r, p["speed"], target_speeds=slow)


@attack(
    {
        "seed": (0, 1e6), "cars": (3, 14), "gap": (7, 25), "speed": (3, 28), "spread": (0, 6), "lanes": (2, 5),
        "objects": (0, 3), "driven": (0, 0.6), "linear": (-0.5, 0.3),
    },
    seconds=8.0,
)  # fmt: skip
def mixed_traffic(p: Numbers) -> Scenario:
    """highway-env's own drivers close together, with obstacles, landmarks, and vehicles that wander, swerve or
    reverse."""
    rng = np.random.default_rng(int(p["seed"]))
    lanes = int(p["lanes"])
    ego_r = LANE * int(rng.integers(lanes))
    ends = np.full(lanes, -40.0) + rng.uniform(0, 10, lanes)
    cars: list[Car] = []
    for _ in range(int(p["cars"])):
        i = int(rng.integers(lanes))
        ds, r = float(ends[i]), LANE * i
        if r == ego_r and abs(ds) < 12:
            ds = 12.0 + float(rng.uniform(0, 8))
        ends[i] = ds + p["gap"] * rng.uniform(0.8, 2)
        speed = max(p["speed"] + float(rng.normal(0, p["spread"])), 0.0)
        kind = "IDMVehicle"
        if rng.random() < p["linear"]:
            kind = str(rng.choice(["LinearVehicle", "AggressiveVehicle", "DefensiveVehicle"]))
        if rng.random() < p["driven"]:
            phase, throttle = float(rng.random()), constant(float(rng.uniform(-6, 3)), float(rng.choice([0.0, -6.0])))
            wheel = waver(r, float(rng.uniform(0.02, 0.15)), float(rng.uniform(0.1, 0.8)), phase, 0.1)
            if speed < 12:
                wheel = swing(float(rng.uniform(0.1, 0.8)), float(rng.uniform(0.2, 1.2)), phase, r)
            cars.append(Car(ds, r, speed, controller(then(2 * phase, cruise(speed), throttle), wheel)))
        else:
            cars.append(Car(ds, r, speed, kind=kind, target_speed=float(rng.uniform(15, 32))))
    for _ in range(int(p["objects"])):
        i = int(rng.integers(lanes))
        cars.append(Car(float(ends[i]) + 8.0, LANE * i, 0.0, kind=str(rng.choice(["Obstacle", "Landmark"]))))
        ends[i] += 20.0
    slow = SLOW if p["speed"] < 18 else None
    return Scenario(cars, policy(p), lanes, ego_r, p["speed"], target_speeds=slow)


def _one(p: Numbers, i: int, v: float) -> Car:
    """A car that waits, goes to a lateral place, and may turn back; full freedom along the road at two times."""
    r = MIDDLE + LANE * round(1.49 * p[f"lane{i}"]) + p[f"r{i}"]
    ds, at, limit = p[f"ds{i}"], p[f"at{i}"], p[f"limit{i}"]
    if abs(r - MIDDLE) < 2 and abs(ds) < 10:
        ds = 10.0 + abs(ds) if ds >= 0 else -10.0 + ds
    out = change(r, r + p[f"move{i}"], lambda m: m.time >= at, limit)
    home = keep(r, limit)
    wheel = then(p[f"back{i}"] + at, out, home)
    early, late = constant(p[f"a{i}"]), constant(p[f"b{i}"], -8.0)
    speed = max(v + p[f"dv{i}"], 0.0)
    return Car(ds, r, speed, controller(then(at, early, late), wheel))


_ONE = {
    "ds": (-25, 35), "lane": (-1, 1), "r": (-0.5, 0.5), "dv": (-6, 6), "at": (0, 3), "limit": (0.05, 0.35),
    "move": (-5, 5), "back": (0.2, 4), "a": (-3, 2), "b": (-6, 3),
}  # fmt: skip


@attack({**{f"{k}{i}": b for i in range(3) for k, b in _ONE.items()}, "ego_speed": (4, 30)})
def coordinated(p: Numbers) -> Scenario:
    """Three cars with the same freedom each: made for the search."""
    v = p["ego_speed"]
    cars = [_one(p, i, v) for i in range(3)]
    return Scenario(cars, policy(p), 3, MIDDLE, v, goal=MIDDLE + LANE, target_speeds=SLOW if v < 18 else None)
