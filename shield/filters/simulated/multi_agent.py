"""The filter for several egos: each has a plan, and the plans are verified together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import deepcopy
from time import perf_counter
from typing import Any

import numpy as np
from highway_env.envs.common.action import DiscreteMetaAction, MultiAgentAction

from dynamics.highway_simulator.layout import ALLY, EGO, KIND
from dynamics.road_networks.geometry.layout import FRAMES
from dynamics.road_networks.simulation.supported_traffic import check_network, on_network
from dynamics.scenes.parking_lot import is_parking_lot
from shield.batch.arrays import empty_records
from shield.batch.codes import REASONS
from shield.certificate.simulated.decision_kernels import (
    StoredSequences,
    empty_plans,
    last_resort,
    replace,
    try_proposal,
)
from shield.certificate.simulated.search import simulate_action
from shield.certificate.simulated.workspace import LaneSpeedTarget
from shield.config import ShieldConfig
from shield.decision import Decision, Reason
from shield.environments import check_configuration
from shield.errors import ConfigError
from shield.explaining.simulated import copy_of
from shield.filters.discrete_action import action_index
from shield.filters.simulated.meta_actions import as_decision
from shield.filters.simulated.predicted_scene import (
    STATE,
    LoadedSearch,
    PredictedScene,
    PredictingFilter,
    scene_failure,
    simulate_network,
)
from shield.pipelines.screen import slower
from shield.supported_environments import check

__all__ = ["MultiAgentFilter", "is_multi_agent"]


def is_multi_agent(base: Any) -> bool:
    """Whether an environment, unwrapped, has several egos."""
    return isinstance(getattr(base, "action_type", None), MultiAgentAction)


class MultiAgentFilter(PredictingFilter):
    """Filters the meta-actions of several egos in simulated traffic.

    Each ego has a plan, and all plans together keep every ego's buffer. The proposals are verified one after the other:
    the earlier egos execute what was chosen for them, the later ones follow their plans. So there is a verified plan
    for every ego after each choice, if there was one before.

    Parameters
    ----------
    base : highway-env's environment, unwrapped, with `MultiAgentAction`.
    config : settings with `Assumptions.simulated_traffic()`.

    Raises
    ------
    ConfigError
        If the egos' actions are not meta-actions, the simulator does not support the environment, or the settings are
        for another kind of verification.

    Attributes
    ----------
    cause : why the scene of the last decision could not be read; "" if it could.
    """

    supervising = False

    def __init__(self, base: Any, config: ShieldConfig) -> None:
        # First the refusals that no other setting remedies; otherwise a message would suggest these settings.
        if not on_network(base) or is_parking_lot(base):
            raise ConfigError(
                f"several egos are shielded on networks of roads, such as intersection-multi-agent-v2, not in "
                f"{type(base).__name__}"
            )
        check_network(base)
        kinds = {type(each) for each in base.action_type.agents_action_types}
        if kinds - {DiscreteMetaAction}:
            names = ", ".join(sorted(kind.__name__ for kind in kinds))
            instead = _with_meta_actions(base)
            raise ConfigError(f"the shield of several egos filters DiscreteMetaAction; here they have {names}{instead}")
        check_configuration(base, config)
        if not config.assumptions.simulated:
            raise ConfigError(
                "several egos are verified by simulation: ShieldedEnv(env, ShieldConfig.simulated_traffic())"
            )
        check(config)
        self.config, self._base = config, base
        self._scene = PredictedScene(base, config, simulate_network, self._verifies)
        self.cause = ""
        self.reset()

    @property
    def agents(self) -> int:
        """Number of egos."""
        return len(self._base.controlled_vehicles)

    def reset(self) -> None:
        """Clear everything about the episode.

        Raises
        ------
        ConfigError
            If the environment's present configuration is not supported.
        """
        check_configuration(self._base, self.config)
        check_network(self._base)
        self._scene.forget()
        self._plans: list[StoredSequences] = [empty_plans(1, 1) for _ in range(self.agents)]

    def decide(self, actions: Sequence[Any]) -> list[Decision]:
        """Filter the meta-actions of all egos.

        Parameters
        ----------
        actions : one for each.

        Raises
        ------
        ConfigError
            If their number differs from that of the egos.
        """
        given: Any = actions
        rows: list[Any] = list(given) if np.iterable(given) else [given]
        if len(rows) != self.agents or not np.iterable(given):
            raise ConfigError(f"there are {self.agents} egos and {len(rows)} actions; pass a tuple with one for each")
        start, self.cause = perf_counter(), ""
        try:
            simulator, search = self._scene.read()
        except Exception as error:
            reason, self.cause = scene_failure(error)
            return self._last_resort(actions, reason, start)
        for k, plans in enumerate(self._plans):
            if len(plans.actions[0]) != search.bounds.depth:
                self._plans[k] = empty_plans(1, search.bounds.depth)
            elif self._scene.mismatched:
                plans.length[0] = 0
        decisions = self._one_by_one(actions, self._base, (simulator, search), self._plans, start)
        simulate_action(search, 0, 1, int(decisions[-1].executed), LaneSpeedTarget(0.0, 0.0, 0.0), -math.inf)
        self._scene.expect(search.futures.f[1][STATE])
        return decisions

    def _one_by_one(
        self, actions: Sequence[Any], base: Any, loaded: LoadedSearch, remembered: list[StoredSequences], start: float
    ) -> list[Decision]:
        """Decide for one ego after the other in the scene of `base`. Updates `remembered`, the egos' plans."""
        simulator, search = loaded
        depth, slowest = search.bounds.depth, int(search.order[0])
        wanted = np.full((self.agents, depth + 1), slowest, np.intp)
        for k, plans in enumerate(remembered):
            wanted[k, : plans.length[0]] = plans.actions[0, : plans.length[0]]
        columns = np.array([base.road.vehicles.index(vehicle) for vehicle in base.controlled_vehicles], np.intp)
        g, decisions = simulator.worlds.g[0], []
        search.other_egos.since[0] = g[FRAMES, 0]
        for k, action in enumerate(actions):
            others = [i for i in range(self.agents) if i != k]
            search.other_egos.columns[:], search.other_egos.plans[:] = columns[others], wanted[others]
            g[KIND, columns] = ALLY
            g[KIND, columns[k]] = EGO
            decisions.append(self._of_one(action, loaded, remembered[k], start))
            plans, start = remembered[k], perf_counter()
            wanted[k] = slowest
            wanted[k, 0] = decisions[-1].executed
            wanted[k, 1 : 1 + plans.length[0]] = plans.actions[0, : plans.length[0]]
        return decisions

    def _of_one(self, action: Any, loaded: LoadedSearch, plans: StoredSequences, start: float) -> Decision:
        """Decide for one ego."""
        proposed, records = action_index(action), empty_records(1, 1)
        (simulator, search), source = loaded, None
        if not try_proposal(search, plans, records, simulator.worlds, 0, proposed):
            other_egos = (
                search.other_egos.columns.copy(),
                search.other_egos.plans.copy(),
                int(search.other_egos.since[0]),
            )
            planned = plans.actions[0], plans.length[0]
            source = self._scene.kept(search, copy_of(simulator.worlds), proposed, *planned, other_egos)
            replace(search, plans, records, 0, proposed, np.array([-1], np.intp))
        return as_decision(action if proposed < 0 else proposed, records, start, source=source)

    def _verifies(self, base: Any, loaded: LoadedSearch) -> bool:
        """Whether some sequences of actions of all egos verify in a scene. Read-only."""
        depth, slowest = loaded[1].bounds.depth, int(loaded[1].order[0])
        alike = all(len(plans.actions[0]) == depth and plans.verified[0] for plans in self._plans)
        plans = deepcopy(self._plans) if alike else [empty_plans(1, depth) for _ in self._plans]
        decisions = self._one_by_one([slowest] * self.agents, base, loaded, plans, perf_counter())
        return all(decision.tier.verified for decision in decisions)

    def _last_resort(self, actions: Sequence[Any], reason: Reason, start: float) -> list[Decision]:
        """Decisions without a readable scene: the stored plans, or SLOWER."""
        self._scene.expect_nothing()
        slowest, decisions = slower(list(self._base.action_type.agents_action_types[0].actions_indexes)), []
        for plans, action in zip(self._plans, actions, strict=True):
            records, proposed = empty_records(1, 1), action_index(action)
            last_resort(records, plans, 0, slowest, REASONS.index(reason))
            decisions.append(as_decision(action if proposed < 0 else proposed, records, start))
        return decisions


def _with_meta_actions(base: Any) -> str:
    """Advice on how to give the egos meta-actions; "" where highway-env or the shield refuses these.

    Parameters
    ----------
    base : highway-env's environment, unwrapped. The check makes another one of its class.
    """
    action = {"type": "MultiAgentAction", "action_config": {"type": "DiscreteMetaAction"}}
    try:
        MultiAgentFilter(type(base)(config={**base.config, "action": action}), ShieldConfig.simulated_traffic())
    except Exception:
        # An error of this check must not hide the message that it is for.
        return ""
    return (
        '. Pass config={"action": {"type": "MultiAgentAction", "action_config": {"type": "DiscreteMetaAction"}}} to '
        "gym.make, and ShieldConfig.simulated_traffic() to ShieldedEnv"
    )
