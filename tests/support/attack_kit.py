"""What an attack is: a function from named numbers (with bounds) to a `Scenario`; and how it is run and repeated.

A point of the unit cube stands for the numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from attack_drivers import POLICIES, policy_of
from driven_traffic import LANE, Outcome, Scenario, Setting, drive

from dynamics.traffic.assumptions import Assumptions
from shield import ShieldConfig

__all__ = ["ATTACKS", "Attack", "Run", "play"]

Numbers = Mapping[str, float]
Bounds = Mapping[str, tuple[float, float]]

SLOW = (0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0)
"""Speeds of the meta-actions where the ego is to drive slowly."""

WARY = ShieldConfig(assumptions=replace(Assumptions.idm(), comfortable_braking=Assumptions.idm().braking))
"""Counts on no reason for braking."""

TRUCK, CAR, MOTORCYCLE = (12.0, 2.5), (5.0, 2.0), (2.0, 0.8)


@dataclass(frozen=True)
class Attack:
    """A behaviour with bounds on its numbers, and where it is worth trying."""

    name: str
    build: Callable[[Numbers], Scenario]
    bounds: Bounds
    actions: tuple[str, ...] = ("meta", "continuous")
    rates: tuple[int, ...] = (5, 15, 30)
    seconds: float = 6.0

    @property
    def size(self) -> int:
        return len(self.bounds)

    def numbers(self, unit: Sequence[float]) -> dict[str, float]:
        """The numbers that a point of the unit cube stands for."""
        return {k: low + float(u) * (high - low) for (k, (low, high)), u in zip(self.bounds.items(), unit, strict=True)}


@dataclass(frozen=True)
class Run:
    """Everything that it takes to repeat a run."""

    attack: str
    action: str
    hz: int
    seed: int
    unit: tuple[float, ...]

    @staticmethod
    def sample(name: str, action: str, hz: int, seed: int) -> Run:
        """The run of a seed."""
        rng = np.random.default_rng([seed, hz, len(action), *name.encode()])
        return Run(name, action, hz, seed, tuple(float(u) for u in rng.random(ATTACKS[name].size)))

    def describe(self, out: Outcome) -> str:
        """What to say of it when it fails."""
        numbers = {k: round(v, 4) for k, v in ATTACKS[self.attack].numbers(self.unit).items()}
        return (
            f"{self!r} clearance {out.clearance:.3f} m, vehicle {out.breach_vehicle} at frame {out.breach_frame} of "
            f"tier {out.tier}, crashed {out.crashed}, uncertified from {out.uncertified_frame}, "
            f"tiers {dict(out.tiers)}; {numbers}"
        )


def play(run: Run) -> Outcome:
    """Drive one run; every other one where anybody may brake as hard as can be at any time."""
    attack = ATTACKS[run.attack]
    scenario = attack.build(attack.numbers(run.unit))
    setting = Setting(run.action, run.hz, attack.seconds)
    config = WARY if run.seed % 2 else ShieldConfig()
    return drive(scenario, setting, policy_of(scenario.policy, run.action), run.seed, config)


ATTACKS: dict[str, Attack] = {}


def attack(
    bounds: Bounds,
    *,
    actions: tuple[str, ...] = ("meta", "continuous"),
    rates: tuple[int, ...] = (5, 15, 30),
    seconds: float = 6.0,
) -> Callable[[Callable[[Numbers], Scenario]], Callable[[Numbers], Scenario]]:
    """Enter a function among the attacks; the ego's policy is always its last number."""

    def enter(build: Callable[[Numbers], Scenario]) -> Callable[[Numbers], Scenario]:
        every = {**bounds, "policy": (0.0, float(len(POLICIES)))}
        ATTACKS[build.__name__] = Attack(build.__name__, build, every, actions, rates, seconds)
        return build

    return enter


def pick(options: Sequence[str], share: float) -> str:
    """One of the options, by a number in [0, len(options)]."""
    return options[min(int(share), len(options) - 1)]


def side(p: Numbers) -> float:
    return -1.0 if p["side"] < 0 else 1.0


def policy(p: Numbers) -> str:
    return pick(POLICIES, p["policy"])


MIDDLE = LANE
SIDE = (-1.0, 1.0)
