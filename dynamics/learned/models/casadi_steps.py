"""A learned body-frame model as CasADi expressions, for programs that linearise it.

Notation
--------
State (x, y, psi, v) in the order of `dynamics.state.State`, input (a, delta): acceleration [m/s^2], front wheel angle
[rad], as for `dynamics.vehicle.bicycle.step_expression`. With z = (0, 0, v, 0, 1, 0) the body-frame state of the model,
u the normalised input and d = A(z, u) z + B(z, u) u,

    z+ = z + dt d        psi+ = psi + atan2(z+_sin, z+_cos)        v+ = (z+_vx z+_cos + z+_vy z+_sin) / |z+_heading|

and z+ is rotated by psi and translated to (x, y). It equals `LinearStructuredModel.step`, in double precision, between
states whose velocity points along the heading. The speed afterwards is the component of the velocity along the new
heading.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from dynamics.errors import ConfigError, ModelError
from dynamics.learned.models.body_frame import Layout
from dynamics.learned.models.files import load_model, read_config
from dynamics.learned.models.linear import LinearStructuredModel
from dynamics.vehicle.actuators import Actuators

__all__ = ["TOLERANCE", "LearnedStep", "LearnedSteps", "actuator_notes"]

TOLERANCE = 1e-4
"""Greatest difference to the model, which computes in single precision, relative to 1 or the state's greatest entry."""

_STATE, _INPUTS = 6, 2


class LearnedStep:
    """One decision of a learned model of driving, as an expression.

    Two objects are never equal, so that a program compiled for one is not used for another.

    Parameters
    ----------
    model : in body frame, with the state of `dynamics.learned.tasks.driving_state` or `parking_state`.
    actuators : the throttle and steering of its normalised actions.

    Attributes
    ----------
    dt : duration of a decision [s].

    Raises
    ------
    ModelError
        If the model is of another form, state or input, or a weight is not finite.
    """

    def __init__(self, model: LinearStructuredModel, actuators: Actuators | None = None) -> None:
        config = model.config
        actuators = actuators if actuators is not None else Actuators()
        if config.form != "body" or config.layout != Layout() or config.state_dim != _STATE:
            raise ModelError(
                f"a step in any frame needs form 'body' and {_STATE} columns laid out as {Layout()}; this model has "
                f"form {config.form!r} and {config.state_dim} columns laid out as {config.layout}"
            )
        if config.action_dim != _INPUTS or not (actuators.longitudinal and actuators.lateral):
            raise ModelError(
                f"a step takes throttle and steering; this model has {config.action_dim} inputs, its actuators "
                f"longitudinal {actuators.longitudinal} and lateral {actuators.lateral}"
            )
        model.require_finite()
        self.dt, self.actuators = float(config.dt), actuators
        self._body = _body_function(model, actuators)

    def __deepcopy__(self, memo: Any) -> LearnedStep:
        """The object itself, as it is immutable."""
        return self

    def held(self, state: ca.SX, control: ca.SX, duration: float) -> ca.SX:
        """State (4, 1) after a constant input (2, 1) for `duration` [s], (4, 1).

        Raises
        ------
        ConfigError
            If the duration is not a whole number of decisions.
        """
        count = _times(duration, self.dt)
        if count is None:
            raise ConfigError(
                f"an input that is held for {duration:.4g} s is no whole number of the model's decisions of "
                f"{self.dt:.4g} s"
            )
        for _ in range(count):
            state = self.expression(state, control)
        return state

    def expression(self, state: ca.SX, control: ca.SX) -> ca.SX:
        """State (4, 1) one decision later, (4, 1)."""
        ahead, across, turn, speed = ca.vertsplit(self._body(state[3], control[0], control[1]))
        cos, sin = ca.cos(state[2]), ca.sin(state[2])
        return ca.vertcat(
            state[0] + cos * ahead - sin * across, state[1] + sin * ahead + cos * across, state[2] + turn, speed
        )

    @classmethod
    def load(cls, folder: str | Path) -> LearnedStep:
        """Load a folder that `dynamics.learned.models.files.save_model` wrote, with `actuator_notes` among its notes.

        Raises
        ------
        ModelError
            If it is no such folder, is damaged, or has no notes about its actuators.
        """
        notes = read_config(folder).get("notes")
        try:
            ranges = notes["actuators"]  # type: ignore[index]
            pairs = [(float(low), float(high)) for low, high in (ranges["acceleration"], ranges["steering"])]
            good = all(np.isfinite(pair).all() and pair[0] < pair[1] for pair in pairs)
        except (KeyError, TypeError, ValueError):
            good, pairs = False, []
        if not good:
            raise ModelError(
                f"{folder} does not say which throttle and steering its actions stand for (notes.actuators with "
                f"acceleration and steering, each [low, high]); its notes are {json.dumps(notes)}. "
                "`shield dynamics fit --setting` writes them"
            )
        return cls(load_model(folder), Actuators(acceleration=pairs[0], steering=pairs[1]))


