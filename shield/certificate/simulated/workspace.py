"""Limits of a search in simulated traffic, and its workspace."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from dynamics.highway_simulator.arrays import Machine, Rules
from dynamics.highway_simulator.simulator import Simulator
from dynamics.road_networks.simulation.simulator import NetworkSimulator
from dynamics.state import BoolArray, FloatArray, IntArray
from shield.config import ShieldConfig

__all__ = [
    "ANY",
    "NOBODY",
    "LaneSpeedNodes",
    "LaneSpeedTarget",
    "OtherEgos",
    "SearchLimits",
    "TrafficSearch",
    "new_search",
]

ANY = -1
"""Stands for any action."""
NOBODY = -1
"""Stands for no node."""

_LOOKAHEAD, _LOOKAHEAD_ON_NETWORKS = 8.0, 5.0
"""Time over which alternatives are compared on straight highways and on networks [s]; beyond it they only have to stay
clear."""
_KEEP_RIGHT = 0.8
"""Cost of one lane further left, as a loss of speed [m/s]: among alternatives of similar speed the rightmost is chosen.
highway-env's default reward gives 0.83 m/s for a lane on three."""
_REQUESTED_SIDE = 3.0
"""The same on a network, for each lane that remains on the requested side: to leave the road there takes the outermost
lane."""
_BUDGET = 10
"""Decisions that one depth-first search may simulate for each decision of the horizon."""
_NODE_BUDGET, _NODE_BUDGET_ON_NETWORKS = 1_000, 24
"""The same for all searches of one decision together; on straight highways it is not reached."""
_LAST, _LAST_ON_NETWORKS = 1_000, 4
"""The same for each of the two last searches, which follow if the others have failed: an extension of the stored
sequence, and the longest sequence."""
_DEAD_ENDS = 64
"""Capacity of the dead-end table for each number of decisions."""
_NODES = 1024
"""Number of futures that a search over lanes and speeds may compare."""


class SearchLimits(NamedTuple):
    """Limits of a search.

    Attributes
    ----------
    longitudinal, lateral : buffer around the ego [m].
    depth : decisions in the horizon. lookahead : those of them over which alternatives are compared.
    budget : decisions that one depth-first search may simulate.
    node_budget : node budget of all searches of a decision. last : that of each of the two last searches.
    straight : whether the road is a straight highway. There, an action that has spent its budget is searched for over
        lanes and speeds; on a network, part of the budget is for joining the stored sequence.
    keep_right : cost of one lane further left [m/s]. requested_side : cost of one lane on the requested side [m/s].
    spare : index of a spare future; the futures of the nodes follow it.
    """

    longitudinal: float
    lateral: float
    depth: int
    lookahead: int
    budget: int
    node_budget: int
    last: int
    straight: bool
    keep_right: float
    requested_side: float
    spare: int


class LaneSpeedTarget(NamedTuple):
    """Target command of a proposal, with the cost of the lanes beside.

    Attributes
    ----------
    speed : target speed [m/s].
    left, right : cost of each lane to the left and to the right of the ego's target lane, as a loss of speed [m/s].
    """

    speed: float
    left: float
    right: float


class DeadEnds(NamedTuple):
    """Dead-end table of one decision.

    Attributes
    ----------
    counts : number of states stored after each number of decisions, (depth + 1,).
    states : the last of them: the ego's x, y [m], speed [m/s], target lane, and target speed [m/s], (depth + 1,
        `_DEAD_ENDS`, 5).
    """

    counts: IntArray
    states: FloatArray


class SequenceToCrossing(NamedTuple):
    """A sequence that keeps the buffer and ends with the ego on a crossing where others may appear. It is used only if
    no other is found.

    Attributes
    ----------
    going : speeding up at each decision, (depth,).
    plan : the first such sequence, (depth,). margin : its least clearance beyond the buffer, (1,) [m], -inf if there is
        none.
    allowed : whether a sequence may end so, since the ego stands there already, (1,).
    """

    going: IntArray
    plan: IntArray
    margin: FloatArray
    allowed: BoolArray


