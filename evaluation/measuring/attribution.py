"""Attribution of crashes to a cause, from the simulator's true state.

This is a measuring instrument, not part of the shield. It reads true states, which no shield can, and shares no code
with the shield's rules. It is strict: a crash counts as the ego's fault unless the other vehicle clearly caused it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from dynamics.errors import SceneError
from dynamics.roads.straight import StraightRoad
from dynamics.state import FloatArray
from dynamics.traffic.assumptions import Assumptions
from evaluation.measuring.recorder import History, Track

__all__ = ["AttributionRules", "Cause", "attribute_from_simulator_state", "rss_gap"]

_TOUCHING = 1.0
"""Largest distance between the boxes of the ego and its crash partner in a collision [m]."""
_SPEEDING_UP = 0.5
"""Gain of speed after the other vehicle's entry above which the ego has sped up [m/s]."""


class Cause(StrEnum):
    """Cause of a crash."""

    NONE = "none"
    EGO_AT_FAULT = "ego_at_fault"
    STRUCK_FROM_BEHIND = "struck_from_behind"
    STRUCK_FROM_SIDE = "struck_from_side"
    SPAWNED_IN_COLLISION = "spawned_in_collision"
    ASSUMPTION_VIOLATED = "assumption_violated"
    UNATTRIBUTED = "unattributed"


@dataclass(frozen=True, slots=True)
class AttributionRules:
    """Thresholds of the attribution.

    Attributes
    ----------
    assumptions : the shield's assumptions about other vehicles.
    braking : deceleration that is expected of the ego [m/s^2].
    response_time : response time that is granted to the ego [s].
    lane_window : time for which the ego's footprint has to be inside its lane to count as lane keeping [s].
    bound_window : longest time from the violation of a bound to a crash that it explains [s].
    spawn_window : longest time from the reset to a crash that the reset explains [s].
    braking_tolerance : excess over `assumptions.braking` that is no violation yet [m/s^2].
    """

    assumptions: Assumptions = field(default_factory=Assumptions.idm)
    braking: float = 8.0
    response_time: float = 0.5
    lane_window: float = 1.5
    bound_window: float = 3.0
    spawn_window: float = 2.0
    braking_tolerance: float = 0.2


def rss_gap(
    rear_speed: float,
    front_speed: float,
    rear_braking: float,
    front_braking: float,
    response_time: float,
) -> float:
    """Smallest gap from which the rear vehicle can avoid the front one [m].

    The rear vehicle keeps its speed for `response_time` [s] and then brakes to a standstill. The front vehicle brakes
    to a standstill at once. Speeds are in m/s, decelerations in m/s^2. The greatest approach over time counts, not only
    that at standstill: a rear vehicle that brakes harder is nearest before.

    Examples
    --------
    >>> rss_gap(20.0, 20.0, 8.0, 8.0, 1.0)
    20.0
    """
    v, w = max(rear_speed, 0.0), max(front_speed, 0.0)
    end = max(response_time + v / rear_braking, w / front_braking)
    t = np.append(np.linspace(0.0, end, 400), response_time)
    braking = np.clip(t - response_time, 0.0, v / rear_braking)
    rear = v * np.minimum(t, response_time) + v * braking - rear_braking * braking**2 / 2
    stopping = np.minimum(t, w / front_braking)
    front = w * stopping - front_braking * stopping**2 / 2
    return max(0.0, round(float(np.max(rear - front)), 9))


def attribute_from_simulator_state(history: History, rules: AttributionRules | None = None) -> Cause:
    """Cause of the ego's crash in a recorded episode; `Cause.NONE` without a crash.

    The first of these conditions that holds determines the cause:

    - `UNATTRIBUTED`: the road is not straight. The other conditions compare lanes and gaps along a straight road.
    - `SPAWNED_IN_COLLISION`: the crash was within `spawn_window` of the reset. At the reset the two vehicles
      overlapped, or one followed the other so fast that full braking could not avoid the crash.
    - `STRUCK_FROM_BEHIND`: the partner was behind, in line with the ego and closing, and the ego
      had kept its lane.
    - `STRUCK_FROM_SIDE`: the partner came sideways into the lane that the ego had kept, alongside
      or with less than the RSS gap, at most `lane_window` before, and the ego did not speed up.
    - `ASSUMPTION_VIOLATED`: the partner ahead braked harder than assumed, or crashed with a third
      vehicle, at most `bound_window` before, while the ego had kept its lane and the RSS gap.
    - `EGO_AT_FAULT`: everything else.
    """
    rules = rules or AttributionRules()
    crash = history.crash_frame
    if crash is None:
        return Cause.NONE
    if not isinstance(history.road, StraightRoad):
        return Cause.UNATTRIBUTED
    partner = _partner(history, crash)
    if partner is None:
        return Cause.EGO_AT_FAULT
    before = max(crash - 1, 0)
    ego, other = history.ego[: before + 1], history.states[: before + 1, partner]
    at_reset = history.from_reset and crash * history.dt <= rules.spawn_window + 1e-9
    if at_reset and _hopeless(ego[0], other[0], rules.braking):
        return Cause.SPAWNED_IN_COLLISION
    if not _kept_lane(history, before, rules):
        return Cause.EGO_AT_FAULT
    if _from_behind(ego[-1], other[-1]):
        return Cause.STRUCK_FROM_BEHIND
    if _from_side(history, ego, other, rules):
        return Cause.STRUCK_FROM_SIDE
    if _broke_a_bound(history, ego, other, rules):
        return Cause.ASSUMPTION_VIOLATED
    return Cause.EGO_AT_FAULT


