"""Attacks on the theorem: hand-written behaviours of single other vehicles, each with numbers to search over.

`attacks_in_company` has those with several vehicles; `ATTACKS` holds all of them.
"""

from __future__ import annotations

import attacks_in_company  # noqa: F401  (enters its attacks)
from attack_drivers import (
    abort,
    at_ego,
    below_zero,
    change,
    constant,
    controller,
    cruise,
    flick,
    hound,
    keep,
    swing,
    then,
    waver,
    zigzag,
)
from attack_kit import ATTACKS, MIDDLE, MOTORCYCLE, SIDE, SLOW, TRUCK, Numbers, Run, attack, pick, play, policy, side
from driven_traffic import LANE, Car, Scenario

__all__ = ["ATTACKS", "Run", "play"]


@attack(
    {
        "ds": (-8, 16), "dv": (-8, 3), "ego_speed": (14, 30), "from_c": (0, 1.6), "progress": (0.2, 1.6),
        "heading": (0, 0.3), "turn_at": (0.5, 1.55), "out": (0.15, 0.35), "back": (0.18, 0.35), "trigger": (0, 6),
        "wait": (0.5, 3.5), "near": (-5, 7), "side": SIDE, "a": (-3, 2), "drift": (0, 0.06),
    }
)  # fmt: skip
def abort_after_midline(p: Numbers) -> Scenario:
    """A car leaves the middle lane, is nearer to the next lane's centre than to its own, and comes back: at a time,
    when the ego is beside it, or when the ego is in the lane that it has left.
    """
    sign = side(p)
    to, turn_at = MIDDLE + sign * LANE, p["turn_at"]
    r = MIDDLE + min(p["progress"], 1.0) * sign * (LANE - turn_at - 0.05)
    mine = MIDDLE if p["from_c"] < 1 else MIDDLE - sign * LANE
    waits = (
        lambda m: m.ds > p["near"],
        lambda m: m.time < p["wait"],
        lambda m: abs(m.ego.r - MIDDLE) > 0.5 + 0.7 * p["wait"],
    )
    wheel = abort(MIDDLE, to, turn_at, (p["out"], p["back"]), waits[int(p["trigger"]) % 3], p["drift"])
    speed = max(p["ego_speed"] + p["dv"], 3.0)
    throttle = then(p["wait"], cruise(speed), constant(p["a"]))
    heading = sign * (p["drift"] if p["progress"] > 1 else min(p["heading"], p["out"]))
    cars = [Car(p["ds"], r, speed, controller(throttle, wheel), heading)]
    return Scenario(cars, policy(p), 3, mine, p["ego_speed"], goal=MIDDLE)


@attack(
    {
        "gap": (6, 22), "speed": (0, 12), "behind": (9, 45), "ego_speed": (2, 25), "kind": (0, 4), "obstacle": (0, 2),
        "side": SIDE,
    },
    seconds=8.0,
)  # fmt: skip
def idm_reverses(p: Numbers) -> Scenario:
    """highway-env's own car stops too close behind something that stands, and reverses; the ego is behind it."""
    kind = pick(("IDMVehicle", "IDMVehicle", "LinearVehicle", "DefensiveVehicle"), p["kind"])
    front = Car(p["behind"] + p["gap"], MIDDLE, 0.0, kind="Obstacle" if p["obstacle"] < 1 else "driven")
    wall = [Car(front.ds - 2, MIDDLE + d * LANE, 0.0, kind="Obstacle") for d in (-1, 1)]
    car = Car(p["behind"], MIDDLE, p["speed"], kind=kind, target_speed=20.0)
    return Scenario([car, front, *wall], policy(p), 3, MIDDLE, p["ego_speed"], target_speeds=SLOW)


