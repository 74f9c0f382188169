"""The loops of the worst-case prediction: one pass over the vehicles, and one over vehicles and frames.

`dynamics.traffic.occupancy` says what the quantities are and where they come from.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dynamics.compiled import compiled
from dynamics.state import Vehicle

__all__ = ["CHANGE", "COS", "HIGH", "LOW", "REACH", "hulls", "rears"]

LOW, HIGH, REACH, COS, CHANGE = range(5)
"""Rows of the quantities of the vehicles."""
_LENGTH, _WIDTH, _CRASHED = int(Vehicle.LENGTH), int(Vehicle.WIDTH), int(Vehicle.CRASHED)


@compiled
def hulls(
    others: Any,
    states: Any,
    centers: Any,
    lane_width: float,
    tolerance: float,
    keeping_offset: float,
    max_heading: float,
    lane: Any,
    moving: Any,
    out: Any,
) -> None:
    """What follows from each vehicle's present state, on a straight road.

    Parameters
    ----------
    others, states : rows of vehicles (m, 7), and road states (m, 4).
    centers, lane_width : of the lanes [m].
    tolerance, keeping_offset : heading [rad] and offset [m] up to which a vehicle keeps its lane.
    max_heading : greatest heading of one that changes lanes [rad].
    lane, moving, out : results, (m,), (m,) and (5, m); NaN for a vehicle whose row is.
    """
    last, right = centers.shape[0] - 1, 0.5 * math.pi
    for i in range(states.shape[0]):
        r, psi, length, width = states[i, 1], states[i, 2], others[i, _LENGTH], others[i, _WIDTH]
        if not math.isfinite(r + psi + length + width + states[i, 0] + states[i, 3]):
            lane[i], moving[i], out[:, i] = 0, False, np.nan
            continue
        heading = abs(psi)
        here = int(min(max(np.rint((r - centers[0]) / lane_width), 0), last))
        center = centers[here]
        offset = r - center
        lane[i] = here
        moving[i] = (heading > tolerance or abs(offset) > keeping_offset) and others[i, 3] != 0
        # Even one that keeps its lane may start to leave it at the next frame.
        turn = min(max(max_heading, heading), right)
        # The extent along the road is greatest at the heading of the diagonal, or as near to it as it can turn.
        diagonal = min(turn, math.atan2(width, length))
        half = 0.5 * (width + length * math.sin(min(max(heading, tolerance), right)))
        low, high = min(r, center) - half, max(r, center) + half
        out[REACH, i] = 0.5 * (length * math.cos(diagonal) + width * math.sin(diagonal))
        out[COS, i] = math.cos(turn)
        # v (1 - cos psi) <= tan(psi / 2) v sin psi: what a single lane change costs it along the road.
        out[CHANGE, i] = math.tan(0.5 * turn) * lane_width
        if moving[i]:
            # Towards its heading, else back to the centre of its lane.
            toward = np.sign(psi) if heading > tolerance else -np.sign(offset)
            leaving = toward * offset >= 0
            end = centers[int(min(max(here + toward, 0), last))] if leaving else center
            turned = 0.5 * (width + length * math.sin(turn))
            # One that is coming back to its lane's centre turns no further outwards than it is turned now.
            low = min(min(r, center), end) - (half if not leaving and offset < 0 else turned)
            high = max(max(r, center), end) + (half if not leaving and offset > 0 else turned)
            out[CHANGE, i] = np.inf
        out[LOW, i], out[HIGH, i] = low, high


@compiled
def rears(
    rows: Any,
    others: Any,
    states: Any,
    moving: Any,
    quantities: Any,
    stretch: Any,
    braking: float,
    min_speed: float,
    hold: int,
    dt: float,
    out: Any,
) -> None:
    """Least s of the bodies of vehicles `rows` (m,) after each frame, `out` (m, K) [m].

    `stretch` (2, vehicles) has the least and greatest metres of s in a metre driven; no columns on a straight road.
    """
    for i in range(rows.shape[0]):
        j = rows[i]
        v, wrecked, wreck = states[j, 3], others[j, _CRASHED] > 0, 1.0
        floor, start, way = min(v, min_speed), states[j, 0] - quantities[REACH, j], 0.0
        for k in range(out.shape[1]):
            slow = max(v - braking * dt * max(k - hold, 0), floor)
            if wrecked:
                # highway-env: a crashed vehicle brakes at -1 * speed per second.
                slow = min(slow, v * wreck)
                wreck *= 1 - dt
            way += slow
            # On a heading of up to the bound, only the cosine of the speed advances along the road.
            loss = max(min((1 - quantities[COS, j]) * way * dt, quantities[CHANGE, j]), 0.0)
            if hold > 0 and not moving[j]:
                loss = 0.0  # One that keeps its lane is expected to go on doing so.
            along = way * dt - loss
            if stretch.shape[1] > 0:
                along = min(along * stretch[0, j], along * stretch[1, j])
            out[i, k] = start + along
