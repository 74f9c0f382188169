"""Simulates the outcome of a refused proposal."""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.compiled import kernel_no_refcount
from dynamics.state import FloatArray, IntArray
from shield.certificate.simulated.search import PreferredActions, depth_first, set_root_scene, simulate_sequence
from shield.certificate.simulated.traffic import ego_in, frame, hold, sorted_in
from shield.certificate.simulated.workspace import ANY, TrafficSearch

__all__ = ["simulate_refused"]


@kernel_no_refcount
def simulate_refused(
    search: TrafficSearch, worlds: Any, action: int, inputs: FloatArray, planned: IntArray, rows: FloatArray
) -> tuple[int, int]:
    """Simulate a proposal, followed by the actions that stay clear longest after it, until no action keeps the buffer.

    Parameters
    ----------
    worlds : the present, in its first scene.
    action : the proposal. inputs : instead of it, acceleration [m/s^2] and front wheel angle [rad] for one frame, (2,);
        NaN if there are none. With inputs the action is `ANY`.
    planned : actions that are tried first after it.
    rows : as in `simulate_sequence`, with room for two more frames than the horizon.

    Returns
    -------
    Number of rows written, the present first; and the column of the ego.
    """
    depth, before, worst = search.bounds.depth, 0, search.order[0]
    set_root_scene(search, worlds, 0)
    if not np.isnan(inputs[0]):
        before = simulate_sequence(search, planned, 0, rows)
        hold(search, 0, inputs[0], inputs[1])
        frame(search, 0, sorted_in(search, 0))
    lasts, _, _ = depth_first(search, PreferredActions(action, planned, planned.shape[0]), 0, 0.0, 2 * depth)
    # Up to here the buffer is kept; afterwards the ego slows down.
    for k in range(lasts, depth):
        search.plan[k] = worst
    if lasts == 0 and action != ANY:
        search.plan[0] = action
    count = simulate_sequence(search, search.plan, min(lasts + 1, depth), rows[before:])
    return before + count, ego_in(search, 0)
