"""Traffic on straight highways that keeps to every rule and is as reckless as the rules permit, in highway-env itself.

highway-env's own traffic uses little of what the certificate permits. These drivers use it: they brake for nothing as
hard as anybody may who is not asked to, accelerate as hard as can be, close in on the ego until they can just stop
behind it, straddle lanes, turn in before it with the least room that they owe, and change lanes as MOBIL has it. They
know `Assumptions.idm()` and nothing of what the shield is told. So a shield that is told the truth has nothing to name
and nothing to fear; one that is told too little has: a crash or a breach of the buffer with nobody named is a hole,
and somebody named who has done no wrong is a wrong assumption.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.kinematics import Vehicle
from joblib import Parallel, delayed

from dynamics.traffic.assumptions import Assumptions
from dynamics.traffic.rules_of_the_road import footprint, gap_between
from evaluation.settings import Setting
from evaluation.threads import one_thread
from shield import ShieldConfig, ShieldedEnv
from shield.config import Buffer
from shield.errors import ConfigError
from shield.filters.meta_actions import MetaDoor

__all__ = ["Bold", "BoldEpisode", "drive_bold", "drive_bold_many", "man_highway"]

RULES = Assumptions.idm()
"""What they keep to, whatever the shield is told."""
BUFFER = Buffer()
"""Whoever comes nearer to the ego has breached it."""
FAIL_SAFE = 9.8
"""How hard the ego may brake at any time [m/s^2]."""
_OFTEN = {"LANE_LEFT": 3.0, "LANE_RIGHT": 3.0, "FASTER": 2.0}
"""How often the ego proposes what, against 1 of the rest."""
_HELD = 2, 12
"""For how many frames what is held is held."""
_TOUCHES = 2.0
"""Half the width of a lane [m]."""
_REST = 2.5
"""How long one rests from going across the road: turning costs way, and nobody may lose much within a second [s]."""
_HASTE = 0.5, 2.0
"""They steer for no more than this at once: inside a lane, and from one to the next [m]."""
_ALIKE = 5.0
"""Whose speeds differ by less are about as fast [m/s]."""
_CRAWL = 12.0
"""They brake for nothing no further than to here: queues have rules of their own [m/s]."""
_HUNTS = 90.0
"""From so far behind the ego they mostly push [m]."""
_SETTLED = 0.3
"""Nearer to where they want to be across than this they are there [m]."""
_SPARE = 2.0, 5.0
"""What they keep to the ego's buffer beyond the ways to a standstill: behind it, and before it, where a lane change of
theirs may cost them way [m]."""
_AROUND = -90.0, 80.0
"""Where they start, from the ego [m]."""
_SPEEDS = (15.0, 30.0), (20.0, 36.0)
"""How fast they are at first, ahead of the ego and behind it [m/s]."""
_APART = 16.0
"""Two in one lane start no nearer than this, centre to centre, and with a second between them [m]."""


class Bold(IDMVehicle):  # type: ignore[misc]
    """As reckless as the rules permit; where they ask for more it brakes as IDM does, which they always permit."""

    target_lane_index: Any
    position: Any

    def take(self, draw: np.random.Generator, ego: Any, dt: float) -> None:
        """Be driven by these numbers, around this ego, in frames of so long [s]."""
        self.draw, self.ego, self.dt, self.left = draw, ego, dt, 0
        self.held, self.offset, self.rest = 0.0, 0.0, 0
        self.target_speed = RULES.max_speed

    def act(self, action: Any = None) -> None:
        """For the coming frame."""
        if self.crashed:
            return
        if self.left == 0:
            self._choose()
        self.left -= 1
        self.rest -= 1
        before = self.target_lane_index, self.offset
        if self.rest <= 0:
            self._go_across()
        self._hold_on()
        if (self.target_lane_index, self.offset) != before:
            self.rest = round(_REST / self.dt)
        wheel = float(np.clip(self._wheel(), -self.MAX_STEERING_ANGLE, self.MAX_STEERING_ANGLE))
        Vehicle.act(self, {"acceleration": self._acceleration(), "steering": wheel})

    def _choose(self) -> None:
        """What to do for a while: how hard to push or brake, and where to be across."""
        self.left = int(self.draw.integers(*_HELD))
        calm = RULES.calm_braking
        self.held = float(self.draw.choice([-calm, -calm, -0.5 * calm, 0.0, RULES.acceleration, RULES.acceleration]))
        if 0 < self.ego.position[0] - self.position[0] < _HUNTS and self.draw.random() < 0.8:
            self.held = RULES.acceleration

    def _go_across(self) -> None:
        """Where to be across: in another lane as MOBIL has it, or wherever there is room, or astride."""
        if self.target_lane_index != self.lane_index or abs(self._across() - self.offset) > _SETTLED:
            return
        if self.offset == 0.0:
            self._change_as_mobil()
        if self.target_lane_index != self.lane_index or self.left != 0:
            return
        habit, side = self.draw.random(), int(self.draw.choice([-1, 1]))
        if habit < 0.4:
            astride = side * float(self.draw.uniform(1.3, 1.9))
            self.offset = astride if self._lets_in(self.lane_index[2] + side) else 0.0
        elif habit < 0.7 and self.offset == 0.0:
            self._change(side)
        else:
            self.offset = 0.0

    def _change_as_mobil(self) -> None:
        """Whether or not that leaves the ego room, as long as both are about as fast: so does highway-env's traffic."""
        self.change_lane_policy()
        if abs(self.speed - self.ego.speed) > _ALIKE and not self._leaves_room(self.target_lane_index[2]):
            self.target_lane_index = self.lane_index

    def _change(self, side: int) -> None:
        """Go to the next lane, where there is one, and room for everybody."""
        start, end, k = self.target_lane_index
        if self._lets_in(k + side):
            self.target_lane_index = (start, end, k + side)

    def _lets_in(self, lane: int) -> bool:
        """Whether there is such a lane, in which nobody has to brake hard for it, nor it for anybody."""
        if not 0 <= lane < self._lanes or not self._leaves_room(lane):
            return False
        first, last = self.road.neighbour_vehicles(self, (*self.lane_index[:2], lane))
        asked = [self.acceleration(self, first) if first is not None else 0.0]
        if last is not None and last is not self.ego:
            asked.append(self.acceleration(last, self))
        return bool(min(asked) >= -self.LANE_CHANGE_MAX_BRAKING_IMPOSED)

    def _hold_on(self) -> None:
        """Take back what would leave the ego no room, as long as no other lane is touched."""
        _, _, k = self.lane_index
        at = self._across()
        across = self.speed * np.sin(self.heading) * self.dt
        touching = abs(at) + 0.5 * self.WIDTH > _TOUCHES
        into = self.target_lane_index[2] - k or (int(np.sign(self.offset)) if self.offset else 0)
        if into == 0 or touching:
            return
        near = abs(at + 2 * across) + 0.5 * self.WIDTH > _TOUCHES - 0.6
        inside = 0 <= k + into < self._lanes
        if not inside or (near and not self._leaves_room(k + into)):
            self.target_lane_index, self.offset = self.lane_index, 0.0

    def _leaves_room(self, lane: int) -> bool:
        """Whether the ego could still stop behind it there, or it behind the ego."""
        ego = self.ego
        start, end, _ = self.lane_index
        across = float(self.road.network.get_lane((start, end, lane)).local_coordinates(ego.position)[1])
        if abs(across) > 3.5 and ego.target_lane_index[2] != lane:
            return True
        ahead = float(self.position[0] - ego.position[0])
        gap = abs(ahead) - 0.5 * (self.LENGTH + ego.LENGTH) - BUFFER.longitudinal
        mine, yours = max(self.speed, 0.0), max(ego.speed, 0.0)
        if ahead > 0:
            pushed = yours + 10.0 * self.dt
            return bool(
                gap > _SPARE[1] + 3 * self.dt * yours + pushed**2 / (2 * FAIL_SAFE) - mine**2 / (2 * RULES.braking)
            )
        return bool(gap > _SPARE[0] + self._closing(mine, yours))

    def _closing(self, mine: float, yours: float) -> float:
        """How much of a gap behind the ego is lost until both stand, where it pushes for two more frames [m]."""
        pushed = mine + 2 * RULES.acceleration * self.dt
        return 2 * self.dt * pushed + pushed**2 / (2 * RULES.follower_braking) - yours**2 / (2 * FAIL_SAFE)

    def _acceleration(self) -> float:
        v = max(self.speed, 0.0)
        held = max(self.held, 0.0) if v < _CRAWL else self.held
        a = min(held, RULES.acceleration, RULES.power / max(v, 1.0), (RULES.max_speed - v) / self.dt)
        for lane in dict.fromkeys((self.lane_index, self.target_lane_index, self._leaning())):
            first, _ = self.road.neighbour_vehicles(self, lane)
            if first is None:
                continue
            if first is self.ego:
                gap = float(first.position[0] - self.position[0]) - 0.5 * (self.LENGTH + first.LENGTH)
                if gap - BUFFER.longitudinal < _SPARE[0] + self._closing(v, max(first.speed, 0.0)):
                    a = -RULES.braking
            elif lane != self._leaning() or lane == self.lane_index:
                asked = self.acceleration(self, first)
                off = abs(float(self.road.network.get_lane(lane).local_coordinates(first.position)[1]))
                touches = off - 0.5 * first.WIDTH < _TOUCHES - RULES.lean
                # Who only comes near the lane is nobody to brake hard for.
                a = min(a, asked if touches else max(asked, -RULES.calm_braking))
        return float(np.clip(a, max(-RULES.braking, -v / self.dt), RULES.acceleration))

    def _leaning(self) -> Any:
        """The lane that it straddles into, or its own."""
        start, end, k = self.lane_index
        other = k + int(np.sign(self.offset))
        return (start, end, other) if self.offset and 0 <= other < self._lanes else self.lane_index

    def _across(self) -> float:
        """How far it is from the middle of its lane [m]."""
        return float(self.lane.local_coordinates(self.position)[1])

    @property
    def _lanes(self) -> int:
        start, end, _ = self.lane_index
        return len(self.road.network.graph[start][end])

    def _wheel(self) -> float:
        """highway-env's own steering; astride a marking, to the offset from the middle of the lane, without haste."""
        here, lane = self.position, self.road.network.get_lane(self.target_lane_index)
        along, at = lane.local_coordinates(here)
        haste = _HASTE[self.target_lane_index != self.lane_index]
        off = float(np.clip(at - self.offset, -haste, haste))
        self.position = lane.position(along, off)
        try:
            return float(self.steering_control(self.target_lane_index))
        finally:
            self.position = here


