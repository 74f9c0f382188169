"""Action masks of many environments, as `shield.filters.simulated.meta_actions.SimulatedMetaActionFilter.mask`
computes them."""

from __future__ import annotations

from typing import Any

from dynamics.compiled import kernel_no_refcount
from dynamics.state import BoolArray
from shield.certificate.simulated.decision_kernels import StoredSequences, has_no_certificate, verify
from shield.certificate.simulated.node_budget import reset_budget
from shield.certificate.simulated.search import set_root_scene
from shield.certificate.simulated.workspace import TrafficSearch

__all__ = ["mask_all"]


@kernel_no_refcount
def mask_all(
    search: TrafficSearch, worlds: Any, plans: StoredSequences, masks: BoolArray, first: int, last: int
) -> None:
    """Fill in the actions that verify in each of the environments from `first` to `last`, (e, actions). The stored
    sequences do not change."""
    for e in range(first, last):
        set_root_scene(search, worlds, e)
        twice = not has_no_certificate(plans, e)
        for k in range(masks.shape[1]):
            # The dead ends of one action would influence the next, and `decide` has none at this point.
            reset_budget(search)
            masks[e, k] = verify(search, k, plans.actions[e], plans.length[e], twice) >= 0
