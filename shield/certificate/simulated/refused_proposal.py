"""What would have happened after a proposal that was refused."""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.compiled import uncounted
from dynamics.state import FloatArray, IntArray
from shield.certificate.simulated.search import enter, foretell, in_depth
from shield.certificate.simulated.traffic import ego_in, frame, hold, sorted_in
from shield.certificate.simulated.workspace import ANY, Search

__all__ = ["foretell_refused"]


@uncounted
def foretell_refused(
    search: Search, worlds: Any, action: int, inputs: FloatArray, planned: IntArray, rows: FloatArray
) -> tuple[int, int]:
    """What comes of a proposal, and then of what stays clear longest after it, until no action keeps the buffer.

    Parameters
    ----------
    worlds : the present, in its first scene.
    action : the proposal. inputs : in its place acceleration [m/s^2] and front wheel angle [rad] for a frame, (2,), NaN
        without; the action is `ANY` then.
    planned : what is tried first after it. rows : as of `foretell`, of which two more frames than of all decisions.

    Returns
    -------
    How many rows there are, the present first, and the column of the ego.
    """
    depth, before, worst = search.bounds.depth, 0, search.order[0]
    enter(search, worlds, 0)
    if not np.isnan(inputs[0]):
        before = foretell(search, planned, 0, rows)
        hold(search, 0, inputs[0], inputs[1])
        frame(search, 0, sorted_in(search, 0))
    lasts, _, _ = in_depth(search, action, planned, planned.shape[0], 0, 0.0, 2 * depth)
    # The buffer is kept so far; what comes after it is whatever slows down.
    for k in range(lasts, depth):
        search.plan[k] = worst
    if lasts == 0 and action != ANY:
        search.plan[0] = action
    count = foretell(search, search.plan, min(lasts + 1, depth), rows[before:])
    return before + count, ego_in(search, 0)
