"""The filter for meta-actions in simulated traffic."""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import deepcopy
from time import perf_counter
from typing import Any

import numpy as np

from dynamics.highway_simulator.env import CompiledHighwayEnv
from dynamics.highway_simulator.simulator import Simulator
from dynamics.road_networks.simulation.simulator import NetworkSimulator
from dynamics.road_networks.simulation.supported_traffic import on_network
from dynamics.state import FloatArray
from shield.alternatives.preference import resolve
from shield.batch.arrays import BatchRecords, empty_records
from shield.batch.codes import REASONS, TIERS
from shield.certificate.simulated.decision_kernels import (
    StoredSequences,
    empty_plans,
    has_no_certificate,
    last_resort,
    replace,
    try_proposal,
    verify,
)
from shield.certificate.simulated.node_budget import reset_budget
from shield.certificate.simulated.search import set_root_scene, simulate_action
from shield.certificate.simulated.workspace import LaneSpeedTarget, TrafficSearch
from shield.config import ShieldConfig
from shield.decision import Decision, Reason, Source
from shield.environments import check_configuration, refuse_parking_lots
from shield.explaining.simulated import SimulatedDecisionData, copy_of
from shield.filters.discrete_action import action_index
from shield.filters.simulated.predicted_scene import (
    STATE,
    LoadedSearch,
    PredictedScene,
    PredictingFilter,
    check_traffic,
    scene_failure,
    simulate_network,
)
from shield.pipelines.screen import slower
from shield.supported_environments import check

__all__ = ["SimulatedMetaActionFilter", "as_decision"]


