"""Worst-case compliant traffic on straight highways, in highway-env itself.

highway-env's own traffic uses little of what the certificate permits. The drivers of this module use it:

- without cause they brake as hard as the rules allow, and they accelerate as hard as they can;
- they close in on the ego until they can just stop behind it;
- they straddle lanes, cut in before the ego with the smallest permitted gap, and change lanes by MOBIL.

They keep to `Assumptions.idm()` and do not read the shield's own assumptions. A shield with these assumptions should
record no violation, and no vehicle should enter the ego's buffer. With weaker assumptions it fails in one of two ways.
A crash or an intrusion into the buffer without a recorded violation is a hole in the certificate. A violation recorded
for a compliant driver shows a wrong assumption.
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
from shield.filters.meta_actions import MetaActionFilter

__all__ = [
    "CompliantEpisode",
    "CompliantHighwayDriver",
    "drive_compliant",
    "drive_compliant_many",
    "install_highway_drivers",
]

RULES = Assumptions.idm()
"""Assumptions that the drivers keep to, independent of the shield's."""
BUFFER = Buffer()
"""Buffer of the ego in this search; a vehicle inside it has intruded."""
FAIL_SAFE = 9.8
"""Hardest braking of the ego in its fail-safe [m/s^2]."""
_OFTEN = {"LANE_LEFT": 3.0, "LANE_RIGHT": 3.0, "FASTER": 2.0}
"""Weights of the ego's random proposals; every other action has the weight 1."""
_KEPT_FRAMES = 2, 12
"""Range of frames for which a drawn acceleration is kept; the end is exclusive."""
_TOUCHES = 2.0
"""Half the width of a lane [m]."""
_REST = 2.5
"""Pause after a lateral manoeuvre: turning shortens the way forward, and the rules bound that loss within a second [s].
"""
_HASTE = 0.5, 2.0
"""Largest lateral error that the steering tracks: inside a lane, and during a lane change [m]."""
_ALIKE = 5.0
"""Speed difference up to which two vehicles count as equally fast [m/s]."""
_CRAWL = 12.0
"""Below this speed there is no braking without cause, because queues have rules of their own [m/s]."""
_HUNTS = 90.0
"""Distance behind the ego within which a driver mostly accelerates [m]."""
_SETTLED = 0.3
"""Lateral error below which a driver has reached its offset [m]."""
_SPARE = 2.0, 5.0
"""Gap to the ego's buffer beyond the stopping distances: behind the ego, and ahead of it, where a lane change of the
driver may shorten its way [m]."""
_AROUND = -90.0, 80.0
"""Range of initial positions along the road, relative to the ego [m]."""
_SPEEDS = (15.0, 30.0), (20.0, 36.0)
"""Ranges of initial speed, ahead of the ego and behind it [m/s]."""
_APART = 16.0
"""Least initial distance of two vehicles in one lane, centre to centre, beside two seconds of their closing speed [m].
"""


