"""Planners for parking by name, and training of their models.

- `cem` plans with a learned model, `cem-fast` with the same model in half the time.
- `cem-oracle` plans with the true bicycle model.
- `cem-notebook` is HighwayEnv's parking notebook.
- `cem-mppi` searches with `mpc.sampling.mppi`.
- `cem-cautious` penalises disagreement among the members of the model.

The bundled models have training seed 0; `train` makes others.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from time import perf_counter
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import torch

from dynamics.learned.data.transitions import Transitions
from dynamics.learned.models.files import load_model, save_model
from dynamics.learned.models.linear import LinearStructuredModel, ModelConfig
from dynamics.learned.models.macro_steps import DistilledModel
from dynamics.learned.tasks import parking_state as parking
from dynamics.learned.training.distill import DistillConfig, distill
from dynamics.learned.training.fit import FitConfig
from dynamics.learned.training.on_policy_rounds import RoundsConfig, rounds
from mpc.cem_policy import CEMPolicy
from mpc.tasks.cautious_parking import CautiousTask
from mpc.tasks.notebook import NotebookModel, NotebookPolicy, collect_as_notebook, fit_as_notebook
from mpc.tasks.parking import ParkingTask, parking_settings
from shield.errors import ConfigError

__all__ = [
    "BUNDLED",
    "CAUTION",
    "PARKING_POLICIES",
    "TEMPERATURE",
    "TrainedParking",
    "load",
    "network",
    "parking_policy",
    "save",
    "train",
]

PARKING_POLICIES = ("cem", "cem-fast", "cem-oracle", "cem-notebook", "cem-mppi", "cem-cautious")
"""Names of the policies for parking."""

TEMPERATURE, CAUTION = 0.05, 1.0
"""Temperature of `cem-mppi`; weight of the disagreement for `cem-cautious`."""

BUNDLED = Path(__file__).parent.parent / "policies"
"""Folder of the bundled models."""
_MODEL, _NOTEBOOK, _DATA = "cem-parking", "cem-notebook", "transitions.npz"
_DISTILL = DistillConfig(holds=(1, 4))


@dataclass(frozen=True, slots=True, eq=False)
class TrainedParking:
    """A learned model of parking, and its data.

    Attributes
    ----------
    model : the network.
    fast : its macro-steps, which the planner uses.
    data : the transitions of its fit.
    seconds : time for collecting, fitting and distilling [s].
    """

    model: LinearStructuredModel
    fast: DistilledModel
    data: Transitions
    seconds: float


def train(seed: int = 0, progress: bool = False) -> TrainedParking:
    """Collect 1,000 random and 2 x 400 on-policy transitions in `parking-v0`, fit, and distil.

    Parameters
    ----------
    seed : seed of all random numbers.
    progress : whether to show bars.
    """
    begin = perf_counter()
    env = gym.make("parking-v0")
    env.reset(seed=seed)

    def driver(model: LinearStructuredModel, data: Transitions) -> CEMPolicy:
        return CEMPolicy.parking(env, distill(model, data, _DISTILL), parking_settings(seed=seed))

    *_, last = rounds(
        env,
        parking.state,
        ModelConfig(seed=seed),
        driver,
        RoundsConfig(seed=seed),
        FitConfig(seed=seed),
        progress=progress,
    )
    env.close()
    fast = distill(last.fit.model, last.data, _DISTILL)
    return TrainedParking(last.fit.model, fast, last.data, perf_counter() - begin)


def train_notebook(seed: int = 0) -> NotebookModel:
    """Collect 2,000 transitions as HighwayEnv's notebook does, and fit its model."""
    env = gym.make("parking-v0")
    data = collect_as_notebook(env, seed)
    env.close()
    return fit_as_notebook(data, seed)


def save(trained: TrainedParking, notebook: NotebookModel, folder: str | Path = BUNDLED) -> None:
    """Write both models in the layout that `load` reads."""
    notes = {"transitions": len(trained.data), "seconds": round(trained.seconds, 1)}
    save_model(trained.model, Path(folder, _MODEL), notes)
    trained.data.save(Path(folder, _MODEL, _DATA))
    arrays = {name: part.detach().numpy() for name, part in notebook.state_dict().items()}
    np.savez_compressed(Path(folder, f"{_NOTEBOOK}.npz"), **arrays)


@lru_cache(maxsize=4)
def load(folder: str | Path = BUNDLED) -> tuple[DistilledModel, NotebookModel]:
    """Load the macro-steps of the learned model, and the notebook's model."""
    model, data = load_model(Path(folder, _MODEL)), Transitions.load(Path(folder, _MODEL, _DATA))
    notebook = NotebookModel()
    with np.load(Path(folder, f"{_NOTEBOOK}.npz"), allow_pickle=False) as arrays:
        notebook.load_state_dict({name: torch.as_tensor(arrays[name]) for name in arrays.files})
    return distill(model, data, _DISTILL), notebook


@lru_cache(maxsize=4)
def network(folder: str | Path = BUNDLED) -> LinearStructuredModel:
    """Load the learned model itself, an ensemble with a measure of disagreement."""
    return load_model(Path(folder, _MODEL))


def parking_policy(name: str, env: gym.Env[Any, Any]) -> CEMPolicy | NotebookPolicy:
    """A policy for parking by name.

    Parameters
    ----------
    name : one of `PARKING_POLICIES`.
    env : the environment of the policy.

    Raises
    ------
    ConfigError
        If there is no such name, or the environment is not parking.
    """
    if name == "cem-oracle":
        return CEMPolicy.parking(env)
    if name == "cem-notebook":
        return NotebookPolicy(load()[1])
    if name == "cem-mppi":
        return CEMPolicy.parking(env, load()[0], temperature=TEMPERATURE)
    if name == "cem-cautious":
        return CEMPolicy.parking(env, load()[0], task=CautiousTask(ParkingTask(env), network(), CAUTION))
    profiles = {"cem": "quality", "cem-fast": "fast"}
    if name not in profiles:
        raise ConfigError(f"unknown policy {name!r} for parking; have {', '.join(PARKING_POLICIES)}")
    return CEMPolicy.parking(env, load()[0], parking_settings(profiles[name]))
