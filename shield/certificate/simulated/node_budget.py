"""Node budget: number of decisions that may be simulated for one decision, shared by all its searches.

If no sequence keeps the buffer, every search uses its whole budget. The shared budget bounds the time of such a
decision.
"""

from __future__ import annotations

from dynamics.compiled import uncounted
from shield.certificate.simulated.dead_ends import forget_dead
from shield.certificate.simulated.workspace import Search

__all__ = ["begin_anew", "may_go_on", "try_once_more"]


@uncounted
def _allow(search: Search, decisions: int) -> None:
    """Allow `decisions` more from now on."""
    search.spent[1] = search.spent[0] + decisions


@uncounted
def begin_anew(search: Search) -> None:
    """Reset the budget and the dead-end table for a new root state."""
    forget_dead(search)
    search.spent[0] = 0
    _allow(search, search.bounds.effort)


@uncounted
def try_once_more(search: Search) -> None:
    """Give the last searches a budget of their own and an empty dead-end table, after all others have failed."""
    forget_dead(search)
    _allow(search, search.bounds.last)


@uncounted
def may_go_on(search: Search) -> bool:
    """Whether any budget is left."""
    return bool(search.spent[0] < search.spent[1])
