"""Explanation of a refusal in simulated traffic: the simulated effect of the proposal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan
from typing import Any

import numpy as np

from dynamics.highway_simulator.layout import LANE
from dynamics.state import FloatArray, IntArray
from dynamics.traffic.rules_of_the_road import EgoFootprint, gap_between
from shield.certificate.simulated.refused_proposal import simulate_refused
from shield.certificate.simulated.workspace import ANY, TrafficSearch
from shield.compiling import announced
from shield.decision import Decision, Reason, Tier
from shield.explaining.words import action_name, executed_text, inputs_name, justification_text, nothing_judged
from shield.explaining.worlds import VehicleIdentity, describe, lane_of
from shield.explanation import Explanation, LostGuarantee, Obstruction, number

__all__ = ["SimulatedDecisionData", "copy_of"]


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedDecisionData:
    """Data of a decision in simulated traffic.

    Attributes
    ----------
    search : rules of the traffic, and search buffers as a template; see `shield.certificate.simulated.workspace`.
    worlds : the present state of one environment (see `copy_of`).
    nearest : the bodies by column; numbers where there are no objects.
    lanes : highway-env's name of each lane, by number; empty on a straight highway.
    proposal : an action, or acceleration [m/s^2] and wheel angle [rad], (2,). labels : of the actions; empty for
        inputs.
    hint : planned actions, tried first after the proposal.
    other_egos : columns, plans and frames of the other egos (`shield.certificate.simulated.workspace.OtherEgos`); None
        without.
    """

    search: TrafficSearch
    worlds: Any
    identities: Sequence[Any]
    lanes: Sequence[tuple[str, str, int]]
    proposal: Any
    labels: Sequence[str]
    hint: IntArray
    other_egos: tuple[Any, ...] | None = None

    def __reduce__(self) -> Any:
        return type(None), ()

    def explain(self, at: Decision, record: Decision, number_of_frame: int) -> Explanation:
        """See `shield.decision.Source`."""
        inputs = isinstance(self.proposal, np.ndarray)
        proposal = inputs_name(self.proposal) if inputs else action_name(self.labels, record.proposed)

        def name(action: Any) -> str:
            if not inputs:
                return action_name(self.labels, action)
            return ", ".join(number(float(x), 2) for x in np.ravel(action))

        rows, ego = np.zeros((0, 0, 7)), 0
        if at.reason in (Reason.UNVERIFIED, Reason.NO_SAFE_PLAN):
            rows, ego = self.predicted()
        if not len(rows):
            return nothing_judged(at, record, name, nan, proposal, number_of_frame)
        lost = (
            LostGuarantee.GUARANTEE if at.tier.fallback and at.tier is not Tier.STORED_PLAN else LostGuarantee.NOTHING
        )
        tail = executed_text(at, record, name, float(rows[0, ego, 3])), justification_text(at, lost)
        clause, cause, short, after, why = self._what(rows, ego)
        return Explanation(
            proposal, at.reason, clause, cause, short, after, why, *tail, at.margin, number_of_frame, lost
        )

    def _what(self, rows: FloatArray, ego: int) -> tuple[str, Obstruction | None, float, float, str]:
        """The clause, the vehicle, the shortfall of the buffer [m], its time [s], and the text."""
        gaps, dt = self._gaps(rows, ego), float(self.search.rules.times[0])
        inside = np.flatnonzero((gaps < 0).any(axis=1))
        hit = np.flatnonzero(rows[1:, ego, 6] > 0) + 1
        nothing_else = "and no continuation was found that keeps it"
        if not inside.size and not hit.size:
            after = (len(rows) - 1) * dt
            why = (
                f"in the simulation no continuation was found after {number(after)} s "
                "that keeps to the road and the buffer"
            )
            return "road", None, nan, after, why
        first = int(min([*inside[:1], *hit[:1]]))
        nearest, after = int(gaps[first].argmin()), first * dt
        short, cause = -float(min(gaps[first:, nearest].min(), 0.0)), self._cause(rows[0], ego, nearest)
        crash = f", with a crash after {number(hit[0] * dt)} s" if hit.size else ""
        lacks = f"the buffer would be short after {number(after)} s, by up to {number(short)} m{crash}"
        why = f"in the simulation {cause.text} comes in the way; {lacks}, {nothing_else}"
        return "crash" if hit.size else "simulated", cause, short, after, why

    def _cause(self, bodies: FloatArray, ego: int, column: int) -> Obstruction:
        """Description of the body in a column."""
        number_of_lane = int(self.worlds.g[0, LANE, column])
        several = len({(start, end) for start, end, _ in self.lanes}) > 1
        lane = lane_of(self.lanes[number_of_lane]) if several else f"lane {number_of_lane}"
        return describe(bodies[ego, :6], bodies[column, :6], VehicleIdentity(self.identities[column], lane))

    def _gaps(self, rows: FloatArray, ego: int) -> FloatArray:
        """Clearance beyond the buffer from each body at each frame, (frames + 1, m) [m]; inf for the ego and empty
        columns."""
        bounds, out = self.search.bounds, np.full(rows.shape[:2], np.inf)
        for k, bodies in enumerate(rows):
            x, y, heading, speed, length, width, _ = bodies[ego]
            along, across = 0.5 * length + bounds.longitudinal, 0.5 * width + bounds.lateral
            own = EgoFootprint(x, y, heading, speed, along, across, 0.5 * length, 0.5 * width, False)
            near = np.hypot(bodies[:, 0] - x, bodies[:, 1] - y) < 40.0
            for i in np.flatnonzero(near & (bodies[:, 4] > 0)):
                if i != ego:
                    out[k, i] = gap_between(own, along, across, bodies, int(i), 0.0)
        return out

    def rehearse(self) -> None:
        """Call every kernel of an explanation, so that it is compiled."""
        rows, ego = self.predicted()
        self._gaps(np.repeat(rows[:1, [ego]], 2, axis=1), 0)

    def predicted(self) -> tuple[FloatArray, int]:
        """Predicted bodies now and at each frame, (frames + 1, m, 7), and the column of the ego.

        The ego executes the proposal, and then the sequence that keeps the buffer longest.
        """
        search = _with_own_buffers(self.search)
        if self.other_egos is not None:
            search.other_egos.columns[:], search.other_egos.plans[:], search.other_egos.since[0] = self.other_egos
        frames = (search.bounds.depth + 2) * int(search.rules.numbers[0])
        rows, inputs, action = np.zeros((2 + frames, search.futures.f.shape[2], 7)), np.full(2, np.nan), self.proposal
        if isinstance(action, np.ndarray):
            inputs[:], action = action, ANY
        elif not 0 <= action < search.order.shape[0]:
            return rows[:0], 0
        where = "highways" if search.bounds.straight else "networks"
        with announced(f"simulated explanations on {where}"):
            count, ego = simulate_refused(search, self.worlds, int(action), inputs, self.hint, rows)
        return rows[:count], ego


def _with_own_buffers(search: TrafficSearch) -> TrafficSearch:
    """The search with buffers of its own for a search in depth; those of the decisions stay unchanged."""

    def own(part: Any) -> Any:
        return part._replace(**{name: getattr(part, name).copy() for name in part._fields})

    futures, few = search.futures, search.bounds.spare + 2
    arrays = ("given", "row", "nodes_used", "choices", "reached", "least", "plan", "hint", "sequence")
    return search._replace(
        futures=futures._replace(**{name: getattr(futures, name)[:few].copy() for name in futures._fields}),
        **{name: getattr(search, name).copy() for name in arrays},
        other_egos=own(search.other_egos),
        dead_ends=own(search.dead_ends),
        resting=own(search.resting),
    )


def copy_of(worlds: Any, e: int = 0) -> Any:
    """Copy of the present state of environment `e`."""
    return worlds._replace(**{name: getattr(worlds, name)[e : e + 1].copy() for name in worlds._fields})
