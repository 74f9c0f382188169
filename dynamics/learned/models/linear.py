"""A learned model that is linear in its structure: x+ = x + dt (A(x, u) x + B(x, u) u), A and B from networks.

Notation
--------
State x (d), normalised action u (m), decision dt [s]; E members of an ensemble, each with networks for A and B.

- *plain*: the networks for A and B read all of x except the position; A and B multiply x itself. `hide_position` also
  removes the position's columns from A. With `units` instead of a fitted normalisation and one member, it is the model
  of HighwayEnv's parking notebook (Leurent, 2020), where A multiplies the absolute position.
- *body*: the same in the ego's frame (`dynamics.learned.models.body_frame`): z+ = z + dt (A(z, u) z + B(z, u) u), then
  back to the world. It is equivariant under rigid motions of the plane. In world coordinates it is of the plain form
  again, with R A R' and R B.

After the step the heading is scaled to unit length (not in the notebook's model). The ensemble's prediction is the mean
of its members' A and B; their spread is the disagreement. The model contains its normalisation: networks read (x -
mean) / std and return values in units of the usual rate of change; A and B are in the units of x.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from dynamics.errors import ModelError
from dynamics.learned.models import model as protocol
from dynamics.learned.models.config import ModelConfig
from dynamics.state import Float32Array, FloatArray

__all__ = ["LinearStructuredModel", "ModelConfig"]


class _Ensemble(nn.Module):
    """E perceptrons side by side: (n, inputs) or (E, n, inputs) to (E, n, outputs)."""

    def __init__(self, sizes: Sequence[int], members: int, activation: str, generator: torch.Generator) -> None:
        super().__init__()
        self._activation = getattr(nn.functional, activation)
        self.weights, self.biases = nn.ParameterList(), nn.ParameterList()
        for a, b in pairwise(sizes):
            bound = a**-0.5
            for parameters, shape in ((self.weights, (members, a, b)), (self.biases, (members, 1, b))):
                parameters.append(nn.Parameter((2 * torch.rand(shape, generator=generator) - 1) * bound))

    def forward(self, x: Tensor) -> Tensor:
        if x.ndim == 2:
            x = x.expand(len(self.weights[0]), *x.shape)
        last = len(self.weights) - 1
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            x = torch.baddbmm(bias, x, weight)
            x = x if i == last else self._activation(x)
        return x


class LinearStructuredModel(nn.Module):
    """x+ = x + dt (A(x, u) x + B(x, u) u); see the head of this module.

    A new model has random weights and no normalisation. `dynamics.learned.training.fit.fit` returns a trained one,
    `dynamics.learned.models.files.load_model` a stored one.

    Parameters
    ----------
    config : its configuration.
    """

    mean: Tensor
    std: Tensor
    column_scale: Tensor
    rate_scale: Tensor

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        self.state_dim, self.action_dim, self.dt = config.state_dim, config.action_dim, config.dt
        d, m, layout = config.state_dim, config.action_dim, config.layout
        body = config.form == "body"
        constant = {*layout.position, *(layout.heading if body else ())}
        self.seen = [i for i in range(d) if i not in constant]
        zero = ({*layout.position} if config.hide_position or body else set()) | (
            {layout.heading[1]} if body else set()
        )
        self._multiplied = [i for i in range(d) if i not in zero]
        inputs, k = len(self.seen) + m, len(self._multiplied)
        generator = torch.Generator().manual_seed(config.seed)
        self.networks = nn.ModuleList(
            _Ensemble([inputs, *config.hidden, d * columns], config.members, config.activation, generator)
            for columns in ((k + m,) if config.shared else (k, m))
        )
        units = torch.ones(d) if config.units is None else torch.tensor(config.units, dtype=torch.float32)
        self.register_buffer("mean", torch.zeros(inputs))
        self.register_buffer("std", torch.cat([units[self.seen], torch.ones(m)]))
        self.register_buffer("column_scale", torch.cat([units[self._multiplied], torch.ones(m)]))
        self.register_buffer("rate_scale", units.clone())

    def normalise(self, states: Tensor, actions: Tensor, next_states: Tensor) -> None:
        """Fit the normalisation to data, (n, d), (n, m), (n, d); a model with fixed `units` keeps them."""
        if self.config.units is not None:
            return
        config, pairs = self.config, (self.config.layout.heading, *self.config.layout.vectors)
        z, seen = self._local(states, actions)
        after = config.layout.about(states, next_states) if config.form == "body" else next_states
        std, size, rate = (_scales(x, pairs) for x in (z - z.mean(0), z, (after - z) / self.dt))
        self.mean.copy_(seen.mean(0))
        self.std.copy_(torch.cat([std[self.seen], _scales(actions - actions.mean(0))]))
        self.column_scale[: len(self._multiplied)] = size[self._multiplied]
        self.rate_scale.copy_(rate)

    def _local(self, states: Tensor, actions: Tensor) -> tuple[Tensor, Tensor]:
        """The vector that A multiplies (..., d), and the inputs of the networks (..., inputs)."""
        z = self.config.layout.to_body(states) if self.config.form == "body" else states
        return z, torch.cat([z[..., self.seen], actions], dim=-1)

    def _matrices(self, seen: Tensor) -> Tensor:
        """Each member's A (its nonzero columns) and B side by side, (E, n, d, k + m), in the frame of its form."""
        seen = (seen - self.mean) / self.std
        raw = [network(seen).unflatten(-1, (self.state_dim, -1)) for network in self.networks]
        return (raw[0] if len(raw) == 1 else torch.cat(raw, dim=-1)) * (self.rate_scale[:, None] / self.column_scale)

    def members(self, states: Tensor, actions: Tensor) -> Tensor:
        """Each member's next states (E, n, d), of shared states (n, d) or of its own (E, n, d); differentiable."""
        z, seen = self._local(states, actions)
        return self._advance(states, z, actions, self._matrices(seen))

    def _advance(self, states: Tensor, z: Tensor, actions: Tensor, matrices: Tensor) -> Tensor:
        """The next states for given A and B."""
        out = z + self.dt * (matrices * torch.cat([z[..., self._multiplied], actions], dim=-1)[..., None, :]).sum(-1)
        layout = self.config.layout
        if self.config.form == "body":
            out = layout.to_world(states, out)
        return layout.unit_heading(out) if self.config.unit_heading else out

    def forward(self, states: Tensor, actions: Tensor) -> Tensor:
        """The ensemble's next states: (n, d) and (n, m) to (n, d); differentiable."""
        z, seen = self._local(states, actions)
        return self._advance(states, z, actions, self._matrices(seen).mean(0))

    def step(self, states: Any, actions: Any) -> Float32Array:
        """The ensemble's prediction.

        Parameters
        ----------
        states : shape (n, d).
        actions : shape (n, m), normalised.

        Returns
        -------
        States one decision later, shape (n, d).

        Raises
        ------
        ModelError
            If a shape is wrong.
        """
        protocol.check_batch(self, states, actions)
        with torch.inference_mode():
            found: Float32Array = self(self._tensor(states), self._tensor(actions)).numpy()
            return found

    def rollout(self, states: Any, actions: Any) -> Float32Array:
        """Repeated steps: (n, d) and (n, H, m) to the states after each, (n, H, d).

        Raises
        ------
        ModelError
            If a shape is wrong.
        """
        protocol.check_batch(self, states, actions, sequences=True)
        with torch.inference_mode():
            now, inputs, out = self._tensor(states), self._tensor(actions), []
            for k in range(inputs.shape[1]):
                now = self(now, inputs[:, k])
                out.append(now)
            return torch.stack(out, dim=1).numpy() if out else np.empty((len(now), 0, self.state_dim), np.float32)

    def disagreement(self, states: Any, actions: Any) -> Float32Array:
        """Disagreement of the members' one-step predictions: standard deviation over the members, (n, d).

        Zero for a single member. Raises `ModelError` if a shape is wrong.
        """
        protocol.check_batch(self, states, actions)
        with torch.inference_mode():
            return self.members(self._tensor(states), self._tensor(actions)).std(0, correction=0).numpy()

    def matrices(self, state: Any, action: Any) -> tuple[FloatArray, FloatArray]:
        """A (d, d) and B (d, m) of the ensemble at one point, in the world frame: x+ = x + dt (A x + B u).

        The equation holds before the heading is scaled to unit length. Columns of A for entries that it does not
        multiply are zero.

        Raises
        ------
        ModelError
            If a shape is wrong.
        """
        x, u = np.asarray(state, dtype=float)[None], np.asarray(action, dtype=float)[None]
        protocol.check_batch(self, x, u)
        with torch.inference_mode():
            _, seen = self._local(self._tensor(x), self._tensor(u))
            local = self._matrices(seen).mean(0)[0].double().numpy()
        full, b = np.zeros((self.state_dim, self.state_dim)), local[:, len(self._multiplied) :]
        full[:, self._multiplied] = local[:, : len(self._multiplied)]
        if self.config.form == "plain":
            return full, b
        turn = self.config.layout.rotation(x[0])
        return turn @ full @ turn.T, turn @ b

    def linearise(self, state: Any, action: Any) -> tuple[FloatArray, FloatArray, FloatArray]:
        """F (d, d), G (d, m) and c (d,) with x+ ~ F x + G u + c, exact at the point: the Jacobians of `step`.

        Raises
        ------
        ModelError
            If a shape is wrong.
        """
        x, u = np.asarray(state, dtype=float), np.asarray(action, dtype=float)
        protocol.check_batch(self, x[None], u[None])

        with torch.enable_grad():
            # One copy of the point for each output, with the gradient of that output.
            points = [self._tensor(np.tile(part, (self.state_dim, 1))).requires_grad_() for part in (x, u)]
            gradients = torch.autograd.grad(self(*points).diagonal().sum(), points)
        f, g = (part.double().numpy() for part in gradients)
        return f, g, self.step(x[None], u[None])[0] - f @ x - g @ u

    def _tensor(self, array: Any) -> Tensor:
        return torch.tensor(np.asarray(array), dtype=self.mean.dtype)

    @property
    def is_finite(self) -> bool:
        """Whether every weight is finite."""
        return all(bool(torch.isfinite(part).all()) for part in self.state_dict().values())

    def require_finite(self) -> None:
        """Check that all weights are finite.

        Raises
        ------
        ModelError
            If one is not.
        """
        if not self.is_finite:
            raise ModelError("the model has weights that are not finite; its training diverged or its file is damaged")


def _scales(x: Tensor, pairs: Sequence[tuple[int, int]] = ()) -> Tensor:
    """Root mean square of each column (n, d).

    A column that is tiny compared with its partner of the same vector gets the partner's value. A zero gets 1. So
    columns that are constant, except for rounding, are not amplified.
    """
    scale = x.square().mean(0).sqrt()
    for a, b in (*pairs, *((b, a) for a, b in pairs)):
        scale[a] = torch.where(scale[a] < 1e-3 * scale[b], scale[b], scale[a])
    return torch.where(scale > 0, scale, torch.ones_like(scale))
