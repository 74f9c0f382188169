"""The door for meta-actions that are verified by simulation: what `Shield` runs with `Assumptions.exact()`."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from functools import cache
from time import perf_counter
from typing import Any

import gymnasium as gym
import numpy as np

from dynamics.errors import SceneError
from dynamics.networks.refusals import check_network, on_network
from dynamics.networks.simulator import NetworkSimulator
from dynamics.simulator.env import CompiledHighwayEnv
from dynamics.simulator.layout import HEADING, SPEED, X, Y
from dynamics.simulator.scenario import scenario_of
from dynamics.simulator.simulator import Simulator
from dynamics.state import FloatArray
from shield.batch.arrays import Records, empty_records
from shield.batch.vocabulary import REASONS, TIERS
from shield.config import ShieldConfig
from shield.decision import Decision, Reason
from shield.doors.discrete_action import action_index
from shield.errors import ConfigError
from shield.exact.deciding import Plans, empty_plans, last_resort, passes, replace
from shield.exact.room import Search, new_search
from shield.exact.search import foretell, leap
from shield.procedures.screen import slower
from shield.procedures.warm_up import announced
from shield.refusals import check
from shield.repair.order import resolve

__all__ = ["ExactDoor", "warm_up_exact"]

_log = logging.getLogger(__name__)
Room = tuple[Simulator | NetworkSimulator, Search]
_STATE = [X, Y, HEADING, SPEED]
_SAME = 1e-6
"""A vehicle has done what was foretold of it within this [m, rad, m/s]; where numpy's own sums cannot be had they
differ by some 1e-12."""
_ELSEWHERE = 10.0
"""No vehicle strays so far from what was foretold of a decision [m]."""


class ExactDoor:
    """Filters meta-actions where the traffic, of known classes, follows from its state: on straight highways, and on
    the networks of merges, exits, roundabouts, two-way roads, u-turns and intersections (where nobody knows
    who comes next).

    Parameters
    ----------
    base : the environment, unwrapped: highway-env's own, or a `CompiledHighwayEnv`.
    config : settings with `Assumptions.exact()`.

    Raises
    ------
    ConfigError
        If the simulator cannot run the environment, or the settings are for another kind of verification.

    Attributes
    ----------
    violations : vehicles that have done something else than what was foretold, counted at each decision.
    cause : why the scene of the last decision could not be read, "" where it could.
    """

    supervising = False

    def __init__(self, base: Any, config: ShieldConfig) -> None:
        check(config)
        self.config, self._base = config, base
        if not isinstance(base, CompiledHighwayEnv):
            if on_network(base):
                check_network(base)
            elif base.spec is None:
                raise ConfigError("the environment has no id; make it with gym.make")
            else:
                scenario_of(base.spec.id, base.config)
        self.violations, self.cause = 0, ""
        self.reset()

    def reset(self) -> None:
        """Forget everything about the episode."""
        self._rooms: dict[int, Room] = {}
        self._search: Search | None = None
        self._plans: Plans = empty_plans(1, 1)
        self._foretold: FloatArray = np.zeros((len(_STATE), 0))
        self._foretold_of: dict[Any, int] = {}

    def decide(self, action: Any, order: Callable[[], list[int] | None] | None = None) -> Decision:
        """Filter one meta-action; `order` gives the policy's order of preference over the others."""
        start, proposed, self.cause = perf_counter(), action_index(action), ""
        shown = action if proposed < 0 else proposed
        reason: Reason | None = None
        try:
            simulator = self._now()
        except (SceneError, ConfigError) as error:
            reason, self.cause = Reason.BAD_SCENE, str(error)
        except Exception as error:
            _log.exception("the scene could not be read; the last resort acts")
            reason, self.cause = Reason.STAGE_FAILED, f"{type(error).__name__}: {error}"
        records = empty_records(1, 1)
        if reason is not None:
            self._foretold_of = {}
            slowest = slower(list(self._base.action_type.actions_indexes))
            last_resort(records, self._plans, 0, slowest, REASONS.index(reason))
            return _decision(shown, records, start)
        search = self._search
        assert search is not None
        self._compare(simulator)
        if not passes(search, self._plans, records, simulator.worlds, 0, proposed):
            # The policy is asked for its order only where something takes the proposal's place.
            wanted = resolve(order) or []
            ranked = np.array([*(a for a in wanted if a != proposed), -1], np.intp)
            replace(search, self._plans, records, 0, proposed, ranked)
        leap(search, 0, 1, int(records.executed[0]), 0.0, -math.inf)
        self._foretold, self._foretold_of = search.futures.f[1][_STATE].copy(), self._bodies()
        plan, areas = self._shown(search) if self.config.record else (None, None)
        return _decision(shown, records, start, plan, areas)

    def _shown(self, search: Search) -> tuple[FloatArray, FloatArray]:
        """What is foretold of the ego, (frames + 1, 4) x, y [m], heading [rad], speed [m/s], and the boxes around the
        others, (frames + 1, others, 4) x_min, x_max, y_min, y_max [m]."""
        n = int(self._plans.length[0]) + 1
        rows = np.zeros((n * search.rules.numbers[0] + 1, search.futures.f.shape[2], 7))
        rows = rows[: foretell(search, search.plan, n, rows)]
        ego = self._ego(self._foretold_of)
        others = np.delete(rows, ego, axis=1)
        cos, sin = np.abs(np.cos(others[..., 2])), np.abs(np.sin(others[..., 2]))
        half = np.stack([others[..., 4] * cos + others[..., 5] * sin, others[..., 4] * sin + others[..., 5] * cos]) / 2
        x, y = others[..., 0], others[..., 1]
        return rows[:, ego, :4], np.stack([x - half[0], x + half[0], y - half[1], y + half[1]], axis=-1)

    def _now(self) -> Simulator | NetworkSimulator:
        """The traffic as it is, and room for searches in it."""
        base = self._base
        if isinstance(base, CompiledHighwayEnv):
            simulator, search = self._rooms.get(0) or self._furnish(0, base.simulator)
        else:
            bodies = 0 if base.road is None else len(base.road.vehicles) + len(base.road.objects)
            room = self._rooms.get(bodies)
            if room is None or not room[0].fits(base):
                room = self._furnish(bodies, NetworkSimulator(base) if on_network(base) else Simulator.of(base))
            else:
                room[0].load(base)
            simulator, search = room
        self._search = search
        return simulator

    def _furnish(self, bodies: int, simulator: Simulator | NetworkSimulator) -> Room:
        """Room for so many bodies: where vehicles come and go, their number changes back and forth."""
        search = new_search(simulator, self.config)
        if len(self._plans.actions[0]) != search.bounds.depth:
            self._plans = empty_plans(1, search.bounds.depth)
        self._rooms[bodies] = simulator, search
        return simulator, search

    def _bodies(self) -> dict[Any, int]:
        """The columns of the scene, by what they stand for."""
        base = self._base
        if isinstance(base, CompiledHighwayEnv):
            return {k: k for k in range(base.simulator.worlds.f.shape[2])}
        return {body: k for k, body in enumerate([*base.road.vehicles, *base.road.objects])}

    def _ego(self, bodies: dict[Any, int]) -> int:
        """The column of the ego among `_bodies`."""
        return 0 if isinstance(self._base, CompiledHighwayEnv) else bodies[self._base.vehicle]

    def _compare(self, simulator: Simulator | NetworkSimulator) -> None:
        """Count the vehicles that have done something else than was foretold, as long as the ego has not: of those who
        were there then and are there now. Who is somewhere else altogether has been put there: another newcomer."""
        bodies, before = self._bodies(), self._foretold_of
        columns = np.array([(k, before[body]) for body, k in bodies.items() if body in before], np.intp).reshape(-1, 2)
        now, foretold = simulator.worlds.f[0][_STATE][:, columns[:, 0]], self._foretold[:, columns[:, 1]]
        there = np.hypot(*(now - foretold)[:2]) <= _ELSEWHERE
        other = there & ~(np.abs(now - foretold) <= _SAME).all(axis=0)
        if other.any():
            self._plans.length[0] = 0
        ego = self._ego(bodies)
        if not other[columns[:, 0] == ego].any():
            self.violations += int(other.sum())


@cache
def warm_up_exact(network: bool) -> None:
    """What `warm_up` does for the other doors, on a straight highway or on a network of roads."""
    with announced(30):
        env = gym.make("u-turn-v1") if network else gym.make("highway-fast-v0", config={"vehicles_count": 3})
        env.reset(seed=0)
        door, nothing = ExactDoor(env.unwrapped, ShieldConfig.exact()), np.full(1, -1, np.intp)
        door.decide(1)
        assert door._search is not None
        records = empty_records(1, 1)
        replace(door._search, door._plans, records, 0, 1, nothing)
        last_resort(records, door._plans, 0, 4, records.reason[0])


def _decision(
    shown: Any,
    records: Records,
    start: float,
    plan: FloatArray | None = None,
    areas: FloatArray | None = None,
) -> Decision:
    """What the records say of the first environment, as a decision that began at `start`."""
    reason, tier = REASONS[records.reason[0]], TIERS[records.tier[0]]
    return Decision(
        shown, int(records.executed[0]), reason, tier, float(records.margin[0]), perf_counter() - start, plan, areas
    )
