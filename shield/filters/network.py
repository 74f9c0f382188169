"""The door for meta-actions on road networks whose traffic may do whatever the assumptions permit."""

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
from dynamics.road_networks.simulation.ego_alone import Alone, Course, alone_on
from dynamics.road_networks.simulation.frame_kernels import command, on_way
from dynamics.road_networks.simulation.live import length_of_route, load_ego
from shield.certificate.network.choice import Choice, choose, try_course
from shield.certificate.network.clearance import CLEAR
from shield.certificate.network.late_braking import Braking
from shield.certificate.network.manoeuvres import Wish, courses_of, frames_of, gone_on_with, stopping
from shield.certificate.network.mitigation import bare, save
from shield.certificate.network.monitor import Breach, Seen, Watch, check_readable
from shield.certificate.network.obligations import Dues
from shield.certificate.network.prediction import Outlook, road_of
from shield.certificate.network.workspace import Foreseen, empty_trial, foreseen
from shield.config import ShieldConfig
from shield.decision import Decision, Reason, Source, Tier
from shield.environments import check_configuration, refuse_lots
from shield.errors import SceneError
from shield.explaining.roads import on_roads
from shield.filters.discrete_action import action_index, action_labels
from shield.filters.simulated.predicted_scene import why_unread
from shield.filters.supervision import Command, limited_braking
from shield.supported_environments import refuse_simulated

__all__ = ["RoadDoor"]

_OF_A_DECISION = ("_wish", "_left", "_ready", "_others", "_who", "_trial")
"""Attributes that a decision writes and its frames read."""


