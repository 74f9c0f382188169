"""Riders on road networks that deviate as far as the monitor lets them.

Each is placed by hand in every frame: what it wants is tried on the monitor a frame ahead, and comes halfway back to
keeping its lane until nobody would be named. So riders lag, swerve, turn, grow, reverse and creep along the edge of
each rule.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
from highway_env.vehicle.kinematics import Vehicle

from dynamics.road_networks.simulation.live import load_ego
from dynamics.state import FloatArray
from dynamics.traffic.rules_of_the_road import EgoFootprint, gap_between
from shield import ShieldedEnv
from shield.certificate.network.monitor import NetworkRule

__all__ = ["RoadRider", "Tally", "ride_roads"]

_HALVINGS, _LONGEST, _MOST, _AROUND = 7, 90, 5, 80.0
_WANTS = ("lag", "swerve", "turn", "grow", "reverse", "creep", "brake", "chase", "ram")
_RATES = (0.0, -3.0, -6.0)
"""How a rider may brake where keeping its speed would be named [m/s^2]."""


class RoadRider(Vehicle):  # type: ignore[misc]
    """Goes where it is put: x, y, heading, speed, length and width after the coming frame."""

    going: FloatArray | None = None
    route = None

    def act(self, action: Any = None) -> None:
        """Nothing."""

    def step(self, dt: float) -> None:
        """Be where it was put; a wreck is highway-env's."""
        if self.crashed or self.going is None:
            Vehicle.step(self, dt)
            return
        self.put(self.going)
        if self.impact is not None:
            self.crashed, self.impact = True, None

    def put(self, row: FloatArray) -> None:
        """Stand there."""
        self.position, (self.heading, self.speed) = np.array(row[:2]), row[2:4].tolist()
        self.LENGTH, self.WIDTH = row[4:6].tolist()
        self.diagonal = math.hypot(self.LENGTH, self.WIDTH)
        self.on_state_update()

    @property
    def row(self) -> FloatArray:
        """Where it stands, (6,)."""
        return np.array([*self.position, self.heading, self.speed, self.LENGTH, self.WIDTH], float)


@dataclass
class Tally:
    """What came of one episode; where its first frame is not verified, nothing is promised and nothing counted.

    Attributes
    ----------
    frames : driven. verified : whether the first frame's decision was. named : whether a rule was broken.
    clean : frames in which the ego's buffer, or its body of one that owed it its distance, was touched with nobody
        named. crashed : whether the ego crashed so. lost : frames without a plan with nobody named. unforeseen : how
        often the monitor said so. owed : frames in which one that owed its distance was in the buffer. nearest : the
        least distance from the buffer with nobody named [m].
    """

    frames: int = 0
    verified: bool = False
    named: bool = False
    clean: int = 0
    crashed: bool = False
    lost: int = 0
    unforeseen: int = 0
    owed: int = 0
    nearest: float = field(default=np.inf)