class SimulatedMetaActionFilter(PredictingFilter):
    """Filters meta-actions where the traffic consists of known classes and follows from its state.

    It supports straight highways and the networks of merges, exits, roundabouts, two-way roads, u-turns and
    intersections. (At an intersection it does not predict the vehicles that will spawn.)

    Parameters
    ----------
    base : the environment, unwrapped: highway-env's own, or a `CompiledHighwayEnv`.
    config : settings with `Assumptions.simulated_traffic()`.

    Raises
    ------
    ConfigError
        If the simulator does not support the environment, it is a parking lot, or the settings are for another kind of
        verification.

    Attributes
    ----------
    on_network : whether the road is not a straight highway.
    cause : why the scene of the last decision could not be read; "" if it could.
    """

    supervising = False

    def __init__(self, base: Any, config: ShieldConfig) -> None:
        refuse_parking_lots([base])
        check(config)
        self.config, self._base = config, base
        self.on_network = not isinstance(base, CompiledHighwayEnv) and on_network(base)
        self._check()
        self._scene = PredictedScene(base, config, _simulate, self._verifies)
        self.cause = ""
        self._plans: StoredSequences = empty_plans(1, 1)
        self._search: TrafficSearch | None = None

    def reset(self) -> None:
        """Clear everything about the episode.

        Raises
        ------
        ConfigError
            If the environment's present configuration is not supported.
        """
        self._check()
        self._scene.forget()
        self._plans = empty_plans(1, 1)
        self._search = None

    def _check(self) -> None:
        """Raise unless the environment's present configuration can be simulated."""
        check_configuration(self._base, self.config)
        check_traffic(self._base)

    def decide(self, action: Any, order: Callable[[], list[int] | None] | None = None) -> Decision:
        """Filter one meta-action; `order` returns the policy's order of preference over the others."""
        start, proposed, self.cause = perf_counter(), action_index(action), ""
        shown = action if proposed < 0 else proposed
        reason: Reason | None = None
        try:
            simulator, search = self._read()
        except Exception as error:
            reason, self.cause = scene_failure(error)
        records = empty_records(1, 1)
        if reason is not None:
            self._scene.expect_nothing()
            slowest = slower(list(self._base.action_type.actions_indexes))
            last_resort(records, self._plans, 0, slowest, REASONS.index(reason))
            return as_decision(shown, records, start)
        source = None
        if not try_proposal(search, self._plans, records, simulator.worlds, 0, proposed):
            source = self._kept(search, simulator, proposed)
            # The policy's order is computed only if another action may replace the proposal.
            wanted = resolve(order) or []
            ranked = np.array([*(a for a in wanted if a != proposed), -1], np.intp)
            replace(search, self._plans, records, 0, proposed, ranked)
        simulate_action(search, 0, 1, int(records.executed[0]), LaneSpeedTarget(0.0, 0.0, 0.0), -math.inf)
        self._scene.expect(search.futures.f[1][STATE])
        plan, areas = None, None
        if self.config.record:
            plan, areas = self._scene.shown(search, search.plan, int(self._plans.length[0]) + 1)
        return as_decision(shown, records, start, plan, areas, source)

    def _kept(self, search: TrafficSearch, simulator: Any, proposed: int) -> SimulatedDecisionData:
        """Data for an explanation of a refusal."""
        return self._scene.kept(
            search, copy_of(simulator.worlds), proposed, self._plans.actions[0], self._plans.length[0]
        )

    def _verifies(self, base: Any, loaded: LoadedSearch) -> bool:
        """Whether any sequence of actions verifies in a scene. Read-only."""
        simulator, search = loaded
        plans, records = empty_plans(1, search.bounds.depth), empty_records(1, 1)
        if len(self._plans.actions[0]) == search.bounds.depth and self._plans.verified[0]:
            plans = deepcopy(self._plans)
        slowest = int(search.order[0])
        if not try_proposal(search, plans, records, simulator.worlds, 0, slowest):
            replace(search, plans, records, 0, slowest, np.full(1, -1, np.intp))
        return bool(TIERS[records.tier[0]].verified)

    def mask(self) -> np.ndarray[Any, Any]:
        """Mask of actions that verify; all True if none does. Read-only: changes no memory, record or later decision.

        Raises
        ------
        SceneError, ConfigError
            If the traffic cannot be simulated.
        """
        simulator, search = self._read(counting=False)
        set_root_scene(search, simulator.worlds, 0)
        plans, actions = self._plans, range(len(search.order))
        twice, stored, length = not has_no_certificate(plans, 0), plans.actions[0], plans.length[0]
        mask = np.zeros(len(search.order), np.bool_)
        for k in actions:
            # Clear the dead-end table: `decide` starts without entries of an earlier search.
            reset_budget(search)
            mask[k] = verify(search, k, stored, length, twice) >= 0
        return mask if mask.any() else np.ones_like(mask)

    def source(self, proposed: int) -> SimulatedDecisionData:
        """Data for an explanation of a refusal of `proposed` in the present scene.

        Raises
        ------
        SceneError, ConfigError
            If the traffic cannot be simulated.
        """
        simulator, search = self._read(counting=False)
        return self._kept(search, simulator, proposed)

    def rehearse(self) -> None:
        """Make a decision and call the kernels of the fallback, so that all are compiled."""
        self.decide(1)
        assert self._search is not None
        records = empty_records(1, 1)
        replace(self._search, self._plans, records, 0, 1, np.full(1, -1, np.intp))
        last_resort(records, self._plans, 0, 4, records.reason[0])

    def _read(self, counting: bool = True) -> LoadedSearch:
        """The present traffic, and search buffers for it. The stored plan is kept if the scene is as predicted."""
        simulator, search = self._scene.read(counting)
        if self._scene.mismatched:
            self._plans.length[0] = 0
        if len(self._plans.actions[0]) != search.bounds.depth:
            self._plans = empty_plans(1, search.bounds.depth)
        self._search = search
        return simulator, search


def _simulate(base: Any, like: Any) -> Simulator | NetworkSimulator:
    return simulate_network(base, like) if on_network(base) else Simulator.of(base, observes=False)


def as_decision(
    shown: Any,
    records: BatchRecords,
    start: float,
    plan: FloatArray | None = None,
    areas: FloatArray | None = None,
    source: Source | None = None,
) -> Decision:
    """Decision of the first environment in `records`; its computation began at `start` [s]."""
    reason, tier = REASONS[records.reason[0]], TIERS[records.tier[0]]
    margin, latency = float(records.margin[0]), perf_counter() - start
    return Decision(shown, int(records.executed[0]), reason, tier, margin, latency, plan, areas, source=source)
