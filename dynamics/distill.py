r"""Macro-steps: what an action held for several decisions leads to, as one polynomial in numpy, for planners.

Notation
--------
In the ego's frame the k-decision map of a body-form model depends only on what its networks see, w = (body-frame
velocity, …), and on the held action u. For each k that is asked for, polynomials of a total degree are fitted by least
squares to the model's own rollouts,

    (w, u) -> (w_k - w, e_k, theta_k):

the change of w, seen from the frame *after* the block, the turn theta_k [rad], and the way e_k [m], seen from half-way
through the turn, where it is nearly straight ahead (so that low degrees do). As sums over phi_i(w) c_ij psi_j(u) they
need one matrix product for the actions of all blocks and a short sum for each block. Only w goes from block to block;
headings are then cumulative sums of the turns, positions of the ways, turned by the headings half-way. So the
result is as equivariant under rigid motions as the model. Beyond the range that w was fitted in, phi stays at the
range's end. How far the result is from the model is measured on fresh rollouts and kept as `Agreement`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics import model as protocol
from dynamics.data import Transitions
from dynamics.errors import ConfigError, ModelError
from dynamics.learned import Float32Array, LinearStructuredModel, ModelConfig
from dynamics.monomials import Monomials
from dynamics.state import FloatArray

__all__ = ["Agreement", "DistillConfig", "DistilledModel", "distill"]


@dataclass(frozen=True, slots=True)
class DistillConfig:
    """How a model is distilled.

    Attributes
    ----------
    holds : numbers of decisions that get a polynomial; 1 is always among them. Others are put together from these.
    degree : total degree of the polynomials.
    samples : rollouts that each is fitted to, and a quarter as many to measure it on.
    stretch : w is drawn from the range that the data have, made so much longer.
    tolerance : greatest 99 % quantile of the distance between model and polynomial [m] after one block.
    seed : of the draws.
    """

    holds: tuple[int, ...] = (1, 5)
    degree: int = 7
    samples: int = 8192
    stretch: float = 1.25
    tolerance: float = 0.1
    seed: int = 0

    def __post_init__(self) -> None:
        counts = {"degree": self.degree, "samples": self.samples, **{f"hold {k}": k for k in self.holds}}
        for name, count in counts.items():
            if type(count) is not int or count < 1:
                raise ConfigError(f"{name} must be a positive whole number, got {count!r}")
        if not (self.tolerance > 0 and self.stretch >= 1):
            raise ConfigError("tolerance must be positive, stretch 1 or more")


@dataclass(frozen=True, slots=True)
class Agreement:
    """Distance between the model's position and the polynomial's after one block [m], on rollouts not fitted to."""

    median: float
    p99: float
    worst: float


@dataclass(frozen=True, slots=True, eq=False)
class _Basis:
    """phi and psi, and the range [low, high] of w that becomes [-1, 1]; both (k, 1)."""

    phi: Monomials
    psi: Monomials
    low: Float32Array
    high: Float32Array

    def scaled(self, w: Any) -> Any:
        """w (k, n) in [-1, 1]."""
        return np.clip((2 * w - (self.low + self.high)) / (self.high - self.low), -1, 1)


class DistilledModel:
    """Macro-steps of a body-form model: a `DynamicsModel` with a fast `rollout_held`. Made by `distill`.

    Attributes
    ----------
    config : of the model that it stands for.
    holds : numbers of decisions with a polynomial of their own.
    agreement : for each of them, how far it is from the model.
    """

    def __init__(
        self,
        config: ModelConfig,
        seen: Sequence[int],
        basis: _Basis,
        coefficients: Mapping[int, Float32Array],
        agreement: Mapping[int, Agreement],
    ) -> None:
        self.config, self.agreement, self.holds = config, dict(agreement), tuple(sorted(coefficients))
        self.state_dim, self.action_dim, self.dt = config.state_dim, config.action_dim, config.dt
        self._seen, self._basis, self._coefficients = list(seen), basis, dict(coefficients)
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

        A hold without a polynomial is put together from those that have one.

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
        states, actions = np.asarray(states, np.float32), np.asarray(actions, np.float32)
        parts = _parts(hold, self.holds)
        (n, blocks, m), calls, k = actions.shape, len(parts), len(self._seen)
        u = np.clip(np.ascontiguousarray(actions.transpose(2, 1, 0)).reshape(m, blocks * n), -1, 1)
        psi, phi = self._basis.psi(u), self._basis.phi
        acting = {part: (self._coefficients[part] @ psi).reshape(k + 3, len(phi), blocks, n) for part in set(parts)}
        w = np.ascontiguousarray(self.config.layout.to_body(states)[:, self._seen].T)
        seen, moved = np.empty((k, blocks * calls, n), np.float32), np.empty((3, blocks * calls, n), np.float32)
        for call in range(blocks * calls):
            y = np.einsum("oin,in->on", acting[parts[call % calls]][:, :, call // calls], phi(self._basis.scaled(w)))
            w = w + y[:k]
            seen[:, call], moved[:, call] = w, y[k:]
        return self._compose(states, seen, moved)[calls - 1 :: calls].transpose(1, 0, 2)

    def _compose(self, states: Float32Array, seen: Float32Array, moved: Float32Array) -> Float32Array:
        """World states (calls, n, d) of body-frame ones: turns and ways add up."""
        layout, (ahead, aside, turns) = self.config.layout, moved
        headings = np.arctan2(states[:, layout.heading[1]], states[:, layout.heading[0]]) + np.cumsum(turns, axis=0)
        half = headings - turns / 2
        out = np.empty((*turns.shape, self.state_dim), np.float32)
        for column, way in zip(layout.position, _turned(half, ahead, aside), strict=True):
            out[..., column] = states[:, column] + np.cumsum(way, axis=0)
        c, s = np.cos(headings), np.sin(headings)
        out[..., layout.heading[0]], out[..., layout.heading[1]] = c, s
        for i, j in layout.vectors:
            a, b = seen[self._seen.index(i)], seen[self._seen.index(j)]
            out[..., i], out[..., j] = c * a - s * b, s * a + c * b
        for i in self._numbers:
            out[..., i] = seen[self._seen.index(i)]
        return out


def distill(model: LinearStructuredModel, data: Transitions, config: DistillConfig | None = None) -> DistilledModel:
    """Macro-steps of a body-form model, fitted to its own rollouts.

    Parameters
    ----------
    model : in body form.
    data : which states there are.

    Raises
    ------
    ConfigError
        If the model is of another form, or there are fewer samples than terms of the polynomials.
    ModelError
        If a polynomial does not come within the tolerance.
    """
    config = config or DistillConfig()
    if model.config.form != "body":
        raise ConfigError(f"macro-steps are made of models in the form 'body', this one has {model.config.form!r}")
    basis = _basis(model, data, config)
    allowed = np.add.outer(basis.phi.exponents.sum(1), basis.psi.exponents.sum(1)) <= config.degree
    if 2 * allowed.sum() > config.samples:
        raise ConfigError(
            f"polynomials of degree {config.degree} have {allowed.sum()} terms here, too many for {config.samples} "
            "samples; lower the degree or take more"
        )
    generator = np.random.default_rng(config.seed)
    coefficients, agreement = {}, {}
    for hold in sorted({1, *config.holds}):
        w, u = _draw(model, basis, config.samples, generator)
        c = np.linalg.lstsq(_terms(basis, allowed, w, u), _teach(model, w, u, hold), rcond=None)[0].T
        k = len(model.seen)
        full = np.zeros((k + 3, *allowed.shape))
        full[:, allowed] = c
        coefficients[hold] = np.ascontiguousarray(full.reshape(-1, allowed.shape[1]), dtype=np.float32)
        w, u = _draw(model, basis, max(config.samples // 4, 1), generator)
        error = _terms(basis, allowed, w, u) @ c.T - _teach(model, w, u, hold)
        distance = np.hypot(error[:, k], error[:, k + 1])
        agreement[hold] = Agreement(*(float(np.quantile(distance, q)) for q in (0.5, 0.99, 1.0)))
        if not agreement[hold].p99 <= config.tolerance:
            raise ModelError(
                f"the polynomial for {hold} held decisions is {agreement[hold].p99:.3f} m from the model (99 % "
                f"quantile), more than the tolerance of {config.tolerance} m; raise the degree or the tolerance"
            )
    return DistilledModel(model.config, model.seen, basis, coefficients, agreement)


def _basis(model: LinearStructuredModel, data: Transitions, config: DistillConfig) -> _Basis:
    layout, seen = model.config.layout, model.seen
    known = layout.to_body(data.states)
    # With the model's predictions: they stray a little from what there is, such as a speed sideways.
    reached = np.concatenate([known, layout.to_body(model.step(known, data.actions).astype(float))])[:, seen]
    low, high = reached.min(axis=0), reached.max(axis=0)
    margin = np.maximum((config.stretch - 1) / 2 * (high - low), 1e-3)
    low, high = (part.astype(np.float32)[:, None] for part in (low - margin, high + margin))
    never_varied = np.flatnonzero(np.ptp(known[:, seen], axis=0) < 1e-6).tolist()
    phi = Monomials(len(seen), config.degree, linear=never_varied)
    return _Basis(phi, Monomials(model.action_dim, config.degree), low, high)


def _draw(
    model: LinearStructuredModel, basis: _Basis, samples: int, generator: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """w (n, k) and u (n, m) in their ranges; many actions at a bound, where plans often are."""
    w = generator.uniform(basis.low[:, 0], basis.high[:, 0], (samples, len(model.seen)))
    return w, np.clip(generator.uniform(-1.2, 1.2, (samples, model.action_dim)), -1, 1)


def _terms(basis: _Basis, allowed: Any, w: FloatArray, u: FloatArray) -> FloatArray:
    """phi_i(w) psi_j(u) of the allowed pairs, (n, terms)."""
    phi, psi = basis.phi(basis.scaled(w.T)), basis.psi(u.T)
    i, j = np.nonzero(allowed)
    return np.asarray((phi[i] * psi[j]).T)


def _teach(model: LinearStructuredModel, w: FloatArray, u: FloatArray, hold: int) -> FloatArray:
    """What the model says about a block, (n, k + 3)."""
    layout, seen = model.config.layout, model.seen
    starts = np.zeros((len(w), model.state_dim))
    starts[:, layout.heading[0]] = 1
    starts[:, seen] = w
    path = model.rollout(starts, np.repeat(u[:, None], hold, axis=1)).astype(float)
    angles = np.arctan2(path[..., layout.heading[1]], path[..., layout.heading[0]])
    # From decision to decision a turn is less than half a circle.
    turn, ends = np.unwrap(angles, axis=1)[:, -1], path[:, -1]
    x, y = (ends[:, column] for column in layout.position)
    return np.column_stack([layout.to_body(ends)[:, seen] - w, *_turned(-turn / 2, x, y), turn])


def _turned(angle: Any, x: Any, y: Any) -> tuple[Any, Any]:
    c, s = np.cos(angle), np.sin(angle)
    return c * x - s * y, s * x + c * y


def _parts(hold: int, holds: Sequence[int]) -> list[int]:
    """A hold as a sum of those that there are polynomials for, the largest first."""
    parts: list[int] = []
    for part in sorted(holds, reverse=True):
        parts += [part] * (hold // part)
        hold %= part
    return parts
