"""How many decisions may be simulated to make one: what the searches of it have between them.

Where nothing keeps the buffer, no search of some thousand decisions finds more than one of a hundred and what was
planned already; so a decision takes about as long as any other there.
"""

from __future__ import annotations

from dynamics.compiled import uncounted
from shield.exact.dead import forget_dead
from shield.exact.room import Search

__all__ = ["allow", "begin_anew", "may_go_on"]


@uncounted
def allow(search: Search, decisions: int) -> None:
    """So many may be simulated from now on."""
    search.spent[1] = search.spent[0] + decisions


@uncounted
def begin_anew(search: Search) -> None:
    """As if nothing had been searched for in the present yet."""
    forget_dead(search)
    search.spent[0] = 0
    allow(search, search.bounds.effort)


@uncounted
def may_go_on(search: Search) -> bool:
    """Whether any more may be."""
    return bool(search.spent[0] < search.spent[1])
