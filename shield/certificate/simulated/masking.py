"""Action masks of many environments, as `shield.filters.simulated.meta_actions.ExactDoor.mask` computes them."""

from __future__ import annotations

from typing import Any

from dynamics.compiled import uncounted
from dynamics.state import BoolArray
from shield.certificate.simulated.decision_kernels import Plans, boxed_in, verify
from shield.certificate.simulated.node_budget import begin_anew
from shield.certificate.simulated.search import enter
from shield.certificate.simulated.workspace import Search

__all__ = ["mask_all"]


@uncounted
def mask_all(search: Search, worlds: Any, plans: Plans, masks: BoolArray, first: int, last: int) -> None:
    """Fill in the actions that verify in each of the environments from `first` to `last`, (e, actions). The stored
    sequences do not change."""
    for e in range(first, last):
        enter(search, worlds, e)
        twice = not boxed_in(plans, e)
        for k in range(masks.shape[1]):
            # The dead ends of one action would influence the next, and `decide` has none at this point.
            begin_anew(search)
            masks[e, k] = verify(search, k, plans.actions[e], plans.length[e], twice) >= 0
