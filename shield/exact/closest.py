"""The plan that comes closest to what was proposed: a search with one future for each lane, speed and time."""

from __future__ import annotations

import numpy as np

from dynamics.compiled import inlined, uncounted
from dynamics.simulator.layout import TARGET, TARGET_SPEED
from dynamics.simulator.scene import speed_index
from shield.exact.room import ANY, NOBODY, Nodes, Search
from shield.exact.search import copy_future, depart, repeats, survives, travel
from shield.exact.traffic import ego_in

__all__ = ["best_plan", "clear_plan", "closest_plan", "wished_speed"]


@uncounted
def wished_speed(search: Search, target_speed: float, action: int) -> float:
    """Where an action that is held on to brings the target speed [m/s]."""
    label, speeds = search.rules.labels[action], search.rules.target_speeds
    if label == 3:
        return speeds[len(speeds) - 1]
    return speeds[0] if label == 4 else target_speed


@inlined
def _next(nodes: Nodes, count: int) -> int:
    """The open node of least cost, of equals the one of the least level and then kind; `NOBODY` where none is open."""
    best = NOBODY
    for i in range(count):
        if not nodes.open[i]:
            continue
        if best == NOBODY or nodes.cost[i] < nodes.cost[best]:
            best = i
        elif nodes.cost[i] == nodes.cost[best]:
            level, other = nodes.level[i], nodes.level[best]
            if level < other or (level == other and nodes.kind[i] < nodes.kind[best]):
                best = i
    return best


@inlined
def _deepest(nodes: Nodes, count: int) -> int:
    """The node of the greatest level, and of these the one of least cost; `NOBODY` where there is none."""
    best = NOBODY
    for i in range(count):
        if best == NOBODY or nodes.level[i] > nodes.level[best]:
            best = i
        elif nodes.level[i] == nodes.level[best]:
            cost, other = nodes.cost[i], nodes.cost[best]
            if cost < other or (cost == other and nodes.kind[i] < nodes.kind[best]):
                best = i
    return best


@uncounted
def _expand(
    search: Search, parent: int, count: int, only: int, never: int, depth: int, wish: float, floor: float
) -> int:
    """Take every action after a node, or after the present, and keep what is the best way to its lane and speed by
    then; how many nodes there are."""
    futures, speeds, nodes, tried = search.futures, search.rules.target_speeds, search.nodes, search.reached[0]
    spare, first = search.bounds.spare, search.bounds.spare + 1
    level, source = (0, 0) if parent == NOBODY else (nodes.level[parent], first + parent)
    for action in range(search.order.shape[0]):
        tried[action, 0] = -1.0
        if level == 0 and (action == never or only not in (ANY, action)):
            continue
        tried[action, 0], tried[action, 1] = depart(search, source, spare, action)
        if repeats(tried, action):
            continue
        least, cost = travel(search, spare, wish, floor)
        if least < floor:
            continue
        ego = ego_in(search, spare)
        speed = speed_index(speeds, futures.f[spare, TARGET_SPEED, ego])
        kind = futures.g[spare, TARGET, ego] * len(speeds) + speed
        slot = nodes.slots[level, kind]
        if (count == nodes.cost.shape[0]) if slot == NOBODY else not nodes.open[slot]:
            continue
        if parent != NOBODY:
            least, cost = min(least, nodes.clear[parent]), cost + nodes.cost[parent]
        if floor < 0:
            cost = -least
        if not cost < (np.inf if slot == NOBODY else nodes.cost[slot]):
            continue
        if slot == NOBODY:
            slot, count = count, count + 1
            nodes.slots[level, kind], nodes.open[slot] = slot, True
        nodes.cost[slot], nodes.clear[slot], nodes.level[slot] = cost, least, level + 1
        nodes.kind[slot], nodes.parent[slot], nodes.action[slot] = kind, parent, action
        if level + 1 < depth:
            copy_future(search, spare, first + slot)
    return count


@uncounted
def best_plan(search: Search, only: int, never: int, depth: int, wish: float, floor: float) -> tuple[int, float]:
    """The sequence that stays clear for `depth` decisions and loses the least way against a speed, into `search.plan`;
    where none does, the one that does for most of them.

    A uniform-cost search (Dijkstra 1959) in which, of the futures that are bound for the same lane at the same speed
    after as many decisions, the one goes on that has lost least, so it need not find a sequence where there is one.

    Parameters
    ----------
    only, never : the one action that it begins with, and one that it does not begin with; -1 for any.
    wish : the speed [m/s].
    floor : smallest clearance beyond the buffer that is allowed [m]; where it is negative, the clearance is what is
        made largest.

    Returns
    -------
    For how many decisions it stays clear, and its smallest clearance beyond the buffer [m], -inf where it is none.
    """
    nodes = search.nodes
    for level in range(depth):
        for k in range(nodes.slots.shape[1]):
            nodes.slots[level, k] = NOBODY
    node, count = NOBODY, _expand(search, NOBODY, 0, only, never, depth, wish, floor)
    while True:
        node = _next(nodes, count)
        if node == NOBODY:
            node = _deepest(nodes, count)
            break
        nodes.open[node] = False
        if nodes.level[node] == depth:
            break
        count = _expand(search, node, count, only, never, depth, wish, floor)
    if node == NOBODY:
        return 0, -np.inf
    lasts, margin = nodes.level[node], nodes.clear[node]
    while node != NOBODY:
        search.plan[nodes.level[node] - 1] = nodes.action[node]
        node = nodes.parent[node]
    return lasts, margin


@uncounted
def clear_plan(search: Search, only: int, never: int, wish: float) -> float:
    """The smallest clearance beyond the buffer [m] of what `best_plan` finds, -inf where that does not keep the buffer
    for all decisions."""
    lasts, margin = best_plan(search, only, never, search.bounds.depth, wish, 0.0)
    return margin if lasts == search.bounds.depth else -np.inf


@uncounted
def closest_plan(search: Search, proposed: int, wish: float) -> float:
    """The sequence that does not begin with the proposal, stays clear for all decisions, and loses the least way
    against a speed over the first `outlook` of them, into `search.plan`; its smallest clearance beyond the buffer [m],
    -inf where none is found."""
    bounds = search.bounds
    lasts, _ = best_plan(search, ANY, proposed, bounds.outlook, wish, 0.0)
    if lasts < bounds.outlook:
        return -np.inf
    for k in range(bounds.outlook):
        search.hint[k] = search.plan[k]
    margin, _ = survives(search, search.hint[0], search.hint, bounds.outlook)
    return margin if margin >= 0 else clear_plan(search, ANY, proposed, wish)
