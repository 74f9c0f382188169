"""Interface of a dynamics model for a planner, and rollouts that need only its `step`.

Notation
--------
n states of width d, actions of width m normalised to [-1, 1] as in the environment's Box, a horizon of H decisions. All
arrays are numpy, batch first. Results have the floating type in which the model computes.
"""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import numpy as np

from dynamics.errors import ModelError

__all__ = ["DynamicsModel", "HeldModel", "StepModel", "check_batch", "rollout", "rollout_held"]


class StepModel(Protocol):
    """The smallest interface of a model."""

    state_dim: int
    action_dim: int

    def step(self, states: Any, actions: Any) -> Any:
        """States one decision later: (n, d) and (n, m) to (n, d)."""
        ...


class DynamicsModel(StepModel, Protocol):
    """A model that also rolls out whole action sequences. If it has no faster way, it uses `rollout` below."""

    def rollout(self, states: Any, actions: Any) -> Any:
        """States after each decision: (n, d) and (n, H, m) to (n, H, d); `[:, -1]` is the last."""
        ...


@runtime_checkable
class HeldModel(Protocol):
    """A model with a fast rollout of actions that are repeated for several decisions."""

    def rollout_held(self, states: Any, actions: Any, hold: int) -> Any:
        """States at the END of each block: (n, d) and (n, blocks, m), each held `hold` times, to (n, blocks, d)."""
        ...


def check_batch(model: StepModel, states: Any, actions: Any, sequences: bool = False) -> None:
    """Check the shapes of a batch for a model.

    Parameters
    ----------
    sequences : whether each state has a sequence of actions, (n, H, m), and not one action, (n, m).

    Raises
    ------
    ModelError
        If a shape is wrong; the message states the correct one.
    """
    states, actions, expected = np.shape(states), np.shape(actions), 3 if sequences else 2
    if len(states) != 2 or states[1] != model.state_dim:
        raise ModelError(f"states must have shape (n, {model.state_dim}), got {states}")
    if len(actions) != expected or actions[-1] != model.action_dim or actions[0] != states[0]:
        middle = "horizon, " if sequences else ""
        raise ModelError(f"actions must have shape ({states[0]}, {middle}{model.action_dim}), got {actions}")


def rollout(model: StepModel, states: Any, actions: Any) -> Any:
    """Repeated `model.step`: (n, d) and (n, H, m) to (n, H, d).

    Raises
    ------
    ModelError
        If a shape is wrong.
    """
    check_batch(model, states, actions, sequences=True)
    out = []
    for k in range(np.shape(actions)[1]):
        states = model.step(states, actions[:, k])
        out.append(states)
    return np.stack(out, axis=1) if out else np.empty((len(states), 0, model.state_dim))


def rollout_held(model: StepModel, states: Any, actions: Any, hold: int) -> Any:
    """States at the end of each block: (n, d) and (n, blocks, m), each held `hold` times, to (n, blocks, d).

    A `HeldModel` uses its own method, another model repeated steps.

    Raises
    ------
    ModelError
        If a shape is wrong or `hold` is less than 1.
    """
    check_batch(model, states, actions, sequences=True)
    if hold < 1:
        raise ModelError(f"hold must be 1 or more decisions, got {hold}")
    if isinstance(model, HeldModel):
        return model.rollout_held(states, actions, hold)
    return rollout(model, states, np.repeat(actions, hold, axis=1))[:, hold - 1 :: hold]
