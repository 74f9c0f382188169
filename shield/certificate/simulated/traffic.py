"""Operations of a search on the traffic, each for a straight highway and for a network of roads."""

from __future__ import annotations

from typing import Any

from dynamics.compiled import dispatch_by_field_type, kernel_inline, kernel_no_refcount
from dynamics.highway_simulator import step_kernels as highways
from dynamics.highway_simulator.arrays import Rules as HighwayRules
from dynamics.highway_simulator.lanes import on_lane
from dynamics.highway_simulator.layout import LANE, LENGTH, TARGET, WIDTH, X, Y
from dynamics.highway_simulator.neighbours import sort
from dynamics.road_networks.geometry.layout import COUNT, CROSSES, ENDS, FRAMES, ID, LEADS_BACK
from dynamics.road_networks.simulation import frame_kernels as networks
from shield.certificate.simulated.workspace import TrafficSearch

__all__ = ["copy_more", "ego_in", "frame", "hold", "lanes_beside", "on_crossing", "on_road", "sorted_in", "start"]

_advance, _begin, _ego_of, _on_way = networks.advance, networks.begin, networks.ego_of, networks.on_way
_command, _hold = networks.command, networks.hold
_advance_highway, _begin_highway, _NO_INPUTS = highways.advance, highways.begin, highways.NO_INPUTS


@kernel_no_refcount
def _start_highway(search: TrafficSearch, k: int) -> None:
    _begin_highway(search.futures, search.rules, k, search.given)


@kernel_no_refcount
def _start_network(search: TrafficSearch, k: int) -> None:
    other_egos, g, rules = search.other_egos, search.futures.g[k], search.rules
    now = (g[FRAMES, 0] - other_egos.since[0]) // rules.numbers[0]
    _begin(search.machine, search.futures, rules, k, search.given)
    for i in range(other_egos.columns.shape[0]):
        _command(search.machine, search.futures, rules, k, other_egos.columns[i], other_egos.plans[i, now])


@kernel_no_refcount
def hold(search: TrafficSearch, k: int, throttle: float, wheel: float) -> None:
    """Set a constant acceleration [m/s^2] and front wheel angle [rad] of the ego of a network in future k."""
    _hold(search.futures, k, throttle, wheel)


@kernel_no_refcount
def _sort_highway(search: TrafficSearch, k: int) -> bool:
    return bool(sort(search.futures.f[k], search.futures.order[k]))


@kernel_inline
def _sorts_itself(search: TrafficSearch, k: int) -> bool:
    return False


@kernel_no_refcount
def _frame_highway(search: TrafficSearch, k: int, level: bool) -> bool:
    return _advance_highway(search.machine, search.futures, search.rules, search.work, k, level, _NO_INPUTS)


@kernel_no_refcount
def _frame_network(search: TrafficSearch, k: int, level: bool) -> bool:
    _advance(search.machine, search.futures, search.rules, search.work, k)
    return level


@kernel_no_refcount
def _on_highway(search: TrafficSearch, k: int) -> tuple[bool, bool]:
    f, g = search.futures.f[k], search.futures.g[k]
    return on_lane(search.rules.lanes, g[LANE, 0], f[X, 0], f[Y, 0], 0.0), False


@kernel_no_refcount
def _on_network(search: TrafficSearch, k: int) -> tuple[bool, bool]:
    g = search.futures.g[k]
    on, at_end = _on_way(search.rules, search.futures.f[k], g)
    return on, at_end and search.rules.network.ids[g[LANE, _ego_of(g)], ENDS] == LEADS_BACK


@kernel_inline
def _first(search: TrafficSearch, k: int) -> int:
    return 0


@kernel_inline
def _ego_on_network(search: TrafficSearch, k: int) -> int:
    return _ego_of(search.futures.g[k])


@kernel_no_refcount
def _beside_on_highway(search: TrafficSearch, k: int) -> tuple[int, int]:
    target = search.futures.g[k, TARGET, 0]
    return target, len(search.rules.lanes) - 1 - target


