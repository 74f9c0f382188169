"""Vehicles of highway-env driven by hand, frame by frame, and highways among them behind either wrapper."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
from driven_traffic import body_of, overlap
from highway_env.vehicle.kinematics import Vehicle

from shield import Shield, ShieldConfig, ShieldedEnv

__all__ = ["Drive", "Driven", "Outcome", "Placed", "drive", "inputs"]

START, IDLE = 400.0, 1
"""Where the ego starts along the road [m]; the action that is proposed by default."""

Drive = Callable[["Driven", int], None]
"""Sets the action of a vehicle in the frame of that index, in place of its `act`."""


class Driven(Vehicle):
    """A vehicle whose action `drive` sets, in place of its own `act`; without `drive` it keeps its speed."""

    def __init__(self, road: Any, ahead: float, lane: int, speed: float, drive: Drive | None = None) -> None:
        super().__init__(road, [START + ahead, 4.0 * lane], 0.0, speed)
        self.drive, self.frame = drive, 0
        self.check_collisions = False

    def act(self, action: Any = None) -> None:
        self.action = {"steering": 0.0, "acceleration": 0.0}
        if self.drive is not None:
            self.drive(self, self.frame)
        self.frame += 1


class Placed(Vehicle):
    """A vehicle whose state is set by hand, after each frame or by `put`; a crashed one moves as in highway-env.

    Parameters
    ----------
    size : length and width [m].
    place : x [m], y [m], heading [rad] and speed [m/s] after a number of frames; None to keep the state until `put`.
    """

    route = None

    def __init__(
        self,
        road: Any,
        state: Sequence[float],
        size: tuple[float, float] = (5.0, 2.0),
        place: Callable[[int], Sequence[float]] | None = None,
    ) -> None:
        super().__init__(road, state[:2], state[2], state[3])
        self.LENGTH, self.WIDTH = size
        self.diagonal = float(np.hypot(*size))
        self.place, self.frame = place, 0

    def act(self, action: Any = None) -> None:
        pass

    def step(self, dt: float) -> None:
        if self.place is None:
            return
        if self.crashed:
            super().step(dt)
            return
        self.frame += 1
        x, y, heading, speed = self.place(self.frame)
        self.put((x, y), heading, speed)

    def put(self, position: Sequence[float], heading: float, speed: float) -> None:
        self.position, self.heading, self.speed = np.array(position, float), float(heading), float(speed)
        self.on_state_update()


def inputs(acceleration: float, floor: float = -np.inf) -> Drive:
    """An acceleration [m/s^2] down to a speed [m/s]."""

    def act(own: Driven, _: int) -> None:
        rate = 1.0 / own.dt  # type: ignore[attr-defined]
        own.action["acceleration"] = max(acceleration, (floor - own.speed) * rate)

    return act


@dataclass
class Outcome:
    """Of an episode up to the crash, or its end.

    Attributes
    ----------
    clearance : least separation of the ego with its buffer from anybody, after the first frame [m].
    crashed : whether the ego has crashed. violations : that were reported, up to the step of the crash.
    rules : how often each rule was broken. verified : whether the first decision was.
    named : violations that were reported by the step in which the buffer was first touched, -1 if it never was.
    """

    clearance: float = np.inf
    crashed: bool = False
    violations: int = 0
    named: int = -1
    verified: bool = False
    rules: dict[str, int] | None = None

    @property
    def unnamed(self) -> bool:
        """Whether the buffer was touched, or the ego crashed, with nobody named by the end of that step."""
        return (self.clearance < -1e-6 and self.named == 0) or (self.crashed and self.violations == 0)


def drive(
    cast: Callable[[Any], Sequence[Any]],
    hz: int = 15,
    period: int = 1,
    seconds: float = 6.0,
    speed: float = 25.0,
    action: Callable[[int], Any] = lambda k: IDLE,
    placement: str = "env",
    config: ShieldConfig | None = None,
    **settings: Any,
) -> Outcome:
    """Drive the ego in the middle one of three lanes among a cast.

    Parameters
    ----------
    cast : makes the other vehicles on a road; ends with `Landmark`s and obstacles, if any, in `road.objects`.
    period : frames a decision. action : what is proposed at each decision. placement : "env" or "policy", or
        "actions", a filter of actions that supervises no frame.
    settings : of the environment.
    """
    frequency = {"simulation_frequency": hz, "policy_frequency": hz // period, "duration": 1e3}
    speeds = {"action": {"type": "DiscreteMetaAction", "target_speeds": [0, 5, 10, 15, 20, 25, 30]}}
    env = gym.make("highway-v0", config={"lanes_count": 3, **frequency, **speeds, **settings}, disable_env_checker=True)
    base: Any = env.unwrapped

    def populate() -> None:
        road = base.road
        base.controlled_vehicles = [base.action_type.vehicle_class(road, [START, 4.0], 0.0, speed)]
        base.vehicle.target_speed = speed
        road.vehicles = [base.vehicle]
        road.vehicles += cast(road)
        for body in road.vehicles[1:]:
            body.dt = 1.0 / hz

    base._create_vehicles = populate
    out, config = Outcome(rules={}), config or ShieldConfig()
    proposed = [IDLE]
    shielded: Any = ShieldedEnv(env, config) if placement == "env" else env
    obs, _ = shielded.reset(seed=0)
    shield = None
    if placement != "env":
        shield = Shield(lambda _: proposed[0], env=env, config=config, frames=placement == "policy")
    own_step = base.road.step

    def watched(dt: float) -> None:
        own_step(dt)
        mine = body_of(base.vehicle).corners(config.buffer.longitudinal, config.buffer.lateral)
        others = [*base.road.vehicles[1:], *base.road.objects]
        gaps = [overlap(mine, body_of(each).corners()) for each in others]
        out.clearance = min([out.clearance, *gaps])

    base.road.step = watched
    for k in range(round(seconds * hz / period)):
        proposed[0] = action(k)
        if shield is None:
            obs, _, terminated, truncated, info = shielded.step(proposed[0])
            told, first = info["shield"], shielded.last_decision
        else:
            chosen, _ = shield.predict(obs)
            obs, _, terminated, truncated, _ = env.step(chosen)
            told, first = shield.report(), shield.last_decision
        out.verified = out.verified or (k == 0 and first.tier.verified)
        out.violations += told["violations"]
        for rule, count in told["rules"].items():
            out.rules[rule] = out.rules.get(rule, 0) + count
        if out.clearance < -1e-6 and out.named < 0:
            out.named = out.violations
        out.crashed = bool(base.vehicle.crashed)
        if terminated or truncated:
            break
    shielded.close()
    return out