def _partner(history: History, crash: int) -> int | None:
    """Index of the ego's crash partner: the nearest crashed vehicle by footprint; None if none is near enough."""
    crashed = history.states[crash, 1:, Track.CRASHED] > 0
    if not crashed.any():
        return None
    gaps = np.minimum(history.gaps(crash), history.gaps(max(crash - 1, 0)))
    gaps = np.where(crashed, gaps, np.inf)
    speeds = history.states[crash, :, Track.SPEED]
    nearest = int(np.argmin(gaps))
    reach = _TOUCHING + abs(float(speeds[0] - speeds[nearest + 1])) * history.dt
    return nearest + 1 if gaps[nearest] <= reach else None


def _bumper_gap(ego: FloatArray, other: FloatArray) -> float:
    """Signed gap along the road [m]: positive if the other vehicle is ahead, negative if it is behind, 0 alongside."""
    between = float(other[Track.S] - ego[Track.S])
    length = float(other[Track.LENGTH] + ego[Track.LENGTH]) / 2
    return float(np.sign(between)) * max(abs(between) - length, 0.0)


def _in_line(ego: FloatArray, other: FloatArray) -> bool:
    """Whether the two would meet by motion along the road alone."""
    apart = abs(float(other[Track.R] - ego[Track.R]))
    return apart < float(other[Track.WIDTH] + ego[Track.WIDTH]) / 2


def _hopeless(ego: FloatArray, other: FloatArray, braking: float) -> bool:
    if not _in_line(ego, other):
        return False
    gap = _bumper_gap(ego, other)
    if gap == 0.0:
        return True
    rear, front = (ego, other) if gap > 0 else (other, ego)
    closing = float(rear[Track.SPEED] - front[Track.SPEED])
    return closing > 0 and closing**2 / (2 * braking) > abs(gap)


def _kept_lane(history: History, before: int, rules: AttributionRules) -> bool:
    """Whether the ego's footprint was inside one lane over the last `lane_window` seconds."""
    first = max(before - round(rules.lane_window / history.dt), 0)
    road = _straight(history)
    center = _lane_center(history, before)
    recent = history.ego[first : before + 1]
    outside = np.abs(recent[:, Track.R] - center) + recent[:, Track.WIDTH] / 2
    return bool(np.all(outside <= road.width / 2))


def _straight(history: History) -> StraightRoad:
    if not isinstance(history.road, StraightRoad):
        raise SceneError(f"lanes are compared on a StraightRoad only, not on {type(history.road).__name__}")
    return history.road


def _lane_center(history: History, frame: int) -> float:
    road = _straight(history)
    return float(road.centers[road.lane_at(float(history.ego[frame, Track.R]))])


def _from_behind(ego: FloatArray, other: FloatArray) -> bool:
    behind = other[Track.S] < ego[Track.S]
    closing = other[Track.SPEED] > ego[Track.SPEED]
    return bool(_in_line(ego, other) and behind and closing)


def _from_side(history: History, ego: FloatArray, other: FloatArray, rules: AttributionRules) -> bool:
    """Whether the other vehicle entered the ego's lane sideways, alongside or with too small a gap."""
    center = _lane_center(history, len(ego) - 1)
    inside = np.abs(other[:, Track.R] - center) < (_straight(history).width + other[:, Track.WIDTH]) / 2
    first = max(len(ego) - 1 - round(rules.lane_window / history.dt), 0)
    outside = np.flatnonzero(~inside[first:])
    if not outside.size:
        return False  # in the lane for the whole window
    entry = min(first + int(outside[-1]) + 1, len(ego) - 1)
    if ego[-1, Track.SPEED] > ego[entry, Track.SPEED] + _SPEEDING_UP:
        return False
    gap = _bumper_gap(ego[entry], other[entry])
    if gap <= 0:
        return True
    return gap < _needed(ego[entry], other[entry], rules)


def _broke_a_bound(history: History, ego: FloatArray, other: FloatArray, rules: AttributionRules) -> bool:
    """Whether the vehicle ahead recently braked too hard or crashed, while the ego kept the RSS gap."""
    first = max(len(ego) - 1 - round(rules.bound_window / history.dt), 0)
    if other[first, Track.CRASHED]:
        return False  # crashed before the window
    braking = -np.diff(other[:, Track.SPEED]) / history.dt
    too_hard = braking > rules.assumptions.braking + rules.braking_tolerance
    crashed = np.diff(other[:, Track.CRASHED]) > 0
    onsets = np.flatnonzero(too_hard[first:] | crashed[first:])
    if not onsets.size:
        return False
    onset = first + int(onsets[0])
    if not (_in_line(ego[onset], other[onset]) and _in_line(ego[-1], other[-1])):
        return False
    return _bumper_gap(ego[onset], other[onset]) >= _needed(ego[onset], other[onset], rules)


def _needed(ego: FloatArray, other: FloatArray, rules: AttributionRules) -> float:
    return rss_gap(
        float(ego[Track.SPEED]),
        float(other[Track.SPEED]),
        rules.braking,
        rules.assumptions.braking,
        rules.response_time,
    )