class LaneSpeedNodes(NamedTuple):
    """Nodes of a search over lanes and speeds; the future `spare + 1 + i` belongs to node i.

    Attributes
    ----------
    slots : node of each lane and speed after each number of decisions, (depth, K), or `NOBODY`.
    cost, clear : distance lost, and least clearance beyond the buffer, up to each node, (n,) [m].
    bound : lower bound on the distance lost over all decisions, (n,) [m].
    level, kind : number of decisions, and lane and speed, (n,). parent, action : previous node and action, (n,).
    open : whether the node has not been expanded yet, (n,).
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


class OtherEgos(NamedTuple):
    """The other egos (multi-agent) and their plans.

    Attributes
    ----------
    columns : of the other egos, (allies,). plans : their actions from the present decision on, (allies, depth + 1).
    since : number of frames of the road at the present, (1,).
    """

    columns: IntArray
    plans: IntArray
    since: IntArray


class TrafficSearch(NamedTuple):
    """Traffic rules and workspace for the searches of one thread, with K lanes and target speeds.

    Attributes
    ----------
    machine, rules, work : of the simulator, on a straight highway or on a network of roads. bounds : limits.
    futures : states: the present, those of a depth-first search by level, a spare one, and those of the nodes.
    order : all actions, those that slow down first.
    given : an action, (2,). row : a body, (1, 7).
    nodes_used : number of decisions simulated since the present was entered, and the number allowed, (2,).
    choices : number of actions tried at each level, (depth + 1,).
    reached : target lane and target speed [m/s] of each of them, (depth + 1, actions + 1, 2).
    least : least clearance beyond the buffer up to each level, (depth + 1,) [m].
    plan : the sequence found, (depth,). hint : a sequence that is extended, (depth,).
    sequence : the sequence that a depth-first search is trying, (depth,).
    other_egos : the other egos, on a network. nodes : of a search over lanes and speeds.
    dead_ends : dead-end table. resting : a sequence that ends on a crossing.
    """

    machine: Machine
    rules: Any
    work: Any
    bounds: SearchLimits
    futures: Any
    order: IntArray
    given: FloatArray
    row: FloatArray
    nodes_used: IntArray
    choices: IntArray
    reached: FloatArray
    least: FloatArray
    plan: IntArray
    hint: IntArray
    sequence: IntArray
    other_egos: OtherEgos
    nodes: LaneSpeedNodes
    dead_ends: DeadEnds
    resting: SequenceToCrossing


_SAFEST_FIRST = (4, 1, 2, 0, 3)
"""Labels of the actions (see `dynamics.highway_simulator.arrays.Rules`): slower, none, right, left, faster."""


def _takes(search: TrafficSearch, simulator: Simulator | NetworkSimulator, other_ego_count: int) -> bool:
    """Whether a search has the dimensions of a simulator's traffic."""
    old, rules = search.rules, simulator.rules
    return (
        type(old) is type(rules)
        and old.times == rules.times
        and np.array_equal(old.labels, rules.labels)
        and _kinds(old) == _kinds(rules)
        and search.other_egos.columns.shape == (other_ego_count,)
        and all(a.shape[1:] == b.shape[1:] for a, b in zip(search.futures, simulator.worlds, strict=True))
    )


def _kinds(rules: Any) -> int:
    """Number of pairs of a lane and a target speed."""
    return len(rules.lanes if isinstance(rules, Rules) else rules.network.lanes) * len(rules.target_speeds)


def _limits(config: ShieldConfig, period: float, straight: bool) -> SearchLimits:
    """Limits of searches on a straight highway or on a network, with decisions of `period` [s]."""
    depth = max(1, math.ceil((config.horizon if straight else config.network_horizon) / period - 1e-9))
    lookahead = _LOOKAHEAD if straight else _LOOKAHEAD_ON_NETWORKS
    return SearchLimits(
        longitudinal=config.buffer.longitudinal,
        lateral=config.buffer.lateral,
        depth=depth,
        lookahead=min(depth, max(1, round(lookahead / period))),
        budget=_BUDGET * depth,
        node_budget=(_NODE_BUDGET if straight else _NODE_BUDGET_ON_NETWORKS) * depth,
        last=(_LAST if straight else _LAST_ON_NETWORKS) * depth,
        straight=straight,
        keep_right=_KEEP_RIGHT,
        requested_side=0.0 if straight else _REQUESTED_SIDE,
        spare=depth + 2,
    )


def _empty_nodes(depth: int, kinds: int) -> LaneSpeedNodes:
    """Nodes of a search over `kinds` lanes and speeds."""
    n, index = min(depth * kinds, _NODES), np.intp
    return LaneSpeedNodes(
        slots=np.full((depth, kinds), NOBODY, index),
        cost=np.zeros(n),
        bound=np.zeros(n),
        clear=np.zeros(n),
        level=np.zeros(n, index),
        kind=np.zeros(n, index),
        parent=np.zeros(n, index),
        action=np.zeros(n, index),
        open=np.zeros(n, np.bool_),
    )


def new_search(
    simulator: Simulator | NetworkSimulator,
    config: ShieldConfig,
    other_ego_count: int = 0,
    old: TrafficSearch | None = None,
) -> TrafficSearch:
    """Workspace for searches in the traffic of a simulator, with `other_ego_count` other egos.

    Parameters
    ----------
    simulator : the traffic. config : buffer and horizon.
    old : a search with the same settings that is no longer used; its buffers are reused if they have the right size.
    """
    if old is not None and _takes(old, simulator, other_ego_count):
        return old._replace(machine=simulator.machine, rules=simulator.rules, work=simulator.new_work())
    rules, index = simulator.rules, np.intp
    labels = rules.labels.tolist()
    bounds = _limits(config, rules.times[1], isinstance(rules, Rules))
    depth, nodes = bounds.depth, _empty_nodes(bounds.depth, _kinds(rules))
    order = np.array([labels.index(label) for label in _SAFEST_FIRST if label in labels], index)
    going = np.full(depth, order[-1], index)
    return TrafficSearch(
        machine=simulator.machine,
        rules=rules,
        work=simulator.new_work(),
        bounds=bounds,
        futures=simulator.new_worlds(bounds.spare + 1 + len(nodes.cost)),
        order=order,
        given=np.zeros(2),
        row=np.zeros((1, 7)),
        nodes_used=np.zeros(2, index),
        choices=np.zeros(depth + 1, index),
        reached=np.zeros((depth + 1, len(labels) + 1, 2)),
        least=np.zeros(depth + 1),
        plan=np.zeros(depth, index),
        hint=np.zeros(depth, index),
        sequence=np.zeros(depth, index),
        other_egos=OtherEgos(
            np.zeros(other_ego_count, index), np.zeros((other_ego_count, depth + 1), index), np.zeros(1, index)
        ),
        nodes=nodes,
        dead_ends=DeadEnds(np.zeros(depth + 1, index), np.zeros((depth + 1, _DEAD_ENDS, 5))),
        resting=SequenceToCrossing(going, np.zeros(depth, index), np.zeros(1), np.zeros(1, np.bool_)),
    )
