"""Macro-steps: the result of an action repeated for several decisions as one polynomial in numpy, for planners.

Notation
--------
In the ego's frame the k-decision map of a body-form model depends only on the inputs of its networks: w = (body-frame
velocity, …), and the repeated action u. For each chosen k, polynomials are fitted by least squares to the model's own
rollouts, of the lowest total degree within a tolerance,

    (w, u) -> (w_k - w, e_k, theta_k):

the change of w, in the frame *after* the block; the turn theta_k [rad]; and the displacement e_k [m], in the frame
half-way through the turn, where it is nearly straight ahead (so that low degrees suffice). As sums over phi_i(w) c_ij
psi_j(u) they need one matrix product for the actions of all blocks and a short sum for each block. Only w passes from
block to block. Headings are then cumulative sums of the turns, positions cumulative sums of the displacements, rotated
by the headings half-way. So the result is as equivariant under rigid motions as the model. Outside the fitted range of
w, phi is evaluated at the end of the range. The distance of the result from the model is measured on new rollouts and
stored as `Agreement`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.errors import ModelError
from dynamics.learned.models import model as protocol
from dynamics.learned.models.config import ModelConfig
from dynamics.learned.models.monomials import Monomials
from dynamics.state import Float32Array

__all__ = ["Agreement", "DistilledModel", "MacroStep", "turned"]


@dataclass(frozen=True, slots=True)
class Agreement:
    """Distance of a polynomial from the model after one block, on rollouts that are not in its fit.

    Attributes
    ----------
    degree : of the polynomial.
    median, p99, worst : distance between the positions [m]: median, 99 % quantile, greatest.
    turn : 99 % quantile of the difference of the headings [rad].
    """

    degree: int
    median: float
    p99: float
    worst: float
    turn: float


@dataclass(frozen=True, slots=True, eq=False)
class MacroStep:
    """One polynomial: sums over phi_i(w) c_ij psi_j(u), with w scaled and clipped to [-1, 1].

    Attributes
    ----------
    phi, psi : the monomials of w and of u.
    gain, shift : the scaling, (k, 1).
    coefficients : ((k + 3) * phis, psis).
    """

    phi: Monomials
    psi: Monomials
    gain: Float32Array
    shift: Float32Array
    coefficients: Float32Array

    def acting(self, u: Float32Array, shape: tuple[int, ...]) -> Float32Array:
        """The polynomials in w for given actions (m, points), (k + 3, phis, *shape)."""
        found: Float32Array = (self.coefficients @ self.psi(u)).reshape(
            len(self.coefficients) // len(self.phi), len(self.phi), *shape
        )
        return found

    def __call__(self, acting: Float32Array, w: Float32Array) -> Float32Array:
        """Evaluate the polynomials of `acting`: (k + 3, phis, n) and w (k, n) to (k + 3, n)."""
        scaled = w * self.gain
        scaled += self.shift
        np.minimum(scaled, 1, out=scaled)
        np.maximum(scaled, -1, out=scaled)
        return np.asarray(np.einsum("oin,in->on", acting, self.phi(scaled)))


class DistilledModel:
    """Macro-steps of a body-form model, made by `dynamics.learned.training.distill`: a `DynamicsModel` with a fast
    `rollout_held`.

    Attributes
    ----------
    config : of the original model.
    holds : numbers of decisions with a polynomial.
    agreement : for each of them, its distance from the model.
    """

    def __init__(
        self,
        config: ModelConfig,
        seen: Sequence[int],
        steps: Mapping[int, MacroStep],
        agreement: Mapping[int, Agreement],
    ) -> None:
        self.config, self.agreement, self.holds = config, dict(agreement), tuple(sorted(steps))
        self.state_dim, self.action_dim, self.dt = config.state_dim, config.action_dim, config.dt
        self._seen, self._steps = list(seen), dict(steps)
        geometry = {*config.layout.position, *config.layout.heading, *(i for v in config.layout.vectors for i in v)}
        self._numbers = [i for i in self._seen if i not in geometry]

    def step(self, states: Any, actions: Any) -> Float32Array:
        """States one decision later: (n, d) and (n, m) to (n, d). Raises `ModelError` on wrong shapes."""
        protocol.check_batch(self, states, actions)
        return self._roll(states, np.asarray(actions)[:, None], 1)[:, 0]

    def rollout(self, states: Any, actions: Any) -> Float32Array:
        """States after each decision: (n, d) and (n, H, m) to (n, H, d). Raises `ModelError` on wrong shapes."""
        return self.rollout_held(states, actions, 1)

    def rollout_held(self, states: Any, actions: Any, hold: int) -> Float32Array:
        """States at the end of each block: (n, d) and (n, blocks, m), each held `hold` times, to (n, blocks, d).

        A number of decisions without a polynomial is composed of those with one.

        Raises
        ------
        ModelError
            If a shape is wrong or `hold` is less than 1.
        """
        protocol.check_batch(self, states, actions, sequences=True)
        if hold < 1:
            raise ModelError(f"hold must be 1 or more decisions, got {hold}")
        return self._roll(states, actions, hold)

    def _roll(self, states: Any, actions: Any, hold: int) -> Float32Array:
        """States at the end of each block, by the polynomials of the parts of `hold`; shapes as in `rollout_held`."""
        states, actions = np.asarray(states, np.float32), np.asarray(actions, np.float32)
        parts = _parts(hold, self.holds)
        (n, blocks, m), calls, k = actions.shape, len(parts), len(self._seen)
        u = np.clip(np.ascontiguousarray(actions.transpose(2, 1, 0)).reshape(m, blocks * n), -1, 1)
        acting = {part: self._steps[part].acting(u, (blocks, n)) for part in set(parts)}
        w = self._seen_of(states)
        seen, moved = np.empty((k, blocks * calls, n), np.float32), np.empty((3, blocks * calls, n), np.float32)
        for call in range(blocks * calls):
            part = parts[call % calls]
            y = self._steps[part](acting[part][:, :, call // calls], w)
            w = w + y[:k]
            seen[:, call], moved[:, call] = w, y[k:]
        return self._compose(states, seen, moved)[calls - 1 :: calls].transpose(1, 0, 2)

    def _seen_of(self, states: Float32Array) -> Float32Array:
        """The part of the body-frame states that the polynomials depend on, (k, n); see `Layout.to_body`."""
        heading = states[:, self.config.layout.heading]
        c, s = (heading / np.sqrt((heading * heading).sum(axis=1, keepdims=True))).T
        body = {i: states[:, i] for i in self._numbers}
        for i, j in self.config.layout.vectors:
            a, b = states[:, i], states[:, j]
            body[i], body[j] = c * a + s * b, c * b - s * a
        return np.stack([body[i] for i in self._seen])

    def _compose(self, states: Float32Array, seen: Float32Array, moved: Float32Array) -> Float32Array:
        """World states (calls, n, d) from body-frame ones, by cumulative sums of turns and displacements."""
        layout, (ahead, aside, turns) = self.config.layout, moved
        headings = np.arctan2(states[:, layout.heading[1]], states[:, layout.heading[0]]) + np.cumsum(turns, axis=0)
        half = headings - turns / 2
        out = np.empty((*turns.shape, self.state_dim), np.float32)
        for column, way in zip(layout.position, turned(half, ahead, aside), strict=True):
            out[..., column] = states[:, column] + np.cumsum(way, axis=0)
        c, s = np.cos(headings), np.sin(headings)
        out[..., layout.heading[0]], out[..., layout.heading[1]] = c, s
        for i, j in layout.vectors:
            a, b = seen[self._seen.index(i)], seen[self._seen.index(j)]
            out[..., i], out[..., j] = c * a - s * b, s * a + c * b
        for i in self._numbers:
            out[..., i] = seen[self._seen.index(i)]
        return out


def turned(angle: Any, x: Any, y: Any) -> tuple[Any, Any]:
    """The vectors (x, y) turned by angles [rad]."""
    c, s = np.cos(angle), np.sin(angle)
    return c * x - s * y, s * x + c * y


def _parts(hold: int, holds: Sequence[int]) -> list[int]:
    """A number of decisions as a sum of those with a polynomial, the largest first."""
    parts: list[int] = []
    for part in sorted(holds, reverse=True):
        parts += [part] * (hold // part)
        hold %= part
    return parts
