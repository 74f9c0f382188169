"""The filter for meta-actions on road networks, in the worst case that the assumptions permit."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np

from dynamics.highway_simulator.layout import CRASHED, IMPACTED, LANE, SPEED, TARGET, TARGET_SPEED
from dynamics.road_networks.geometry.layout import COUNT, ROAD
from dynamics.road_networks.geometry.network import index_of
from dynamics.road_networks.simulation.ego_manoeuvres import EgoManoeuvre, EgoOnNetwork, read_ego_on_network
from dynamics.road_networks.simulation.frame_kernels import command, on_way
from dynamics.road_networks.simulation.live import length_of_route, load_ego
from shield.certificate.network.choice import JudgedCandidate, choose, try_candidate
from shield.certificate.network.late_braking import LateBraking
from shield.certificate.network.manoeuvres import (
    TargetCommand,
    candidates_of,
    frames_of,
    remainder_after_frame,
    stopping,
)
from shield.certificate.network.mitigation import mitigate, without_buffer
from shield.certificate.network.monitor import NetworkMonitor, NetworkObservation, NetworkRule, check_readable
from shield.certificate.network.obligations import RightOfWayObligations
from shield.certificate.network.prediction import NetworkPredictor, network_context
from shield.certificate.network.tolerances import CLEAR
from shield.certificate.network.workspace import NetworkPrediction, empty_rollout, prediction_of
from shield.config import ShieldConfig
from shield.decision import Decision, Reason, Source, Tier
from shield.environments import check_configuration, refuse_parking_lots
from shield.errors import SceneError
from shield.explaining.roads import network_decision_data
from shield.filters.discrete_action import action_index, action_labels
from shield.filters.simulated.predicted_scene import scene_failure
from shield.filters.supervision import Command, limited_braking
from shield.supported_environments import refuse_simulated

__all__ = ["NetworkFilter"]

_OF_A_DECISION = ("_target_command", "_left", "_ready", "_others", "_identities", "_rollout")
"""Attributes that a decision writes and its frames read."""


class NetworkFilter:
    """Filters the meta-actions of one environment on a road network, frame by frame.

    A candidate follows the target command for some frames, and then brakes to a standstill. Its path has to stay clear
    of every place that another vehicle can reach (`shield.certificate.network.clearance`). If the target command is not
    clear, the filter takes the greatest lower speed that is clear, or the candidate verified a frame before.

    Parameters
    ----------
    base : highway-env's environment, unwrapped. config : settings.

    Raises
    ------
    SceneError
        If the road has lanes of another shape, or there are several egos.
    ConfigError
        If the actions are not meta-actions, or the environment is a parking lot.

    Attributes
    ----------
    cause : why the scene of the last decision could not be read; "" if it could.
    watch : monitor of the other vehicles.
    disturbed : whether a violator has intruded on the candidate that was verified last.
    kept : separation of that candidate from each vehicle when it was verified, and a frame later [m]. For a vehicle
        that keeps to the assumptions the second is never less.
    """

    supervising = True

    def __init__(self, base: Any, config: ShieldConfig) -> None:
        refuse_parking_lots([base])
        check_configuration(base, config)
        refuse_simulated(config)
        self.config, self._base, self.cause = config, base, ""
        self._past: Counter[NetworkRule] = Counter()
        self.watch = NetworkMonitor()
        self._forget()
        if base.road is not None:
            self._furnish()

    def _forget(self) -> None:
        self._past.update(self.watch.by_rule)
        self.watch = NetworkMonitor()
        self._network: Any = None
        self._obligations = RightOfWayObligations()
        self._stored: EgoManoeuvre | None = None
        self._target_command: TargetCommand | None = None
        self._left = self._judged = -1
        self.disturbed = False
        self.kept: dict[Any, tuple[float, float]] = {}
        self._then: dict[Any, float] = {}
        self._ready: tuple[EgoManoeuvre, Decision] | None = None

    @property
    def _frequency(self) -> float:
        """Frames per second, in the environment's present configuration."""
        return float(self._base.config["simulation_frequency"])

    @property
    def violations(self) -> int:
        """Number of violations of the assumptions by the traffic."""
        return self._past.total() + self.watch.count

    @property
    def by_rule(self) -> dict[str, int]:
        """The same by rule."""
        return {str(rule): count for rule, count in (self._past + Counter(self.watch.by_rule)).items()}

    @property
    def ahead(self) -> dict[tuple[str, str, int], list[tuple[str, str, int]]]:
        """The successors of each lane of the road."""
        return {
            lane: [self._names[k] for k in row if k >= 0]
            for lane, row in zip(self._names, self._road.ways.after, strict=True)
        }

    @property
    def over(self) -> dict[tuple[str, str, int], tuple[str, str, int]]:
        """For each lane that ends, the lane into which its vehicles have to change."""
        return {self._names[k]: self._names[beside] for k, beside in enumerate(self._road.ways.over) if beside >= 0}

    @property
    def foreseen(self) -> NetworkPrediction:
        """Prediction that the last decision used."""
        return prediction_of(self._others, self._rollout, self._names)

    def counts_on(self, body: Any) -> bool:
        """Whether another vehicle is expected to wait for the ego, and has had its reaction time.

        Unless that vehicle brakes now, it may violate the right of way (`shield.certificate.network.monitor`).
        """
        return self._obligations.counts_on(body, self._road.response.reaction)

    def has_distance_obligation(self, body: Any) -> bool:
        """Whether another vehicle has a distance obligation: it is behind the ego, and is expected to brake in time."""
        return self._obligations.has_distance_obligation(body)

    def culprits(self, bodies: Iterable[Any]) -> set[Any]:
        """Those of the vehicles in a crash with the ego that are violators, including a violation since the last
        frame."""
        hit = set(bodies)
        for body in hit:
            body.crashed = False
        try:
            seen = self._predict()
            load_ego(self._base, self._alone.rules, self._index, self._alone.worlds)
            self._alone.worlds.g[0, [CRASHED, IMPACTED]] = 0
            late = set() if self._stored is None else self._braking.now(self._stored, seen)[1]
            return self.watch.judge(seen, hit, self._road, late)
        finally:
            for body in hit:
                body.crashed = True

    def have_broken(self, bodies: Iterable[Any], since: NetworkObservation) -> set[Any]:
        """Those of the vehicles that violated a rule in the frame from `since` to the last scene, whether or not the
        ego's fail-safe is affected."""
        last = self.watch.last
        return set() if last is None else NetworkMonitor(last=since).judge(last, set(bodies), self._road, set())

    def record(self) -> None:
        """Keep in each decision the data for drawings, as with `ShieldConfig.record`."""
        self.config = self.config.replace(record=True)

    def reset(self) -> None:
        """Clear everything about the episode.

        Raises
        ------
        ConfigError, SceneError
            As of the class, if the environment's configuration has changed.
        """
        check_configuration(self._base, self.config)
        self._forget()
        self._furnish()

    def decide(self, action: Any, order: Callable[[], list[int] | None] | None = None) -> Decision:
        """Filter one meta-action."""
        start, proposed = perf_counter(), action_index(action)
        shown = action if proposed < 0 else proposed
        self._ready, self.cause = None, ""
        try:
            bad = proposed not in self._base.action_type.actions
            self._read()
            if bad:
                proposed = self._idle()
            self._intend(proposed)
            self._ready = self._choose()
            decision = self._ready[1]
            if bad:
                decision = replace(decision, reason=Reason.BAD_ACTION, tier=Tier.ALTERNATIVE)
        except Exception as error:
            reason, self.cause = scene_failure(error)
            self._target_command, proposed = None, self._idle()
            decision = Decision(shown, proposed, reason, Tier.EMERGENCY, np.nan, 0.0)
        return replace(decision, proposed=shown, executed=proposed, latency=perf_counter() - start)

    def frame(self) -> tuple[Command, Decision]:
        """Command for the next frame, None to keep the environment's own; and the record."""
        start = perf_counter()
        try:
            if self._ready is None:
                self._read()
                self._ready = self._choose()
            (manoeuvre, decision), self._ready = self._ready, None
            self._go(manoeuvre, decision.tier)
            command = self._command(decision.tier)
            executed = decision.executed if command is None else command
            return command, replace(decision, executed=executed, latency=perf_counter() - start)
        except Exception as error:
            reason, self.cause = scene_failure(error)
            self._stored = None
            speed = float(getattr(self._base.vehicle, "speed", 0.0))
            brake = limited_braking(-self.config.braking, speed, self._frequency)
            inputs = {"acceleration": brake, "steering": 0.0}
            return inputs, Decision(-1, -1, reason, Tier.EMERGENCY, np.nan, perf_counter() - start)

    def monitor_last_frame(self) -> None:
        """Run the monitor on the last frame of an episode, after which there is no decision."""
        try:
            self._read()
        except Exception as error:
            _, self.cause = scene_failure(error)

    def mask(self) -> np.ndarray[Any, Any]:
        """Mask of the actions that verify now; all True if none does. Read-only: changes no memory, record or later
        decision.

        Raises
        ------
        SceneError
            If the scene cannot be read.
        """
        kept = {name: value for name, value in vars(self).items() if name in _OF_A_DECISION}
        mask = np.zeros(len(self._base.action_type.actions), dtype=bool)
        try:
            check_readable(self._see())
            self._rollout = empty_rollout(self._frames, len(self._names), len(self._identities))
            for action in range(len(mask)):
                load_ego(self._base, self._alone.rules, self._index, self._alone.worlds)
                self._intend(action)
                mask[action] = self._choose()[1].tier is Tier.PASSED
        finally:
            vars(self).update(kept)
        return mask if mask.any() else np.ones_like(mask)

    def _intend(self, action: int) -> None:
        """Set the target command of a meta-action."""
        alone, self._left = self._alone, self._bound
        command(alone.machine, alone.worlds, alone.rules, 0, 0, action)
        self._target_command = TargetCommand(self._bound, float(alone.worlds.f[0, TARGET_SPEED, 0]))

    def _idle(self) -> int:
        """Index of IDLE, or of SLOWER where there is no IDLE."""
        labels = self._base.action_type.actions_indexes
        return int(labels.get("IDLE", labels.get("SLOWER", 0)))

    @property
    def _bound(self) -> int:
        """Index of the ego's target lane."""
        return int(self._alone.worlds.g[0, TARGET, 0])

    def _lanes(self) -> list[int]:
        """The ego's target lane; and, if they are on the same road, the target lane before the decision and the present
        lane, which the ego may not have left yet."""
        ids, bound = self._road.lanes.ids, self._bound
        own = int(self._alone.worlds.g[0, LANE, 0])
        return [bound, *(lane for lane in (self._left, own) if lane >= 0 and ids[lane, ROAD] == ids[bound, ROAD])]

    def _furnish(self) -> None:
        """Allocate the buffers for the episode's road, and compute its tables."""
        base = self._base
        if len(base.controlled_vehicles) != 1:
            raise SceneError(f"a road network requires one ego, not {len(base.controlled_vehicles)}")
        stays = {} if self._network is None else self._braking.stays
        self._alone: EgoOnNetwork = read_ego_on_network(base)
        self._network, self._index = base.road.network, index_of(base.road.network)
        self._names = list(self._index)
        self._road = network_context(base, self._alone, self.config)
        self._without_buffer = without_buffer(self._road)
        self._frames = frames_of(self._frequency, self.config.braking)
        self._braking: LateBraking = LateBraking.on(self._alone, self._road, self._frames, stays)
        self._predictor = NetworkPredictor(base, self._alone, self._road, self._frames)
        self._rollout = empty_rollout(self._frames, len(self._names), 0)

    def _read(self) -> None:
        """Read the scene and, once a frame, run the monitor."""
        seen, frame = self._see(), int(self._base.steps)
        if frame != self._judged:
            self._watch(seen)
            self._judged = frame
        check_readable(seen)
        self._others.offends[:] = [body in self.watch.offenders for body in seen.identities]

    def _see(self) -> NetworkObservation:
        """Read the scene."""
        base = self._base
        if base.road.network is not self._network or length_of_route(base) > self._alone.worlds.routes.shape[2]:
            self._furnish()
        load_ego(base, self._alone.rules, self._index, self._alone.worlds)
        seen = self._predict()
        self._others, self._identities = seen.others, seen.identities
        if len(self._rollout.margins) != len(seen.identities):
            self._rollout = empty_rollout(self._frames, len(self._names), len(seen.identities))
        if self.watch.last is None:
            # At the beginning every follower has seen the ego for long enough to react.
            self._try(stopping(self._bound, self.config.braking))
            self._keep_distance(seen.identities, True)
        return seen

    def _predict(self) -> NetworkObservation:
        """Predict the reachable places of the other vehicles."""
        return self._predictor.predict(self._obligations)

    def _watch(self, seen: NetworkObservation) -> None:
        """Run the monitor on the motions since the last scene."""
        margins, late, self.kept, ego = None, set[Any](), {}, self._base.vehicle
        # A crashed ego does not obey its commands. An ego about to be hit has obeyed so far: it is judged without the
        # impact. A candidate ends where the road ends: highway-env's behaviour beyond that is not predicted.
        if self._stored is not None and not ego.crashed and not self._at_end():
            flags = self._alone.worlds.g[0, IMPACTED]
            pushed, flags[:] = flags.copy(), 0
            margins, late = self._braking.now(self._stored, seen)
            flags[:] = pushed
            self.kept = {
                b: (self._then[b], float(margins[i])) for i, b in enumerate(seen.identities) if b in self._then
            }
        self.watch.next(seen, set(self._then), margins, self._road, late)
        self.disturbed = self.disturbed or bool(self.watch.offenders)

    def _at_end(self) -> bool:
        """Whether the ego is at the end of its road."""
        worlds = self._alone.worlds
        return bool(on_way(self._alone.rules, worlds.f[0], worlds.g[0])[1])

    def _try(self, manoeuvre: EgoManoeuvre) -> None:
        """Write the rollout of a candidate to the trial buffer; vehicles with a distance obligation keep their
        distance."""
        try_candidate(self._alone, self._road, self._others, np.array(manoeuvre, float), True, self._rollout)

    def _keep_distance(self, identities: list[Any], verified: bool) -> None:
        """Update the distance obligations for the candidate in the trial buffer."""
        self._obligations.keep_distance(identities, self._others, self._rollout, self._road, verified)

    def _choose(self) -> tuple[EgoManoeuvre, Decision]:
        """The chosen candidate, and the record."""
        alone, braking = self._alone, self.config.braking
        if self._target_command is None:
            self._target_command = TargetCommand(self._bound, float(alone.worlds.f[0, TARGET_SPEED, 0]))
        speed, several = float(alone.worlds.f[0, SPEED, 0]), self._road.lanes.ids[self._target_command.lane, COUNT] > 1
        tried = list(
            candidates_of(self._target_command, self._stored, speed, self._lanes(), several, self._frequency, braking)
        )
        courses = np.array([manoeuvre for manoeuvre, _ in tried], float)
        room = self._rollout, self._braking.bodies
        found: JudgedCandidate = choose(alone, self._road, self._without_buffer.body, self._others, courses, *room)
        margin, binding, evades = found.margin, found.vehicle, found.compliant_margin >= CLEAR
        if margin < CLEAR and found.clear == 0:
            # No candidate keeps the buffer: choose by the bodies alone (collision mitigation).
            evades, found = False, mitigate(alone, self._without_buffer, self._others, courses, speed, *room)
        manoeuvre, tier = tried[found.manoeuvre]
        reason = Reason.NONE if tier is Tier.PASSED else Reason.UNVERIFIED
        if margin < CLEAR:
            reason = Reason.NO_SAFE_PLAN
            tier = Tier.EVADED if evades else Tier.LARGEST_MARGIN
        source = None if tier is Tier.PASSED else self._kept(tried)
        plan = self.foreseen.path if self.config.record else None
        return manoeuvre, Decision(-1, -1, reason, tier, float(margin), 0.0, plan, vehicle=int(binding), source=source)

    def _kept(self, tried: list[tuple[EgoManoeuvre, Tier]]) -> Source:
        """Data for an explanation of the decision."""
        ego, labels = self._base.vehicle, action_labels(self._base)
        return network_decision_data(
            self._alone,
            road=self._road,
            body=self._without_buffer.body,
            others=self._others,
            identities=self._identities,
            tried=tried,
            lanes=[body.lane_index for body in self._identities],
            labels=[labels[k] for k in sorted(labels)],
            size=(float(ego.LENGTH), float(ego.WIDTH)),
        )

    def _go(self, manoeuvre: EgoManoeuvre, tier: Tier) -> None:
        """Record the chosen candidate, and update the obligations from its rollout in the trial buffer."""
        identities = [] if self.watch.last is None else self.watch.last.identities
        self._then = (
            {body: float(self._rollout.margins[i]) for i, body in enumerate(identities)} if tier.verified else {}
        )
        self.disturbed = self.disturbed and not tier.verified
        self._keep_distance(identities, tier.verified)
        self._braking.remember(manoeuvre, identities, self._others)
        if self._road.response.gives_way:
            self._obligations.give_way(identities, self._others, self._rollout, self._road, tier.verified)
        bound = int(self._rollout.bound[0])
        self._stored = remainder_after_frame(manoeuvre, bound)
        if self._target_command is not None and manoeuvre.lane == self._target_command.lane and manoeuvre.frames >= 1:
            self._target_command = self._target_command._replace(lane=bound)

    def _command(self, tier: Tier) -> Command:
        """Low-level action of the frame; None if the environment's own is the same."""
        ego, lane = self._base.vehicle, self._names[int(self._rollout.bound[0])]
        if tier is Tier.PASSED and self._index[ego.target_lane_index] == int(self._rollout.bound[0]):
            return None
        ego.target_lane_index = lane
        return {"acceleration": float(self._rollout.first[0]), "steering": float(self._rollout.first[1])}
