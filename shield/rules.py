"""Distance rules: the shield's cheap first stage, and baselines on their own.

Each rule accepts or refuses the target command of an action in a scene. If it decides alone, a refused action is
replaced by the *safe action*: keep the lane and slow down.
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
from shield.rule_kernels import RuleScene, alongside, lateral_gap, longitudinal_gap, time_is_short, violates_rss

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
        """Reason for the record of a refusal."""
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

    Source: Shalev-Shwartz, Shammah, Shashua 2017, definition 1, which presupposes b_r <= b_f. A rear vehicle that
    brakes harder comes nearest while both still move, when their speeds are equal. Then the result is at least the
    distance up to that moment.
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


def _kinematics(scene: Scene) -> RuleScene:
    """The scene as the kernels read it."""
    road = scene.road
    return RuleScene(scene.ego, scene.ego_road, scene.others, scene.others_road, road.centers, float(road.width))


@dataclass(frozen=True, slots=True)
class BufferRule:
    """Refuses a lane change into a vehicle alongside, within the buffer.

    It is necessary for verification, so it is checked first: it saves a rollout and changes no verdict.

    Attributes
    ----------
    longitudinal : buffer along the road [m].
    """

    longitudinal: float
    reason: Reason = Reason.BUFFER

    def objects(self, scene: Scene, target: Target) -> bool:
        """Whether the lane of `target` contains a vehicle alongside."""
        return alongside(_kinematics(scene), target.lane, self.longitudinal)


@dataclass(frozen=True, slots=True)
class DistanceRule:
    """The fixed distance D: refuses a lane change while a vehicle is nearer than D, from centre to centre.

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
    """Responsibility-Sensitive Safety: longitudinal gaps in the lane of `target`, lateral gaps beside it.

    Attributes
    ----------
    config : source of the braking, the response time and the assumptions.
    """

    config: ShieldConfig
    reason: Reason = Reason.RSS

    def objects(self, scene: Scene, target: Target) -> bool:
        """Whether `target` violates a gap that RSS requires of the ego."""
        c, a = self.config, self.config.assumptions
        aim = target.lane, float(target.speed)
        braking, response = (c.braking, a.braking, a.follower_braking), (c.response_time, a.reaction_time)
        return violates_rss(_kinematics(scene), *aim, braking, response, a.acceleration)


@dataclass(frozen=True, slots=True)
class TtcRule:
    """Time to collision: refuses a target command with a collision in its lane before the threshold.

    Attributes
    ----------
    threshold : least time to collision at constant speeds [s].
    """

    threshold: float
    reason: Reason = Reason.TTC

    def objects(self, scene: Scene, target: Target) -> bool:
        """Whether the time to collision in the target's lane is below the threshold."""
        aim = target.lane, float(target.speed)
        return time_is_short(_kinematics(scene), *aim, self.threshold)


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
