"""The door for meta-actions on road networks whose traffic may do whatever the assumptions permit."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache
from time import perf_counter
from typing import Any

import gymnasium as gym
import numpy as np

from dynamics.networks.alone import Alone, alone_on
from dynamics.networks.continuations import continuations_of, leads_over
from dynamics.networks.engine import command
from dynamics.networks.lanes import Lanes
from dynamics.networks.layout import COUNT, PRIORITY
from dynamics.networks.live import load_ego, longest_route
from dynamics.networks.network import index_of
from dynamics.networks.prediction import STRIP, Conduct, Strips, Ways, reach, spread
from dynamics.networks.rights import ranks_of, rights_of
from dynamics.simulator.layout import SPEED, TARGET, TARGET_SPEED
from dynamics.state import FloatArray
from shield.config import ShieldConfig
from shield.decision import Decision, Reason, Tier
from shield.doors.discrete_action import action_index
from shield.doors.exact_scene import why_unread
from shield.doors.input_door import refuse_lots
from shield.doors.supervision import Command
from shield.errors import SceneError
from shield.procedures.warm_up import announced
from shield.refusals import refuse_simulated
from shield.roads.choosing import CLEAR, Choice, choose, try_course
from shield.roads.reading import read_traffic
from shield.roads.room import Duty, Foreseen, Others, Road, Trial, empty_trial, foreseen
from shield.roads.survey import Body, circles_of
from shield.roads.watch import Breach, Seen, Watch, behind

__all__ = ["RoadDoor", "warm_up_roads"]

_ON = (0.0, 0.5, 1.0, 2.0, 3.0, 4.0)
"""For how long a course may be kept beyond the coming frame before the ego brakes [s]."""
_SPEEDS = 8
"""Speeds between that of a decision and standing still that are tried in its place."""
_STOP = 5.0
"""Longer than it takes to brake to a standstill [s]."""
_ROOM = 1024
_COMMITTED = 1e3
"""Stands for highway-env's own speed controller, which brakes as hard as it likes [m/s^2]."""