class RoadDoor:
    """Filters the meta-actions of one environment on a road network, frame by frame.

    Each frame the decision's lane and speed are followed by the ego, alone, for some time, and then braking to a
    standstill; this path has to stay clear of every place where anybody may be
    (`shield.certificate.network.clearance`). Where none does, the greatest lower speed that does is taken, or what was
    verified a frame before.

    Parameters
    ----------
    base : highway-env's environment, unwrapped. config : settings.

    Raises
    ------
    SceneError
        If the road has lanes of another shape, or there are several egos.
    ConfigError
        If the actions are no meta-actions, or it is a parking lot.

    Attributes
    ----------
    cause : why the scene of the last decision could not be read, "" where it could.
    watch : what has been seen of the others.
    disturbed : whether one who has broken a rule has been in the way of what was verified last.
    kept : how far what was verified last stayed clear of each of the others then, and does a frame later [m]. Of who
        keeps to what is assumed it is never less.
    """

    supervising = True

    def __init__(self, base: Any, config: ShieldConfig) -> None:
        refuse_lots([base])
        check_configuration(base, config)
        refuse_simulated(config)
        self.config, self._base, self.cause = config, base, ""
        self._past: Counter[Breach] = Counter()
        self.watch = Watch()
        self._forget()
        if base.road is not None:
            self._furnish()

    def _forget(self) -> None:
        self._past.update(self.watch.by_rule)
        self.watch = Watch()
        self._network: Any = None
        self._dues = Dues()
        self._stored: Course | None = None
        self._wish: Wish | None = None
        self._left = self._judged = -1
        self.disturbed = False
        self.kept: dict[Any, tuple[float, float]] = {}
        self._then: dict[Any, float] = {}
        self._ready: tuple[Course, Decision] | None = None

    @property
    def _frequency(self) -> float:
        """Frames per second, as the environment is configured now."""
        return float(self._base.config["simulation_frequency"])

    @property
    def violations(self) -> int:
        """How often the traffic has broken the assumptions."""
        return self._past.total() + self.watch.count

    @property
    def by_rule(self) -> dict[str, int]:
        """The same by the rule that was broken."""
        return {str(rule): count for rule, count in (self._past + Counter(self.watch.by_rule)).items()}

    @property
    def ahead(self) -> dict[tuple[str, str, int], list[tuple[str, str, int]]]:
        """The lanes that each lane of the road leads to."""
        return {
            lane: [self._names[k] for k in row if k >= 0]
            for lane, row in zip(self._names, self._road.ways.after, strict=True)
        }

    @property
    def over(self) -> dict[tuple[str, str, int], tuple[str, str, int]]:
        """The lane that one has to come over to from each that ends."""
        return {self._names[k]: self._names[beside] for k, beside in enumerate(self._road.ways.over) if beside >= 0}

    @property
    def foreseen(self) -> Foreseen:
        """What the last decision has gone by."""
        return foreseen(self._others, self._trial, self._names)

    def counts_on(self, body: Any) -> bool:
        """Whether another vehicle has been counted on to wait for the ego, and has had the time to react: unless it
        brakes now, it may break the rule of the right of way (`shield.certificate.network.monitor`)."""
        return self._dues.counts_on(body, self._road.duty.reaction)

    def is_owed_by(self, body: Any) -> bool:
        """Whether another vehicle owes the ego its distance: it is behind it, and is believed to brake in time."""
        return self._dues.is_owed_by(body)

    def culprits(self, bodies: Iterable[Any]) -> set[Any]:
        """Who of those that the ego has just crashed with had broken a rule, or has since the last frame."""
        hit = set(bodies)
        for body in hit:
            body.crashed = False
        try:
            seen = self._look()
            load_ego(self._base, self._alone.rules, self._index, self._alone.worlds)
            self._alone.worlds.g[0, [CRASHED, IMPACTED]] = 0
            late = set() if self._stored is None else self._braking.now(self._stored, seen)[1]
            return self.watch.judge(seen, hit, self._road, late)
        finally:
            for body in hit:
                body.crashed = True

    def have_broken(self, bodies: Iterable[Any], since: Seen) -> set[Any]:
        """Who of these has broken a rule from a scene on, a frame ago, to the one seen last, whether or not what is
        verified suffers from it."""
        last = self.watch.last
        return set() if last is None else Watch(last=since).judge(last, set(bodies), self._road, set())

    def record(self) -> None:
        """Keep in each decision what is drawn, as with `ShieldConfig.record`."""
        self.config = self.config.replace(record=True)

    def reset(self) -> None:
        """Forget everything about the episode.

        Raises
        ------
        ConfigError, SceneError
            As of the class, if the environment is now configured otherwise.
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
            reason, self.cause = why_unread(error)
            self._wish, proposed = None, self._idle()
            decision = Decision(shown, proposed, reason, Tier.EMERGENCY, np.nan, 0.0)
        return replace(decision, proposed=shown, executed=proposed, latency=perf_counter() - start)

    def frame(self) -> tuple[Command, Decision]:
        """What the actuators get for the next frame, None where the environment's own stands; and the record."""
        start = perf_counter()
        try:
            if self._ready is None:
                self._read()
                self._ready = self._choose()
            (course, decision), self._ready = self._ready, None
            self._go(course, decision.tier)
            command = self._command(decision.tier)
            executed = decision.executed if command is None else command
            return command, replace(decision, executed=executed, latency=perf_counter() - start)
        except Exception as error:
            reason, self.cause = why_unread(error)
            self._stored = None
            speed = float(getattr(self._base.vehicle, "speed", 0.0))
            brake = limited_braking(-self.config.braking, speed, self._frequency)
            inputs = {"acceleration": brake, "steering": 0.0}
            return inputs, Decision(-1, -1, reason, Tier.EMERGENCY, np.nan, perf_counter() - start)

    def look(self) -> None:
        """Judge the others in the last frame of an episode, after which nothing is decided."""
        try:
            self._read()
        except Exception as error:
            _, self.cause = why_unread(error)

    def mask(self) -> np.ndarray[Any, Any]:
        """Which actions verify now; all True where none does. No decision, and no record, is another for being asked.

        Raises
        ------
        SceneError
            If the scene cannot be read.
        """
        kept = {name: value for name, value in vars(self).items() if name in _OF_A_DECISION}
        mask = np.zeros(len(self._base.action_type.actions), dtype=bool)
        try:
            check_readable(self._see())
            self._trial = empty_trial(self._frames, len(self._names), len(self._who))
            for action in range(len(mask)):
                load_ego(self._base, self._alone.rules, self._index, self._alone.worlds)
                self._intend(action)
                mask[action] = self._choose()[1].tier is Tier.PASSED
        finally:
            vars(self).update(kept)
        return mask if mask.any() else np.ones_like(mask)

    def _intend(self, action: int) -> None:
        """Take a meta-action for what is wished from now on."""
        alone, self._left = self._alone, self._bound
        command(alone.machine, alone.worlds, alone.rules, 0, 0, action)
        self._wish = Wish(self._bound, float(alone.worlds.f[0, TARGET_SPEED, 0]))

    def _idle(self) -> int:
        labels = self._base.action_type.actions_indexes
        return int(labels.get("IDLE", labels.get("SLOWER", 0)))

    @property
    def _bound(self) -> int:
        """The lane that the ego is bound for."""
        return int(self._alone.worlds.g[0, TARGET, 0])

    def _lanes(self) -> list[int]:
        """The lane that the ego is bound for, and on the same road those that it was bound for before the decision, and
        that it is on: it may not have left them yet."""
        ids, bound = self._road.lanes.ids, self._bound
        own = int(self._alone.worlds.g[0, LANE, 0])
        return [bound, *(lane for lane in (self._left, own) if lane >= 0 and ids[lane, ROAD] == ids[bound, ROAD])]

    def _furnish(self) -> None:
        """Room for the episode's road."""
        base = self._base
        if len(base.controlled_vehicles) != 1:
            raise SceneError(f"have one ego on a road network, not {len(base.controlled_vehicles)}")
        stays = {} if self._network is None else self._braking.stays
        self._alone: Alone = alone_on(base)
        self._network, self._index = base.road.network, index_of(base.road.network)
        self._names = list(self._index)
        self._road = road_of(base, self._alone, self.config)
        self._bare = bare(self._road)
        self._frames = frames_of(self._frequency)
        self._braking: Braking = Braking.on(self._alone, self._road, self._frames, stays)
        self._outlook = Outlook(base, self._alone, self._road, self._frames)
        self._trial = empty_trial(self._frames, len(self._names), 0)

    def _read(self) -> None:
        """Take in the scene, and once what has become of it since the one before."""
        seen, frame = self._see(), int(self._base.steps)
        if frame != self._judged:
            self._watch(seen)
            self._judged = frame
        check_readable(seen)
        self._others.offends[:] = [body in self.watch.offenders for body in seen.who]

    def _see(self) -> Seen:
        """Look at the scene."""
        base = self._base
        if base.road.network is not self._network or length_of_route(base) > self._alone.worlds.routes.shape[2]:
            self._furnish()
        load_ego(base, self._alone.rules, self._index, self._alone.worlds)
        seen = self._look()
        self._others, self._who = seen.others, seen.who
        if len(self._trial.margins) != len(seen.who):
            self._trial = empty_trial(self._frames, len(self._names), len(seen.who))
        if self.watch.last is None:
            # Whoever is behind when it all begins has seen the ego for long.
            self._try(stopping(self._bound, self.config.braking))
            self._keep_distance(seen.who, True)
        return seen

    def _look(self) -> Seen:
        """The others, and where they can be."""
        return self._outlook.look(self._dues)

    def _watch(self, seen: Seen) -> None:
        """Who has broken a rule since the scene before."""
        margins, late, self.kept, ego = None, set[Any](), {}, self._base.vehicle
        # Who has been hit does not do what it is told; who is about to be has done it so far, and is judged unpushed.
        # A plan ends where the road does: nothing is promised of what highway-env has the ego do then.
        if self._stored is not None and not ego.crashed and not self._at_end():
            flags = self._alone.worlds.g[0, IMPACTED]
            pushed, flags[:] = flags.copy(), 0
            margins, late = self._braking.now(self._stored, seen)
            flags[:] = pushed
            self.kept = {b: (self._then[b], float(margins[i])) for i, b in enumerate(seen.who) if b in self._then}
        self.watch.next(seen, set(self._then), margins, self._road, late)
        self.disturbed = self.disturbed or bool(self.watch.offenders)

    def _at_end(self) -> bool:
        """Whether the ego has come to the end of its road."""
        worlds = self._alone.worlds
        return bool(on_way(self._alone.rules, worlds.f[0], worlds.g[0])[1])

    def _try(self, course: Course) -> None:
        """Have the trial hold what comes of a course; whoever owes the ego its distance keeps it."""
        try_course(self._alone, self._road, self._others, np.array(course, float), True, self._trial)

    def _keep_distance(self, who: list[Any], verified: bool) -> None:
        """Who owes the ego its distance from now on, where it goes on with what the trial holds."""
        self._dues.keep_distance(who, self._others, self._trial, self._road, verified)

    def _choose(self) -> tuple[Course, Decision]:
        """What is gone on with, and the record of it."""
        alone, braking = self._alone, self.config.braking
        if self._wish is None:
            self._wish = Wish(self._bound, float(alone.worlds.f[0, TARGET_SPEED, 0]))
        speed, several = float(alone.worlds.f[0, SPEED, 0]), self._road.lanes.ids[self._wish.lane, COUNT] > 1
        tried = list(courses_of(self._wish, self._stored, speed, self._lanes(), several, self._frequency, braking))
        courses = np.array([course for course, _ in tried], float)
        room = self._trial, self._braking.bodies
        found: Choice = choose(alone, self._road, self._bare.body, self._others, courses, *room)
        margin, who, evades = found.margin, found.vehicle, found.innocent >= CLEAR
        if margin < CLEAR and found.clear == 0:
            # The buffer is gone: what is left to save is the body.
            evades, found = False, save(alone, self._bare, self._others, courses, speed, *room)
        course, tier = tried[found.course]
        reason = Reason.NONE if tier is Tier.PASSED else Reason.UNVERIFIED
        if margin < CLEAR:
            reason = Reason.NO_SAFE_PLAN
            tier = Tier.EVADED if evades else Tier.LARGEST_MARGIN
        source = None if tier is Tier.PASSED else self._kept(tried)
        plan = self.foreseen.path if self.config.record else None
        return course, Decision(-1, -1, reason, tier, float(margin), 0.0, plan, vehicle=int(who), source=source)

    def _kept(self, tried: list[tuple[Course, Tier]]) -> Source:
        """What a decision is made from, for whoever asks why."""
        ego, labels = self._base.vehicle, action_labels(self._base)
        return on_roads(
            self._alone,
            road=self._road,
            body=self._bare.body,
            others=self._others,
            who=self._who,
            tried=tried,
            lanes=[body.lane_index for body in self._who],
            labels=[labels[k] for k in sorted(labels)],
            size=(float(ego.LENGTH), float(ego.WIDTH)),
        )

    def _go(self, course: Course, tier: Tier) -> None:
        """Remember what is gone on with; the trial holds what comes of it."""
        who = [] if self.watch.last is None else self.watch.last.who
        self._then = {body: float(self._trial.margins[i]) for i, body in enumerate(who)} if tier.verified else {}
        self.disturbed = self.disturbed and not tier.verified
        self._keep_distance(who, tier.verified)
        self._braking.remember(course, who, self._others)
        if self._road.duty.gives_way:
            self._dues.give_way(who, self._others, self._trial, self._road, tier.verified)
        bound = int(self._trial.bound[0])
        self._stored = gone_on_with(course, bound)
        if self._wish is not None and course.lane == self._wish.lane and course.frames >= 1:
            self._wish = self._wish._replace(lane=bound)

    def _command(self, tier: Tier) -> Command:
        ego, lane = self._base.vehicle, self._names[int(self._trial.bound[0])]
        if tier is Tier.PASSED and self._index[ego.target_lane_index] == int(self._trial.bound[0]):
            return None
        ego.target_lane_index = lane
        return {"acceleration": float(self._trial.first[0]), "steering": float(self._trial.first[1])}