class _Stage:
    """Drives the others of one episode."""

    def __init__(self, env: ShieldedEnv, rng: np.random.Generator) -> None:
        self.env, self.rng, self.tally = env, rng, Tally()
        self.base: Any = env.unwrapped
        self.road, self.network_filter = self.base.road, env.filter
        self.dt = 1 / self.base.config["simulation_frequency"]
        self.start, self.wants, self.pending = self._count(), {}, (0, False, np.inf)
        self._step, self.road.step = self.road.step, self.frame

    def riders(self) -> list[RoadRider]:
        return [body for body in self.road.vehicles if isinstance(body, RoadRider) and not body.crashed]

    def _count(self) -> int:
        return int(self.network_filter.violations) - int(self.network_filter.by_rule.get(NetworkRule.UNFORESEEN, 0))

    def settle(self) -> None:
        """The monitor has looked at the present frame: count what was touched in it."""
        tally = self.tally
        tally.named = self._count() > self.start
        if tally.verified and not tally.named:
            tally.clean += self.pending[0]
            tally.crashed = tally.crashed or self.pending[1]
            tally.nearest = min(tally.nearest, self.pending[2])
        self.pending = (0, False, np.inf)

    def frame(self, dt: float) -> None:
        """One frame of the road."""
        self.settle()
        decision = self.env.frame_decisions[-1]
        if self.tally.frames == 0:
            self.tally.verified = decision.tier.verified
        self.tally.lost += self.tally.verified and not decision.tier.verified and not self.tally.named
        self._choose()
        self._step(dt)
        self.tally.frames += 1
        self._measure()

    def _measure(self) -> None:
        ego, touched, nearest = self.base.vehicle, 0, np.inf
        buffer = self.network_filter.config.buffer
        half, wide = 0.5 * ego.LENGTH, 0.5 * ego.WIDTH
        it = EgoFootprint(*ego.position.tolist(), ego.heading, ego.speed, half, wide, half, wide, False)
        for body in self.road.vehicles:
            if body is ego:
                continue
            row = np.array([[*body.position, body.heading, body.speed, body.LENGTH, body.WIDTH, 0.0]])
            wanted = gap_between(it, half + buffer.longitudinal, wide + buffer.lateral, row, 0, 0.0)
            owes = self.network_filter.has_distance_obligation(body)
            self.tally.owed += owes and wanted < 0
            gap = gap_between(it, half, wide, row, 0, 0.0) if owes else wanted
            touched += gap < -1e-6
            nearest = min(nearest, gap)
        self.pending = (touched, bool(ego.crashed), nearest)

    # -- what they do -----------------------------------------------------------------------------------------

    def _choose(self) -> None:
        """Place each rider as near to its target as the monitor permits."""
        riders, rng = self.riders(), self.rng
        now = [rider.row for rider in riders]
        with _Ahead(self, riders):
            rows = [self._calm(row, 0.0) for row in now]
            named = self._named(riders, rows)
            for rate in _RATES:
                for i in np.flatnonzero(named):
                    rows[i] = self._calm(now[i], rate)
                named = self._named(riders, rows)
                if not named.any():
                    break
            for i in rng.permutation(len(riders)).tolist() if not named.any() else ():
                wanted, share = self._wanted(riders[i], now[i], rows[i]), 1.0
                for _ in range(_HALVINGS):
                    tried = [*rows]
                    tried[i] = rows[i] + share * (wanted - rows[i])
                    if not self._named(riders, tried).any():
                        rows = tried
                        break
                    share *= 0.5
        for rider, row in zip(riders, rows, strict=True):
            rider.going = row

    def _named(self, riders: list[RoadRider], rows: list[FloatArray]) -> np.ndarray[Any, Any]:
        """Mask of the riders that would be named at their place, or touch another, (n,)."""
        network_filter, out = self.network_filter, np.zeros(len(riders), bool)
        for rider, row in zip(riders, rows, strict=True):
            rider.put(row)
        seen = network_filter._predict()
        load_ego(self.base, network_filter._alone.rules, network_filter._index, network_filter._alone.worlds)
        margins, late = None, set()
        if network_filter._stored is not None and not self.base.vehicle.crashed and not network_filter._at_end():
            margins, late = network_filter._braking.now(network_filter._stored, seen)
        last = network_filter.watch
        watch = replace(
            last,
            breaking=dict(last.breaking),
            offenders=set(last.offenders),
            by_rule=dict(last.by_rule),
            culprits=set(last.culprits),
        )
        watch.next(seen, set(network_filter._then), margins, network_filter._road, late)
        broken = {body for body, rules in watch.breaking.items() if rules - {NetworkRule.UNFORESEEN}}
        for i, rider in enumerate(riders):
            out[i] = rider in broken or any(
                rider is not other and any(rider._is_colliding(other, self.dt)[:2])
                for other in self.road.vehicles
                if other is not self.base.vehicle
            )
        return out

    def _lane(self, row: FloatArray) -> tuple[Any, float, float]:
        network = self.road.network
        lane = network.get_lane(network.get_closest_lane_index(row[:2], row[2]))
        return lane, *lane.local_coordinates(row[:2])

    def _calm(self, row: FloatArray, rate: float) -> FloatArray:
        """Keeping the lane, and the speed but for that rate [m/s^2]."""
        lane, s, r = self._lane(row)
        off = (row[2] - lane.heading_at(s) + math.pi) % (2 * math.pi) - math.pi
        ahead = s + row[3] * self.dt
        x, y = lane.position(ahead, r)
        speed = row[3] + rate * self.dt
        return np.array([x, y, lane.heading_at(ahead) + 0.7 * off, max(speed, min(row[3], 0.0)), *row[4:]])

    def _wanted(self, rider: RoadRider, now: FloatArray, calm: FloatArray) -> FloatArray:
        rng, ego, out = self.rng, self.base.vehicle, calm.copy()
        if rider not in self.wants or rng.random() < 0.04:
            self.wants[rider] = str(rng.choice(_WANTS)), float(rng.choice([-1.0, 1.0])), float(rng.random())
        want, side, much = self.wants[rider]
        heading = calm[2]
        along, across = (
            np.array([math.cos(heading), math.sin(heading)]),
            np.array([-math.sin(heading), math.cos(heading)]),
        )
        way = max(now[3], 0.0) * self.dt
        aside = float((ego.position - now[:2]) @ across)
        if want == "lag":
            out[:2] -= way * much * along
        elif want == "swerve":
            out[:2] += np.sign(aside) * min(abs(aside), way) * across
            out[2] += np.sign(aside) * much
        elif want == "turn":
            out[2] += side * math.pi * much
        elif want == "grow":
            out[4], out[5] = min(now[4] * (1 + much), 15.0), min(now[5] * (1 + 0.5 * much), 3.5)
        elif want == "reverse":
            out[3] = now[3] - 6.0 * self.dt
        elif want == "creep":
            out[3] = np.clip(0.4 + 2.5 * much, now[3] - 6.0 * self.dt, now[3] + 3.0 * self.dt)
        elif want == "brake":
            out[3] = max(now[3] - 6.0 * self.dt, min(now[3], 0.0))
        elif want == "chase":
            out[3] = now[3] + 4.0 * self.dt
        else:
            off = ego.position - now[:2]
            out[:2] = now[:2] + min(way, float(np.hypot(*off))) * off / max(float(np.hypot(*off)), 1e-9)
            out[2:4] = math.atan2(off[1], off[0]), now[3] + 3.0 * self.dt
        return out


