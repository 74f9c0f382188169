"""`SimulatedRoads`: many compiled environments on a road network, each with its meta-actions verified by simulation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.layout import LANE
from dynamics.highway_simulator.step_kernels import write_row
from dynamics.road_networks.episodes.rewards import CROSSING
from dynamics.road_networks.episodes.simulator import RoadSimulator
from dynamics.road_networks.episodes.step_kernels import (
    EpisodeRules,
    Episodes,
    EpisodeWork,
    RoadStepResults,
    begin,
    finish,
    start_next_episode,
)
from dynamics.road_networks.geometry.lanes import on_lane
from dynamics.road_networks.geometry.layout import ACROSS, ALONG, FRAMES
from dynamics.road_networks.simulation.frame_kernels import NetworkWorlds, advance, ego_of
from dynamics.state import BoolArray, FloatArray, IntArray
from dynamics.traffic.crossing import make
from shield.batch.codes import TIERS
from shield.batch.step_kernels import BatchPart, DecisionInputs, FrameRecords, let_pass
from shield.certificate.simulated.decision_kernels import decide
from shield.certificate.simulated.highways import SimulatedHighways
from shield.certificate.simulated.step_kernels import SimulatedShields
from shield.config import ShieldConfig
from shield.decision import Tier
from shield.errors import ConfigError

__all__ = ["SimulatedRoads"]

_OFF = TIERS.index(Tier.OFF)
_ENDLESS = 1_000
"""Number of decisions that suffices if an episode ends only at a place on the road."""


class SimulatedRoads(SimulatedHighways):
    """Copies of an environment on a road network with meta-actions. Each has a filter with the same decisions as
    `Shield` with `ShieldConfig.simulated_traffic()` and `frames=False` around one environment.

    Parameters
    ----------
    env_id, num_envs, config, threads : as in `RoadSimulator`.
    shield : as in `SimulatedHighways`, or settings of mode "none": the proposals are executed.

    Raises
    ------
    ConfigError
        If the simulator cannot run the environment, its actions are not meta-actions, or the settings are others.

    Attributes
    ----------
    simulator, records, plans : as in `SimulatedHighways`.
    rows : vehicle rows after each frame, the ego first. Rows beyond the number of bodies are infinitely far away.
    off_road : whether the ego was off the road.

    Examples
    --------
    >>> roads = SimulatedRoads("roundabout-v1", 2)
    >>> observations = roads.reset([0, 1])
    >>> observations, reward, terminated, truncated = roads.step([1, 1])
    >>> roads.records.executed
    array([1, 1])
    """

    simulator: Any

    def _settings(self, shield: ShieldConfig | str | Path | None) -> ShieldConfig:
        config = ShieldConfig.of(shield, ShieldConfig.simulated_traffic())
        return config if config.mode == "none" else super()._settings(config)

    def _traffic(
        self, env_id: str, num_envs: int, config: Mapping[str, Any] | None, replay_draws: bool
    ) -> RoadSimulator:
        if replay_draws:
            raise ConfigError("scenes are chosen on straight highways only")
        return RoadSimulator(env_id, num_envs, config)

    def _prepare(self, threads: int) -> None:
        super()._prepare(threads)
        simulator, rules = self.simulator, self.simulator.rules
        self._works = [simulator.episode_work() for _ in range(threads)]
        if simulator.scenario.kind == CROSSING:
            # A vehicle that leaves is removed at the end of a decision. The roads count decisions; a search counts its
            # frames.
            frames = rules.numbers[0]
            phase = int(simulator.episodes.worlds.g[0, FRAMES, 0] % frames)
            rules = rules._replace(regulation=rules.regulation._replace(stay=frames, phase=phase))
            self._searches = [search._replace(rules=rules) for search in self._searches]

    def write_rows(self, e: int, rows: FloatArray) -> bool:
        """Write the bodies of one environment to `rows`, (m, 7), in the order of the attribute `rows`. Return whether
        the ego is on the road."""
        return bool(_write_rows(self.worlds, self.simulator.scenario.rules, e, rows))

    @property
    def worlds(self) -> Any:
        """The state of the traffic."""
        worlds: NetworkWorlds = self.simulator.episodes.worlds
        return worlds

    def one(self) -> gym.Env[Any, Any]:
        """One such environment without a filter, reset."""
        scenario = self.simulator.scenario
        env = make(scenario.env_id, scenario.config)
        env.reset(seed=0)
        return env

    @property
    def steps(self) -> int:
        """Upper bound on the decisions of an episode, plus one; `_ENDLESS` if an episode ends only at a place on the
        road."""
        worth, decision = self.simulator.scenario.rules.worth, self.simulator.rules.times[1]
        most = min(worth.duration / decision, worth.decisions or math.inf, _ENDLESS)
        return math.ceil(most) + 1

    def reset_to(self, uniforms: FloatArray, which: Any) -> Any:
        """Not supported on road networks.

        Raises
        ------
        ConfigError
            Always.
        """
        raise ConfigError("scenes are chosen on straight highways only")

    def _decide(self, part: int, first: int, last: int, actions: IntArray, orders: IntArray, again: bool) -> None:
        simulator, search = self.simulator, self._searches[part]
        _step_all(
            _Roads(simulator.episodes, simulator.scenario.rules, self._works[part], simulator.flat),
            SimulatedShields(search, self.plans, self.records),
            self.config.mode == "none",
            DecisionInputs(actions, orders, search.given),
            FrameRecords(self.rows, self.off_road),
            BatchPart(first, last, again),
        )
        simulator.check_capacity()

    def _mask(self, part: int, first: int, last: int, masks: BoolArray) -> None:
        if self.config.mode == "none":
            masks[first:last] = True
        else:
            super()._mask(part, first, last, masks)


@kernel_inline
def _write_rows(worlds: NetworkWorlds, rules: EpisodeRules, e: int, rows: FloatArray) -> bool:
    f, g, p, lanes = worlds.f[e], worlds.g[e], worlds.p[e], rules.drive.network.lanes
    ego, bodies, n = ego_of(g), worlds.counts[e, 1], 1
    write_row(f, g, p, ego, rows[0])
    for i in range(rows.shape[0]):
        if i >= bodies:
            rows[i] = 0.0
            rows[i, 0] = math.inf
        elif i != ego:
            write_row(f, g, p, i, rows[n])
            n += 1
    return on_lane(lanes, g[LANE, ego], f[ALONG, ego], f[ACROSS, ego], 0.0)


class _Roads(NamedTuple):
    """The environments on one network, and what a step of them reads and writes."""

    episodes: Episodes
    rules: EpisodeRules
    work: EpisodeWork
    seen: RoadStepResults


@kernel_no_refcount
def _step_all(
    roads: _Roads,
    shield: SimulatedShields,
    off: bool,
    inputs: DecisionInputs,
    frames: FrameRecords,
    part: BatchPart,
) -> None:
    """One decision in each of the environments of a part; see `step_kernels.step_all_simulated`.

    Parameters
    ----------
    off : whether the proposals are executed without verification.
    """
    episodes, rules, work, seen = roads
    search, plans, records = shield
    machine, worlds, given = search.machine, episodes.worlds, inputs.given
    for e in range(part.first, part.last):
        if off:
            let_pass(records, e, inputs.actions[e])
        else:
            decide(search, plans, records, worlds, e, inputs.actions[e], inputs.orders[e])
        given[0], given[1] = records.executed[e], 0.0
        begin(machine, episodes, rules, e, given)
        for k in range(rules.drive.numbers[0]):
            records.tiers[e, k], records.reasons[e, k], records.margins[e, k] = _OFF, 0, math.nan
            advance(machine, worlds, rules.drive, work.drive, e)
            frames.off_road[e, k] = not _write_rows(worlds, rules, e, frames.rows[e, k])
        finish(machine, episodes, rules, work, seen, e, given)
        # The traffic is the one that was simulated, so no vehicle present can deviate.
        records.violations[e] = 0
        if part.again and (seen.terminated[e] or seen.truncated[e]):
            start_next_episode(machine, episodes, rules, work, seen, e)
            plans.length[e] = 0
