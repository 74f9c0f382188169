"""What is foretold of one environment's traffic, and whether it comes about."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any

import numpy as np
from highway_env.envs.common.action import ContinuousAction

from dynamics.errors import ConfigError, SceneError
from dynamics.highway_simulator.env import CompiledHighwayEnv
from dynamics.highway_simulator.layout import HEADING, LENGTH, SPEED, WIDTH, X, Y
from dynamics.highway_simulator.own_methods import check_moves
from dynamics.highway_simulator.scenario import scenario_of_live
from dynamics.highway_simulator.simulator import Simulator
from dynamics.road_networks.geometry.network import index_of
from dynamics.road_networks.simulation.simulator import NetworkSimulator
from dynamics.road_networks.simulation.supported_traffic import check_network, on_network
from dynamics.state import FloatArray, IntArray
from shield.certificate.network.monitor import Breach
from shield.certificate.simulated.search import foretell
from shield.certificate.simulated.workspace import Search, new_search
from shield.config import ShieldConfig
from shield.decision import Reason
from shield.explaining.simulated import Simulated
from shield.filters.discrete_action import action_labels
from shield.filters.simulated.newcomers import blocking, unannounced

__all__ = ["STATE", "ExactScene", "Foretells", "Room", "check_traffic", "simulate_network", "why_unread"]

_log = logging.getLogger(__name__)

Room = tuple[Simulator | NetworkSimulator, Search]
"""A simulator of the scene as it is, and room for searches in it."""
STATE = [X, Y, HEADING, SPEED]
"""Rows of the arrays that are foretold."""
_SIZE = [LENGTH, WIDTH]
_SAME = 1e-6
"""A vehicle has done what was foretold of it within this [m, rad, m/s]; where numpy's own sums cannot be had they
differ by some 1e-12."""
_ELSEWHERE = 100.0
"""No vehicle strays so far from what was foretold of a decision [m]."""


def why_unread(error: Exception) -> tuple[Reason, str]:
    """The reason and the cause that a record gets where reading the scene raised; what is nobody's fault is logged."""
    if isinstance(error, SceneError | ConfigError):
        return Reason.BAD_SCENE, str(error)
    _log.error("the scene could not be read; the last resort acts", exc_info=error)
    return Reason.STAGE_FAILED, f"{type(error).__name__}: {error}"


def check_traffic(base: Any) -> None:
    """Raise where the traffic of an environment, unwrapped, cannot be simulated.

    Raises
    ------
    ConfigError
        That says what moves it in another way.
    """
    if isinstance(base, CompiledHighwayEnv):
        return
    if on_network(base):
        check_network(base)
    elif isinstance(base.action_type, ContinuousAction):
        check_moves(base)
    else:
        scenario_of_live(base, observes=False)


def simulate_network(base: Any, like: Any, **options: Any) -> NetworkSimulator:
    """A simulator of a network of roads, for `ExactScene`; options as of `NetworkSimulator`."""
    return NetworkSimulator(base, like=like, **options)


