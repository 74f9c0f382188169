"""Models that were trained in `VecNormalize`, with its statistics in a file beside them."""

from __future__ import annotations

import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecNormalize

from shield.errors import ConfigError, PolicyError
from shield.wrappers.ranking import ranking_of

__all__ = ["NormalisedModel", "statistics_beside", "with_statistics"]

_NAMES = ("{stem}_vecnormalize.pkl", "{stem}-vecnormalize.pkl", "vecnormalize.pkl", "vec_normalize.pkl")
"""Names of the file in SB3's documentation and in the RL Zoo; those with the model's own name first."""
_CHECKPOINT = re.compile(r"^(?P<prefix>.+)_(?P<steps>\d+)_steps$")
"""Name of a model of SB3's `CheckpointCallback`; its statistics are in PREFIX_vecnormalize_STEPS_steps.pkl."""


class NormalisedModel:
    """A model for raw observations, which it normalises as in its training.

    Parameters
    ----------
    model : the trained model.
    statistics : statistics of the observations from `VecNormalize.save`; they are not updated.

    Raises
    ------
    PolicyError
        If the statistics have another shape than the observations.
    """

    def __init__(self, model: BaseAlgorithm, statistics: VecNormalize) -> None:
        self.model, self.statistics = model, statistics
        self.observation_space, self.action_space = model.observation_space, model.action_space
        mean = getattr(statistics.obs_rms, "mean", None) if statistics.norm_obs else None
        if mean is not None and np.shape(mean) != self.observation_space.shape:
            raise PolicyError(
                f"the statistics are of observations of shape {np.shape(mean)}, the model takes "
                f"{self.observation_space.shape}"
            )

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """The model's action for a raw observation."""
        seen = self.statistics.normalize_obs(observation)
        return self.model.predict(seen, state=state, episode_start=episode_start, deterministic=deterministic)

    def action_scores(self, observation: Any) -> Any:
        """The model's scores of discrete actions (n, actions), or None (see `shield.wrappers.ranking.ranking_of`)."""
        return ranking_of(self.model, self.statistics.normalize_obs(observation))


def statistics_beside(path: Path) -> Path | None:
    """The file of `VecNormalize` statistics of a model, if there is one in its folder."""
    names = [name.format(stem=path.stem) for name in _NAMES]
    if match := _CHECKPOINT.match(path.stem):
        names.insert(0, f"{match['prefix']}_vecnormalize_{match['steps']}_steps.pkl")
    return next((path.with_name(name) for name in names if path.with_name(name).is_file()), None)


def with_statistics(model: BaseAlgorithm, path: Path) -> NormalisedModel:
    """A model with statistics from a file. Like SB3's own files, the file can run code when it is read.

    Raises
    ------
    ConfigError
        If there is no such file.
    PolicyError
        If it is no file of `VecNormalize.save`, or its statistics have another shape than the observations.
    """
    if not path.is_file():
        raise ConfigError(f"there is no file {path}; have one that VecNormalize.save(path) wrote")
    try:
        statistics = pickle.loads(path.read_bytes())
    except Exception as error:
        raise PolicyError(f"{path} cannot be read as VecNormalize statistics: {error}") from error
    if not isinstance(statistics, VecNormalize):
        raise PolicyError(f"{path} holds a {type(statistics).__name__}, not what VecNormalize.save(path) writes")
    return NormalisedModel(model, statistics)