@attack(
    {
        "ds": (-8.0, -2.5), "dv": (-3, 4), "ego_speed": (3, 32), "a": (-2, 3), "ego_r": (0.0, 2.4), "r": (-0.4, 1.2),
        "side": SIDE, "hold": (0, 2), "gap": (12, 80), "leads": (0, 2),
    },
    seconds=4.0,
)  # fmt: skip
def beside_the_rear(p: Numbers) -> Scenario:
    """A car whose front is beside the ego's rear keeps its lane; the ego is steered at it."""
    lane = MIDDLE + side(p) * LANE
    throttle = hound(p["ds"], 3.0, 2.0) if p["hold"] < 0.7 else constant(p["a"])
    speed = max(p["ego_speed"] + p["dv"], 1.0)
    r = lane + side(p) * p["r"]
    cars = [Car(p["ds"], r, speed, controller(throttle, keep(r)))]
    if p["leads"] < 1:
        braking = then(1.0, cruise(p["ego_speed"]), constant(-6.0))
        cars.append(Car(p["gap"], MIDDLE, p["ego_speed"], controller(braking, keep(MIDDLE))))
    slow = SLOW if p["ego_speed"] < 18 else None
    mine = MIDDLE + side(p) * p["ego_r"]
    return Scenario(cars, policy(p), 3, mine, p["ego_speed"], goal=lane, target_speeds=slow)


@attack(
    {
        "ds": (-10, 16), "speed": (2, 12), "dv": (-3, 8), "wheel": (0.3, 1.04), "frequency": (0.1, 1.2),
        "phase": (0, 1), "lane": (-1, 2), "a": (-3, 3), "side": SIDE, "law": (0, 2),
    }
)  # fmt: skip
def slip(p: Numbers) -> Scenario:
    """A slow car turns its wheels far: it moves sideways more than it points there."""
    lane = MIDDLE + side(p) * LANE * (p["lane"] > 0)
    other = MIDDLE if lane != MIDDLE else MIDDLE + side(p) * LANE
    quick = change(lane, other, lambda m: m.time > 2 * p["phase"], 0.35, gain=3.0)
    wheel = swing(p["wheel"], p["frequency"], p["phase"], lane) if p["law"] < 1 else quick
    ds = p["ds"] if lane != MIDDLE else 8.0 + abs(p["ds"])
    cars = [Car(ds, lane, p["speed"], controller(constant(p["a"], 1.0, 14.0), wheel))]
    return Scenario(cars, policy(p), 3, MIDDLE, max(p["speed"] + p["dv"], 1.0), goal=lane, target_speeds=SLOW)


@attack(
    {
        "ds": (-8, 8), "dv": (-3, 3), "heading": (0.03, 0.1), "reach": (0.1, 1.3), "r": (-0.3, 0.3), "side": SIDE,
        "leader": (14, 45), "brake_at": (0, 3), "ego_speed": (15, 30),
    }
)  # fmt: skip
def waver_beside(p: Numbers) -> Scenario:
    """A car beside the ego wavers inside its lane while the ego's leader brakes."""
    lane = MIDDLE + side(p) * LANE
    wheel = zigzag(lane, p["reach"], p["heading"])
    beside = Car(p["ds"], lane + p["r"], p["ego_speed"] + p["dv"], controller(hound(p["ds"]), wheel))
    braking = then(p["brake_at"], cruise(p["ego_speed"]), constant(-6.0))
    leader = Car(p["leader"], MIDDLE, p["ego_speed"], controller(braking, keep(MIDDLE)))
    return Scenario([beside, leader], policy(p), 3, MIDDLE, p["ego_speed"], goal=lane)


