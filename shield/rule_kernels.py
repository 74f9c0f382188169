"""The distance rules as compiled loops over vehicles; `shield.rules` documents them."""

from __future__ import annotations

import math
from typing import NamedTuple

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.roads.straight import nearest
from dynamics.state import FloatArray, Vehicle

__all__ = ["RuleScene", "alongside", "lateral_gap", "longitudinal_gap", "time_is_short", "violates_rss"]

_SPEED, _LENGTH, _WIDTH = int(Vehicle.SPEED), int(Vehicle.LENGTH), int(Vehicle.WIDTH)
_BLOCKING_DISTANCE = 1.0
"""A vehicle nearer than this to a lane's centre blocks a change to that lane [m]."""
_LATERAL = (1.0, 2.0, 0.3)
"""RSS's lateral acceleration and braking [m/s^2], and the margin [m]."""


class RuleScene(NamedTuple):
    """A scene as the rules read it.

    Attributes
    ----------
    ego, state : vehicle row (7,) and road state (4,). rows, states : of the others, (m, 7) and (m, 4).
    centers : lane centres [m]. width : of a lane [m].
    """

    ego: FloatArray
    state: FloatArray
    rows: FloatArray
    states: FloatArray
    centers: FloatArray
    width: float


@kernel_inline
def longitudinal_gap(
    rear_speed: float,
    front_speed: float,
    response_time: float,
    acceleration: float,
    rear_braking: float,
    front_braking: float,
) -> float:
    """See `shield.rules.rss_gap`."""
    v_r, v_f = max(rear_speed, 0.0), max(front_speed, 0.0)
    after = v_r + response_time * acceleration
    gap = (
        v_r * response_time
        + 0.5 * acceleration * (response_time * response_time)
        + after * after / (2 * rear_braking)
        - v_f * v_f / (2 * front_braking)
    )
    if rear_braking > front_braking:
        front_after = v_f - front_braking * response_time
        closing = after - front_after
        meet = closing / (rear_braking - front_braking)
        if closing > 0 and after - rear_braking * meet >= 0 and front_after > 0:
            travelled = v_f * response_time - 0.5 * front_braking * (response_time * response_time)
            nearest_gap = (
                v_r * response_time
                + 0.5 * acceleration * (response_time * response_time)
                - travelled
                + closing * closing / (2 * (rear_braking - front_braking))
            )
            gap = max(gap, nearest_gap)
    return max(gap, 0.0)


@kernel_inline
def lateral_gap(
    left_speed: float, right_speed: float, response_time: float, acceleration: float, braking: float, margin: float
) -> float:
    """See `shield.rules.rss_lateral_gap`."""
    rho = response_time
    v1, v2 = left_speed + rho * acceleration, right_speed - rho * acceleration
    toward = 0.5 * (left_speed + v1) * rho + math.copysign(v1 * v1, v1) / (2 * braking)
    away = 0.5 * (right_speed + v2) * rho + math.copysign(v2 * v2, v2) / (2 * braking)
    return margin + max(toward - away, 0.0)


@kernel_inline
def _gap(ego: FloatArray, state: FloatArray, rows: FloatArray, states: FloatArray, i: int) -> float:
    """Bumper distance to a vehicle along the road, negative where they overlap [m]."""
    return abs(states[i, 0] - state[0]) - 0.5 * (rows[i, _LENGTH] + ego[_LENGTH])


@kernel_inline
def _in_lane(rows: FloatArray, states: FloatArray, i: int, center: float, width: float) -> bool:
    """Whether a vehicle touches a lane."""
    return abs(states[i, 1] - center) < 0.5 * (width + rows[i, _WIDTH]) - 0.5


@kernel_no_refcount
def alongside(scene: RuleScene, lane: int, longitudinal: float) -> bool:
    """Whether a target lane contains a vehicle alongside the ego.

    Parameters
    ----------
    lane : the target lane. longitudinal : buffer along the road [m].
    """
    ego, state, rows, states, centers = scene.ego, scene.state, scene.rows, scene.states, scene.centers
    if lane == nearest(centers, state[1]):
        return False
    for i in range(rows.shape[0]):
        beside = abs(states[i, 1] - centers[lane]) < _BLOCKING_DISTANCE
        if beside and _gap(ego, state, rows, states, i) < longitudinal:
            return True
    return False


@kernel_no_refcount
def violates_rss(
    scene: RuleScene,
    lane: int,
    speed: float,
    braking: tuple[float, float, float],
    response: tuple[float, float],
    acceleration: float,
) -> bool:
    """Whether a target command violates an RSS distance.

    Parameters
    ----------
    lane, speed : the target command; the speed in [m/s].
    braking : of the ego, of a leader, and of a follower [m/s^2]. response : times of the ego and of a follower [s].
    acceleration : of a follower during its response time [m/s^2].
    """
    ego, state, rows, states = scene.ego, scene.state, scene.rows, scene.states
    centers, width = scene.centers, scene.width
    v, now = ego[_SPEED], nearest(centers, state[1])
    fast = max(v, speed)
    side = 0.0
    if centers[lane] != state[1]:
        side = 1.0 if centers[lane] > state[1] else -1.0
    for i in range(rows.shape[0]):
        gap, other = _gap(ego, state, rows, states, i), rows[i, _SPEED]
        ahead = states[i, 0] >= state[0]
        if _in_lane(rows, states, i, centers[lane], width):
            if ahead and gap < longitudinal_gap(fast, other, response[0], 0.0, braking[0], braking[1]):
                return True
            behind = longitudinal_gap(other, v, response[1], acceleration, braking[2], braking[0])
            if lane != now and not ahead and gap < behind:
                return True
        if lane != now and gap < 0:
            away = side * (states[i, 1] - state[1])
            flank = away - 0.5 * (rows[i, _WIDTH] + ego[_WIDTH])
            own, its = side * v * math.sin(state[2]), side * other * math.sin(states[i, 2])
            if away > 0 and flank < lateral_gap(own, its, response[0], _LATERAL[0], _LATERAL[1], _LATERAL[2]):
                return True
    return False


@kernel_no_refcount
def time_is_short(scene: RuleScene, lane: int, speed: float, threshold: float) -> bool:
    """Whether the time to collision in the target lane is below a threshold [s]; other parameters as in
    `violates_rss`."""
    ego, state, rows, states = scene.ego, scene.state, scene.rows, scene.states
    centers, width = scene.centers, scene.width
    v, changes = max(ego[_SPEED], speed), lane != nearest(centers, state[1])
    for i in range(rows.shape[0]):
        ahead = states[i, 0] >= state[0]
        if not _in_lane(rows, states, i, centers[lane], width) or not (ahead or changes):
            continue
        gap, other = _gap(ego, state, rows, states, i), rows[i, _SPEED]
        closing = v - other if ahead else other - ego[_SPEED]
        if gap < 0 or (closing > 0 and max(gap, 0.0) / closing < threshold):
            return True
    return False
