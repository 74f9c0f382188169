"""What a search is asked, and the room that it works in."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from dynamics.highway_simulator.simulator import Simulator
from dynamics.highway_simulator.step_kernels import Machine, Rules
from dynamics.road_networks.simulation.simulator import NetworkSimulator
from dynamics.state import BoolArray, FloatArray, IntArray
from shield.config import ShieldConfig

__all__ = ["ANY", "NOBODY", "Bounds", "Nodes", "Search", "Team", "Wish", "new_search"]

ANY = -1
"""Stands for any action."""
NOBODY = -1
"""Stands for no node."""

_OUTLOOK, _OUTLOOK_ON_NETWORKS = 8.0, 5.0
"""How far ahead alternatives are compared on straight highways and on networks [s]; beyond it they have to stay clear,
and no more."""
_KEEP_RIGHT = 0.8
"""What being one lane further left counts as, as a loss of speed [m/s]: of alternatives that are about as fast, the
rightmost. highway-env's default reward gives 0.83 m/s for a lane on three."""
_ASKED = 3.0
"""The same on a network for each lane that there is on the side that is asked for: who wants to leave there has to."""
_BUDGET = 10
"""Decisions that a search in depth may simulate for each that it looks ahead."""
_EFFORT, _EFFORT_ON_NETWORKS = 1_000, 24
"""The same for all searches of a decision together; on straight highways they do not come to it."""
_LAST, _LAST_ON_NETWORKS = 1_000, 4
"""The same for going on with what was planned, and for what lasts longest, when all of these were in vain."""
_DEAD = 64
"""States without a way on that are remembered after each number of decisions."""
_NODES = 1024
"""Futures that a search over lanes and speeds may compare."""


class Bounds(NamedTuple):
    """What is asked of a sequence.

    Attributes
    ----------
    longitudinal, lateral : the buffer around the ego [m].
    depth : decisions that are looked ahead. outlook : of them, those over which alternatives are compared.
    budget : decisions that one search in depth may simulate. effort : that all searches of a decision may. last : that
        each of the two may that come when those were in vain.
    straight : whether the road is a straight highway. There an action that has spent its budget is searched for over
        lanes and speeds; on a network some of the budget is for joining what was planned.
    keep_right : what a lane further left counts as [m/s]. asked : what a lane on the side that is asked for does.
    spare : the future that those after it, the nodes, are reached in.
    """

    longitudinal: float
    lateral: float
    depth: int
    outlook: int
    budget: int
    effort: int
    last: int
    straight: bool
    keep_right: float
    asked: float
    spare: int


class Wish(NamedTuple):
    """Where a proposal leads.

    Attributes
    ----------
    speed : [m/s]. left, right : what each lane to the left and to the right of the ego's counts as, as a loss of speed
        [m/s].
    """

    speed: float
    left: float
    right: float


class Dead(NamedTuple):
    """Where, in the traffic of one decision, no way was found that goes on.

    Attributes
    ----------
    buried : how many states there have been after each number of decisions, (depth + 1,).
    states : the last of them: the ego's x, y [m], speed [m/s], and the lane and the speed [m/s] that it is bound for,
        (depth + 1, `_DEAD`, 5).
    """

    buried: IntArray
    states: FloatArray


class Resting(NamedTuple):
    """A sequence that keeps the buffer and ends with the ego where ways cross and others may appear: it is taken where
    no other is found.

    Attributes
    ----------
    going : to speed up at each decision, (depth,).
    plan : the first that was found, (depth,). margin : its smallest clearance beyond the buffer, (1,) [m], -inf where
        there is none. allowed : whether any may end so, since the ego stands there now already, (1,).
    """

    going: IntArray
    plan: IntArray
    margin: FloatArray
    allowed: BoolArray


class Nodes(NamedTuple):
    """What a search over lanes and speeds has reached: the future `spare + 1 + i` belongs to node i.

    Attributes
    ----------
    slots : the node of each lane and speed after each number of decisions, (depth, K), or `NOBODY`.
    cost, clear : way lost, and smallest clearance beyond the buffer, on the way to each, (n,) [m]. bound : way lost at
        the least when all decisions have been taken, (n,) [m].
    level, kind : decisions to each, and its lane and speed, (n,). parent, action : where it was reached from and by
        what, (n,). open : whether nothing has been tried after it yet, (n,).
    """

    slots: IntArray
    cost: FloatArray
    bound: FloatArray
    clear: FloatArray
    level: IntArray
    kind: IntArray
    parent: IntArray
    action: IntArray
    open: BoolArray


class Team(NamedTuple):
    """The other egos, and what they are going to do.

    Attributes
    ----------
    columns : theirs, (allies,). plans : their actions from the present decision on, (allies, depth + 1).
    since : the frames that the road had seen at the present, (1,).
    """

    columns: IntArray
    plans: IntArray
    since: IntArray


