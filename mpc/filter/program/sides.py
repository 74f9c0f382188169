"""Choice of the side on which a plan passes each obstacle, from the guess, as CasADi expressions.

Separation of two rectangles is a disjunction (behind, ahead, lower r, higher r). With a chosen side it is one smooth
constraint. The choice is the greatest gap of the guess, measured relative to the distance that a plan could cover in
the time. A plan cannot jump: so the choice is never the opposite of the former side, and stays the same while the guess
overlaps the obstacle.
"""

from __future__ import annotations

import casadi as ca

from mpc.filter.problem import FREE, Occupied, Side

__all__ = ["SideChoice", "along"]

_SMOOTH = 0.02
"""Rounding of the corner of |sin psi| in h_s; the error is at most this times the half width [m]."""
_REACH = (5.0, 2.0, 4.0, 0.6)
"""Deviations that a plan can reach: acceleration along and across [m/s^2], greatest across [m], least time [s]."""


def along(psi: ca.SX, lon: ca.SX, lat: ca.SX) -> ca.SX:
    """Half extent along the road [m], smooth and at least lon |cos| + lat |sin|."""
    return lon * ca.fabs(ca.cos(psi)) + lat * ca.sqrt(ca.sin(psi) ** 2 + _SMOOTH**2)


class SideChoice:
    """Builds the choice of sides as expressions, one stage after the other (at build time)."""

    def __init__(self, obstacles: int, lon: ca.SX, lat: ca.SX, given: ca.SX) -> None:
        self._given = given
        self._m, self._lon, self._lat = obstacles, lon, lat
        self._sides: list[ca.SX] = []
        self._chosen: list[list[ca.SX]] = []

    def start(self, x: ca.SX, rectangles: ca.SX, time: float) -> None:
        """Choose sides at the present state, for the rectangles at the end of the first stage, after `time` [s]."""
        self._sides = [self._best(self._gaps(x, rectangles[:, j]), time) for j in range(self._m)]

    def step(self, k: int, x: ca.SX, rectangles: ca.SX, time: float) -> tuple[tuple[ca.SX, ca.SX, ca.SX, ca.SX], ca.SX]:
        """Tightest bounds (s high, s low, r high, r low) of stage k, ending after `time` [s]; least separation [m]."""
        s_high, s_low, r_high, r_low, clear = (ca.SX(v) for v in (FREE, -FREE, FREE, -FREE, FREE))
        for j in range(self._m):
            rectangle, before = rectangles[:, j], self._sides[j]
            gaps = self._gaps(x, rectangle)
            greatest = ca.mmax(gaps)
            best = self._best(gaps, time)
            opposite = best == before + 1 - 2 * ca.fmod(before, 2)
            side = ca.if_else(ca.logic_or(greatest < 0, opposite), before, best)
            side = ca.if_else(self._given[j, k] >= 0, self._given[j, k], side)
            self._sides[j] = side
            s_high = ca.fmin(s_high, ca.if_else(side == Side.BEHIND, rectangle[Occupied.S_MIN], FREE))
            s_low = ca.fmax(s_low, ca.if_else(side == Side.AHEAD, rectangle[Occupied.S_MAX], -FREE))
            r_high = ca.fmin(r_high, ca.if_else(side == Side.LOW, rectangle[Occupied.R_MIN], FREE))
            r_low = ca.fmax(r_low, ca.if_else(side == Side.HIGH, rectangle[Occupied.R_MAX], -FREE))
            clear = ca.fmin(clear, greatest)
        self._chosen.append(list(self._sides))
        return (s_high, s_low, r_high, r_low), clear

    def rest(self, rest: ca.SX) -> ca.SX:
        """Nearest stopping position [m] of an obstacle that the plan ends behind."""
        out = ca.SX(FREE)
        for j in range(self._m):
            out = ca.fmin(out, ca.if_else(self._sides[j] == Side.BEHIND, rest[j], FREE))
        return out

    def table(self) -> ca.SX:
        """Sides of all stages, (m, N), column-major for an (N, m) array."""
        return ca.densify(ca.horzcat(*[ca.vertcat(*sides) for sides in self._chosen]))

    def _gaps(self, x: ca.SX, rectangle: ca.SX) -> ca.SX:
        h_s = along(x[2], self._lon, self._lat)
        h_r = self._lat * ca.fabs(ca.cos(x[2])) + self._lon * ca.fabs(ca.sin(x[2]))
        return ca.vertcat(
            rectangle[Occupied.S_MIN] - x[0] - h_s,
            x[0] - h_s - rectangle[Occupied.S_MAX],
            rectangle[Occupied.R_MIN] - x[1] - h_r,
            x[1] - h_r - rectangle[Occupied.R_MAX],
        )

    def _best(self, gaps: ca.SX, time: float) -> ca.SX:
        forward, across, most, least = _REACH
        t = max(time, least)
        reach = (0.5 * forward * t**2, min(0.5 * across * t**2, most))
        scores = [gaps[0] / reach[0], gaps[1] / reach[0], gaps[2] / reach[1], gaps[3] / reach[1]]
        best, score = ca.SX(0), scores[0]
        for i in range(1, 4):
            best, score = ca.if_else(scores[i] > score, i, best), ca.fmax(score, scores[i])
        return best