@attack(
    {
        "ds": (-14, 14), "dv": (-4, 4), "heading": (0.05, 0.45), "pattern": (1, 64), "period": (2, 7), "side": SIDE,
        "offset": (-0.6, 0.8), "ego_speed": (15, 32), "a": (-3, 2), "start": (0, 2), "away": (-1, 3),
    },
    rates=(5,),
)  # fmt: skip
def coming_frame(p: Numbers) -> Scenario:
    """A car beside the ego points at it (or away) for single frames: its coming frame sweeps across the ego."""
    sign = side(p)
    r = MIDDLE + sign * (LANE + p["offset"])
    toward = sign if p["away"] < 0 else -sign
    wheel = flick(r, toward * p["heading"], int(p["pattern"]), int(p["period"]), lambda m: m.time >= p["start"])
    throttle = then(p["start"], hound(p["ds"]), constant(p["a"]))
    cars = [Car(p["ds"], r, p["ego_speed"] + p["dv"], controller(throttle, wheel))]
    return Scenario(cars, policy(p), 3, MIDDLE, p["ego_speed"], goal=MIDDLE + sign * LANE)


@attack(
    {
        "ds": (-20, 26), "dv": (-6, 6), "size": (0, 3), "law": (0, 4), "start": (0, 3), "limit": (0.05, 0.35),
        "side": SIDE, "ego_speed": (12, 30), "a": (-6, 3), "r": (-0.4, 0.4), "ds2": (-25, 25), "lane": (0, 3),
    }
)  # fmt: skip
def trucks(p: Numbers) -> Scenario:
    """Long and wide (or narrow) vehicles change lanes, keep them, or waver in them."""
    length, width = (TRUCK, TRUCK, MOTORCYCLE)[min(int(p["size"]), 2)]
    sign = side(p)
    lane = MIDDLE + sign * LANE
    law = pick(("keep", "in", "out", "waver"), p["law"])
    start = MIDDLE if law == "out" else lane
    to = {"keep": lane, "in": MIDDLE, "out": lane, "waver": lane}[law]
    wheel = change(start + p["r"], to, lambda m: m.time >= p["start"], p["limit"])
    if law == "waver":
        wheel = waver(lane + p["r"], 0.5 * p["limit"], 0.3, p["start"] / 3, 0.1)
    ds = p["ds"] if start != MIDDLE else 13 + 0.7 * abs(p["ds"])
    throttle = then(p["start"], cruise(p["ego_speed"] + p["dv"]), constant(p["a"], 2.0))
    first = Car(ds, start + p["r"], p["ego_speed"] + p["dv"], controller(throttle, wheel), 0.0, length, width)
    far = MIDDLE - sign * LANE
    second = Car(p["ds2"], far, p["ego_speed"], controller(hound(p["ds2"]), keep(far)), 0.0, *TRUCK)
    cars = [first, second] if p["lane"] < 2 else [first]
    return Scenario(cars, policy(p), 3, MIDDLE, p["ego_speed"], goal=lane)


@attack(
    {
        "ds": (9, 40), "speed": (0, 15), "ego_speed": (1, 25), "law": (0, 3), "rate": (1, 6), "back": (1, 15),
        "delay": (0, 4), "r": (-0.5, 0.5), "near": (6, 20), "lane": (0, 3), "side": SIDE,
    },
    seconds=8.0,
)  # fmt: skip
def standing_and_reversing(p: Numbers) -> Scenario:
    """Standing cars that start, and cars that brake to a standstill and reverse towards the ego."""
    law = pick(("start", "reverse", "reverse_near"), p["law"])
    lane = MIDDLE if p["lane"] < 2 else MIDDLE + side(p) * LANE
    if law == "start":
        throttle, speed = then(p["delay"], cruise(0.0), constant(0.5 * p["rate"])), 0.0
    else:
        stop = below_zero(constant(-p["rate"]), p["rate"], p["back"])
        throttle = (
            then(p["delay"], cruise(p["speed"]), stop)
            if law == "reverse"
            else at_ego(p["near"], constant(-p["rate"]), stop)
        )
        speed = p["speed"]
    wheel = keep(MIDDLE + p["r"]) if law == "start" and lane != MIDDLE and p["near"] > 13 else keep(lane + p["r"])
    cars = [Car(p["ds"], lane + p["r"], speed, controller(throttle, wheel))]
    return Scenario(cars, policy(p), 3, MIDDLE, p["ego_speed"], goal=lane, target_speeds=SLOW)
