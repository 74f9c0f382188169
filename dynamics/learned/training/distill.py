"""Macro-steps of a learned model: polynomials fitted to its rollouts, and measured on other rollouts (see
`dynamics.learned.models.macro_steps`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.errors import ConfigError, ModelError
from dynamics.learned.data.transitions import Transitions
from dynamics.learned.models.linear import LinearStructuredModel
from dynamics.learned.models.macro_steps import Agreement, DistilledModel, MacroStep, turned
from dynamics.learned.models.monomials import Monomials
from dynamics.state import FloatArray

__all__ = ["DistillConfig", "distill"]


@dataclass(frozen=True, slots=True)
class DistillConfig:
    """Parameters of a distillation.

    Attributes
    ----------
    holds : numbers of decisions for which a polynomial is fitted; 1 is always included. Other numbers are composed of
        these.
    degree : greatest total degree of the polynomials.
    samples : number of rollouts for each fit; a quarter as many for its measurement.
    stretch : w is drawn from its range in the data, widened by this factor.
    tolerance : greatest 99 % quantile of the distance between model and polynomial after one block [m], for each
        decision of the block. The lowest degree within the tolerance is used.
    seed : of the draws.
    """

    holds: tuple[int, ...] = (1, 4, 5)
    degree: int = 9
    samples: int = 8192
    stretch: float = 1.25
    tolerance: float = 0.02
    seed: int = 0

    def __post_init__(self) -> None:
        counts = {"degree": self.degree, "samples": self.samples, **{f"hold {k}": k for k in self.holds}}
        for name, count in counts.items():
            if type(count) is not int or count < 1:
                raise ConfigError(f"{name} must be a positive whole number, got {count!r}")
        if not (self.tolerance > 0 and self.stretch >= 1):
            raise ConfigError("tolerance must be positive, stretch 1 or more")


def distill(model: LinearStructuredModel, data: Transitions, config: DistillConfig | None = None) -> DistilledModel:
    """Macro-steps of a body-form model, fitted to its own rollouts.

    Parameters
    ----------
    model : in body form.
    data : transitions that determine the range of states.

    Raises
    ------
    ConfigError
        If the model is of another form, or there are too few samples.
    ModelError
        If a polynomial is not within the tolerance.
    """
    config = config or DistillConfig()
    if model.config.form != "body":
        raise ConfigError(f"macro-steps are made of models in the form 'body', this one has {model.config.form!r}")
    generator = np.random.default_rng(config.seed)
    steps, agreement = {}, {}
    for hold in sorted({1, *config.holds}):
        steps[hold], agreement[hold] = _macro_step(model, data, hold, config, generator)
    return DistilledModel(model.config, model.seen, steps, agreement)


def _macro_step(
    model: LinearStructuredModel, data: Transitions, hold: int, config: DistillConfig, generator: np.random.Generator
) -> tuple[MacroStep, Agreement]:
    """The polynomial of the lowest degree within the tolerance."""
    low, high, linear = _range(model, data, config.stretch)
    k = len(model.seen)
    w, u = _draw(low, high, model.action_dim, config.samples, generator)
    fresh = _draw(low, high, model.action_dim, max(config.samples // 4, 1), generator)
    targets, fresh_targets = _teach(model, w, u, hold), _teach(model, *fresh, hold)
    scaled, fresh_scaled = (2 * (x - low) / (high - low) - 1 for x in (w, fresh[0]))
    found, tolerance = None, config.tolerance * hold
    for degree in range(min(3, config.degree), config.degree + 1):
        phi, psi = Monomials(k, degree, linear), Monomials(model.action_dim, degree)
        allowed = np.add.outer(phi.exponents.sum(1), psi.exponents.sum(1)) <= degree
        if 2 * allowed.sum() > config.samples:
            break
        c = np.linalg.lstsq(_terms(phi, psi, allowed, scaled, u), targets, rcond=None)[0].T
        error = np.abs(_terms(phi, psi, allowed, fresh_scaled, fresh[1]) @ c.T - fresh_targets)
        distance, turn = np.hypot(error[:, k], error[:, k + 1]), error[:, k + 2]
        median, p99, worst = (float(np.quantile(distance, q)) for q in (0.5, 0.99, 1))
        found = Agreement(degree, median, p99, worst, float(np.quantile(turn, 0.99)))
        if found.p99 <= tolerance:
            full = np.zeros((k + 3, *allowed.shape), np.float32)
            full[:, allowed] = c
            gain, shift = (x.astype(np.float32)[:, None] for x in (2 / (high - low), -(high + low) / (high - low)))
            return MacroStep(phi, psi, gain, shift, full.reshape(-1, allowed.shape[1])), found
    if found is None:
        raise ConfigError(f"{config.samples} samples are too few for polynomials of {k + model.action_dim} variables")
    raise ModelError(
        f"the polynomial of degree {found.degree} for {hold} held decisions is {found.p99:.3g} m from the model (99 % "
        f"quantile), more than the tolerance of {tolerance:.3g} m; raise the degree, the samples or the tolerance"
    )


def _range(model: LinearStructuredModel, data: Transitions, stretch: float) -> tuple[FloatArray, FloatArray, list[int]]:
    """Least and greatest expected w, and the entries of w that are constant in the data."""
    layout, seen = model.config.layout, model.seen
    known = layout.to_body(data.states)
    # Predictions of the model are included: they exceed the data slightly, for example with a lateral speed.
    reached = np.concatenate([known, layout.to_body(model.step(known, data.actions).astype(float))])[:, seen]
    low, high = reached.min(axis=0), reached.max(axis=0)
    margin = np.maximum((stretch - 1) / 2 * (high - low), 1e-3)
    return low - margin, high + margin, np.flatnonzero(np.ptp(known[:, seen], axis=0) < 1e-6).tolist()


def _draw(
    low: FloatArray, high: FloatArray, actions: int, samples: int, generator: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """w (n, k) and u (n, m) in their ranges. Many actions are at a bound, as in plans."""
    w = generator.uniform(low, high, (samples, len(low)))
    return w, np.clip(generator.uniform(-1.2, 1.2, (samples, actions)), -1, 1)


def _terms(phi: Monomials, psi: Monomials, allowed: Any, w: FloatArray, u: FloatArray) -> FloatArray:
    """phi_i(w) psi_j(u) of the allowed pairs, (n, terms)."""
    i, j = np.nonzero(allowed)
    return np.asarray((phi(w.T)[i] * psi(u.T)[j]).T)


def _teach(model: LinearStructuredModel, w: FloatArray, u: FloatArray, hold: int) -> FloatArray:
    """Targets for the polynomials from the model's rollouts of a block, (n, k + 3)."""
    layout, seen = model.config.layout, model.seen
    starts = np.zeros((len(w), model.state_dim))
    starts[:, layout.heading[0]] = 1
    starts[:, seen] = w
    path = model.rollout(starts, np.repeat(u[:, None], hold, axis=1)).astype(float)
    angles = np.arctan2(path[..., layout.heading[1]], path[..., layout.heading[0]])
    # From decision to decision a turn is less than half a circle.
    turn, ends = np.unwrap(angles, axis=1)[:, -1], path[:, -1]
    x, y = (ends[:, column] for column in layout.position)
    return np.column_stack([layout.to_body(ends)[:, seen] - w, *turned(-turn / 2, x, y), turn])
