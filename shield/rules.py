"""Distance rules: the shield's cheap first stage, and baselines on their own.

Each rule looks at the scene and the target that an action would set, and says whether it objects. A rule that
objects on its own sends the ego to the *safe action*: keep the lane and slow down.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dynamics.scenes.scene import Scene, Target
from dynamics.state import BoolArray, FloatArray, RoadState, State, Vehicle
from shield.config import ShieldConfig
from shield.decision import Reason
from shield.errors import ConfigError

__all__ = [
    "BufferRule",
    "DistanceRule",
    "RssRule",
    "Rule",
    "TtcRule",
    "make_rule",
    "rss_gap",
    "rss_lateral_gap",
]


class Rule(Protocol):
    """A cheap necessary check."""

    @property
    def reason(self) -> Reason:
        """What to put in the record when the rule objects."""
        ...

    def objects(self, scene: Scene, target: Target) -> bool:
        """Whether `target` is refused in `scene`."""
        ...


def rss_gap(
    rear_speed: FloatArray,
    front_speed: FloatArray,
    response_time: float,
    acceleration: float,
    rear_braking: float,
    front_braking: float,
) -> FloatArray:
    """Least safe longitudinal distance between bumpers [m].

    d = v_r rho + a rho^2 / 2 + (v_r + rho a)^2 / (2 b_r) - v_f^2 / (2 b_f), and at least 0.

    Source: Shalev-Shwartz, Shammah, Shashua 2017, definition 1, which takes for granted that b_r <= b_f. A rear
    vehicle that brakes harder comes nearest while both still move, when their speeds are equal; then the distance
    to that moment is asked for as well.
    """
    v_r, v_f = np.maximum(rear_speed, 0.0), np.maximum(front_speed, 0.0)
    after = v_r + response_time * acceleration
    gap = (
        v_r * response_time
        + 0.5 * acceleration * response_time**2
        + after**2 / (2 * rear_braking)
        - v_f**2 / (2 * front_braking)
    )
    if rear_braking > front_braking:
        front_after = v_f - front_braking * response_time
        closing = after - front_after
        meet = closing / (rear_braking - front_braking)
        moving = (closing > 0) & (after - rear_braking * meet >= 0) & (front_after > 0)
        travelled = v_f * response_time - 0.5 * front_braking * response_time**2
        nearest = (
            v_r * response_time
            + 0.5 * acceleration * response_time**2
            - travelled
            + closing**2 / (2 * (rear_braking - front_braking))
        )
        gap = np.where(moving, np.maximum(gap, nearest), gap)
    return np.maximum(gap, 0.0)


def rss_lateral_gap(
    left_speed: FloatArray,
    right_speed: FloatArray,
    response_time: float,
    acceleration: float,
    braking: float,
    margin: float,
) -> FloatArray:
    """Least safe lateral distance between flanks [m]; speeds are positive towards higher r [m/s].

    Source: Shalev-Shwartz, Shammah, Shashua 2017, definition 6 (mu is `margin`).
    """
    rho = response_time
    v1, v2 = left_speed + rho * acceleration, right_speed - rho * acceleration
    toward = 0.5 * (left_speed + v1) * rho + np.sign(v1) * v1**2 / (2 * braking)
    away = 0.5 * (right_speed + v2) * rho + np.sign(v2) * v2**2 / (2 * braking)
    return margin + np.maximum(toward - away, 0.0)


def _gaps(scene: Scene) -> FloatArray:
    """Bumper distance to each other vehicle along the road, negative where they overlap (n,) [m]."""
    ds = scene.others_road[:, RoadState.S] - scene.ego_road[RoadState.S]
    return np.abs(ds) - 0.5 * (scene.others[:, Vehicle.LENGTH] + scene.ego[Vehicle.LENGTH])


def _in_lane(scene: Scene, lane: int) -> BoolArray:
    """Which others touch a lane (n,)."""
    half = 0.5 * (scene.road.width + scene.others[:, Vehicle.WIDTH])
    offset = scene.others_road[:, RoadState.R] - scene.road.centers[lane]
    return np.abs(offset) < half - 0.5


@dataclass(frozen=True, slots=True)
class BufferRule:
    """A lane change into a vehicle that is alongside, within the buffer, is refused.

    Necessary for verification, so that the shield asks it first: it saves a rollout and changes no verdict.

    Attributes
    ----------
    longitudinal : buffer along the road [m].
    """

    longitudinal: float
    reason: Reason = Reason.BUFFER

    def objects(self, scene: Scene, target: Target) -> bool:
        """Whether `target` enters a lane that somebody alongside is in."""
        here = scene.road.lane_at(float(scene.ego_road[RoadState.R]))
        if target.lane == here or scene.others.shape[0] == 0:
            return False
        offset = scene.others_road[:, RoadState.R] - scene.road.centers[target.lane]
        beside = (np.abs(offset) < 1.0) & (_gaps(scene) < self.longitudinal)
        return bool(beside.any())


@dataclass(frozen=True, slots=True)
class DistanceRule:
    """The fixed distance D: a lane change with some vehicle nearer than D (centre to centre) is refused.

    Attributes
    ----------
    distance : D [m].
    """

    distance: float
    reason: Reason = Reason.DISTANCE

    def objects(self, scene: Scene, target: Target) -> bool:
        """Whether `target` changes lanes with a vehicle nearer than D."""
        if target.lane == scene.control.target.lane or scene.others.shape[0] == 0:
            return False
        delta = scene.others_road[:, :2] - scene.ego_road[:2]
        return bool(np.min(np.hypot(delta[:, 0], delta[:, 1])) < self.distance)


@dataclass(frozen=True, slots=True)
class RssRule:
    """Responsibility-Sensitive Safety: longitudinal gaps in the lane that `target` uses, lateral gaps beside it.

    Attributes
    ----------
    config : braking, response time and assumptions are taken from it.
    """

    config: ShieldConfig
    reason: Reason = Reason.RSS

    def objects(self, scene: Scene, target: Target) -> bool:
        """Whether a gap that RSS asks of the ego would be broken."""
        if scene.others.shape[0] == 0:
            return False
        c, a = self.config, self.config.assumptions
        gaps = _gaps(scene)
        ahead = scene.others_road[:, RoadState.S] >= scene.ego_road[RoadState.S]
        v, others_v = scene.ego[State.SPEED], scene.others[:, Vehicle.SPEED]
        here = _in_lane(scene, target.lane)
        speed = np.full_like(others_v, max(v, target.speed) if target.speed > v else v)
        front = rss_gap(speed, others_v, c.response_time, 0.0, c.braking, a.braking)
        breaks = here & ahead & (gaps < front)
        now = scene.road.lane_at(float(scene.ego_road[RoadState.R]))
        if target.lane != now:
            rear = rss_gap(
                others_v,
                np.full_like(others_v, v),
                a.reaction_time,
                a.acceleration,
                a.follower_braking,
                c.braking,
            )
            breaks |= here & ~ahead & (gaps < rear)
            breaks |= self._lateral(scene, target, gaps)
        return bool(breaks.any())

    def _lateral(self, scene: Scene, target: Target, gaps: FloatArray) -> BoolArray:
        """Vehicles alongside, on the side that the ego moves to, nearer than the lateral gap."""
        side = np.sign(scene.road.centers[target.lane] - scene.ego_road[RoadState.R])
        dr = side * (scene.others_road[:, RoadState.R] - scene.ego_road[RoadState.R])
        flank = dr - 0.5 * (scene.others[:, Vehicle.WIDTH] + scene.ego[Vehicle.WIDTH])
        own = side * scene.ego[State.SPEED] * np.sin(scene.ego_road[RoadState.HEADING])
        other = side * scene.others[:, Vehicle.SPEED] * np.sin(scene.others_road[:, RoadState.HEADING])
        need = rss_lateral_gap(np.full_like(other, own), other, self.config.response_time, 1.0, 2.0, 0.3)
        return (gaps < 0) & (dr > 0) & (flank < need)


@dataclass(frozen=True, slots=True)
class TtcRule:
    """Time to collision: a target is refused when its lane holds a collision nearer than the threshold.

    Attributes
    ----------
    threshold : least time to collision at constant speeds [s].
    """

    threshold: float
    reason: Reason = Reason.TTC

    def objects(self, scene: Scene, target: Target) -> bool:
        """Whether the time to collision in the target's lane is below the threshold."""
        if scene.others.shape[0] == 0:
            return False
        here = _in_lane(scene, target.lane)
        gaps = _gaps(scene)
        ahead = scene.others_road[:, RoadState.S] >= scene.ego_road[RoadState.S]
        v = max(float(scene.ego[State.SPEED]), target.speed)
        others_v = scene.others[:, Vehicle.SPEED]
        now = scene.road.lane_at(float(scene.ego_road[RoadState.R]))
        closing = np.where(ahead, v - others_v, others_v - scene.ego[State.SPEED])
        if target.lane == now:
            here &= ahead
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            ttc = np.where(closing > 0, np.maximum(gaps, 0.0) / closing, np.inf)
        return bool((here & ((ttc < self.threshold) | (gaps < 0))).any())


def make_rule(name: str, config: ShieldConfig) -> Rule:
    """The rule called "distance", "rss" or "ttc".

    Raises
    ------
    ConfigError
        For any other name.
    """
    if name == "distance":
        return DistanceRule(config.distance)
    if name == "rss":
        return RssRule(config)
    if name == "ttc":
        return TtcRule(config.time_to_collision)
    raise ConfigError(f"unknown rule {name!r}; valid are 'distance', 'rss', 'ttc'")