class CompliantHighwayDriver(IDMVehicle):  # type: ignore[misc]
    """Worst-case compliant driver. Where the rules demand more it brakes by IDM, which they always permit."""

    target_lane_index: Any
    position: Any

    def take(self, draw: np.random.Generator, ego: Any, dt: float) -> None:
        """Set the random generator, the ego, and the duration of a frame [s]."""
        self.draw, self.ego, self.dt, self.left = draw, ego, dt, 0
        self.drawn_acceleration, self.offset, self.rest = 0.0, 0.0, 0
        self.target_speed = RULES.max_speed

    def act(self, action: Any = None) -> None:
        """Set acceleration and steering for the coming frame; `action` is ignored."""
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
        """Draw an acceleration and the number of frames for which it is kept."""
        self.left = int(self.draw.integers(*_KEPT_FRAMES))
        comfortable = RULES.comfortable_braking
        self.drawn_acceleration = float(
            self.draw.choice(
                [-comfortable, -comfortable, -0.5 * comfortable, 0.0, RULES.acceleration, RULES.acceleration]
            )
        )
        if 0 < self.ego.position[0] - self.position[0] < _HUNTS and self.draw.random() < 0.8:
            self.drawn_acceleration = RULES.acceleration

    def _go_across(self) -> None:
        """Choose a lateral target: a lane change by MOBIL or to any free lane, or an offset across a marking."""
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
        """Change lanes by MOBIL. At about the ego's speed without a check of its gap, like highway-env's traffic."""
        self.change_lane_policy()
        if abs(self.speed - self.ego.speed) > _ALIKE and not self._leaves_gap(self.target_lane_index[2]):
            self.target_lane_index = self.lane_index

    def _change(self, side: int) -> None:
        """Change to the next lane, if it exists and has room."""
        start, end, k = self.target_lane_index
        if self._lets_in(k + side):
            self.target_lane_index = (start, end, k + side)

    def _lets_in(self, lane: int) -> bool:
        """Whether the lane exists, and a change into it makes no vehicle but the ego brake hard."""
        if not 0 <= lane < self._lanes or not self._leaves_gap(lane):
            return False
        first, last = self.road.neighbour_vehicles(self, (*self.lane_index[:2], lane))
        accelerations = [self.acceleration(self, first) if first is not None else 0.0]
        if last is not None and last is not self.ego:
            accelerations.append(self.acceleration(last, self))
        return bool(min(accelerations) >= -self.LANE_CHANGE_MAX_BRAKING_IMPOSED)

    def _hold_on(self) -> None:
        """Cancel a lateral target that would leave the ego too little room, while no other lane is touched."""
        _, _, k = self.lane_index
        at = self._across()
        across = self.speed * np.sin(self.heading) * self.dt
        touching = abs(at) + 0.5 * self.WIDTH > _TOUCHES
        into = self.target_lane_index[2] - k or (int(np.sign(self.offset)) if self.offset else 0)
        if into == 0 or touching:
            return
        near = abs(at + 2 * across) + 0.5 * self.WIDTH > _TOUCHES - 0.6
        inside = 0 <= k + into < self._lanes
        if not inside or (near and not self._leaves_gap(k + into)):
            self.target_lane_index, self.offset = self.lane_index, 0.0

    def _leaves_gap(self, lane: int) -> bool:
        """Whether the ego could still stop behind the driver in that lane, or the driver behind the ego."""
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
        """Length by which a gap behind the ego shrinks until both stand, after two more frames of acceleration [m]."""
        pushed = mine + 2 * RULES.acceleration * self.dt
        return 2 * self.dt * pushed + pushed**2 / (2 * RULES.follower_braking) - yours**2 / (2 * FAIL_SAFE)

    def _acceleration(self) -> float:
        v = max(self.speed, 0.0)
        kept = max(self.drawn_acceleration, 0.0) if v < _CRAWL else self.drawn_acceleration
        a = min(kept, RULES.acceleration, RULES.power / max(v, 1.0), (RULES.max_speed - v) / self.dt)
        for lane in dict.fromkeys((self.lane_index, self.target_lane_index, self._leaning())):
            first, _ = self.road.neighbour_vehicles(self, lane)
            if first is None:
                continue
            if first is self.ego:
                gap = float(first.position[0] - self.position[0]) - 0.5 * (self.LENGTH + first.LENGTH)
                if gap - BUFFER.longitudinal < _SPARE[0] + self._closing(v, max(first.speed, 0.0)):
                    a = -RULES.braking
            elif lane != self._leaning() or lane == self.lane_index:
                by_idm = self.acceleration(self, first)
                off = abs(float(self.road.network.get_lane(lane).local_coordinates(first.position)[1]))
                touches = off - 0.5 * first.WIDTH < _TOUCHES - RULES.marking_tolerance
                # A vehicle that only comes near the lane is no reason for hard braking.
                a = min(a, by_idm if touches else max(by_idm, -RULES.comfortable_braking))
        return float(np.clip(a, max(-RULES.braking, -v / self.dt), RULES.acceleration))

    def _leaning(self) -> Any:
        """Index of the lane that the driver straddles into, or of its own lane."""
        start, end, k = self.lane_index
        other = k + int(np.sign(self.offset))
        return (start, end, other) if self.offset and 0 <= other < self._lanes else self.lane_index

    def _across(self) -> float:
        """Lateral offset from the centre line of its lane [m]."""
        return float(self.lane.local_coordinates(self.position)[1])

    @property
    def _lanes(self) -> int:
        start, end, _ = self.lane_index
        return len(self.road.network.graph[start][end])

    def _wheel(self) -> float:
        """Steering angle of highway-env's controller, with a bounded lateral error to the offset [rad]."""
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
class CompliantEpisode:
    """Result of one episode, up to the first intrusion into the buffer or violation.

    Attributes
    ----------
    seed : seed of the episode, to repeat it.
    frames : number of frames.
    started : whether the first decision was verified; otherwise the episode does not count.
    clearance : least distance of another vehicle from the ego with its `BUFFER` [m]; negative in an intrusion.
    crashed : whether the ego crashed.
    named : violations that the monitor recorded by then, by rule.
    """

    seed: int
    frames: int
    started: bool
    clearance: float
    crashed: bool
    named: dict[str, int]

    @property
    def breached(self) -> bool:
        """Whether the ego crashed or another vehicle was inside its buffer."""
        return self.started and (self.crashed or self.clearance < 0)

    @property
    def unnamed(self) -> bool:
        """Whether there was an intrusion without a recorded violation: a hole in the certificate."""
        return self.breached and not self.named

    @property
    def is_find(self) -> bool:
        """Whether the episode shows a wrong assumption, by a violation of a compliant driver, or a hole."""
        return self.started and (bool(self.named) or self.unnamed)