@dataclass(frozen=True, slots=True)
class BoldEpisode:
    """What came of one episode, as far as the first breach or offence.

    Attributes
    ----------
    seed : to drive it again. frames : how many there were.
    started : whether the first decision was verified; nothing counts where it was not.
    clearance : the least separation of the ego with its `BUFFER` from anybody [m]; negative in a breach.
    crashed : whether the ego was. named : the rules that the monitor saw broken by then.
    """

    seed: int
    frames: int
    started: bool
    clearance: float
    crashed: bool
    named: dict[str, int]

    @property
    def breached(self) -> bool:
        """Whether the ego crashed or somebody was in its buffer."""
        return self.started and (self.crashed or self.clearance < 0)

    @property
    def unnamed(self) -> bool:
        """Whether it was breached and the monitor has named nobody: a hole."""
        return self.breached and not self.named

    @property
    def told(self) -> bool:
        """Whether it tells of a wrong assumption: somebody named who keeps to the rules, or a hole."""
        return self.started and (bool(self.named) or self.unnamed)


class _Referee:
    """Sees every frame of an episode: how near the ego comes, and whom the monitor has named by then."""

    def __init__(self, base: Any, door: MetaDoor) -> None:
        self._base, self._door, self._step = base, door, base.road.step
        self.frames, self.clearance, self.crashed, self.over = 0, float("inf"), False, False
        self.named: dict[str, int] = {}
        base.road.step = self._watched

    def look(self) -> None:
        """Whom the monitor has named in what it has seen; the episode is over with the first."""
        if not self.over:
            watch: Any = self._door.core.memory.watch
            self.named = {rule.name or str(rule): n for rule, n in watch.by_rule.items()}
            self.over = bool(self.named) or self.crashed or self.clearance < 0

    def _watched(self, dt: float) -> None:
        # By now the shield has seen what the last frame came to.
        self.look()
        self._step(dt)
        if self.over:
            return
        self.frames += 1
        ego, *others = self._base.road.vehicles
        rows = np.array([[*v.position, v.heading, v.speed, v.LENGTH, v.WIDTH, 0.0] for v in (ego, *others)])
        mine = footprint(rows[0], BUFFER.longitudinal, BUFFER.lateral)
        for i in range(1, len(rows)):
            self.clearance = min(self.clearance, gap_between(mine, mine.along, mine.across, rows, i, 0.0))
        self.crashed = bool(ego.crashed or ego.impact is not None)


