"""Traffic that is driven against the certificate on road networks, in highway-env itself.

What comes of wild drivers (`evaluation.falsification.network_adversaries`) has to be flagged; of bold ones there is
nothing to flag, and nothing may happen.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from evaluation.falsification.network_adversaries import man
from evaluation.settings import Setting
from evaluation.threads import one_thread
from shield import ShieldConfig, ShieldedEnv
from shield.certificate.network.monitor import Breach
from shield.config import WORST_CASE
from shield.decision import Decision
from shield.errors import ConfigError
from shield.filters.network import RoadDoor

__all__ = ["Attack", "attack", "attack_many", "watch_for_a_crash"]

_HIT = 8.0
"""Whoever has crashed and is nearer to the ego was in it [m]."""
_FRESH = 3.0
"""A wreck of fewer seconds counts as its own doing [s]."""


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


def watch_for_a_crash(base: Any, door: RoadDoor) -> list[bool]:
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
    drivers : of `evaluation.falsification.network_adversaries.DRIVERS`. vehicles : how many of the others they take.
        decisions : how many at most.
    config : settings; the worst case of the road's traffic by default.

    Raises
    ------
    ConfigError
        If there are none of that name, or the environment is none of a road network with meta-actions.
    """
    with one_thread():
        env = ShieldedEnv(setting.make(), config or WORST_CASE)
        door = env.door
        if not isinstance(door, RoadDoor):
            raise ConfigError(f"{setting.name} is no road network with meta-actions, which this attacks")
        base: Any = env.unwrapped
        env.reset(seed=seed)
        env.action_space.seed(seed)
        man(env, drivers, vehicles, seed)
        blameless = watch_for_a_crash(base, door)
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
