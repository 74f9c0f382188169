"""Traffic that is driven against the certificate on road networks, in highway-env itself.

Two kinds of drivers take the places of the others. *Wild* ones are vehicles with throttle and steering at random, and
break every rule there is. *Bold* ones keep to every rule that `shield.roads.watch` knows and are otherwise as reckless
as the rules permit: from one moment to the next they brake or accelerate as hard as the assumptions allow, turn
wherever the road leads, and answer to nobody but to whoever is before them in their own lane. What comes of the first
has to be flagged; of the second there is nothing to flag, and nothing may happen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np
from highway_env.vehicle.controller import ControlledVehicle
from highway_env.vehicle.kinematics import Vehicle
from joblib import Parallel, delayed

from evaluation.settings import Setting
from evaluation.threads import one_thread
from shield import ShieldConfig, ShieldedEnv
from shield.decision import Decision
from shield.doors.road_door import RoadDoor
from shield.errors import ConfigError
from shield.roads.watch import Breach

__all__ = ["DRIVERS", "Attack", "attack", "attack_many", "man"]

DRIVERS = ("wild", "bold", "mixed")
Draw = Any
"""A numpy generator, or what stands for one."""
Ahead = dict[tuple[str, str, int], list[tuple[str, str, int]]]
_HELD = 2, 20
_HIT = 8.0
"""Whoever has crashed and is nearer to the ego was in it [m]."""
_FRESH = 3.0
"""A wreck of fewer seconds counts as its own doing [s]."""
_CAUTION = 1.0
"""What a bold driver keeps to the one before it beside its own way to a standstill [m]."""


class Wild(Vehicle):  # type: ignore[misc]
    """Throttle and steering at random, each held for a while; nothing else decides what it does."""

    def take(self, draw: Draw, turns: Draw, door: RoadDoor, period: float, ahead: Ahead) -> None:
        """Be driven by these numbers, and turn by these, in frames of so long [s], on lanes that lead to these."""
        self.draw, self.left, self.route = draw, 0, ()

    def act(self, action: Any = None) -> None:
        """For the coming frame."""
        if self.left == 0:
            self.left = int(self.draw.integers(*_HELD))
            hard = self.draw.random() < 0.2
            self.held = {
                "acceleration": self.draw.uniform(-8, 8) if hard else self.draw.uniform(-3, 3),
                "steering": self.draw.normal(0, 0.3 if hard else 0.03),
            }
        self.left -= 1
        super().act(self.held)


class Bold(ControlledVehicle):  # type: ignore[misc]
    """As reckless as the rules permit."""

    target_lane_index: Any

    def take(self, draw: Draw, turns: Draw, door: RoadDoor, period: float, ahead: Ahead) -> None:
        """Be driven by these numbers, and turn by these, in frames of so long [s], on lanes that lead to these."""
        self.draw, self.left, self.held, self.period = draw, 0, 0.0, period
        self.turns, self.ahead = turns, ahead
        self.door, self.assumptions, self.route = door, door.config.assumptions, None

    def act(self, action: Any = None) -> None:
        """For the coming frame."""
        if self.left == 0:
            self.left = int(self.draw.integers(*_HELD))
            a = self.assumptions
            self.held = float(self.draw.choice([-a.braking, 0.0, a.acceleration, a.acceleration]))
        self.left -= 1
        self._turn_anywhere()
        steering = float(
            np.clip(self.steering_control(self.target_lane_index), -self.MAX_STEERING_ANGLE, self.MAX_STEERING_ANGLE)
        )
        Vehicle.act(self, {"acceleration": self._permitted(), "steering": steering})

    def _turn_anywhere(self) -> None:
        if self.road.network.get_lane(self.target_lane_index).after_end(self.position):
            ahead = self.ahead[self.target_lane_index]
            if ahead:
                self.target_lane_index = ahead[int(self.turns.integers(len(ahead)))]

    def _permitted(self) -> float:
        """No faster than its lane, and no nearer to the one before it than it can stop behind."""
        rules, dt = self.assumptions, self.period
        limit = self.lane.speed_limit or rules.max_speed
        held = min(self.held, max(limit - self.speed, -rules.braking * dt) / dt)
        first, _ = self.road.neighbour_vehicles(self, self.lane_index)
        if first is not None:
            gap = self.lane_distance_to(first) - self.LENGTH / 2 - first.LENGTH / 2 - _CAUTION
            speed, other = max(self.speed, 0.0), max(first.speed, 0.0)
            way = speed * 2 * dt + (speed + rules.acceleration * dt) ** 2 / (2 * rules.braking)
            if gap < way - other * other / (2 * 9.8):
                held = -rules.braking
        if self.door.counts_on(self):
            held = -rules.braking
        return max(held, -max(self.speed, 0.0) / dt)


@dataclass(frozen=True, slots=True)
class Attack:
    """What came of one episode.

    Attributes
    ----------
    env_id, seed, drivers : to drive it again. frames : how many there were.
    crashed : whether the ego was. blameless : whether something had been verified, and nobody that it crashed with had
        broken a rule, nor had anybody else come into the way of what was verified last.
    by_rule : how often each was broken.
    """

    env_id: str
    seed: int
    drivers: str
    frames: int
    crashed: bool
    blameless: bool
    by_rule: dict[str, int]

    @property
    def unforeseen(self) -> bool:
        """Whether the certificate had a hole: who broke no rule made the fail-safe suffer, or the ego crash."""
        return Breach.UNFORESEEN in self.by_rule or self.blameless


def man(
    env: ShieldedEnv, drivers: str, vehicles: int, seed: int, told: Sequence[tuple[Draw, Draw]] | None = None
) -> None:
    """Put drivers into the first so many of the others.

    Parameters
    ----------
    drivers : of `DRIVERS`. seed : of what they do. told : instead, what says so of each, and where it turns.

    Raises
    ------
    ConfigError
        If there are none of that name.
    """
    if drivers not in DRIVERS:
        raise ConfigError(f"unknown drivers {drivers!r}; have {', '.join(DRIVERS)}")
    base: Any = env.unwrapped
    assert isinstance(env.door, RoadDoor)
    kinds: Sequence[type[Any]] = {"wild": (Wild,), "bold": (Bold,), "mixed": (Wild, Bold)}[drivers]
    left, ahead, period = vehicles, env.door.ahead, 1 / base.config["simulation_frequency"]
    for k, body in enumerate(base.road.vehicles):
        if body is base.vehicle or left == 0:
            continue
        driven = kinds[left % len(kinds)](body.road, body.position.copy(), body.heading, body.speed)
        draw = np.random.default_rng([seed, k])
        habits, turns = (draw, draw) if told is None else told[vehicles - left]
        driven.take(habits, turns, env.door, period, ahead)
        driven.crashed = body.crashed
        base.road.vehicles[k], left = driven, left - 1


def _watch_for_a_crash(base: Any, door: RoadDoor) -> list[bool]:
    """Whether the ego was `Attack.blameless`, in a list that is empty until it crashes."""
    found: list[bool] = []
    wrecks: dict[Any, int] = {}
    step, ego, frame, ask = base.road.step, base.vehicle, count(), door.frame
    promised = False

    def asked() -> tuple[Any, Decision]:
        nonlocal promised
        command, decision = ask()
        promised = promised or decision.tier.verified
        return command, decision

    def watched(dt: float) -> None:
        now = next(frame)
        for body in base.road.vehicles:
            if body.crashed:
                wrecks.setdefault(body, now)
        step(dt)
        if ego.crashed and not found:
            near = [b for b in base.road.vehicles if b is not ego and np.hypot(*(b.position - ego.position)) < _HIT]
            hit = [body for body in near if body.crashed]
            # Who had its crash just before has slid into the way; what has lain there for long was to be seen.
            fresh = any(now - wrecks.get(body, -np.inf) <= _FRESH / dt for body in hit)
            # Where nothing has been verified since the reset, nothing has been promised.
            found.append(promised and not (fresh or door.disturbed or door.culprits(hit)))

    base.road.step = watched
    door.frame = asked  # type: ignore[method-assign]
    return found


def attack(
    setting: Setting,
    seed: int,
    drivers: str,
    vehicles: int = 8,
    decisions: int = 20,
    config: ShieldConfig | None = None,
) -> Attack:
    """One episode of a shielded ego with actions at random among such drivers.

    Parameters
    ----------
    drivers : of `DRIVERS`. vehicles : how many of the others they take. decisions : how many at most.
    config : settings; those for the road's traffic by default.

    Raises
    ------
    ConfigError
        If there are none of that name, or the environment is none of a road network with meta-actions.
    """
    with one_thread():
        env = ShieldedEnv(setting.make(), config)
        door = env.door
        if not isinstance(door, RoadDoor):
            raise ConfigError(f"{setting.name} is no road network with meta-actions, which this attacks")
        base: Any = env.unwrapped
        env.reset(seed=seed)
        env.action_space.seed(seed)
        man(env, drivers, vehicles, seed)
        blameless = _watch_for_a_crash(base, door)
        each, frames = int(base.config["simulation_frequency"] // base.config["policy_frequency"]), 0
        for _ in range(decisions):
            *_, terminated, truncated, _ = env.step(env.action_space.sample())
            frames += each
            if terminated or truncated:
                break
        return Attack(setting.env_id, seed, drivers, frames, bool(base.vehicle.crashed), any(blameless), door.by_rule)


def attack_many(
    setting: Setting,
    drivers: str,
    episodes: int,
    seed: int,
    vehicles: int = 8,
    jobs: int = -1,
    config: ShieldConfig | None = None,
) -> list[Attack]:
    """So many episodes of `attack`, on the seeds from one on, in so many processes (-1: one for each core)."""
    seeds = range(seed, seed + episodes)
    return list(Parallel(n_jobs=jobs)(delayed(attack)(setting, s, drivers, vehicles, config=config) for s in seeds))