class LearnedSteps:
    """Several steps of different durations. An input is applied with the longest step that divides its duration.

    Parameters
    ----------
    steps : at least one.

    Raises
    ------
    ModelError
        If there is none.
    """

    def __init__(self, *steps: LearnedStep) -> None:
        if not steps:
            raise ModelError("at least one learned step is needed, got none")
        self.steps = tuple(sorted(steps, key=lambda step: -step.dt))

    def __deepcopy__(self, memo: Any) -> LearnedSteps:
        """The object itself, as it is immutable."""
        return self

    def held(self, state: ca.SX, control: ca.SX, duration: float) -> ca.SX:
        """See `LearnedStep.held`.

        Raises
        ------
        ConfigError
            If the duration is no whole number of decisions of any step.
        """
        for step in self.steps:
            if _times(duration, step.dt) is not None:
                return step.held(state, control, duration)
        have = ", ".join(f"{step.dt:.4g}" for step in self.steps)
        raise ConfigError(f"no learned step makes up {duration:.4g} s; have decisions of {have} s")


def _times(duration: float, dt: float) -> int | None:
    """Number of decisions of `dt` in a duration, at least 1; None if it is not a whole number."""
    count = round(duration / dt)
    return count if count >= 1 and abs(count * dt - duration) < 1e-6 * duration else None


def actuator_notes(actuators: Actuators) -> Mapping[str, Any]:
    """The notes about the actuators for a stored model."""
    return {"actuators": {"acceleration": list(actuators.acceleration), "steering": list(actuators.steering)}}


def _body_function(model: LinearStructuredModel, actuators: Actuators) -> ca.Function:
    """(v, a, delta) to (displacement ahead, displacement to the side, turn, speed) in the frame of the heading
    before."""
    weights = {name: part.detach().double().numpy() for name, part in model.state_dict().items()}
    d, m = model.state_dim, model.action_dim
    v, inputs = ca.SX.sym("v"), ca.SX.sym("u", m)
    z: list[Any] = [0.0, 0.0, v, 0.0, 1.0, 0.0]
    u = [2 * (inputs[i] - low) / (high - low) - 1 for i, (low, high) in enumerate(_ranges(actuators))]
    seen = (ca.vertcat(*(z[i] for i in model.seen), *u) - weights["mean"]) / weights["std"]
    # A multiplies neither the position nor the sine of the heading.
    columns = weights["column_scale"]
    zero = {*model.config.layout.position, model.config.layout.heading[1]}
    multiplied = ca.vertcat(*(z[i] for i in range(d) if i not in zero), *u) / columns
    rates: Any = 0
    for member in range(model.config.members):
        parts = [_network(model, weights, j, member, seen) for j in range(len(model.networks))]
        widths = [part.numel() // d for part in parts]
        # Row-major, as `unflatten` of torch.
        a_and_b = ca.horzcat(*(ca.reshape(part, w, d).T for part, w in zip(parts, widths, strict=True)))
        rates = rates + ca.mtimes(a_and_b, multiplied)
    after = ca.vertcat(*z) + model.dt * weights["rate_scale"] * rates / model.config.members
    cos, sin = after[4], after[5]
    speed = (after[2] * cos + after[3] * sin) / ca.sqrt(cos * cos + sin * sin)
    out = ca.vertcat(after[0], after[1], ca.atan2(sin, cos), speed)
    return ca.Function("learned", [v, inputs[0], inputs[1]], [out], {"cse": True})


def _ranges(actuators: Actuators) -> tuple[tuple[float, float], tuple[float, float]]:
    return actuators.acceleration, actuators.steering


def _network(model: LinearStructuredModel, weights: Mapping[str, Any], network: int, member: int, seen: Any) -> Any:
    """The outputs of one member of `model.networks[network]`, a column."""
    x, layers = seen, len(model.config.hidden) + 1
    for i in range(layers):
        weight, bias = (weights[f"networks.{network}.{kind}.{i}"][member] for kind in ("weights", "biases"))
        x = ca.mtimes(ca.DM(weight.T), x) + ca.DM(bias.reshape(-1))
        x = x if i == layers - 1 else _ACTIVATIONS[model.config.activation](x)
    return x


def _silu(x: Any) -> Any:
    return x / (1 + ca.exp(-x))


_ACTIVATIONS: Mapping[str, Any] = {"relu": lambda x: ca.fmax(x, 0), "silu": _silu, "tanh": ca.tanh}
