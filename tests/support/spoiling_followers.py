"""A follower that takes the ego's stored plan away where the monitor lets it: of all that it may do in the coming frame
it does what leaves the plan the smallest margin."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from driven_traffic import LANE
from edge_riders import Skidder, Stage
from induction import left_of

from dynamics.state import FloatArray
from shield import ShieldedEnv
from shield.certificate.road.memory import observe
from shield.pipelines.inputs import InputPipeline

__all__ = ["spoil"]

_HEADINGS = 0.0, 0.5 * np.pi, -0.5 * np.pi, 1.0, -1.0, 0.5
_ACCELERATIONS = 0.0, 5.9, 2.5, -5.9
_ASIDE = 0.0, 0.3, -0.3
_TRIED = 14
"""So many of all moves are tried in a frame."""
_WANDERS = 0.3
"""How often a move is taken that takes nothing from the plan."""


class _Puppet(Skidder):
    """Does what `planned` says: acceleration, heading and way across the road."""

    def act(self, action: Any = None) -> None:
        """Keep on, unless it is told otherwise."""
        self.do(np.array([0.0, self.heading, 0.0]))

    def after(self) -> FloatArray:
        """Where it is a frame later: x, y, heading and speed."""
        speed = max(self.speed + self.planned[0] * self.dt, 0.0)
        aside = float(np.clip(self.planned[2], -self.speed * self.dt, self.speed * self.dt))
        x, y = self.position
        return np.array([x + self.speed * self.dt, y + aside, self.planned[1], speed])


class _Spoiler(Stage):
    """Has the first of the puppets try its moves on the monitor and on the stored plan."""

    def _try(self) -> None:
        self._act()
        core, follower = self._env.core, self._riders[0]
        inputs = core.procedure if isinstance(core.procedure, InputPipeline) else None
        scene = core.memory.verifier.scene
        moves = list(product(_ACCELERATIONS, _HEADINGS, _ASIDE))
        tried = [follower.planned, *(np.array(moves[i]) for i in self.rng.permutation(len(moves))[:_TRIED])]
        worst, chosen = np.inf, follower.planned
        for move in tried:
            follower.do(move)
            now = observe(core.memory, self._ahead(scene), core.procedure.config)
            if now.memory.watch.breaking.any() or now.memory.stored is None:  # type: ignore[union-attr]
                continue
            margin = left_of(now, inputs)[0]
            # Where no move does harm, it wanders, and comes to where one does.
            if margin < worst - 1e-9 or (chosen is tried[0] and margin <= worst and self.rng.random() < _WANDERS):
                worst, chosen = margin, move
        follower.do(chosen)


def spoil(env: ShieldedEnv, seed: int) -> None:
    """Put a follower across the ego's lane and up to three others around it, in the place of whoever is there, and the
    ego anywhere across its lane. One frame has to last one decision, with throttle and steering."""
    base: Any = env.unwrapped
    ego, road, rng = base.vehicle, base.road, np.random.default_rng([seed, 11])
    dt, v = 1 / base.config["simulation_frequency"], float(rng.uniform(8, 35))
    middle, across = LANE * ego.lane_index[2], float(rng.uniform(-1, 1))
    ego.position, ego.heading, ego.speed = np.array([300.0, middle + across]), 0.0, v
    ego.on_state_update()
    places = [(300.0 - rng.uniform(9, 50), middle + rng.uniform(-1.9, 1.9), v + rng.uniform(-8, 12))]
    for _ in range(rng.integers(4)):
        lane = LANE * float(rng.integers(base.config["lanes_count"]))
        places.append((300.0 + rng.uniform(-60, 60), lane, max(v + rng.uniform(-10, 10), 0.0)))
    puppets: list[Any] = []
    for x, y, speed in places:
        if all(abs(x - b.position[0]) > 9.5 or abs(y - b.position[1]) > 2.7 for b in (ego, *puppets)):
            puppet = _Puppet(road, [x, y], 0.0, max(speed, 0.0))
            puppet.take(rng, ego, dt, base.config["lanes_count"])
            puppet.check_collisions = False
            puppets.append(puppet)
    road.vehicles = [ego, *puppets]
    env.filter.reset()
    stage = _Spoiler(env, puppets)
    stage.rng = rng