class _Ahead:
    """Inside, the ego is a frame further; the riders are put back, too."""

    def __init__(self, stage: _Stage, riders: list[RoadRider]) -> None:
        self._ego, self._dt = stage.base.vehicle, stage.dt
        self._riders = [(rider, rider.row) for rider in riders]

    def __enter__(self) -> None:
        ego = self._ego
        self._kept = {**ego.__dict__, "position": ego.position.copy(), "action": dict(ego.action)}
        self._history = list(getattr(ego, "history", ()))
        ego.step(self._dt)

    def __exit__(self, *error: Any) -> None:
        ego = self._ego
        ego.__dict__.clear()
        ego.__dict__.update(self._kept)
        if self._history:
            ego.history.clear()
            ego.history.extend(self._history)
        for rider, row in self._riders:
            rider.put(row)


def _place(base: Any, rng: np.random.Generator) -> None:
    """Riders of any size in place of the present vehicles."""
    road, ego = base.road, base.vehicle
    lanes, own = list(road.network.lanes_dict()), ego.lane_index
    road.vehicles, road.objects = [ego], []
    wanted = 1 + int(rng.integers(_MOST))
    for _ in range(200):
        index = lanes[int(rng.integers(len(lanes)))] if rng.random() < 0.6 else own
        lane = road.network.get_lane(index)
        s = float(rng.uniform(0, lane.length))
        rider = RoadRider(road, lane.position(s, rng.normal(0, 0.15)), lane.heading_at(s), rng.uniform(0, 20))
        if rng.random() < 0.4:
            rider.LENGTH, rider.WIDTH = float(rng.uniform(0.6, 12.0)), float(rng.uniform(0.4, 2.5))
        near = float(np.hypot(*(rider.position - ego.position)))
        free = all(
            np.hypot(*(rider.position - body.position)) > 0.5 * (rider.LENGTH + body.LENGTH) + 2.5
            for body in road.vehicles
        )
        if near < _AROUND and free:
            road.vehicles.append(rider)
        if len(road.vehicles) > wanted:
            return


def ride_roads(env_id: str, seed: int, frequency: int = 15) -> Tally:
    """Drive one episode of an environment with meta-actions, at so many frames a second [Hz]."""
    rng = np.random.default_rng(seed)
    config = {
        "simulation_frequency": frequency,
        "policy_frequency": frequency // int(rng.choice([1, 5])),
        "duration": 300,
    }
    if "intersection" in env_id:
        config |= {"spawn_probability": 0.0, "initial_vehicle_count": 1}
    env = ShieldedEnv(gym.make(env_id, config=config), "worst-case")
    env.reset(seed=seed)
    base: Any = env.unwrapped
    _place(base, rng)
    env.filter.reset()
    stage, faster = _Stage(env, rng), rng.random() < 0.5
    names = base.action_type.actions_indexes
    while stage.tally.frames < _LONGEST:
        action = names["FASTER"] if faster else int(rng.choice(list(names.values())))
        *_, terminated, truncated, _ = env.step(action)
        if terminated or truncated or stage.tally.named or not stage.tally.verified:
            break
    env.filter.monitor_last_frame()
    stage.settle()
    stage.tally.unforeseen = int(env.filter.by_rule.get(NetworkRule.UNFORESEEN, 0))
    return stage.tally
