"""The door for several egos: each has a plan, and counts on the others' plans."""

from __future__ import annotations

import math
from collections.abc import Sequence
from time import perf_counter
from typing import Any

import numpy as np
from highway_env.envs.common.action import DiscreteMetaAction, MultiAgentAction

from dynamics.networks.layout import FRAMES
from dynamics.networks.refusals import check_network, on_network
from dynamics.scenes.parking_lot import is_lot
from dynamics.simulator.layout import ALLY, EGO, KIND
from shield.batch.arrays import empty_records
from shield.batch.vocabulary import REASONS
from shield.config import ShieldConfig
from shield.decision import Decision, Reason
from shield.doors.discrete_action import action_index
from shield.doors.environments import check_configuration
from shield.doors.simulated.exact_door import as_decision
from shield.doors.simulated.exact_scene import STATE, ExactScene, Foretells, simulate_network, why_unread
from shield.errors import ConfigError
from shield.exact.deciding import Plans, empty_plans, last_resort, passes, replace
from shield.exact.room import Search, Wish
from shield.exact.search import leap
from shield.explaining.simulated import copy_of
from shield.procedures.screen import slower
from shield.refusals import check

__all__ = ["TeamDoor", "is_team"]


def is_team(base: Any) -> bool:
    """Whether an environment, unwrapped, has several egos."""
    return isinstance(getattr(base, "action_type", None), MultiAgentAction)


class TeamDoor(Foretells):
    """Filters the meta-actions of several egos, where the traffic follows from its state.

    There is a plan for each of them, and all plans together keep everybody's buffer. One ego after the other is asked
    what it wants: what it gets is verified with those before it doing what they have been given, and those after it
    what is planned for them. So whatever it gets, there is a plan for everybody, as there was before.

    Parameters
    ----------
    base : highway-env's environment, unwrapped, with `MultiAgentAction`.
    config : settings with `Assumptions.exact()`.

    Raises
    ------
    ConfigError
        If the egos' actions are not meta-actions, the simulator cannot run the environment, or the settings are for
        another kind of verification.

    Attributes
    ----------
    cause : why the scene of the last decision could not be read, "" where it could.
    """

    supervising = False

    def __init__(self, base: Any, config: ShieldConfig) -> None:
        # What other settings do not mend comes first: they would be named as the remedy otherwise.
        if not on_network(base) or is_lot(base):
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
            raise ConfigError("several egos are verified by simulation: ShieldedEnv(env, ShieldConfig.exact())")
        check(config)
        self.config, self._base = config, base
        self._scene = ExactScene(base, config, simulate_network)
        self.cause = ""
        self.reset()

    @property
    def agents(self) -> int:
        """How many egos there are."""
        return len(self._base.controlled_vehicles)

    def reset(self) -> None:
        """Forget everything about the episode.

        Raises
        ------
        ConfigError
            If the environment is now configured as the shield does not support.
        """
        check_configuration(self._base, self.config)
        check_network(self._base)
        self._scene.forget()
        self._plans: list[Plans] = [empty_plans(1, 1) for _ in range(self.agents)]

    def decide(self, actions: Sequence[Any]) -> list[Decision]:
        """Filter the meta-actions of all egos.

        Parameters
        ----------
        actions : one for each.

        Raises
        ------
        ConfigError
            If there are more or fewer.
        """
        given: Any = actions
        rows: list[Any] = list(given) if np.iterable(given) else [given]
        if len(rows) != self.agents or not np.iterable(given):
            raise ConfigError(f"there are {self.agents} egos and {len(rows)} actions; have a tuple of one for each")
        start, self.cause = perf_counter(), ""
        try:
            simulator, search = self._scene.read()
        except Exception as error:
            reason, self.cause = why_unread(error)
            return self._last_resort(actions, reason, start)
        depth, slowest = search.bounds.depth, int(search.order[0])
        for k, plans in enumerate(self._plans):
            if len(plans.actions[0]) != depth:
                self._plans[k] = empty_plans(1, depth)
            elif self._scene.surprised:
                plans.length[0] = 0
        wanted = np.full((self.agents, depth + 1), slowest, np.intp)
        for k, plans in enumerate(self._plans):
            wanted[k, : plans.length[0]] = plans.actions[0, : plans.length[0]]
        columns = self._columns()
        g, decisions = simulator.worlds.g[0], []
        search.team.since[0] = g[FRAMES, 0]
        for k, action in enumerate(actions):
            others = [i for i in range(self.agents) if i != k]
            search.team.columns[:], search.team.plans[:] = columns[others], wanted[others]
            g[KIND, columns] = ALLY
            g[KIND, columns[k]] = EGO
            decisions.append(self._of_one(k, action, simulator, search, start))
            plans, start = self._plans[k], perf_counter()
            wanted[k] = slowest
            wanted[k, 0] = decisions[-1].executed
            wanted[k, 1 : 1 + plans.length[0]] = plans.actions[0, : plans.length[0]]
        leap(search, 0, 1, int(decisions[-1].executed), Wish(0.0, 0.0, 0.0), -math.inf)
        self._scene.expect(search.futures.f[1][STATE])
        return decisions

    def _of_one(self, k: int, action: Any, simulator: Any, search: Search, start: float) -> Decision:
        proposed, records = action_index(action), empty_records(1, 1)
        source = None
        if not passes(search, self._plans[k], records, simulator.worlds, 0, proposed):
            team = search.team.columns.copy(), search.team.plans.copy(), int(search.team.since[0])
            planned = self._plans[k].actions[0], self._plans[k].length[0]
            source = self._scene.kept(search, copy_of(simulator.worlds), proposed, *planned, team)
            replace(search, self._plans[k], records, 0, proposed, np.array([-1], np.intp))
        return as_decision(action if proposed < 0 else proposed, records, start, source=source)

    def _columns(self) -> Any:
        bodies = self._scene.bodies()
        return np.array([bodies[vehicle] for vehicle in self._base.controlled_vehicles], np.intp)

    def _last_resort(self, actions: Sequence[Any], reason: Reason, start: float) -> list[Decision]:
        self._scene.expect_nothing()
        slowest, decisions = slower(list(self._base.action_type.agents_action_types[0].actions_indexes)), []
        for plans, action in zip(self._plans, actions, strict=True):
            records, proposed = empty_records(1, 1), action_index(action)
            last_resort(records, plans, 0, slowest, REASONS.index(reason))
            decisions.append(as_decision(action if proposed < 0 else proposed, records, start))
        return decisions


def _with_meta_actions(base: Any) -> str:
    """What gives the egos meta-actions that are filtered, in words; "" where highway-env or the shield refuses them.

    Parameters
    ----------
    base : highway-env's environment, unwrapped. Another of its class is made.
    """
    action = {"type": "MultiAgentAction", "action_config": {"type": "DiscreteMetaAction"}}
    try:
        TeamDoor(type(base)(config={**base.config, "action": action}), ShieldConfig.exact())
    except Exception:
        # Whatever it is, it must not hide what is told.
        return ""
    return (
        '. Pass config={"action": {"type": "MultiAgentAction", "action_config": {"type": "DiscreteMetaAction"}}} to '
        "gym.make, and ShieldConfig.exact() to ShieldedEnv"
    )
