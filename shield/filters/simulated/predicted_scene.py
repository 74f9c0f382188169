"""Prediction of one environment's traffic by simulation, and its comparison with the next scene."""

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
from dynamics.highway_simulator.own_methods import check_own_methods
from dynamics.highway_simulator.scenario import scenario_of_live
from dynamics.highway_simulator.simulator import Simulator
from dynamics.road_networks.geometry.network import index_of
from dynamics.road_networks.simulation.simulator import NetworkSimulator
from dynamics.road_networks.simulation.supported_traffic import check_network, on_network
from dynamics.state import FloatArray, IntArray
from shield.certificate.network.monitor import NetworkRule
from shield.certificate.simulated.search import simulate_sequence
from shield.certificate.simulated.workspace import TrafficSearch, new_search
from shield.config import ShieldConfig
from shield.decision import Reason
from shield.explaining.simulated import SimulatedDecisionData
from shield.filters.discrete_action import action_labels
from shield.filters.simulated.newcomers import blocking, unpredicted

__all__ = [
    "STATE",
    "LoadedSearch",
    "PredictedScene",
    "PredictingFilter",
    "check_traffic",
    "scene_failure",
    "simulate_network",
]

_log = logging.getLogger(__name__)

LoadedSearch = tuple[Simulator | NetworkSimulator, TrafficSearch]
"""A simulator of the present scene, and search buffers for it."""
STATE = [X, Y, HEADING, SPEED]
"""Rows of the predicted arrays."""
_SIZE = [LENGTH, WIDTH]
_SAME = 1e-6
"""Greatest difference between prediction and observation that is not a mismatch [m, rad, m/s]. Without numpy's own sums
rounding differs by about 1e-12."""
_ELSEWHERE = 100.0
"""No vehicle deviates by this much from a prediction within one decision [m]; a vehicle further away is a newcomer."""


def scene_failure(error: Exception) -> tuple[Reason, str]:
    """Reason and cause of a record after an error while reading the scene. An unexpected error is logged."""
    if isinstance(error, SceneError | ConfigError):
        return Reason.BAD_SCENE, str(error)
    _log.error("the scene could not be read; the last resort acts", exc_info=error)
    return Reason.STAGE_FAILED, f"{type(error).__name__}: {error}"


def check_traffic(base: Any) -> None:
    """Raise unless the traffic of an environment, unwrapped, can be simulated.

    Raises
    ------
    ConfigError
        If a vehicle or an object moves in an unknown way; the message names it.
    """
    if isinstance(base, CompiledHighwayEnv):
        return
    if on_network(base):
        check_network(base)
    elif isinstance(base.action_type, ContinuousAction):
        check_own_methods(base)
    else:
        scenario_of_live(base, observes=False)


def simulate_network(base: Any, like: Any, **options: Any) -> NetworkSimulator:
    """Simulator of a road network, for `PredictedScene`; options as of `NetworkSimulator`."""
    return NetworkSimulator(base, like=like, **options)


