"""The plan that comes closest to what was proposed: a beam search with one future for each lane and speed."""

from __future__ import annotations

import numpy as np

from dynamics.compiled import uncounted
from dynamics.simulator.layout import TARGET, TARGET_SPEED
from dynamics.simulator.scene import speed_index
from shield.exact.room import Search
from shield.exact.search import copy_future, depart, repeats, survives, travel
from shield.exact.traffic import ego_in

__all__ = ["ANY", "best_plan", "clear_plan", "closest_plan", "wished_speed"]

ANY = -1
"""Any action."""


@uncounted
def wished_speed(search: Search, target_speed: float, action: int) -> float:
    """Where an action that is held on to brings the target speed [m/s]."""
    label, speeds = search.rules.labels[action], search.rules.target_speeds
    if label == 3:
        return speeds[len(speeds) - 1]
    return speeds[0] if label == 4 else target_speed


@uncounted
def best_plan(search: Search, only: int, never: int, depth: int, wish: float, floor: float) -> tuple[int, float]:
    """The sequence that stays clear for `depth` decisions and loses the least way against a speed, into `search.plan`;
    where none does, the one that does for most of them.

    Of the futures that are bound for the same lane at the same speed the one goes on that has lost least, so it need
    not find a sequence where there is one.

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
    futures, speeds, kinds, n = search.futures, search.rules.target_speeds, search.lost.shape[1], search.order.shape[0]
    lost, clear, paths, tried, spare = search.lost, search.clear, search.paths, search.reached[0], 2 * kinds + 1
    lasts = 0
    for level in range(depth):
        now, then = level % 2, 1 - level % 2
        for k in range(kinds):
            lost[then, k] = np.inf
        for k in range(1 if level == 0 else kinds):
            if level > 0 and lost[now, k] == np.inf:
                continue
            source = 0 if level == 0 else 1 + now * kinds + k
            for action in range(n):
                tried[action, 0] = -1.0
                if level == 0 and (action == never or only not in (ANY, action)):
                    continue
                tried[action, 0], tried[action, 1] = depart(search, source, spare, action)
                if repeats(tried, action):
                    continue
                least, cost = travel(search, spare, wish, floor)
                if least < floor:
                    continue
                if level > 0:
                    least, cost = min(least, clear[now, k]), cost + lost[now, k]
                if floor < 0:
                    cost = -least
                ego = ego_in(search, spare)
                speed = speed_index(speeds, futures.f[spare, TARGET_SPEED, ego])
                kind = futures.g[spare, TARGET, ego] * len(speeds) + speed
                if cost < lost[then, kind]:
                    copy_future(search, spare, 1 + then * kinds + kind)
                    lost[then, kind], clear[then, kind] = cost, least
                    for i in range(level):
                        paths[then, kind, i] = paths[now, k, i]
                    paths[then, kind, level] = action
                    lasts = level + 1
        if lasts == level:
            break
    if lasts == 0:
        return 0, -np.inf
    last, best = lasts % 2, 0
    for k in range(kinds):
        if lost[last, k] < lost[last, best]:
            best = k
    for i in range(lasts):
        search.plan[i] = paths[last, best, i]
    return lasts, clear[last, best]


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