class ExactScene:
    """The traffic of one environment in a simulator's arrays, with room for searches.

    Parameters
    ----------
    base : the environment, unwrapped: highway-env's own, or a `CompiledHighwayEnv`.
    config : settings with `Assumptions.simulated_traffic()`.
    simulate : makes a simulator of the environment as it is; it is handed one that it has made of the same road, or
        None.
    verifies : whether any sequence of actions verifies in a scene, of its environment and its room.

    Attributes
    ----------
    by_rule : offences by the rule that was broken, counted whenever the scene is read: "unforeseen" by a body that has
        done something else than what was foretold or has another size; "appeared" by one that was not there, and with
        which no sequence of actions verifies or an ego has crashed.
    surprised : whether the scene is another than was foretold.
    """

    def __init__(
        self,
        base: Any,
        config: ShieldConfig,
        simulate: Callable[[Any, Any], Simulator | NetworkSimulator],
        verifies: Callable[[Any, Room], bool],
    ) -> None:
        self._base, self._config, self._simulate, self._verifies = base, config, simulate, verifies
        self.by_rule: dict[str, int] = {}
        self._sizes: FloatArray = np.zeros((len(_SIZE), 0))
        self._rooms: dict[int, Room] = {}
        self.expect_nothing()

    @property
    def violations(self) -> int:
        """How many offences there have been."""
        return sum(self.by_rule.values())

    def forget(self) -> None:
        """Forget everything about the episode, and make room for the next. A scene that cannot be read is refused where
        it is asked for."""
        self.expect_nothing()
        if self._base.road is not None or isinstance(self._base, CompiledHighwayEnv):
            with suppress(SceneError, ConfigError):
                self.read()

    def expect_nothing(self) -> None:
        """Foretell nothing of what comes next."""
        self.surprised = False
        self._counted: set[Any] = set()
        self._foretold: FloatArray = np.zeros((len(STATE) + len(_SIZE), 0))
        self._foretold_of: dict[Any, int] = {}

    @property
    def foretells(self) -> bool:
        """Whether anything is foretold of what comes next."""
        return bool(self._foretold_of)

    def expect(self, states: FloatArray) -> None:
        """Foretell the next scene: `states` has the rows x, y [m], heading [rad] and speed [m/s] of its bodies. They
        keep the sizes that they had when the scene was read."""
        self._foretold, self._foretold_of = np.concatenate([states, self._sizes]), self.bodies()
        self._counted = set()

    def read(self, counting: bool = True) -> Room:
        """The scene as it is; `counting` those who have done something else than what was foretold.

        Raises
        ------
        SceneError, ConfigError
            If it cannot be simulated.
        """
        try:
            room = self._load()
        except (SceneError, ConfigError):
            if counting and self._base.road is not None:
                self._count(self._blocking(self._newcomers()), Breach.APPEARED)
            raise
        worlds = room[0].worlds
        self._sizes = worlds.p[0][_SIZE]
        others = self._compare(np.concatenate([worlds.f[0][STATE], self._sizes]))
        newcomers = self._newcomers()
        if counting:
            self._count(others, Breach.UNFORESEEN)
            self._count(self._blocking(newcomers), Breach.APPEARED)
        self.surprised = self.surprised or bool(newcomers)
        return room

    def _load(self) -> Room:
        base = self._base
        if isinstance(base, CompiledHighwayEnv):
            return self._rooms.get(0) or self._furnish(0, base.simulator)
        bodies = 0 if base.road is None else len(base.road.vehicles) + len(base.road.objects)
        known = self._rooms.get(bodies)
        if known is None or not known[0].fits(base):
            return self._furnish(bodies, self._simulate(base, self._of_this_road()))
        known[0].load(base)
        return known

    def look(self) -> None:
        """Count those who have done something else than what was foretold by the end of an episode, after which nothing
        is read."""
        if not self.foretells:
            return
        base, surprised = self._base, self.surprised
        if isinstance(base, CompiledHighwayEnv):
            worlds = base.simulator.worlds
            states = np.concatenate([worlds.f[0][STATE], worlds.p[0][_SIZE]])
        else:
            states = _states(self.bodies())
        self._count(self._compare(states), Breach.UNFORESEEN)
        self._count(self._blocking(self._newcomers()), Breach.APPEARED)
        self.surprised = surprised

    def _count(self, others: set[Any], rule: Breach) -> None:
        """Count each once for what was foretold."""
        new = others - self._counted
        if new:
            self.by_rule[rule.value] = self.by_rule.get(rule.value, 0) + len(new)
            self._counted |= new

    def _newcomers(self) -> set[Any]:
        """The bodies that were not foretold, and those that are somewhere else altogether: they have been put there."""
        if not self.foretells or isinstance(self._base, CompiledHighwayEnv):
            return set()
        known = [(body, self._foretold_of[body]) for body in self.bodies() if body in self._foretold_of]
        foretold = self._foretold[:2, [column for _, column in known]]
        far = np.hypot(*(np.array([body.position for body, _ in known]).T.reshape(2, -1) - foretold)) > _ELSEWHERE
        return unannounced(self._base, {body for (body, _), moved in zip(known, far, strict=True) if not moved})

    def _blocking(self, newcomers: set[Any]) -> set[Any]:
        """Those of them that leave the egos nothing that verifies, or have crashed with one."""
        return blocking(self._base, newcomers, self._verified_in)

    def _verified_in(self, base: Any) -> bool:
        """Whether any sequence of actions verifies in an environment, unwrapped; False where it is not simulated."""
        try:
            simulator = self._simulate(base, self._of_this_road())
        except (SceneError, ConfigError):
            return False
        return self._verifies(base, (simulator, new_search(simulator, self._config, self._allies())))

    def as_foretold(self) -> bool:
        """Whether everybody is where it was foretold, and nobody else has come; nothing is read but where they are."""
        bodies = self.bodies()
        if bodies.keys() != self._foretold_of.keys():
            return False
        return bool((np.abs(_states(bodies) - self._foretold) <= _SAME).all())

    def bodies(self) -> dict[Any, int]:
        """The columns of the scene, by what they stand for."""
        base = self._base
        if isinstance(base, CompiledHighwayEnv):
            return {k: k for k in range(base.simulator.worlds.f.shape[2])}
        return {body: k for k, body in enumerate([*base.road.vehicles, *base.road.objects])}

    def shown(self, search: Search, actions: IntArray, length: int) -> tuple[FloatArray, FloatArray]:
        """What is foretold if the ego carries out the first `length` actions from future 0 on: of the ego,
        (frames + 1, 4) x, y [m], heading [rad], speed [m/s], and the boxes around the others, (frames + 1, others, 4)
        x_min, x_max, y_min, y_max [m]."""
        rows = np.zeros((length * search.rules.numbers[0] + 1, search.futures.f.shape[2], 7))
        rows = rows[: foretell(search, actions, length, rows)]
        ego = self.ego(self._foretold_of)
        others = np.delete(rows, ego, axis=1)
        cos, sin = np.abs(np.cos(others[..., 2])), np.abs(np.sin(others[..., 2]))
        half = np.stack([others[..., 4] * cos + others[..., 5] * sin, others[..., 4] * sin + others[..., 5] * cos]) / 2
        x, y = others[..., 0], others[..., 1]
        return rows[:, ego, :4], np.stack([x - half[0], x + half[0], y - half[1], y + half[1]], axis=-1)

    def kept(
        self,
        search: Search,
        worlds: Any,
        proposal: Any,
        planned: IntArray,
        length: int,
        team: tuple[Any, ...] | None = None,
    ) -> Simulated:
        """What a refusal of a proposal is made from; arguments as of `Simulated`, `planned` with `length` actions."""
        base, labels = self._base, action_labels(self._base)
        lanes: list[Any] = [] if search.bounds.straight else list(index_of(base.road.network))
        return Simulated(
            search=search,
            worlds=worlds,
            who=list(self.bodies()),
            lanes=lanes,
            proposal=proposal,
            labels=[labels[k] for k in sorted(labels)],
            hint=planned[:length].copy(),
            team=team,
        )

    def _furnish(self, bodies: int, simulator: Simulator | NetworkSimulator) -> Room:
        """Room for so many bodies: where vehicles come and go, their number changes back and forth."""
        old = self._rooms[bodies][1] if bodies in self._rooms else None
        self._rooms[bodies] = simulator, new_search(simulator, self._config, self._allies(), old)
        return self._rooms[bodies]

    def _allies(self) -> int:
        """How many egos there are beside the first."""
        return 0 if isinstance(self._base, CompiledHighwayEnv) else len(self._base.controlled_vehicles) - 1

    def _of_this_road(self) -> Simulator | NetworkSimulator | None:
        """A simulator of the road as it is in this episode."""
        of_networks = (s for s, _ in self._rooms.values() if isinstance(s, NetworkSimulator))
        return next((s for s in of_networks if s.is_on(self._base)), None)

    def ego(self, bodies: dict[Any, int]) -> int:
        """The column of the ego among `bodies`."""
        return 0 if isinstance(self._base, CompiledHighwayEnv) else bodies[self._base.vehicle]

    def _compare(self, states: FloatArray) -> set[Any]:
        """The vehicles that have done something else than was foretold, of those who were there then and are there now.
        Where the ego has too, it may be the cause: then there is none, but for those with which it has crashed."""
        bodies, before = self.bodies(), self._foretold_of
        known = [(body, k, before[body]) for body, k in bodies.items() if body in before]
        columns = np.array([each[1:] for each in known], np.intp).reshape(-1, 2)
        now, foretold = states[:, columns[:, 0]], self._foretold[:, columns[:, 1]]
        there = np.hypot(*(now - foretold)[:2]) <= _ELSEWHERE  # the others are newcomers
        other = there & ~(np.abs(now - foretold) <= _SAME).all(axis=0)
        self.surprised = bool(other.any())
        found, ego = {known[k][0] for k in np.flatnonzero(other)}, self.ego(bodies)
        if any(bodies[body] == ego for body in found):
            crashed = getattr(getattr(self._base, "vehicle", None), "crashed", False)
            found = {b for b in found if crashed and bodies[b] != ego and getattr(b, "crashed", False)}
        return found


def _states(bodies: Iterable[Any]) -> FloatArray:
    """Of highway-env's bodies now: rows x, y [m], heading [rad], speed [m/s], length and width [m]."""
    rows = [[*body.position, body.heading, body.speed, body.LENGTH, body.WIDTH] for body in bodies]
    return np.array(rows, float).T


class Foretells:
    """A door that foretells a scene: what offends is what comes about otherwise."""

    _scene: ExactScene
    config: ShieldConfig

    def record(self) -> None:
        """Keep in each decision what is drawn, as with `ShieldConfig.record`."""
        self.config = self.config.replace(record=True)

    def look(self) -> None:
        """Judge the others in the last step of an episode, after which nothing is decided."""
        self._scene.look()

    @property
    def violations(self) -> int:
        """Offences of the others, counted whenever the scene is read."""
        return self._scene.violations

    @property
    def by_rule(self) -> dict[str, int]:
        """The same by the rule that was broken; see `ExactScene`."""
        return dict(self._scene.by_rule)