class _EpisodeMonitor:
    """Observes every frame of an episode: the ego's clearance, and the violations recorded by then."""

    def __init__(self, base: Any, action_filter: MetaActionFilter) -> None:
        self._base, self._action_filter, self._step = base, action_filter, base.road.step
        self.frames, self.clearance, self.crashed, self.over = 0, float("inf"), False, False
        self.named: dict[str, int] = {}
        base.road.step = self._watched

    def read_violations(self) -> None:
        """Read the violations that the monitor has recorded; the episode is over with the first."""
        if not self.over:
            watch: Any = self._action_filter.core.memory.watch
            self.named = {rule.name or str(rule): n for rule, n in watch.by_rule.items()}
            self.over = bool(self.named) or self.crashed or self.clearance < 0

    def _watched(self, dt: float) -> None:
        # By now the monitor has checked the previous frame.
        self.read_violations()
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


def install_highway_drivers(base: Any, vehicles: int, seed: int) -> None:
    """Replace the other vehicles by worst-case compliant drivers around the ego.

    Parameters
    ----------
    base : the unwrapped environment, changed in place.
    vehicles : number of drivers; fewer where there is no room.
    seed : seed of their positions and of their choices.
    """
    ego, road, draw = base.vehicle, base.road, np.random.default_rng([seed, 0])
    dt, lanes = 1 / base.config["simulation_frequency"], base.config["lanes_count"]
    road.vehicles, placed = [ego], [(ego.lane_index[2], float(ego.position[0]), float(ego.speed))]
    for k in range(20 * vehicles):
        lane, off = int(draw.integers(lanes)), draw.uniform(*_AROUND)
        speed = draw.uniform(*(_SPEEDS[0] if off > 0 else _SPEEDS[1]))
        if k == 0:
            # One vehicle approaches fast in the lane beside the ego's: a cut-in before it relies on its braking.
            lane, off, speed = (ego.lane_index[2] + 1) % lanes, draw.uniform(-50.0, -15.0), draw.uniform(30.0, 40.0)
        at = ego.position[0] + off
        near = [(x - at, v) for line, x, v in placed if line == lane]
        if any(abs(d) < _APART + (max(speed - v, 0.0) * 2 if d > 0 else max(v - speed, 0.0) * 2) for d, v in near):
            continue
        driver = CompliantHighwayDriver(road, road.network.get_lane(("0", "1", lane)).position(at, 0.0), 0.0, speed)
        driver.take(np.random.default_rng([seed, 1 + k]), ego, dt)
        driver.randomize_behavior()
        driver.check_collisions = base.vehicle.check_collisions and "fast" not in base.spec.id
        road.vehicles.append(driver)
        placed.append((lane, float(at), float(speed)))
        if len(placed) > vehicles:
            break


def drive_compliant(
    setting: Setting, seed: int, config: ShieldConfig | None = None, vehicles: int = 8, decisions: int = 10
) -> CompliantEpisode:
    """Drive one episode of a shielded ego with random actions among worst-case compliant drivers.

    The episode ends with the first intrusion into the ego's buffer or violation.

    Parameters
    ----------
    setting : a straight highway with meta-actions.
    seed : seed of the scene, the drivers and the actions.
    config : the shield's settings.
    vehicles : number of drivers.
    decisions : largest number of decisions.

    Raises
    ------
    ConfigError
        If the setting is no straight highway with meta-actions, or the shield has no monitor.
    """
    with one_thread():
        env = ShieldedEnv(setting.make(), config)
        try:
            return _drive(env, setting, seed, vehicles, decisions)
        finally:
            env.close()


def _drive(env: ShieldedEnv, setting: Setting, seed: int, vehicles: int, decisions: int) -> CompliantEpisode:
    action_filter, base = env.filter, env.unwrapped
    if not isinstance(action_filter, MetaActionFilter) or not action_filter.supervising:
        raise ConfigError(f"bold drivers need a straight highway with meta-actions and a shield, not {setting.name}")
    env.reset(seed=seed)
    install_highway_drivers(base, vehicles, seed)
    actions, monitor, started = np.random.default_rng([seed, 1_000_000]), _EpisodeMonitor(base, action_filter), True
    labels = [str(base.action_type.actions[k]) for k in range(env.action_space.n)]  # type: ignore[attr-defined]
    often = np.array([_OFTEN.get(label, 1.0) for label in labels])
    for step in range(decisions):
        action = int(actions.choice(len(labels), p=often / often.sum()))
        *_, terminated, truncated, _ = env.step(action)
        if step == 0:
            started = env.decisions[0].tier.verified and env.frame_decisions[0].tier.verified
        if monitor.over or terminated or truncated or not started:
            break
    if not monitor.over:
        # The monitor has not checked the last frame yet.
        action_filter.frame()
        monitor.read_violations()
    return CompliantEpisode(seed, monitor.frames, started, monitor.clearance, monitor.crashed, monitor.named)


def drive_compliant_many(
    setting: Setting,
    seeds: Sequence[int],
    config: ShieldConfig | None = None,
    vehicles: int = 8,
    decisions: int = 10,
    jobs: int = -1,
) -> list[CompliantEpisode]:
    """Call `drive_compliant` on each of the seeds, in `jobs` processes (-1: one for each core)."""
    return list(Parallel(n_jobs=jobs)(delayed(drive_compliant)(setting, s, config, vehicles, decisions) for s in seeds))
