r"""HighwayEnv's parking notebook: its model and planner, as a reference for comparisons.

Notation
--------
States are observations, scaled by the environment. With networks A and B that receive the state without its position,

    x+ = x + dt (A(x, u) x + B(x, u) u)

The planner draws 100 sequences of 5 actions, each repeated for 5 decisions, and fits a normal distribution to the best
10, five times. It executes the first action of the mean. It keeps autograd's graphs, as the notebook does;
`inference=True` omits them without a change of any number.

Source: E. Leurent, `parking_model_based.ipynb` of HighwayEnv, rewritten; 2,000 transitions of random actions repeated
for two decisions, with terminal ones among them, Adam at 0.01, 1,500 epochs on all of the training data at once.
"""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from dynamics.errors import ModelError
from dynamics.learned.tasks.parking_state import ACTION_DIM, DT, STATE_DIM
from mpc.tasks.parking_costs import WEIGHTS

__all__ = ["NotebookModel", "NotebookPolicy", "collect_as_notebook", "fit_as_notebook"]

_HIDDEN, _HORIZON, _HOLD, _SAMPLES, _ELITES, _ITERATIONS = 64, 5, 5, 100, 10, 5


class NotebookModel(nn.Module):
    """x+ = x + dt (A x + B u) on scaled observations.

    Parameters
    ----------
    seed : seed of the initial weights.
    """

    def __init__(self, seed: int = 0) -> None:
        super().__init__()
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            self.a1 = nn.Linear(STATE_DIM + ACTION_DIM, _HIDDEN)
            self.a2 = nn.Linear(_HIDDEN, STATE_DIM * STATE_DIM)
            self.b1 = nn.Linear(STATE_DIM + ACTION_DIM, _HIDDEN)
            self.b2 = nn.Linear(_HIDDEN, STATE_DIM * ACTION_DIM)

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Observations one decision later: (n, 6) and (n, 2) to (n, 6)."""
        seen = torch.cat((x, u), -1)
        seen[:, :2] = 0
        a = self.a2(nn.functional.relu(self.a1(seen))).reshape(-1, STATE_DIM, STATE_DIM)
        b = self.b2(nn.functional.relu(self.b1(seen))).reshape(-1, STATE_DIM, ACTION_DIM)
        change = a @ x.unsqueeze(-1) + b @ u.unsqueeze(-1)
        found: Tensor = x + change.squeeze(-1) * DT
        return found


def collect_as_notebook(env: Any, seed: int = 0, size: int = 1000, hold: int = 2) -> tuple[Any, Any, Any]:
    """Observations (n, 6), actions (n, 2) and next observations (n, 6) of n = size * hold random decisions.

    Parameters
    ----------
    env : `parking-v0`; reset with `seed` and the seeds after it.
    seed : first seed of the resets, and seed of the actions.
    size, hold : number of drawn actions, and decisions of each.
    """
    generator, rows = np.random.default_rng(seed), []
    observation, _ = env.reset(seed=seed)
    episode = 0
    for _ in range(size):
        action = generator.uniform(-1, 1, ACTION_DIM)
        for _ in range(hold):
            before = observation["observation"]
            observation, _, terminated, truncated, _ = env.step(action)
            rows.append((before, action, observation["observation"]))
            if terminated or truncated:
                episode += 1
                observation, _ = env.reset(seed=seed + episode)
    x, u, y = (np.array(part) for part in zip(*rows, strict=True))
    return x, u, y


def fit_as_notebook(data: tuple[Any, Any, Any], seed: int = 0, epochs: int = 1500) -> NotebookModel:
    """A model fitted to the first 70 % of the transitions.

    Raises
    ------
    ModelError
        If its weights are not finite afterwards.
    """
    count = int(0.7 * len(data[0]))
    x, u, y = (torch.as_tensor(part[:count], dtype=torch.float32) for part in data)
    model = NotebookModel(seed)
    optimiser = torch.optim.Adam(model.parameters(), lr=0.01)
    for _ in range(epochs):
        optimiser.zero_grad()
        nn.functional.mse_loss(model(x, u), y).backward()
        optimiser.step()
    if not all(bool(torch.isfinite(p).all()) for p in model.parameters()):
        raise ModelError("the notebook's model has weights that are not finite; its training diverged")
    return model


class NotebookPolicy:
    """The notebook's planner, with SB3's `predict`, for one environment.

    Parameters
    ----------
    model : a fitted `NotebookModel`.
    seed : seed of its random numbers, which restart with each episode.
    inference : whether to omit autograd's graphs.
    """

    def __init__(self, model: NotebookModel, seed: int = 0, inference: bool = False) -> None:
        self.model, self.seed, self.inference = model, seed, inference
        self._generator = torch.Generator().manual_seed(seed)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Any, Any]:
        """The first action of the plan, (2,) float32, and `state` unchanged."""
        if episode_start is not None and np.any(episode_start):
            self._generator.manual_seed(self.seed)
        with torch.inference_mode() if self.inference else contextlib.nullcontext():
            action = self._plan(observation["observation"], observation["desired_goal"])
        return action.detach().numpy(), state

    def _plan(self, observation: Any, goal: Any) -> Tensor:
        state = torch.tensor(observation, dtype=torch.float).expand(_SAMPLES, -1)
        aim = torch.tensor(goal, dtype=torch.float)
        weights = torch.tensor(WEIGHTS, dtype=torch.float)
        mean, std = torch.zeros(_HORIZON, 1, ACTION_DIM), torch.ones(_HORIZON, 1, ACTION_DIM)
        for _ in range(_ITERATIONS):
            sizes = (1, _SAMPLES, 1)
            actions = torch.normal(mean.repeat(sizes), std.repeat(sizes), generator=self._generator).clamp(-1, 1)
            now, states = state, []
            for action in actions:
                for _ in range(_HOLD):
                    now = self.model(now, action)
                states.append(now)
            returns = -torch.linalg.vector_norm((torch.stack(states) - aim) * weights, ord=1, dim=-1).pow(0.5).sum(0)
            best = actions[:, returns.topk(_ELITES, sorted=False).indices]
            mean, std = best.mean(dim=1, keepdim=True), best.std(dim=1, unbiased=False, keepdim=True)
        return mean[0, 0]
