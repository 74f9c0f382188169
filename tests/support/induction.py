"""Whether a plan that verified is still good a frame later: what the induction of the certificate rests on.

An audit stands around `DecisionCore.decide`. In each new frame it judges what is left of the stored plan by the
clauses of the certificate, without precautions and without the vehicles that have broken a rule. Where the plan was
verified a frame before, or was found good then, its margin must not be negative. What a decision has verified, its
first frame must not lose.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np

from dynamics.scenes.scene import Scene
from dynamics.state import Vehicle
from shield import Decision, Reason, ShieldConfig, ShieldedEnv, Tier
from shield.certificate.road.memory import Memory, ObservedScene, observe
from shield.certificate.road.verify import ROUNDING
from shield.pipelines.decide import DecisionCore
from shield.pipelines.inputs import InputPipeline

__all__ = ["Audit", "Lost", "Tally", "audited", "drive", "make"]


@dataclass(frozen=True)
class Lost:
    """A plan that was good, and is not a frame later with nobody named.

    `margin` [m] is what is left of it; `clause` and `vehicle` bind. `tier` is that of the decision before, and `before`
    [m] its margin.
    """

    frame: int
    clause: str
    vehicle: int
    margin: float
    tier: str
    before: float

    def __str__(self) -> str:
        return (
            f"frame {self.frame}: {self.clause or 'nothing'} of vehicle {self.vehicle}, {self.margin:.3f} m; "
            f"{self.before:.3f} m before ({self.tier})"
        )


@dataclass
class Tally:
    """What an audit found: frames judged, those with an offence, plans lost, and fallbacks without a good plan."""

    frames: int = 0
    judged: int = 0
    named: int = 0
    lost: list[Lost] = field(default_factory=list)
    tiers: Counter[str] = field(default_factory=Counter)
    rules: Counter[str] = field(default_factory=Counter)

    def add(self, other: Tally) -> None:
        """Count what another episode found as well."""
        self.frames, self.judged, self.named = (
            self.frames + other.frames,
            self.judged + other.judged,
            self.named + other.named,
        )
        self.lost += other.lost
        self.tiers += other.tiers
        self.rules += other.rules


def left_of(now: ObservedScene, inputs: InputPipeline | None) -> tuple[float, str, int]:
    """What is left of the stored plan in a scene: its margin [m], the clause that binds and the vehicle."""
    if inputs is None:
        kept = now.fail_safe(lawful=True)
        return kept.margin, kept.binding.clause, kept.binding.vehicle
    lane = int(now.memory.stored)
    judged = inputs.judge(
        now, inputs.execution.fail_safe_inputs(now.scene, lane)[None], [lane], verifier=now.lawful.without_cut_ins()
    )
    plan = inputs.plan(now, judged)
    return plan.margin, plan.binding.clause, plan.binding.vehicle


class Audit:
    """Judges the stored plan at each new frame.

    Parameters
    ----------
    core : of a placement for meta-actions or inputs; its `decide` is replaced.
    config : the shield's settings.
    """

    def __init__(self, core: DecisionCore[Any], config: ShieldConfig) -> None:
        self.tally = Tally()
        self._core, self._config, self._decide = core, config, core.decide
        self._good, self._last = False, Tier.OFF
        self._margin, self.hook = float("nan"), None
        core.decide = self.decide  # type: ignore[method-assign]

    def decide(self, scene: Any, proposal: Any, procedure: Any = None) -> Decision:
        """As `DecisionCore.decide`; a new frame is judged before, and a frame after the decision that it begins
        with."""
        again = isinstance(scene, Scene) and scene.frame == self._core.memory.frame
        if isinstance(scene, Scene) and not again:
            self._judge(scene)
        decision = self._decide(scene, proposal, procedure)
        lost = again and self._good and decision.reason is Reason.NO_SAFE_PLAN
        if lost and not self._core.memory.watch.violated:
            at, was = (decision.clause, decision.vehicle, decision.margin), (self._last.value, self._margin)
            self.tally.lost.append(Lost(int(scene.frame or 0), *at, *was))
        if decision.tier.verified or decision.tier is Tier.EVADED:
            self._good = True
        self._good = self._good and self._core.memory.stored is not None
        self._last, self._margin = decision.tier, decision.margin
        self.tally.tiers[decision.tier.value] += 1
        return decision

    def _judge(self, scene: Scene) -> None:
        memory: Memory[Any] = self._core.memory
        procedure = self._core.procedure
        inputs = procedure if isinstance(procedure, InputPipeline) else None
        frames = inputs.execution.frames if inputs is not None else 1
        self.tally.frames += 1
        if memory.verifier is None or memory.stored is None:
            self._good = False
            return
        now = observe(memory, scene, self._config, frames)
        watch: Any = now.memory.watch
        self.tally.named += int(watch.breaking.any())
        for rule, n in watch.by_rule.items():
            self.tally.rules[str(rule)] += n - memory.watch.by_rule.get(rule, 0)
        if scene.ego[Vehicle.CRASHED] > 0:  # highway-env moves the ego then
            self._good = False
        if not self._good:
            return
        self.tally.judged += 1
        margin, clause, vehicle = left_of(now, inputs)
        self._good = margin >= -ROUNDING
        if not self._good:
            lost = Lost(int(scene.frame or 0), clause, vehicle, margin, self._last.value, self._margin)
            self.tally.lost.append(lost)
            if self.hook is not None:
                self.hook(self, lost, memory, now)


def make(action: str, hz: int, env_id: str = "highway-v0", **config: Any) -> gym.Env[Any, Any]:
    """A highway with meta-actions ("meta") or throttle and steering ("inputs") at a simulation frequency [1/s]."""
    kind = "DiscreteMetaAction" if action == "meta" else "ContinuousAction"
    period = 1 if action == "meta" else min(5, hz)
    settings = {
        "action": {"type": kind},
        "simulation_frequency": hz,
        "policy_frequency": period,
        "vehicles_count": 25,
        "duration": 30,
        **config,
    }
    return gym.make(env_id, config=settings, disable_env_checker=True)


Propose = Callable[[Any, np.random.Generator, Any], Any]


def audited(env: ShieldedEnv) -> Audit:
    """An audit of what a shielded environment decides."""
    return Audit(env.core, env.core.procedure.config)


def drive(
    env: gym.Env[Any, Any],
    propose: Propose,
    seed: int,
    frames: int = 10**9,
    prepare: Callable[[ShieldedEnv], None] | None = None,
    config: ShieldConfig | None = None,
    hook: Any = None,
) -> Tally:
    """One audited episode behind `ShieldedEnv`, to its end or so many frames.

    `propose` is handed the environment, a generator and the observation. `prepare` may change the traffic after the
    reset.
    """
    shielded = ShieldedEnv(env, config)
    audit, rng = audited(shielded), np.random.default_rng(seed)
    audit.hook = hook
    obs, _ = shielded.reset(seed=seed)
    if prepare is not None:
        prepare(shielded)
    over = False
    while not over and audit.tally.frames < frames:
        obs, _, terminated, truncated, _ = shielded.step(propose(shielded, rng, obs))
        over = terminated or truncated
    return audit.tally