class Search(NamedTuple):
    """The rules of the traffic, and room for the searches of one thread, with K lanes and target speeds.

    Attributes
    ----------
    machine, rules, work : of the simulator, on a straight highway or on a network of roads. bounds : what is asked.
    futures : states: the present, those that a search in depth has come through, a spare one, and those of the nodes.
    order : all actions, those that slow down first.
    given : an action, (2,). row : a body, (1, 7).
    spent : decisions that have been simulated since the present was entered, and how many may be, (2,).
    choices : actions that have been tried at each level, (depth + 1,). reached : lane and speed [m/s] that each of them
        is bound for, (depth + 1, actions + 1, 2). least : smallest clearance beyond the buffer down to each level,
        (depth + 1,) [m].
    plan : the sequence that was found, (depth,). hint : one that is gone on with, (depth,). sequence : the one that a
        search in depth is trying, (depth,).
    team : the other egos, on a network. nodes : what a search over lanes and speeds has reached.
    dead : where a search in depth has found no way on. resting : what ends where it would be in the way.
    """

    machine: Machine
    rules: Any
    work: Any
    bounds: Bounds
    futures: Any
    order: IntArray
    given: FloatArray
    row: FloatArray
    spent: IntArray
    choices: IntArray
    reached: FloatArray
    least: FloatArray
    plan: IntArray
    hint: IntArray
    sequence: IntArray
    team: Team
    nodes: Nodes
    dead: Dead
    resting: Resting


_SAFEST_FIRST = (4, 1, 2, 0, 3)
"""Labels of the actions (see `dynamics.highway_simulator.step_kernels.Rules`): slower, none, right, left, faster."""


def _takes(search: Search, simulator: Simulator | NetworkSimulator, allies: int) -> bool:
    """Whether there is as much in a simulator's traffic as there is room for in a search."""
    old, rules = search.rules, simulator.rules
    return (
        type(old) is type(rules)
        and old.times == rules.times
        and np.array_equal(old.labels, rules.labels)
        and _kinds(old) == _kinds(rules)
        and search.team.columns.shape == (allies,)
        and all(a.shape[1:] == b.shape[1:] for a, b in zip(search.futures, simulator.worlds, strict=True))
    )


def _kinds(rules: Any) -> int:
    """How many lanes and target speeds there are, each with each."""
    return len(rules.lanes if isinstance(rules, Rules) else rules.network.lanes) * len(rules.target_speeds)


def new_search(
    simulator: Simulator | NetworkSimulator, config: ShieldConfig, allies: int = 0, old: Search | None = None
) -> Search:
    """Room for searches in the traffic of a simulator, with so many egos beside the one that is searched for.

    Parameters
    ----------
    old : a search under the same settings that is not needed any more; its room is taken, where it is as large.
    """
    if old is not None and _takes(old, simulator, allies):
        return old._replace(machine=simulator.machine, rules=simulator.rules, work=simulator.new_work())
    rules, index = simulator.rules, np.intp
    labels = rules.labels.tolist()
    straight = isinstance(rules, Rules)
    depth = max(1, math.ceil((config.horizon if straight else config.network_horizon) / rules.times[1] - 1e-9))
    outlook = _OUTLOOK if straight else _OUTLOOK_ON_NETWORKS
    bounds = Bounds(
        longitudinal=config.buffer.longitudinal,
        lateral=config.buffer.lateral,
        depth=depth,
        outlook=min(depth, max(1, round(outlook / rules.times[1]))),
        budget=_BUDGET * depth,
        effort=(_EFFORT if straight else _EFFORT_ON_NETWORKS) * depth,
        last=(_LAST if straight else _LAST_ON_NETWORKS) * depth,
        straight=straight,
        keep_right=_KEEP_RIGHT,
        asked=0.0 if straight else _ASKED,
        spare=depth + 2,
    )
    kinds, order = _kinds(rules), np.array([labels.index(label) for label in _SAFEST_FIRST if label in labels], index)
    going = np.full(depth, order[-1], index)
    n = min(depth * kinds, _NODES)
    return Search(
        machine=simulator.machine,
        rules=rules,
        work=simulator.new_work(),
        bounds=bounds,
        futures=simulator.new_worlds(bounds.spare + 1 + n),
        order=order,
        given=np.zeros(2),
        row=np.zeros((1, 7)),
        spent=np.zeros(2, index),
        choices=np.zeros(depth + 1, index),
        reached=np.zeros((depth + 1, len(labels) + 1, 2)),
        least=np.zeros(depth + 1),
        plan=np.zeros(depth, index),
        hint=np.zeros(depth, index),
        sequence=np.zeros(depth, index),
        team=Team(np.zeros(allies, index), np.zeros((allies, depth + 1), index), np.zeros(1, index)),
        nodes=Nodes(
            slots=np.full((depth, kinds), NOBODY, index),
            cost=np.zeros(n),
            bound=np.zeros(n),
            clear=np.zeros(n),
            level=np.zeros(n, index),
            kind=np.zeros(n, index),
            parent=np.zeros(n, index),
            action=np.zeros(n, index),
            open=np.zeros(n, np.bool_),
        ),
        dead=Dead(np.zeros(depth + 1, index), np.zeros((depth + 1, _DEAD, 5))),
        resting=Resting(going, np.zeros(depth, index), np.zeros(1), np.zeros(1, np.bool_)),
    )
