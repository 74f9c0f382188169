"""Search for the plan closest to the proposal, with one future for each lane, speed and time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.control import KP_A
from dynamics.highway_simulator.layout import SPEED, TARGET, TARGET_SPEED
from dynamics.highway_simulator.scene import next_target_speed, speed_index
from shield.certificate.simulated.node_budget import has_budget
from shield.certificate.simulated.search import (
    PreferredActions,
    begin_action,
    copy_future,
    depth_first,
    ends_on_crossing,
    extend_past_crossing,
    finish_action,
    repeats,
)
from shield.certificate.simulated.traffic import ego_in, on_road
from shield.certificate.simulated.workspace import ANY, NOBODY, LaneSpeedNodes, LaneSpeedTarget, TrafficSearch

__all__ = ["best_plan", "clear_plan", "closest_plan", "lane_speed_target_of", "stopping_cost"]


@kernel_no_refcount
def lane_speed_target_of(search: TrafficSearch, target_speed: float, action: int) -> LaneSpeedTarget:
    """Target command of an action that is repeated, from a target speed [m/s]. At equal speed the right lane is
    preferred, unless the action is a lane change."""
    label, speeds, bounds = search.rules.labels[action], search.rules.target_speeds, search.bounds
    speed, left, right = target_speed, 0.0, bounds.keep_right
    if label == 3:
        speed = speeds[len(speeds) - 1]
    elif label == 4:
        speed = speeds[0]
    elif label in (0, 2) and bounds.requested_side > 0:
        left, right = (bounds.requested_side, 0.0) if label == 0 else (0.0, bounds.requested_side)
    return LaneSpeedTarget(speed, left, right)


@kernel_no_refcount
def stopping_cost(search: TrafficSearch) -> LaneSpeedTarget:
    """Target command to slow down, with a preference for the right lane."""
    return LaneSpeedTarget(0.0, 0.0, search.bounds.keep_right)


@kernel_no_refcount
def _bound_to_lose(search: TrafficSearch, k: int, decisions: int, target_speed: float) -> float:
    """Lower bound on the distance that future k loses against a speed in the next `decisions` decisions [m]. It is the
    loss on an empty road, with the most favourable target speed at each decision; 0 where the ego's
    road leads back."""
    rules, f, ego = search.rules, search.futures.f[k], ego_in(search, k)
    if on_road(search, k)[1]:
        return 0.0
    speed, target, dt, lost = f[SPEED, ego], f[TARGET_SPEED, ego], rules.times[0], 0.0
    up = speed < target_speed
    for _ in range(decisions):
        following = next_target_speed(rules.target_speeds, speed, 3 if up else 4)
        target = max(target, following) if up else min(target, following)
        for _ in range(rules.numbers[0]):
            speed += KP_A * (target - speed) * dt
            left = target_speed - speed if up else speed - target_speed
            if left <= 0.0:
                return lost
            lost += left * dt
    return lost


@kernel_inline
def _next(nodes: LaneSpeedNodes, count: int) -> int:
    """The open node with the least bound; among equals the greatest level, then the least kind. `NOBODY` if none is
    open."""
    best = NOBODY
    for i in range(count):
        if not nodes.open[i]:
            continue
        if best == NOBODY or nodes.bound[i] < nodes.bound[best]:
            best = i
        elif nodes.bound[i] == nodes.bound[best]:
            level, other = nodes.level[i], nodes.level[best]
            if level > other or (level == other and nodes.kind[i] < nodes.kind[best]):
                best = i
    return best


@kernel_inline
def _deepest(nodes: LaneSpeedNodes, count: int) -> int:
    """The node of the greatest level, and among these the one with the least cost; `NOBODY` if there is none."""
    best = NOBODY
    for i in range(count):
        if best == NOBODY or nodes.level[i] > nodes.level[best]:
            best = i
        elif nodes.level[i] == nodes.level[best]:
            cost, other = nodes.cost[i], nodes.cost[best]
            if cost < other or (cost == other and nodes.kind[i] < nodes.kind[best]):
                best = i
    return best


class _Wanted(NamedTuple):
    """The sequence that is searched for, as in `best_plan`."""

    only: int
    never: int
    depth: int
    command: LaneSpeedTarget
    floor: float


@kernel_no_refcount
def _expand(search: TrafficSearch, parent: int, count: int, wanted: _Wanted) -> int:
    """Simulate every action from a node, or from the present, and keep the best way to each lane and speed of the next
    level. Return the number of nodes."""
    futures, speeds, nodes, tried = search.futures, search.rules.target_speeds, search.nodes, search.reached[0]
    spare, first = search.bounds.spare, search.bounds.spare + 1
    level, source = (0, 0) if parent == NOBODY else (nodes.level[parent], first + parent)
    for action in range(search.order.shape[0]):
        tried[action, 0] = -1.0
        if level == 0 and (action == wanted.never or wanted.only not in (ANY, action)):
            continue
        tried[action, 0], tried[action, 1] = begin_action(search, source, spare, action)
        if repeats(tried, action):
            continue
        least, cost = finish_action(search, spare, wanted.command, wanted.floor)
        if least < wanted.floor:
            continue
        ego = ego_in(search, spare)
        speed = speed_index(speeds, futures.f[spare, TARGET_SPEED, ego])
        kind = futures.g[spare, TARGET, ego] * len(speeds) + speed
        slot = nodes.slots[level, kind]
        if (count == nodes.cost.shape[0]) if slot == NOBODY else not nodes.open[slot]:
            continue
        if parent != NOBODY:
            least, cost = min(least, nodes.clear[parent]), cost + nodes.cost[parent]
        if wanted.floor < 0:
            cost = bound = -least
        else:
            bound = cost + _bound_to_lose(search, spare, wanted.depth - level - 1, wanted.command.speed)
        if not bound < (np.inf if slot == NOBODY else nodes.bound[slot]):
            continue
        if slot == NOBODY:
            slot, count = count, count + 1
            nodes.slots[level, kind], nodes.open[slot] = slot, True
        nodes.cost[slot], nodes.bound[slot], nodes.clear[slot], nodes.level[slot] = cost, bound, least, level + 1
        nodes.kind[slot], nodes.parent[slot], nodes.action[slot] = kind, parent, action
        copy_future(search, spare, first + slot)
    return count


@kernel_no_refcount
def _best_node(search: TrafficSearch, wanted: _Wanted) -> int:
    """The last node of the plan that `best_plan` finds, with its sequence in `search.plan`; `NOBODY` if there is
    none."""
    nodes, depth = search.nodes, wanted.depth
    for level in range(depth):
        for k in range(nodes.slots.shape[1]):
            nodes.slots[level, k] = NOBODY
    node, count = NOBODY, _expand(search, NOBODY, 0, wanted)
    while True:
        node = _next(nodes, count) if has_budget(search) else NOBODY
        if node == NOBODY:
            node = _deepest(nodes, count)
            break
        nodes.open[node] = False
        if nodes.level[node] == depth:
            break
        count = _expand(search, node, count, wanted)
    found = node
    while node != NOBODY:
        search.plan[nodes.level[node] - 1] = nodes.action[node]
        node = nodes.parent[node]
    return found


@kernel_no_refcount
def best_plan(
    search: TrafficSearch, only: int, never: int, depth: int, command: LaneSpeedTarget, floor: float
) -> tuple[int, float]:
    """The sequence that stays clear for `depth` decisions and loses the least distance against a target command, into
    `search.plan`; if there is none, the longest one.

    A* (Hart, Nilsson and Raphael 1968), with the loss on an empty road as the bound. Among futures with the same target
    lane, target speed and number of decisions, only the one with the least bound is kept. So the search may miss a
    sequence that exists.

    Parameters
    ----------
    only, never : the one action that it begins with, and one that it does not begin with; -1 for none.
    floor : least clearance beyond the buffer [m]. If it is negative, the clearance is maximised instead.

    Returns
    -------
    Number of decisions for which it stays clear, and its least clearance beyond the buffer [m], -inf if there is none.
    """
    nodes, node = search.nodes, _best_node(search, _Wanted(only, never, depth, command, floor))
    if node == NOBODY:
        return 0, -np.inf
    return nodes.level[node], nodes.clear[node]


@kernel_no_refcount
def clear_plan(search: TrafficSearch, only: int, never: int, command: LaneSpeedTarget) -> float:
    """Least clearance beyond the buffer [m] of the plan that `best_plan` finds, -inf if it does not keep the buffer for
    the whole horizon."""
    nodes, depth = search.nodes, search.bounds.depth
    node = _best_node(search, _Wanted(only, never, depth, command, 0.0))
    if node == NOBODY or nodes.level[node] < depth:
        return -np.inf
    margin = nodes.clear[node]
    return -np.inf if ends_on_crossing(search, search.bounds.spare + 1 + node, search.plan, margin) else margin


@kernel_no_refcount
def _go_on_from(search: TrafficSearch, node: int) -> float:
    """Extend the sequence of a node to the whole horizon, or find another with the same first action, into
    `search.plan`. Return its least clearance beyond the buffer [m], -inf if none is found. The futures up to the node
    are known."""
    nodes, spare, depth, known = search.nodes, search.bounds.spare, search.bounds.depth, search.nodes.level[node]
    while node != NOBODY:
        level, action = nodes.level[node], nodes.action[node]
        copy_future(search, spare + 1 + node, level)
        search.hint[level - 1], search.sequence[level - 1] = action, action
        search.choices[level - 1], search.least[level] = 1, nodes.clear[node]
        node = nodes.parent[node]
    for level in range(known):
        search.reached[level, 0, 0], search.reached[level, 0, 1] = begin_action(
            search, level, spare, search.hint[level]
        )
    preferred = PreferredActions(search.hint[0], search.hint, known)
    lasts, margin, _ = depth_first(search, preferred, known, 0.0, search.bounds.budget)
    return extend_past_crossing(search, search.plan[0], margin) if lasts == depth else -np.inf


@kernel_no_refcount
def closest_plan(search: TrafficSearch, proposed: int, command: LaneSpeedTarget) -> float:
    """The sequence that loses the least distance against a target command over its first `lookahead` decisions, into
    `search.plan`. It does not begin with the proposal, and stays clear for the whole horizon. Return its least
    clearance beyond the buffer [m], -inf if none is found."""
    lookahead = search.bounds.lookahead
    node = _best_node(search, _Wanted(ANY, proposed, lookahead, command, 0.0))
    if node == NOBODY or search.nodes.level[node] < lookahead:
        return -np.inf
    margin = _go_on_from(search, node)
    # A sequence that ends on a crossing keeps the buffer: another one need not be searched for.
    refused = search.resting.margin[0] >= 0.0
    return margin if margin >= 0 or refused else clear_plan(search, ANY, proposed, command)