def man_highway(base: Any, vehicles: int, seed: int) -> None:
    """Put so many bold drivers around the ego, in the place of whoever is there."""
    ego, road, draw = base.vehicle, base.road, np.random.default_rng([seed, 0])
    dt, lanes = 1 / base.config["simulation_frequency"], base.config["lanes_count"]
    road.vehicles, placed = [ego], [(ego.lane_index[2], float(ego.position[0]), float(ego.speed))]
    for k in range(20 * vehicles):
        lane, off = int(draw.integers(lanes)), draw.uniform(*_AROUND)
        speed = draw.uniform(*(_SPEEDS[0] if off > 0 else _SPEEDS[1]))
        if k == 0:
            # One comes up fast beside the ego's lane: whoever turns in before it counts on its brakes.
            lane, off, speed = (ego.lane_index[2] + 1) % lanes, draw.uniform(-50.0, -15.0), draw.uniform(30.0, 40.0)
        at = ego.position[0] + off
        near = [(x - at, v) for line, x, v in placed if line == lane]
        if any(abs(d) < _APART + (max(speed - v, 0.0) * 2 if d > 0 else max(v - speed, 0.0) * 2) for d, v in near):
            continue
        driver = Bold(road, road.network.get_lane(("0", "1", lane)).position(at, 0.0), 0.0, speed)
        driver.take(np.random.default_rng([seed, 1 + k]), ego, dt)
        driver.randomize_behavior()
        driver.check_collisions = base.vehicle.check_collisions and "fast" not in base.spec.id
        road.vehicles.append(driver)
        placed.append((lane, float(at), float(speed)))
        if len(placed) > vehicles:
            break