class PredictedScene:
    """The traffic of one environment in a simulator's arrays, with search buffers.

    Parameters
    ----------
    base : the environment, unwrapped: highway-env's own, or a `CompiledHighwayEnv`.
    config : settings with `Assumptions.simulated_traffic()`.
    simulate : makes a simulator of the environment's present state. Its second argument is an earlier simulator of the
        same road, or None.
    verifies : whether any sequence of actions verifies in a scene, given its environment and its `LoadedSearch`.

    Attributes
    ----------
    by_rule : violations by rule, counted whenever the scene is read. "unforeseen": a body that has moved otherwise than
        predicted, or changed its size. "appeared": a newcomer that has crashed with an ego, or with which no sequence
        of actions verifies.
    mismatched : whether the scene differs from the prediction.
    """

    def __init__(
        self,
        base: Any,
        config: ShieldConfig,
        simulate: Callable[[Any, Any], Simulator | NetworkSimulator],
        verifies: Callable[[Any, LoadedSearch], bool],
    ) -> None:
        self._base, self._config, self._simulate, self._verifies = base, config, simulate, verifies
        self.by_rule: dict[str, int] = {}
        self._sizes: FloatArray = np.zeros((len(_SIZE), 0))
        self._loaded: dict[int, LoadedSearch] = {}
        self.expect_nothing()

    @property
    def violations(self) -> int:
        """Number of violations."""
        return sum(self.by_rule.values())

    def forget(self) -> None:
        """Clear everything about the episode, and allocate buffers for the next. An unreadable scene raises later, when
        it is read."""
        self.expect_nothing()
        if self._base.road is not None or isinstance(self._base, CompiledHighwayEnv):
            with suppress(SceneError, ConfigError):
                self.read()

    def expect_nothing(self) -> None:
        """Clear the prediction of the next scene."""
        self.mismatched = False
        self._counted: set[Any] = set()
        self._predicted_states: FloatArray = np.zeros((len(STATE) + len(_SIZE), 0))
        self._predicted_columns: dict[Any, int] = {}

    @property
    def has_prediction(self) -> bool:
        """Whether there is a prediction of the next scene."""
        return bool(self._predicted_columns)

    def expect(self, states: FloatArray) -> None:
        """Set the prediction of the next scene.

        Parameters
        ----------
        states : rows x, y [m], heading [rad] and speed [m/s] of its bodies, (4, m). The bodies keep their sizes of the
            last scene read.
        """
        self._predicted_states, self._predicted_columns = np.concatenate([states, self._sizes]), self.bodies()
        self._counted = set()

    def read(self, counting: bool = True) -> LoadedSearch:
        """The present scene; with `counting`, prediction mismatches are counted as violations.

        Raises
        ------
        SceneError, ConfigError
            If it cannot be simulated.
        """
        try:
            loaded = self._load()
        except (SceneError, ConfigError):
            if counting and self._base.road is not None:
                self._count(self._blocking(self._newcomers()), NetworkRule.APPEARED)
            raise
        worlds = loaded[0].worlds
        self._sizes = worlds.p[0][_SIZE]
        others = self._compare(np.concatenate([worlds.f[0][STATE], self._sizes]))
        newcomers = self._newcomers()
        if counting:
            self._count(others, NetworkRule.UNFORESEEN)
            self._count(self._blocking(newcomers), NetworkRule.APPEARED)
        self.mismatched = self.mismatched or bool(newcomers)
        return loaded

    def _load(self) -> LoadedSearch:
        """Load the present state into a simulator with the right number of bodies."""
        base = self._base
        if isinstance(base, CompiledHighwayEnv):
            return self._loaded.get(0) or self._furnish(0, base.simulator)
        bodies = 0 if base.road is None else len(base.road.vehicles) + len(base.road.objects)
        known = self._loaded.get(bodies)
        if known is None or not known[0].fits(base):
            return self._furnish(bodies, self._simulate(base, self._of_this_road()))
        known[0].load(base)
        return known

    def monitor_last_frame(self) -> None:
        """Count the prediction mismatches at the end of an episode, after which no scene is read."""
        if not self.has_prediction:
            return
        base, mismatched = self._base, self.mismatched
        if isinstance(base, CompiledHighwayEnv):
            worlds = base.simulator.worlds
            states = np.concatenate([worlds.f[0][STATE], worlds.p[0][_SIZE]])
        else:
            states = _states(self.bodies())
        self._count(self._compare(states), NetworkRule.UNFORESEEN)
        self._count(self._blocking(self._newcomers()), NetworkRule.APPEARED)
        self.mismatched = mismatched

    def _count(self, others: set[Any], rule: NetworkRule) -> None:
        """Count each body at most once for each prediction."""
        new = others - self._counted
        if new:
            self.by_rule[rule.value] = self.by_rule.get(rule.value, 0) + len(new)
            self._counted |= new

    def _newcomers(self) -> set[Any]:
        """Bodies that were not predicted, and bodies so far from their prediction that they were placed there."""
        if not self.has_prediction or isinstance(self._base, CompiledHighwayEnv):
            return set()
        known = [(body, self._predicted_columns[body]) for body in self.bodies() if body in self._predicted_columns]
        predicted = self._predicted_states[:2, [column for _, column in known]]
        far = np.hypot(*(np.array([body.position for body, _ in known]).T.reshape(2, -1) - predicted)) > _ELSEWHERE
        return unpredicted(self._base, {body for (body, _), moved in zip(known, far, strict=True) if not moved})

    def _blocking(self, newcomers: set[Any]) -> set[Any]:
        """Newcomers that leave the egos without a verified sequence, or have crashed with one."""
        return blocking(self._base, newcomers, self._verified_in)

    def _verified_in(self, base: Any) -> bool:
        """Whether any sequence of actions verifies in an environment, unwrapped; False if it cannot be simulated."""
        try:
            simulator = self._simulate(base, self._of_this_road())
        except (SceneError, ConfigError):
            return False
        return self._verifies(base, (simulator, new_search(simulator, self._config, self._other_ego_count())))

    def is_as_predicted(self) -> bool:
        """Whether the bodies and their states are as predicted. Reads their states only."""
        bodies = self.bodies()
        if bodies.keys() != self._predicted_columns.keys():
            return False
        return bool((np.abs(_states(bodies) - self._predicted_states) <= _SAME).all())

    def bodies(self) -> dict[Any, int]:
        """Columns of the scene, by body."""
        base = self._base
        if isinstance(base, CompiledHighwayEnv):
            return {k: k for k in range(base.simulator.worlds.f.shape[2])}
        return {body: k for k, body in enumerate([*base.road.vehicles, *base.road.objects])}

    def shown(self, search: TrafficSearch, actions: IntArray, length: int) -> tuple[FloatArray, FloatArray]:
        """Predicted motion if the ego executes the first `length` actions from future 0 on.

        Returns
        -------
        The ego's states x, y [m], heading [rad], speed [m/s], (frames + 1, 4), and the bounding boxes of the other
        bodies, x_min, x_max, y_min, y_max [m], (frames + 1, others, 4).
        """
        rows = np.zeros((length * search.rules.numbers[0] + 1, search.futures.f.shape[2], 7))
        rows = rows[: simulate_sequence(search, actions, length, rows)]
        ego = self.ego(self._predicted_columns)
        others = np.delete(rows, ego, axis=1)
        cos, sin = np.abs(np.cos(others[..., 2])), np.abs(np.sin(others[..., 2]))
        half = np.stack([others[..., 4] * cos + others[..., 5] * sin, others[..., 4] * sin + others[..., 5] * cos]) / 2
        x, y = others[..., 0], others[..., 1]
        return rows[:, ego, :4], np.stack([x - half[0], x + half[0], y - half[1], y + half[1]], axis=-1)

    def kept(
        self,
        search: TrafficSearch,
        worlds: Any,
        proposal: Any,
        planned: IntArray,
        length: int,
        other_egos: tuple[Any, ...] | None = None,
    ) -> SimulatedDecisionData:
        """Data for an explanation of a refusal; parameters as of `SimulatedDecisionData`. `planned` has `length`
        actions."""
        base, labels = self._base, action_labels(self._base)
        lanes: list[Any] = [] if search.bounds.straight else list(index_of(base.road.network))
        return SimulatedDecisionData(
            search=search,
            worlds=worlds,
            identities=list(self.bodies()),
            lanes=lanes,
            proposal=proposal,
            labels=[labels[k] for k in sorted(labels)],
            hint=planned[:length].copy(),
            other_egos=other_egos,
        )

    def _furnish(self, bodies: int, simulator: Simulator | NetworkSimulator) -> LoadedSearch:
        """Allocate buffers for a number of bodies. Where vehicles spawn and leave, the buffers are kept for each
        number."""
        old = self._loaded[bodies][1] if bodies in self._loaded else None
        self._loaded[bodies] = simulator, new_search(simulator, self._config, self._other_ego_count(), old)
        return self._loaded[bodies]

    def _other_ego_count(self) -> int:
        """Number of egos besides the first."""
        return 0 if isinstance(self._base, CompiledHighwayEnv) else len(self._base.controlled_vehicles) - 1

    def _of_this_road(self) -> Simulator | NetworkSimulator | None:
        """An existing simulator of the episode's road; None without one."""
        of_networks = (s for s, _ in self._loaded.values() if isinstance(s, NetworkSimulator))
        return next((s for s in of_networks if s.is_on(self._base)), None)

    def ego(self, bodies: dict[Any, int]) -> int:
        """The column of the ego among `bodies`."""
        return 0 if isinstance(self._base, CompiledHighwayEnv) else bodies[self._base.vehicle]

    def _compare(self, states: FloatArray) -> set[Any]:
        """Vehicles with a prediction mismatch, among those present both then and now.

        If the ego has a mismatch too, it may be the cause of the others'. Then the result has only the vehicles that it
        has crashed with.
        """
        bodies, before = self.bodies(), self._predicted_columns
        known = [(body, k, before[body]) for body, k in bodies.items() if body in before]
        columns = np.array([each[1:] for each in known], np.intp).reshape(-1, 2)
        now, predicted = states[:, columns[:, 0]], self._predicted_states[:, columns[:, 1]]
        there = np.hypot(*(now - predicted)[:2]) <= _ELSEWHERE  # a body further away is a newcomer
        other = there & ~(np.abs(now - predicted) <= _SAME).all(axis=0)
        self.mismatched = bool(other.any())
        found, ego = {known[k][0] for k in np.flatnonzero(other)}, self.ego(bodies)
        if any(bodies[body] == ego for body in found):
            crashed = getattr(getattr(self._base, "vehicle", None), "crashed", False)
            found = {b for b in found if crashed and bodies[b] != ego and getattr(b, "crashed", False)}
        return found


def _states(bodies: Iterable[Any]) -> FloatArray:
    """Present states of highway-env's bodies: rows x, y [m], heading [rad], speed [m/s], length and width [m], (6,
    m)."""
    rows = [[*body.position, body.heading, body.speed, body.LENGTH, body.WIDTH] for body in bodies]
    return np.array(rows, float).T


class PredictingFilter:
    """A filter that predicts the next scene, and counts mismatches as violations."""

    _scene: PredictedScene
    config: ShieldConfig

    def record(self) -> None:
        """Keep in each decision the data for drawings, as with `ShieldConfig.record`."""
        self.config = self.config.replace(record=True)

    def monitor_last_frame(self) -> None:
        """Run the monitor on the last step of an episode, after which there is no decision."""
        self._scene.monitor_last_frame()

    @property
    def violations(self) -> int:
        """Number of violations by other vehicles, counted whenever the scene is read."""
        return self._scene.violations

    @property
    def by_rule(self) -> dict[str, int]:
        """The same by rule; see `PredictedScene`."""
        return dict(self._scene.by_rule)