@kernel_no_refcount
def _beside_on_network(search: TrafficSearch, k: int) -> tuple[int, int]:
    g = search.futures.g[k]
    ids, target = search.rules.network.ids, g[TARGET, _ego_of(g)]
    return ids[target, ID], ids[target, COUNT] - 1 - ids[target, ID]


@kernel_inline
def _never(search: TrafficSearch, k: int) -> bool:
    return False


@kernel_no_refcount
def _where_ways_cross(search: TrafficSearch, k: int) -> bool:
    g, ego, rules = search.futures.g[k], _ego_of(search.futures.g[k]), search.rules
    return rules.regulation.stay > 0 and rules.network.ids[g[LANE, ego], CROSSES] != 0


@kernel_no_refcount
def _nothing_more(search: TrafficSearch, worlds: Any, e: int) -> None:
    return


@kernel_no_refcount
def _copy_more(search: TrafficSearch, worlds: Any, e: int) -> None:
    routes, given, counts, p = search.futures.routes, worlds.routes[e], search.futures.counts, search.futures.p
    for k in range(search.bounds.spare + 1):
        counts[k, 0], counts[k, 1] = worlds.counts[e, 0], worlds.counts[e, 1]
        for i in range(routes.shape[1]):
            for j in range(routes.shape[2]):
                routes[k, i, j, 0], routes[k, i, j, 1] = given[i, j, 0], given[i, j, 1]
        for i in range(counts[k, 1], p.shape[2]):
            # No body is in this column any more, so its size is 0.
            p[k, LENGTH, i] = p[k, WIDTH, i] = 0.0


_HIGHWAY, _NETWORK = HighwayRules, networks.NetworkRules


@dispatch_by_field_type({_HIGHWAY: _first, _NETWORK: _ego_on_network}, "rules")
def ego_in(search: TrafficSearch, k: int) -> int:
    """Column of the ego in future k."""
    raise NotImplementedError


@dispatch_by_field_type({_HIGHWAY: _start_highway, _NETWORK: _start_network}, "rules")
def start(search: TrafficSearch, k: int) -> None:
    """Begin the decision in `search.given` in future k."""


@dispatch_by_field_type({_HIGHWAY: _sort_highway, _NETWORK: _sorts_itself}, "rules")
def sorted_in(search: TrafficSearch, k: int) -> bool:
    """Sort the bodies of future k before its frames; see `dynamics.highway_simulator.neighbours.sort`."""
    raise NotImplementedError


@dispatch_by_field_type({_HIGHWAY: _frame_highway, _NETWORK: _frame_network}, "rules")
def frame(search: TrafficSearch, k: int, level: bool) -> bool:
    """Advance future k by a frame; see `dynamics.highway_simulator.neighbours.sort` for `level`."""
    raise NotImplementedError


@dispatch_by_field_type({_HIGHWAY: _on_highway, _NETWORK: _on_network}, "rules")
def on_road(search: TrafficSearch, k: int) -> tuple[bool, bool]:
    """Whether the ego is on the road in future k, and whether it is where the road leads back.

    An ego that cannot stop drives on straight where a road ends, which counts as on the road; for one that can stop it
    does not. Where the road leads back, highway-env turns the ego round, and nothing is verified any more.
    """
    raise NotImplementedError


@dispatch_by_field_type({_HIGHWAY: _beside_on_highway, _NETWORK: _beside_on_network}, "rules")
def lanes_beside(search: TrafficSearch, k: int) -> tuple[int, int]:
    """Number of lanes to the left and to the right of the ego's target lane in future k."""
    raise NotImplementedError


@dispatch_by_field_type({_HIGHWAY: _never, _NETWORK: _where_ways_cross}, "rules")
def on_crossing(search: TrafficSearch, k: int) -> bool:
    """Whether the ego is on a crossing in future k, on a road on which other vehicles may appear."""
    raise NotImplementedError


@dispatch_by_field_type({_HIGHWAY: _nothing_more, _NETWORK: _copy_more}, "rules")
def copy_more(search: TrafficSearch, worlds: Any, e: int) -> None:
    """Copy the constant state of scene e to all futures: on a network the routes, and the number of bodies."""
