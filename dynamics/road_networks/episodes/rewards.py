"""Rewards and ends of episodes of highway-env's environments on road networks."""

from __future__ import annotations

from typing import NamedTuple

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.arithmetic import clip
from dynamics.highway_simulator.layout import CRASHED, KIND, LANE, OBSTACLE, SPEED, TARGET, TARGET_SPEED, X
from dynamics.road_networks.geometry.lanes import on_lane
from dynamics.road_networks.geometry.layout import ACROSS, ALONG, COUNT, ID, LEAVES
from dynamics.road_networks.geometry.routes import NetworkTraffic
from dynamics.state import FloatArray

__all__ = [
    "CROSSING",
    "EXITING",
    "MERGING",
    "NAMES",
    "ROUND",
    "TURNING",
    "TWO_WAY",
    "RewardRules",
    "index_of_speed",
    "reward_of_decision",
]

MERGING, ROUND, EXITING, TWO_WAY, TURNING, CROSSING = range(6)
"""Merge, roundabout, exit, two-way, u-turn, intersection."""
NAMES = (
    ("collision_reward", "right_lane_reward", "high_speed_reward", "lane_change_reward", "merging_speed_reward"),
    ("collision_reward", "high_speed_reward", "lane_change_reward", "on_road_reward"),
    ("collision_reward", "goal_reward", "high_speed_reward", "right_lane_reward"),
    ("high_speed_reward", "left_lane_reward"),
    ("collision_reward", "left_lane_reward", "high_speed_reward", "on_road_reward"),
    ("collision_reward", "high_speed_reward", "arrived_reward", "on_road_reward"),
)
"""The terms of each reward, in highway-env's order."""
_DEFAULT_SPEEDS = 3
"""Number of `MDPVehicle.DEFAULT_TARGET_SPEEDS`."""
_ARRIVED = 25.0
"""Distance along a lane that leaves the intersection from which the ego has arrived [m]."""


class RewardRules(NamedTuple):
    """Parameters of rewards and ends of episodes.

    Attributes
    ----------
    kind : MERGING to CROSSING.
    weights : (5,), of the terms, in the order of `NAMES`.
    speeds : mapped to 0 and 1 [m/s]. rewards : mapped to 0 and 1.
    normalised : whether rewards are normalised. strict : whether leaving the road ends an episode of an intersection.
    lanes : the merging lane, or the exit lanes; -1 for none.
    end : x beyond which an episode ends [m].
    duration, decisions : time [s] and number of decisions after which it is truncated, 0 decisions for never.
    """

    kind: int
    weights: FloatArray
    speeds: tuple[float, float]
    rewards: tuple[float, float]
    normalised: bool
    strict: bool
    lanes: tuple[int, int]
    end: float
    duration: float
    decisions: int


@kernel_inline
def _share(x: float, ends: tuple[float, float]) -> float:
    """highway-env's `lmap`: linear, with 0 at the first of `ends` and 1 at the second."""
    return 0.0 + (x - ends[0]) * 1.0 / (ends[1] - ends[0])


@kernel_inline
def index_of_speed(target_speeds: FloatArray, speed: float) -> int:
    """Index of the ego's target speed."""
    index = 0
    while index < len(target_speeds) - 1 and target_speeds[index] != speed:
        index += 1
    return index


@kernel_no_refcount
def _speed_loss(traffic: NetworkTraffic, lane: int, vehicles: int) -> float:
    """Sum over the vehicles on the merging lane of their shortfall from the target speed, as a share of it."""
    f, g, total = traffic.f, traffic.g, 0.0
    for i in range(vehicles):
        if g[LANE, i] == lane and g[KIND, i] != OBSTACLE:
            total += (f[TARGET_SPEED, i] - f[SPEED, i]) / f[TARGET_SPEED, i]
    return total


@kernel_inline
def _is_on_road(traffic: NetworkTraffic, ego: int) -> bool:
    """Whether the ego is on its lane."""
    f = traffic.f
    return on_lane(traffic.lanes.rows, traffic.g[LANE, ego], f[ALONG, ego], f[ACROSS, ego], 0.0)


@kernel_no_refcount
def _parts(
    traffic: NetworkTraffic,
    worth: RewardRules,
    target_speeds: FloatArray,
    ego: int,
    vehicles: int,
    action: int,
    parts: FloatArray,
) -> None:
    """The terms of the reward, in the order of `NAMES`, to `parts`, (5,)."""
    on_road = 1.0 if _is_on_road(traffic, ego) else 0.0
    f, g, ids = traffic.f, traffic.g, traffic.lanes.ids
    lane, target, kind = g[LANE, ego], g[TARGET, ego], worth.kind
    crashed, speed, beside = float(g[CRASHED, ego]), f[SPEED, ego], 1.0 if action == 0 or action == 2 else 0.0
    fast = _share(speed, worth.speeds)
    for k in range(len(parts)):
        parts[k] = 0.0
    if kind == MERGING:
        parts[0], parts[1], parts[2], parts[3] = crashed, ids[lane, ID] / 1, fast, beside
        parts[4] = _speed_loss(traffic, worth.lanes[0], vehicles)
    elif kind == ROUND:
        index = index_of_speed(target_speeds, f[TARGET_SPEED, ego])
        parts[0], parts[1], parts[2], parts[3] = crashed, index / (_DEFAULT_SPEEDS - 1), beside, on_road
    elif kind == EXITING:
        out = 1.0 if target == worth.lanes[0] or target == worth.lanes[1] else 0.0
        parts[0], parts[1], parts[2], parts[3] = crashed, out, clip(fast, 0.0, 1.0), ids[target, ID]
    elif kind == TWO_WAY:
        others = ids[lane, COUNT] - 1
        parts[0] = index_of_speed(target_speeds, f[TARGET_SPEED, ego]) / (len(target_speeds) - 1)
        parts[1] = (others - ids[target, ID]) / others
    elif kind == TURNING:
        parts[0], parts[1] = crashed, ids[lane, ID] / max(ids[lane, COUNT] - 1, 1)
        parts[2], parts[3] = clip(fast, 0.0, 1.0), on_road
    else:
        arrived = 1.0 if ids[lane, LEAVES] and f[ALONG, ego] >= _ARRIVED else 0.0
        parts[0], parts[1], parts[2], parts[3] = crashed, clip(fast, 0.0, 1.0), arrived, on_road


@kernel_no_refcount
def reward_of_decision(
    traffic: NetworkTraffic,
    worth: RewardRules,
    target_speeds: FloatArray,
    ego: int,
    vehicles: int,
    action: int,
    parts: FloatArray,
) -> tuple[float, bool]:
    """The reward of a decision, and whether it ends the episode; the terms of the reward to `parts`, (5,)."""
    f, g, kind = traffic.f, traffic.g, worth.kind
    on = _is_on_road(traffic, ego)
    on_road = 1.0 if on else 0.0
    _parts(traffic, worth, target_speeds, ego, vehicles, action, parts)
    reward = 0.0
    for k in range(len(parts)):
        reward += worth.weights[k] * parts[k]
    over = g[CRASHED, ego] != 0 or f[X, ego] > worth.end
    if kind == CROSSING:
        if parts[2] != 0.0:
            reward = worth.rewards[1]
        reward *= on_road
        over = over or parts[2] != 0.0 or (worth.strict and not on)
    if worth.normalised:
        reward = _share(reward, worth.rewards)
    if kind == EXITING and worth.normalised:
        reward = clip(reward, 0.0, 1.0)
    if kind in (ROUND, TURNING):
        reward *= on_road
    return reward, over
