"""Node budget: number of decisions that may be simulated for one decision, shared by all its searches.

If no sequence keeps the buffer, every search uses its whole budget. The shared budget bounds the time of such a
decision.
"""

from __future__ import annotations

from dynamics.compiled import kernel_no_refcount
from shield.certificate.simulated.dead_ends import clear_dead_ends
from shield.certificate.simulated.workspace import TrafficSearch

__all__ = ["grant_last_budget", "has_budget", "reset_budget"]


@kernel_no_refcount
def _allow(search: TrafficSearch, decisions: int) -> None:
    """Allow `decisions` more from now on."""
    search.nodes_used[1] = search.nodes_used[0] + decisions


@kernel_no_refcount
def reset_budget(search: TrafficSearch) -> None:
    """Reset the budget and the dead-end table for a new root state."""
    clear_dead_ends(search)
    search.nodes_used[0] = 0
    _allow(search, search.bounds.node_budget)


@kernel_no_refcount
def grant_last_budget(search: TrafficSearch) -> None:
    """Give the last searches a budget of their own and an empty dead-end table, after all others have failed."""
    clear_dead_ends(search)
    _allow(search, search.bounds.last)


@kernel_no_refcount
def has_budget(search: TrafficSearch) -> bool:
    """Whether any budget is left."""
    return bool(search.nodes_used[0] < search.nodes_used[1])
