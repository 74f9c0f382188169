"""Drivers that replace highway-env's traffic on road networks, to attack the certificate.

`UnconstrainedNetworkDriver` is an unconstrained adversary: random throttle and steering, without any rule.
`CompliantNetworkDriver` is a worst-case compliant driver: it keeps to every rule of
`shield.certificate.network.monitor` and uses all that the rules permit. It brakes and accelerates as hard as the
assumptions allow, turns at random, and leaves a lane that ends at a random place. It reacts only to the vehicle ahead
in its own lane.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from highway_env.vehicle.controller import ControlledVehicle
from highway_env.vehicle.kinematics import Vehicle

from shield import ShieldedEnv
from shield.errors import ConfigError
from shield.filters.network import NetworkFilter

__all__ = ["DRIVERS", "FAIL_SAFE", "install_drivers"]

DRIVERS = ("wild", "bold", "mixed")
FAIL_SAFE = 9.8
"""Hardest braking of the ego in its fail-safe [m/s^2]."""
RandomSource = Any
"""A numpy generator, or an object with the same methods, such as `Script`."""
NetworkLane = tuple[str, str, int]
_KEPT_FRAMES = 2, 20
_CAUTION = 1.0
"""Gap of a compliant driver to the vehicle ahead, beyond its own stopping distance [m]."""


class LaneConnections(NamedTuple):
    """Connections of lanes.

    Attributes
    ----------
    ahead : the lanes that each lane leads to.
    over : for each lane that ends, the neighbour that its traffic has to merge into.
    """

    ahead: dict[NetworkLane, list[NetworkLane]]
    over: dict[NetworkLane, NetworkLane]


class UnconstrainedNetworkDriver(Vehicle):  # type: ignore[misc]
    """Unconstrained adversary: throttle and steering at random, each kept for some frames."""

    def take(
        self,
        draw: RandomSource,
        turns: RandomSource,
        network_filter: NetworkFilter,
        period: float,
        ways: LaneConnections,
    ) -> None:
        """Set the random generator of inputs; the other parameters are those of `CompliantNetworkDriver.take`."""
        self.draw, self.left, self.route = draw, 0, ()

    def act(self, action: Any = None) -> None:
        """Set throttle and steering for the coming frame; `action` is ignored."""
        if self.left == 0:
            self.left = int(self.draw.integers(*_KEPT_FRAMES))
            hard = self.draw.random() < 0.2
            self.drawn_input = {
                "acceleration": self.draw.uniform(-8, 8) if hard else self.draw.uniform(-3, 3),
                "steering": self.draw.normal(0, 0.3 if hard else 0.03),
            }
        self.left -= 1
        super().act(self.drawn_input)


class CompliantNetworkDriver(ControlledVehicle):  # type: ignore[misc]
    """Worst-case compliant driver."""

    target_lane_index: Any

    def take(
        self,
        draw: RandomSource,
        turns: RandomSource,
        network_filter: NetworkFilter,
        period: float,
        ways: LaneConnections,
    ) -> None:
        """Set the random generators of inputs and of turns, the filter, the duration of a frame [s] and the lanes."""
        self.draw, self.left, self.drawn_input, self.period = draw, 0, 0.0, period
        self.turns, self.ways, self.until = turns, ways, -1.0
        self.network_filter, self.assumptions, self.route = network_filter, network_filter.config.assumptions, None

    def act(self, action: Any = None) -> None:
        """Set throttle and steering for the coming frame; `action` is ignored."""
        if self.left == 0:
            self.left = int(self.draw.integers(*_KEPT_FRAMES))
            a = self.assumptions
            self.drawn_input = float(self.draw.choice([-a.braking, 0.0, a.acceleration, a.acceleration]))
        self.left -= 1
        self._turn_anywhere()
        steering = float(
            np.clip(self.steering_control(self.target_lane_index), -self.MAX_STEERING_ANGLE, self.MAX_STEERING_ANGLE)
        )
        Vehicle.act(self, {"acceleration": self._permitted(), "steering": steering})

    def _turn_anywhere(self) -> None:
        lane = self.road.network.get_lane(self.target_lane_index)
        if lane.after_end(self.position):
            ahead = self.ways.ahead[self.target_lane_index]
            if ahead:
                self.target_lane_index = ahead[int(self.turns.integers(len(ahead)))]
        elif self.target_lane_index in self.ways.over:
            if self.until < 0:
                self.until = float(self.turns.random()) * lane.length
            if lane.local_coordinates(self.position)[0] >= self.until:
                self.target_lane_index = self.ways.over[self.target_lane_index]

    def _permitted(self) -> float:
        """Acceleration within the speed limit, with a gap in which the driver can stop behind the vehicle ahead
        [m/s^2].
        """
        rules, dt = self.assumptions, self.period
        limit = self.lane.speed_limit or rules.max_speed
        permitted = min(self.drawn_input, max(limit - self.speed, -rules.braking * dt) / dt)
        first, _ = self.road.neighbour_vehicles(self, self.lane_index)
        if first is not None:
            gap = self.lane_distance_to(first) - self.LENGTH / 2 - first.LENGTH / 2 - _CAUTION
            speed, other = max(self.speed, 0.0), max(first.speed, 0.0)
            way = speed * 2 * dt + (speed + rules.acceleration * dt) ** 2 / (2 * rules.braking)
            if gap < way - other * other / (2 * FAIL_SAFE):
                permitted = -rules.braking
        if self.network_filter.counts_on(self):
            permitted = -rules.braking
        return float(max(permitted, -max(self.speed, 0.0) / dt))


def install_drivers(
    env: ShieldedEnv,
    drivers: str,
    vehicles: int,
    seed: int,
    scripts: Sequence[tuple[RandomSource, RandomSource]] | None = None,
) -> None:
    """Replace the first vehicles of the traffic by adversaries, in place.

    Parameters
    ----------
    env : a shielded environment on a road network, after `reset`.
    drivers : one of `DRIVERS`.
    vehicles : number of vehicles to replace.
    seed : seed of the drivers' choices.
    scripts : for each driver, a source of numbers for its inputs and one for its turns, in place of the seed.

    Raises
    ------
    ConfigError
        If `drivers` is unknown.
    """
    if drivers not in DRIVERS:
        raise ConfigError(f"unknown drivers {drivers!r}; have {', '.join(DRIVERS)}")
    base: Any = env.unwrapped
    assert isinstance(env.filter, NetworkFilter)
    kinds: Sequence[type[Any]] = {
        "wild": (UnconstrainedNetworkDriver,),
        "bold": (CompliantNetworkDriver,),
        "mixed": (UnconstrainedNetworkDriver, CompliantNetworkDriver),
    }[drivers]
    left, ways, period = (
        vehicles,
        LaneConnections(env.filter.ahead, env.filter.over),
        1 / base.config["simulation_frequency"],
    )
    for k, body in enumerate(base.road.vehicles):
        if body is base.vehicle or left == 0:
            continue
        driven = kinds[left % len(kinds)](body.road, body.position.copy(), body.heading, body.speed)
        draw = np.random.default_rng([seed, k])
        habits, turns = (draw, draw) if scripts is None else scripts[vehicles - left]
        driven.take(habits, turns, env.filter, period, ways)
        driven.crashed = body.crashed
        base.road.vehicles[k], left = driven, left - 1
