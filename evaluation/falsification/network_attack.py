"""Adversarial traffic against the certificate on road networks, in highway-env itself.

Violations of unconstrained adversaries (`evaluation.falsification.network_adversaries`) have to be recorded. Worst-case
compliant drivers may cause neither a recorded violation nor a crash.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from evaluation.falsification.network_adversaries import install_drivers
from evaluation.settings import Setting
from evaluation.threads import one_thread
from shield import ShieldConfig, ShieldedEnv
from shield.certificate.network.monitor import NetworkRule
from shield.config import WORST_CASE
from shield.decision import Decision
from shield.errors import ConfigError
from shield.filters.network import NetworkFilter

__all__ = ["Attack", "attack", "attack_many", "record_blameless_crash"]

_HIT = 8.0
"""Distance up to which a crashed vehicle counts as part of the ego's crash [m]."""
_FRESH = 3.0
"""Age up to which a wreck counts as the cause of a crash by its own motion [s]."""


@dataclass(frozen=True, slots=True)
class Attack:
    """Result of one episode.

    Attributes
    ----------
    env_id, seed, drivers : identify the episode, to repeat it.
    frames : number of frames.
    crashed : whether the ego crashed.
    blameless : whether the ego crashed after a verified decision, no vehicle in the crash had broken a rule, and no
        violator had disturbed the last verified plan.
    by_rule : number of violations by rule.
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
        """Whether the certificate had a hole: without a violation the fail-safe lost its margin or the ego crashed."""
        return NetworkRule.UNFORESEEN in self.by_rule or self.blameless


def record_blameless_crash(base: Any, network_filter: NetworkFilter) -> list[bool]:
    """Observe an episode until the ego crashes, by replacing the road's `step` and the filter's `frame`.

    Returns
    -------
    A list that is empty until the ego crashes, and then holds `Attack.blameless`.
    """
    found: list[bool] = []
    wrecks: dict[Any, int] = {}
    step, ego, frame, ask = base.road.step, base.vehicle, count(), network_filter.frame
    promised = False

    def observed_frame() -> tuple[Any, Decision]:
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
            # A fresh wreck has slid into the way; an older one was visible before the decision.
            fresh = any(now - wrecks.get(body, -np.inf) <= _FRESH / dt for body in hit)
            # Without a verified decision since the reset there is no guarantee.
            found.append(promised and not (fresh or network_filter.disturbed or network_filter.culprits(hit)))

    base.road.step = watched
    network_filter.frame = observed_frame  # type: ignore[method-assign]
    return found


def attack(
    setting: Setting,
    seed: int,
    drivers: str,
    vehicles: int = 8,
    decisions: int = 20,
    config: ShieldConfig | None = None,
) -> Attack:
    """Drive one episode of a shielded ego with random actions among adversaries.

    Parameters
    ----------
    setting : a road network with meta-actions.
    seed : seed of the scene, the drivers and the actions.
    drivers : one of `evaluation.falsification.network_adversaries.DRIVERS`.
    vehicles : number of vehicles that are replaced by adversaries.
    decisions : largest number of decisions.
    config : the shield's settings; the worst case of the road's traffic by default.

    Raises
    ------
    ConfigError
        If `drivers` is unknown, or the environment is no road network with meta-actions.
    """
    with one_thread():
        env = ShieldedEnv(setting.make(), config or WORST_CASE)
        network_filter = env.filter
        if not isinstance(network_filter, NetworkFilter):
            raise ConfigError(f"{setting.name} is no road network with meta-actions, which this attacks")
        base: Any = env.unwrapped
        env.reset(seed=seed)
        env.action_space.seed(seed)
        install_drivers(env, drivers, vehicles, seed)
        blameless = record_blameless_crash(base, network_filter)
        each, frames = int(base.config["simulation_frequency"] // base.config["policy_frequency"]), 0
        for _ in range(decisions):
            *_, terminated, truncated, _ = env.step(env.action_space.sample())
            frames += each
            if terminated or truncated:
                break
        return Attack(
            setting.env_id, seed, drivers, frames, bool(base.vehicle.crashed), any(blameless), network_filter.by_rule
        )


def attack_many(
    setting: Setting,
    drivers: str,
    episodes: int,
    seed: int,
    vehicles: int = 8,
    jobs: int = -1,
    config: ShieldConfig | None = None,
) -> list[Attack]:
    """Call `attack` on `episodes` consecutive seeds from `seed` on, in `jobs` processes (-1: one for each core)."""
    seeds = range(seed, seed + episodes)
    return list(Parallel(n_jobs=jobs)(delayed(attack)(setting, s, drivers, vehicles, config=config) for s in seeds))