def drive_bold(
    setting: Setting, seed: int, config: ShieldConfig | None = None, vehicles: int = 8, decisions: int = 10
) -> BoldEpisode:
    """One episode of a shielded ego with actions at random among bold drivers, as far as the first breach or offence.

    Parameters
    ----------
    setting : a straight highway with meta-actions. seed : of everything. config : the shield's settings.
    vehicles : how many drivers. decisions : how many at most.

    Raises
    ------
    ConfigError
        If it is no straight highway with meta-actions, or the shield judges no others.
    """
    with one_thread():
        env = ShieldedEnv(setting.make(), config)
        try:
            return _drive(env, setting, seed, vehicles, decisions)
        finally:
            env.close()


def _drive(env: ShieldedEnv, setting: Setting, seed: int, vehicles: int, decisions: int) -> BoldEpisode:
    door, base = env.door, env.unwrapped
    if not isinstance(door, MetaDoor) or not door.supervising:
        raise ConfigError(f"bold drivers need a straight highway with meta-actions and a shield, not {setting.name}")
    env.reset(seed=seed)
    man_highway(base, vehicles, seed)
    actions, referee, started = np.random.default_rng([seed, 1_000_000]), _Referee(base, door), True
    labels = [str(base.action_type.actions[k]) for k in range(env.action_space.n)]  # type: ignore[attr-defined]
    often = np.array([_OFTEN.get(label, 1.0) for label in labels])
    for step in range(decisions):
        action = int(actions.choice(len(labels), p=often / often.sum()))
        *_, terminated, truncated, _ = env.step(action)
        if step == 0:
            started = env.decisions[0].tier.verified and env.frame_decisions[0].tier.verified
        if referee.over or terminated or truncated or not started:
            break
    if not referee.over:
        # The last frame has not been looked at.
        door.frame()
        referee.look()
    return BoldEpisode(seed, referee.frames, started, referee.clearance, referee.crashed, referee.named)


def drive_bold_many(
    setting: Setting,
    seeds: Sequence[int],
    config: ShieldConfig | None = None,
    vehicles: int = 8,
    decisions: int = 10,
    jobs: int = -1,
) -> list[BoldEpisode]:
    """`drive_bold` on each of the seeds, in so many processes (-1: one for each core)."""
    return list(Parallel(n_jobs=jobs)(delayed(drive_bold)(setting, s, config, vehicles, decisions) for s in seeds))