class RoadDoor:
    """Filters the meta-actions of one environment on a road network, frame by frame.

    Each frame the decision's lane and speed are followed by the ego, alone, for some time, and then braking to a
    standstill; this path has to stay clear of every place where anybody may be (`shield.roads.judging`). Where none
    does, the greatest lower speed that does is taken, or what was verified a frame before.

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
        refuse_simulated(config)
        self.config, self._base, self.cause = config, base, ""
        self._frequency = base.config["simulation_frequency"]
        self._past: Counter[Breach] = Counter()
        self.watch = Watch()
        self._forget()
        if base.road is not None:
            self._furnish()

    def _forget(self) -> None:
        self._past.update(self.watch.by_rule)
        self.watch = Watch()
        self._network: Any = None
        self._owes: dict[Any, set[int]] = {}
        self._gives: dict[Any, dict[int, int]] = {}
        self._stored: FloatArray | None = None
        self._clear: set[Any] = set()
        self._wish: tuple[int, float] | None = None
        self.disturbed = False
        self.kept: dict[Any, tuple[float, float]] = {}
        self._then: dict[Any, float] = {}
        self._ready: tuple[tuple[FloatArray, Tier], Decision] | None = None

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
    def foreseen(self) -> Foreseen:
        """What the last decision has gone by."""
        return foreseen(self._others, self._trial, self._names)

    def counts_on(self, body: Any) -> bool:
        """Whether another vehicle has been counted on to wait for the ego, and has had the time to react: unless it
        brakes now, it may break the rule of the right of way (`shield.roads.watch`)."""
        return max(self._gives.get(body, {}).values(), default=0) > self._road.duty.reaction

    def is_owed_by(self, body: Any) -> bool:
        """Whether another vehicle owes the ego its distance: it is behind it, and is believed to brake in time."""
        return bool(self._owes.get(body))

    def culprits(self, bodies: Iterable[Any]) -> set[Any]:
        """Who of those that the ego has just crashed with had broken a rule, or has since the last frame."""
        hit = set(bodies)
        for body in hit:
            body.crashed = False
        try:
            return self.watch.judge(self._look(), hit, self._road)
        finally:
            for body in hit:
                body.crashed = True

    def have_broken(self, bodies: Iterable[Any], since: Seen) -> set[Any]:
        """Who of these has broken a rule from a scene on, a frame ago, to the one seen last, whether or not what is
        verified suffers from it."""
        last = self.watch.last
        return set() if last is None else Watch(last=since).judge(last, set(bodies), self._road)

    def reset(self) -> None:
        """Forget everything about the episode."""
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
            made = self._choose()
            self._ready = made
            decision = made[1]
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
            made = self._choose() if self._ready is None else self._ready
            self._ready = None
            (choice, tier), decision = made
            self._go(choice, tier)
            return self._command(tier), replace(decision, latency=perf_counter() - start)
        except Exception as error:
            reason, self.cause = why_unread(error)
            self._stored = None
            speed = float(getattr(self._base.vehicle, "speed", 0.0))
            brake = max(-self.config.braking, -max(speed, 0.0) * self._frequency)
            inputs = {"acceleration": brake, "steering": 0.0}
            return inputs, Decision(-1, -1, reason, Tier.EMERGENCY, np.nan, perf_counter() - start)

    def mask(self) -> np.ndarray[Any, Any]:
        """Which actions verify now; all True where none does.

        Raises
        ------
        SceneError
            If the scene cannot be read.
        """
        kept = self._wish
        mask = np.zeros(len(self._base.action_type.actions), dtype=bool)
        self._read()
        for action in range(len(mask)):
            load_ego(self._base, self._alone.rules, self._index, self._alone.worlds)
            self._intend(action)
            mask[action] = self._choose()[0][1] is Tier.PASSED
        self._wish = kept
        return mask if mask.any() else np.ones_like(mask)

    def _intend(self, action: int) -> None:
        """Take a meta-action for what is wished from now on."""
        alone = self._alone
        command(alone.machine, alone.worlds, alone.rules, 0, 0, action)
        self._wish = int(alone.worlds.g[0, TARGET, 0]), float(alone.worlds.f[0, TARGET_SPEED, 0])

    def _idle(self) -> int:
        labels = self._base.action_type.actions_indexes
        return int(labels.get("IDLE", labels.get("SLOWER", 0)))

    def _furnish(self) -> None:
        """Room for the episode's road."""
        base, a, buffer = self._base, self.config.assumptions, self.config.buffer
        if len(base.controlled_vehicles) != 1:
            raise SceneError(f"have one ego on a road network, not {len(base.controlled_vehicles)}")
        self._alone: Alone = alone_on(base)
        self._network, self._index = base.road.network, index_of(base.road.network)
        self._names = list(self._index)
        network, machine = self._alone.rules.network, self._alone.machine
        lanes = Lanes(machine.sums, machine.loops, network.lanes, network.ids)
        ways = Ways(*continuations_of(base.road.network), leads_over(base.road.network))
        circles = np.zeros((len(network.lanes), 3))
        circles_of(lanes, circles)
        length, width = base.vehicle.LENGTH / 2, base.vehicle.WIDTH / 2
        body = Body(length, width, length + buffer.longitudinal, width + buffer.lateral, a.visible_distance)
        self._road = Road(
            lanes=lanes,
            circles=circles,
            rights=rights_of(network.ids[:, PRIORITY], ways),
            ways=ways,
            conduct=Conduct(a.braking, a.acceleration, a.max_speed, a.waver, a.lean),
            duty=Duty(
                a.follower_braking,
                int(np.ceil(a.reaction_time * self._frequency - 1e-9)),
                a.looks_ahead,
                a.gives_way,
            ),
            body=body,
            period=1 / self._frequency,
        )
        bare = body._replace(along=length, across=width)
        self._bare = self._road._replace(body=bare)
        self._frames = int(np.ceil((max(_ON) + _STOP) * self._frequency))
        self._trial: Trial = empty_trial(self._frames, len(network.lanes), 0)
        self._strips = _room_for(_ROOM)

    def _read(self) -> None:
        """Take in the scene."""
        base = self._base
        if base.road.network is not self._network or longest_route(base) > self._alone.worlds.routes.shape[2]:
            self._furnish()
        load_ego(base, self._alone.rules, self._index, self._alone.worlds)
        seen = self._look()
        self._others = seen.others
        if len(self._trial.margins) != len(seen.who):
            self._trial = empty_trial(self._frames, len(self._road.circles), len(seen.who))
        self._watch(seen.who)

    def _look(self) -> Seen:
        """The others, and where they can be."""
        seen = read_traffic(self._base, self._alone.rules.network, self._index)
        m, n = len(seen.rows), len(self._road.circles)
        drive = np.zeros((m, 3))
        road = self._road
        while True:
            strips = self._strips
            given = seen.rows, seen.own, seen.routes
            count = spread(road.lanes, road.ways, road.conduct, *given, strips, drive)
            if count <= len(strips.marks):
                break
            self._strips = _room_for(2 * len(strips.marks))
        least, most = np.zeros((2, m, self._frames + 3))
        reach(self._road.conduct, seen.rows, drive, self._road.period, least, most)
        owes, gives = np.zeros((m, n), dtype=bool), np.zeros((m, n), np.int64)
        for i, body in enumerate(seen.who):
            owes[i, list(self._owes.get(body, ()))] = True
            for lane, since in self._gives.get(body, {}).items():
                gives[i, lane] = since
        ranks = np.zeros(count, np.int64)
        if road.duty.gives_way:
            ranks_of(road.ways, road.rights, strips.marks[:count], ranks)
        others = Others(
            rows=seen.rows,
            things=seen.things,
            marks=strips.marks[:count].copy(),
            numbers=strips.numbers[:count].copy(),
            found=np.array([count]),
            drive=drive,
            least=least,
            most=most,
            owes=owes,
            offends=np.zeros(m, dtype=bool),
            gives=gives,
            ranks=ranks,
            waits=np.zeros(count, dtype=bool),
            shut=np.zeros(count, dtype=bool),
            lanes=np.unique(strips.marks[:count, 1]),
        )
        return Seen(seen.who, others)

    def _watch(self, who: list[Any]) -> None:
        margins, self.kept = None, {}
        ego = self._base.vehicle
        # Who has been hit does not do what it is told.
        if self._stored is not None and not ego.crashed:
            self._try_again(self._stored)
            margins = self._trial.margins
            self.kept = {b: (self._then[b], float(margins[i])) for i, b in enumerate(who) if b in self._then}
        first = self.watch.last is None
        self.watch.next(Seen(who, self._others), self._clear, margins, self._road)
        self.disturbed = self.disturbed or bool(self.watch.offenders)
        self._others.offends[:] = [body in self.watch.offenders for body in who]
        if first:
            # Whoever is behind when it all begins has seen the ego for long.
            stop = np.array([self._alone.worlds.g[0, TARGET, 0], 0.0, _COMMITTED, 0, 0, self.config.braking], float)
            try_course(self._alone, self._road, self._others, stop, True, self._trial)
            self._owe(True)

    def _try_again(self, stored: FloatArray) -> None:
        """What was verified a frame before, in this scene. A blow comes with the next frame: so far who is about to get
        one has done what it was told, and is judged without it."""
        ego, alone = self._base.vehicle, self._alone
        impact, ego.impact = ego.impact, None
        if impact is not None:
            load_ego(self._base, alone.rules, self._index, alone.worlds)
        try:
            try_course(alone, self._road, self._others, stored, True, self._trial)
        finally:
            ego.impact = impact
            if impact is not None:
                load_ego(self._base, alone.rules, self._index, alone.worlds)

    def _owe(self, verified: bool) -> None:
        """Who owes the ego its distance from now on: whoever did, and is still behind it in a lane where it is seen;
        where its path is verified, all who are. `_trial` begins where the ego is."""
        there = behind(
            self._others, self._trial.boxes, self._trial.seen, self._road.duty.ahead, self.config.buffer.longitudinal
        )
        if not verified:
            there &= self._others.owes
        self._others.owes[:] = there
        who = self.watch.last.who if self.watch.last is not None else []
        self._owes = {body: set(np.flatnonzero(there[i]).tolist()) for i, body in enumerate(who) if there[i].any()}

    def _give_way(self, verified: bool) -> None:
        """Who is counted on to wait from now on: `Others.waits` is of the path that is taken. Where it is not verified,
        nobody is of whom it was not known before."""
        others = self._others
        gives: dict[Any, dict[int, int]] = {}
        who = self.watch.last.who if self.watch.last is not None else []
        for j in np.flatnonzero(others.waits & (others.ranks < self._road.rights[self._trial.own[0]])):
            i, lane = others.marks[j, :2]
            since = int(others.gives[i, lane])
            if verified or since > 0:
                gives.setdefault(who[i], {})[int(lane)] = since + 1
        self._gives = gives

    def _courses(self) -> tuple[FloatArray, list[Tier]]:
        """What is tried, in order."""
        assert self._wish is not None
        lane, speed = self._wish
        hard, f = self.config.braking, self._frequency
        frames = [1 + round(t * f) for t in _ON]
        rows: list[tuple[float, ...]] = []
        tiers: list[Tier] = []
        stored = self._stored
        same = stored is not None and int(stored[0]) == lane and stored[1] == speed and stored[2] == _COMMITTED
        if same and stored is not None and stored[3] >= 1:
            rows.append(tuple(stored))
            tiers.append(Tier.PASSED)
        asides = (0, -1, 1) if self._road.lanes.ids[lane, COUNT] > 1 else (0,)
        for aside in asides:
            for n in frames:
                rows.append((lane, speed, _COMMITTED, n, aside, hard))
                tiers.append(Tier.PASSED)
        now = float(self._alone.worlds.f[0, SPEED, 0])
        top = max(min(speed, now + 5.0), 0.0)
        lanes = [lane]
        bound = int(self._alone.worlds.g[0, TARGET, 0])
        if stored is not None and int(stored[0]) not in lanes:
            lanes.append(int(stored[0]))
        if bound not in lanes:
            lanes.append(bound)
        for each in lanes:
            for k in range(0 if each != lane else 1, _SPEEDS + 1):
                rows.append((each, top * (1 - k / _SPEEDS), hard, 1, 0, hard))
                tiers.append(Tier.GOVERNED)
        if stored is not None:
            rows.append(tuple(stored))
            tiers.append(Tier.GOVERNED)
        for each in lanes:
            for k in range(0, _SPEEDS + 1, 2):
                for n in frames[2:]:
                    rows.append((each, top * (1 - k / _SPEEDS), hard, n, 0, hard))
                    tiers.append(Tier.GOVERNED)
        return np.array(rows, float), tiers

    def _choose(self) -> tuple[tuple[FloatArray, Tier], Decision]:
        if self._wish is None:
            self._wish = int(self._alone.worlds.g[0, TARGET, 0]), float(self._alone.worlds.f[0, TARGET_SPEED, 0])
        courses, tiers = self._courses()
        found: Choice = choose(self._alone, self._road, self._others, courses, self._trial)
        margin, who, evades = found.margin, found.vehicle, found.innocent >= CLEAR
        if margin < CLEAR and found.clear == 0:
            # The buffer is gone: what is left to save is the body.
            evades, found = False, self._save(courses)
        course, tier = courses[found.course], tiers[found.course]
        reason = Reason.NONE if tier is Tier.PASSED else Reason.UNVERIFIED
        if margin < CLEAR:
            reason = Reason.NO_SAFE_PLAN
            tier = Tier.EVADED if evades else Tier.LARGEST_MARGIN
        decision = Decision(-1, -1, reason, tier, float(margin), 0.0, vehicle=int(who))
        return (course, tier), decision

    def _save(self, courses: FloatArray) -> Choice:
        """What keeps the body clear, or does for longest; nothing faster than now, where that does as long."""
        now = float(self._alone.worlds.f[0, SPEED, 0])
        slower = np.flatnonzero((courses[:, 1] <= now) & (courses[:, 2] < _COMMITTED))
        least = Choice(-1, -np.inf, -1, -1, -np.inf, 0.0)
        if slower.size:
            least = choose(self._alone, self._bare, self._others, courses[slower], self._trial)
        if least.margin < CLEAR:
            most: Choice = choose(self._alone, self._bare, self._others, courses, self._trial)
            if most.margin >= CLEAR or most.clear > least.clear:
                return most
            # The trial holds what comes of what was judged last.
            least = choose(self._alone, self._bare, self._others, courses[slower], self._trial)
        return least._replace(course=int(slower[least.course]))

    def _go(self, course: FloatArray, tier: Tier) -> None:
        """Remember what is gone on with."""
        # trial holds what comes of the course that was chosen.
        who = self.watch.last.who if self.watch.last is not None else []
        self._clear = set(who) if tier.verified else set()
        self._then = {body: float(self._trial.margins[i]) for i, body in enumerate(who)} if tier.verified else {}
        self.disturbed = self.disturbed and not tier.verified
        self._owe(tier.verified)
        if self._road.duty.gives_way:
            self._give_way(tier.verified)
        self._stored = course.copy()
        self._stored[3] = max(course[3] - 1, 0)
        bound = self._trial.bound
        if course[3] < 1 and course[4] != 0:
            self._stored[4] = 0.0
        self._stored[0] = bound[0]
        if self._wish is not None and int(course[0]) == self._wish[0]:
            self._wish = int(bound[0]) if course[3] >= 1 else self._wish[0], self._wish[1]

    def _command(self, tier: Tier) -> Command:
        ego, lane = self._base.vehicle, self._names[int(self._trial.bound[0])]
        if tier is Tier.PASSED and self._index[ego.target_lane_index] == int(self._trial.bound[0]):
            return None
        ego.target_lane_index = lane
        return {"acceleration": float(self._trial.first[0]), "steering": float(self._trial.first[1])}


@cache
def warm_up_roads() -> None:
    """What `warm_up` does for the other doors."""
    with announced(60):
        env = gym.make("roundabout-v1")
        env.reset(seed=0)
        door = RoadDoor(env.unwrapped, ShieldConfig.for_roads())
        door.decide(1)
        door.frame()


def _room_for(count: int) -> Strips:
    return Strips(np.zeros((count, 3), np.int64), np.zeros((count, STRIP)))
