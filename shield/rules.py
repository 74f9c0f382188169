"""Distance rules: the shield's cheap first stage, and baselines on their own.

Each rule looks at the scene and the target that an action would set, and says whether it objects. A rule that
objects on its own sends the ego to the *safe action*: keep the lane and slow down.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dynamics.scenes.scene import Scene, Target
from dynamics.state import FloatArray
from shield.config import RULES_ALONE, ShieldConfig
from shield.decision import Reason
from shield.errors import ConfigError
from shield.rule_kernels import alongside, breaks_rss, lateral_gap, longitudinal_gap, time_is_short

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
    gap: FloatArray = _longitudinal(rear_speed, front_speed, response_time, acceleration, rear_braking, front_braking)
    return gap


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
    gap: FloatArray = _lateral(left_speed, right_speed, response_time, acceleration, braking, margin)
    return gap


_longitudinal, _lateral = np.vectorize(longitudinal_gap, [float]), np.vectorize(lateral_gap, [float])


def _kinematics(scene: Scene) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """What the kernels look at: the ego and the others, as rows and on the road, and the lanes."""
    return scene.ego, scene.ego_road, scene.others, scene.others_road, scene.road.centers


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
        return alongside(*_kinematics(scene), target.lane, self.longitudinal)


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
        c, a = self.config, self.config.assumptions
        aim = float(scene.road.width), target.lane, float(target.speed)
        braking, response = (c.braking, a.braking, a.follower_braking), (c.response_time, a.reaction_time)
        return breaks_rss(*_kinematics(scene), *aim, braking, response, a.acceleration)


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
        aim = float(scene.road.width), target.lane, float(target.speed)
        return time_is_short(*_kinematics(scene), *aim, self.threshold)


def make_rule(name: str, config: ShieldConfig) -> Rule:
    """The rule of a mode in `RULES_ALONE`.

    Raises
    ------
    ConfigError
        For any other name.
    """
    if name == "distance":
        return DistanceRule(config.distance)
    if name == "rss":
        return RssRule(config)
    if name in ("ttc", "ttc-ranking"):
        return TtcRule(config.time_to_collision)
    raise ConfigError(f"unknown rule {name!r}; valid are {', '.join(map(repr, RULES_ALONE))}")
