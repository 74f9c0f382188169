"""Depth-first search for a sequence of meta-actions that keeps the buffer in the exact future of the traffic.

The traffic of a straight highway draws no random numbers after the reset. So `dynamics.highway_simulator` computes what
every vehicle does after every action of the ego, its response to the ego included. An action verifies if *some*
sequence of actions that begins with it keeps the buffer for `depth` decisions.

A *future* is a copy of the traffic's state, in which the search simulates; future 0 is the present.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from dynamics.compiled import kernel_inline, kernel_no_refcount
from dynamics.highway_simulator.layout import (
    CRASHED,
    DIAGONAL,
    HEADING,
    LENGTH,
    SPEED,
    TARGET,
    TARGET_SPEED,
    WIDTH,
    X,
    Y,
)
from dynamics.highway_simulator.step_kernels import write_row
from dynamics.state import FloatArray, IntArray
from dynamics.traffic.rules_of_the_road import EgoFootprint, gap_between
from shield.certificate.simulated.dead_ends import add_dead_end, is_dead_end_state
from shield.certificate.simulated.node_budget import reset_budget
from shield.certificate.simulated.traffic import (
    copy_more,
    ego_in,
    frame,
    lanes_beside,
    on_crossing,
    on_road,
    sorted_in,
    start,
)
from shield.certificate.simulated.workspace import ANY, LaneSpeedTarget, SearchLimits, TrafficSearch

__all__ = [
    "PreferredActions",
    "begin_action",
    "clearance",
    "copy_future",
    "copy_state",
    "depth_first",
    "ends_on_crossing",
    "extend_past_crossing",
    "find_sequence",
    "finish_action",
    "repeats",
    "same_outcome",
    "set_root",
    "set_root_scene",
    "simulate_action",
    "simulate_sequence",
]

_AT_REST = 1.0
"""Speed below which the ego counts as standing [m/s]."""
_LEAVE = 2
"""Decisions that may be simulated, for each decision of the horizon, to find a sequence that does not end on a
crossing. From the second search on it is one."""
_NO_MORE, _TRIED = -2, -1
"""Stand for no further action, and for an action that has been tried."""
_JOIN = 2 / 3
"""Share of its budget that a sequence may spend on joining the stored sequence again, if it begins with another
action."""


@kernel_no_refcount
def copy_state(worlds: Any, e: int, futures: Any, k: int) -> None:
    """Copy the moving state of one environment to a future."""
    f, g, f0, g0 = futures.f[k], futures.g[k], worlds.f[e], worlds.g[e]
    for i in range(f.shape[0]):
        for j in range(f.shape[1]):
            f[i, j] = f0[i, j]
    for i in range(g.shape[0]):
        for j in range(g.shape[1]):
            g[i, j] = g0[i, j]
    for j in range(f.shape[1]):
        futures.order[k, j] = worlds.order[e, j]
    futures.clock[k] = worlds.clock[e]


@kernel_no_refcount
def copy_future(search: TrafficSearch, source: int, target: int) -> None:
    """Copy one future over another."""
    copy_state(search.futures, source, search.futures, target)


@kernel_no_refcount
def set_root(search: TrafficSearch, worlds: Any, e: int) -> None:
    """Copy a state to future 0, like `set_root_scene`, for the same vehicles as at the last `set_root_scene`."""
    copy_state(worlds, e, search.futures, 0)
    reset_budget(search)
    search.resting.margin[0], search.resting.allowed[0] = -np.inf, True


@kernel_no_refcount
def set_root_scene(search: TrafficSearch, worlds: Any, e: int) -> None:
    """Copy the present of one environment to future 0."""
    set_root(search, worlds, e)
    p, p0 = search.futures.p, worlds.p[e]
    # The futures of the nodes are only copied from and to, never simulated in: they need no body parameters.
    for k in range(search.bounds.spare + 1):
        for i in range(p.shape[1]):
            for j in range(p.shape[2]):
                p[k, i, j] = p0[i, j]
    copy_more(search, worlds, e)
    # An ego that stands on a crossing already may stay there.
    moves = abs(search.futures.f[0, SPEED, ego_in(search, 0)]) >= _AT_REST
    search.resting.allowed[0] = not moves and on_crossing(search, 0)


@kernel_no_refcount
def clearance(futures: Any, k: int, ego: int, bounds: SearchLimits, row: FloatArray) -> float:
    """Least distance from the ego to any body, beyond the buffer [m]; negative if a body is inside the buffer.

    Parameters
    ----------
    futures : the futures, of which `k` is evaluated. ego : column of the ego. row : buffer for a vehicle row, (7,).
    """
    f, g, p = futures.f[k], futures.g[k], futures.p[k]
    x, y, half_length, half_width = f[X, ego], f[Y, ego], 0.5 * p[LENGTH, ego], 0.5 * p[WIDTH, ego]
    along, across = half_length + bounds.longitudinal, half_width + bounds.lateral
    own = EgoFootprint(x, y, f[HEADING, ego], f[SPEED, ego], along, across, half_length, half_width, False, False)
    least, reach = np.inf, math.hypot(along, across)
    for i in range(f.shape[1]):
        if i == ego or not p[LENGTH, i] > 0:
            continue
        far, dx, dy = reach + 0.5 * p[DIAGONAL, i], f[X, i] - x, f[Y, i] - y
        if abs(dx) - far < least and abs(dy) - far < least and math.hypot(dx, dy) - far < least:
            write_row(f, g, p, i, row[0])
            least = min(least, gap_between(own, along, across, row, 0, 0.0))
    return least


@kernel_no_refcount
def begin_action(search: TrafficSearch, source: int, target: int, action: int) -> tuple[int, float]:
    """Begin an action in future `source`, with the result in future `target`. Return the target lane and the target
    speed of the ego [m/s], which are all that an action determines."""
    copy_future(search, source, target)
    search.given[0], search.given[1] = action, 0.0
    start(search, target)
    ego = ego_in(search, target)
    return search.futures.g[target, TARGET, ego], search.futures.f[target, TARGET_SPEED, ego]


@kernel_no_refcount
def finish_action(search: TrafficSearch, target: int, command: LaneSpeedTarget, floor: float) -> tuple[float, float]:
    """Simulate the rest of the decision that `begin_action` has begun; see `simulate_action`."""
    futures, rules, bounds, columns = search.futures, search.rules, search.bounds, search.other_egos.columns
    f, g, dt, ego = futures.f[target], futures.g[target], rules.times[0], ego_in(search, target)
    search.nodes_used[0] += 1
    if on_road(search, target)[1]:
        return np.inf, 0.0
    level, least, lost = sorted_in(search, target), np.inf, 0.0
    for _ in range(rules.numbers[0]):
        level = frame(search, target, level)
        on, turns_back = on_road(search, target)
        if g[CRASHED, ego] != 0 or not on:
            return -np.inf, lost
        least = min(least, clearance(futures, target, ego, bounds, search.row))
        for i in range(columns.shape[0]):
            if g[CRASHED, columns[i]] != 0:
                return -np.inf, lost
            least = min(least, clearance(futures, target, columns[i], bounds, search.row))
        left, right = lanes_beside(search, target)
        lost += (abs(command.speed - f[SPEED, ego]) + command.left * left + command.right * right) * dt
        if least < floor or turns_back:
            break
    return least, lost


@kernel_no_refcount
def simulate_action(
    search: TrafficSearch, source: int, target: int, action: int, command: LaneSpeedTarget, floor: float
) -> tuple[float, float]:
    """Simulate an action in future `source`, with the result in future `target`.

    Parameters
    ----------
    command : target command. floor : clearance beyond the buffer below which the simulation stops [m].

    Returns
    -------
    least : least clearance beyond the buffer during the decision [m]; -inf after a crash, or off the road; +inf
        without other bodies. After the end of a road that leads back nothing is checked.
    lost : distance lost against the target command [m], including the cost of its lane.
    """
    begin_action(search, source, target, action)
    return finish_action(search, target, command, floor)


@kernel_no_refcount
def simulate_sequence(search: TrafficSearch, actions: IntArray, length: int, rows: FloatArray) -> int:
    """Simulate the first `length` actions, and write the bodies now and after each frame.

    Parameters
    ----------
    rows : (frames + 1, m, 7), written: x, y [m], heading [rad], speed [m/s], length, width [m], crashed.

    Returns
    -------
    Number of frames written.
    """
    futures, target, n = search.futures, 1, 0
    f, g, p = futures.f[target], futures.g[target], futures.p[target]
    copy_future(search, 0, target)
    for k in range(-1, length):
        if k >= 0:
            search.given[0], search.given[1] = actions[k], 0.0
            start(search, target)
        level = sorted_in(search, target)
        for _ in range(1 if k < 0 else search.rules.numbers[0]):
            if k >= 0:
                level = frame(search, target, level)
            for i in range(f.shape[1]):
                write_row(f, g, p, i, rows[n, i])
            n += 1
    return n


@kernel_inline
def repeats(reached: FloatArray, k: int) -> bool:
    """Whether row k of `reached`, the target lane and target speed of an action, repeats that of an earlier action.
    Then both actions have the same outcome."""
    found = False
    for earlier in range(k):
        found = found or (reached[earlier, 0] == reached[k, 0] and reached[earlier, 1] == reached[k, 1])
    return found


@kernel_no_refcount
def same_outcome(search: TrafficSearch, a: int, b: int) -> bool:
    """Whether two actions have the same target lane and target speed now."""
    spare = search.bounds.spare
    return begin_action(search, 0, spare, a) == begin_action(search, 0, spare, b)


@kernel_no_refcount
def ends_on_crossing(search: TrafficSearch, k: int, sequence: IntArray, margin: float) -> bool:
    """Whether a sequence for the whole horizon is refused because the ego is on a crossing at its end, future k. The
    first such sequence is stored in `search.resting`."""
    resting = search.resting
    if resting.allowed[0] or not on_crossing(search, k):
        return False
    if resting.margin[0] < 0.0:
        resting.margin[0] = margin
        for i in range(resting.plan.shape[0]):
            resting.plan[i] = sequence[i]
    return True


class PreferredActions(NamedTuple):
    """Actions that a depth-first search tries first.

    Attributes
    ----------
    first : action that the sequence begins with; `ANY` for any.
    stored : actions that are tried first at each level, except for the given first action, (depth,), of which `length`
        are valid; elsewhere slowing down is tried first.
    """

    first: int
    stored: IntArray
    length: int


@kernel_inline
def _action_to_try(search: TrafficSearch, preferred: PreferredActions, level: int, tried: int) -> int:
    """The action that is tried at a level after `tried` others; -1 if it has been tried already, and `_NO_MORE` if all
    have."""
    if level == 0 and preferred.first != ANY:
        return preferred.first if tried == 0 else _NO_MORE
    if tried > search.order.shape[0]:
        return _NO_MORE
    before_all: int = preferred.stored[level] if level < preferred.length else search.order[0]
    if tried == 0:
        return before_all
    action: int = search.order[tried - 1]
    return _TRIED if action == before_all else action


@kernel_no_refcount
def depth_first(
    search: TrafficSearch, preferred: PreferredActions, known: int, floor: float, budget: int, leaves: bool = False
) -> tuple[int, float, bool]:
    """Depth-first search for a sequence that stays clear for the whole horizon, into `search.plan`. If none is found,
    the first of the longest ones that were tried.

    Parameters
    ----------
    known : number of levels for which the futures and the other buffers are valid already.
    floor : least clearance beyond the buffer [m]. budget : number of decisions that may be simulated.
    leaves : whether a sequence for the whole horizon may not end on a crossing (`on_crossing`).

    Returns
    -------
    Number of decisions for which the sequence stays clear, its least clearance beyond the buffer [m], and whether the
    budget was spent before all sequences had been tried.
    """
    bounds, level, lasts = search.bounds, known, known
    until = min(search.nodes_used[0] + budget - known, search.nodes_used[1])
    search.least[0] = np.inf
    clear, search.choices[known] = search.least[known], 0
    while level >= 0 and lasts < bounds.depth and search.nodes_used[0] < until:
        tried = search.choices[level]
        search.choices[level] += 1
        action = _action_to_try(search, preferred, level, tried)
        if action == _NO_MORE:
            if level > 0:
                add_dead_end(search, level)
            level -= 1
            continue
        reached = search.reached[level]
        reached[tried, 0] = -1.0
        if action == _TRIED:
            continue
        reached[tried, 0], reached[tried, 1] = begin_action(search, level, level + 1, action)
        if repeats(reached, tried):
            continue
        least, _ = finish_action(search, level + 1, LaneSpeedTarget(0.0, 0.0, 0.0), floor)
        if least < floor or is_dead_end_state(search, level + 1):
            continue
        search.sequence[level] = action
        search.least[level + 1] = min(search.least[level], least)
        if leaves and level + 1 == bounds.depth and on_crossing(search, level + 1):
            continue
        level += 1
        if level > lasts:
            lasts, clear = level, search.least[level]
            for k in range(level):
                search.plan[k] = search.sequence[k]
        search.choices[level] = 0
    return lasts, clear if lasts > 0 else -np.inf, lasts < bounds.depth and search.nodes_used[0] >= until


@kernel_no_refcount
def extend_past_crossing(search: TrafficSearch, first: int, margin: float) -> float:
    """Least clearance beyond the buffer of the sequence for the whole horizon in `search.plan` [m]. If it ends on a
    crossing, it is replaced by one with the same first action that drives on as fast as possible; -inf if none is
    found."""
    depth, going, once = search.bounds.depth, search.resting.going, search.resting.margin[0] >= 0.0
    if not ends_on_crossing(search, depth, search.plan, margin):
        return margin
    budget = depth if once else _LEAVE * depth
    lasts, margin, _ = depth_first(search, PreferredActions(first, going, depth), 0, 0.0, budget, True)
    return margin if lasts == depth else -np.inf


@kernel_no_refcount
def find_sequence(search: TrafficSearch, first: int, stored: IntArray, length: int) -> tuple[float, bool]:
    """Search for a sequence that begins with an action and keeps the buffer for the whole horizon, into `search.plan`;
    see `depth_first`.

    The stored sequence may begin with another action. Then, on a network, the larger part of the budget is for joining
    it again, and the rest for slowing down. On a straight highway all of it is for slowing down.

    Returns
    -------
    Least clearance beyond the buffer of the sequence [m], -inf if none is found; and whether the budget was spent
    before all sequences had been tried.
    """
    depth, budget = search.bounds.depth, search.bounds.budget
    begins = first == ANY or (length > 0 and stored[0] == first)
    lasts, margin, exhausted = 0, -np.inf, True
    if length > 0 and not begins and not search.bounds.straight:
        joins = math.ceil(_JOIN * budget)
        lasts, margin, exhausted = depth_first(search, PreferredActions(first, stored, length), 0, 0.0, joins)
        budget -= joins
    if lasts < depth and exhausted:
        preferred = PreferredActions(first, stored, length if begins else 0)
        lasts, margin, exhausted = depth_first(search, preferred, 0, 0.0, budget)
    return (extend_past_crossing(search, search.plan[0], margin) if lasts == depth else -np.inf), exhausted
