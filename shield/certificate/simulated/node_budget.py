"""How many decisions may be simulated to make one: what the searches of it have between them.

Where nothing keeps the buffer, every search goes on until it has been through all that it may; so they share what that
is, and a decision there takes no longer than this.
"""

from __future__ import annotations

from dynamics.compiled import uncounted
from shield.certificate.simulated.dead_ends import forget_dead
from shield.certificate.simulated.workspace import Search

__all__ = ["begin_anew", "may_go_on", "try_once_more"]


@uncounted
def _allow(search: Search, decisions: int) -> None:
    """So many may be simulated from now on."""
    search.spent[1] = search.spent[0] + decisions


@uncounted
def begin_anew(search: Search) -> None:
    """As if nothing had been searched for in the present yet."""
    forget_dead(search)
    search.spent[0] = 0
    _allow(search, search.bounds.effort)


@uncounted
def try_once_more(search: Search) -> None:
    """All that was searched for was in vain: what comes now has an effort of its own, and no dead ends to avoid."""
    forget_dead(search)
    _allow(search, search.bounds.last)


@uncounted
def may_go_on(search: Search) -> bool:
    """Whether any more may be."""
    return bool(search.spent[0] < search.spent[1])
