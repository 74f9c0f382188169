"""Evaluation of a policy during training, and the best model so far."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
import pandas as pd
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from evaluation.learning.normalisation import fold
from evaluation.names import FIRST_EVALUATION_SEED
from evaluation.training.options import TrainingOptions
from evaluation.training.worlds import make_training_envs
from shield import ShieldConfig

__all__ = ["FIRST_SEED", "PeriodicEvaluation", "better", "drive"]

FIRST_SEED = FIRST_EVALUATION_SEED // 2
"""Seed of the first episode of each evaluation; the seeds are always the same, and apart from those of reports."""
_COMPILED, _LIVE = 50, 4
"""Number of environments in a batch, compiled or not."""


def better(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether one evaluation is better than another: fewer crashes, or as many and a greater score.

    Parameters
    ----------
    one, other : evaluations with `crashes`, and `score`, the mean return less the override penalty of the training.

    Examples
    --------
    >>> better({"crashes": 0, "score": 20.0}, {"crashes": 1, "score": 25.0})
    True
    """
    return (-one["crashes"], one["score"]) > (-other["crashes"], other["score"])


class PeriodicEvaluation(BaseCallback):
    """Drives the same episodes at regular steps of training, without exploration, and keeps the best model.

    Beside `NAME.zip` it writes `NAME-evaluations.csv`, a row for each evaluation, and `NAME-best.zip`, the best model
    by `better`. With videos it writes `NAME-videos/STEPS.gif`, the last seconds of the first episode. The trained model
    is the same with and without evaluation, because episodes have environments of their own and no random numbers are
    drawn.

    Attributes
    ----------
    rows : for each evaluation `steps`, `episodes`, `crashes`, `crash_rate`, `return` (mean), `score`, `overrides`
        (share of the decisions), `speed` [m/s] and `length` (mean number of decisions).
    """

    def __init__(self, options: TrainingOptions) -> None:
        super().__init__()
        self._options = options
        self.rows: list[dict[str, Any]] = []
        # Returns are those of the environment; the penalty is part of the score only.
        without_penalty = options.over(override_penalty=0.0)
        made = make_training_envs(without_penalty, 1)
        envs = min(options.evaluation_episodes, _COMPILED if made.driven_in == "compiled" else _LIVE)
        if envs > 1:
            made.env.close()
            made = make_training_envs(without_penalty, envs)
        self._env = made.env if isinstance(made.env, VecEnv) else DummyVecEnv([cast(Any, lambda: made.env)])

    @classmethod
    def of(cls, options: TrainingOptions) -> PeriodicEvaluation | None:
        """The evaluation of a training; None if the options set none."""
        return cls(options) if options.evaluate_every else None

    @property
    def best(self) -> dict[str, Any]:
        """The best evaluation, and the model's file; empty without evaluations."""
        found: dict[str, Any] = {}
        for row in self.rows:
            if not found or better(row, found):
                found = row
        return {**found, "file": self._file("best.zip").name} if found else {}

    def close(self) -> None:
        """Close the environments."""
        self._env.close()

    def _on_rollout_start(self) -> None:
        every, last = self._options.evaluate_every, self.rows[-1]["steps"] if self.rows else 0
        if self.model.num_timesteps >= (last // every + 1) * every:
            self.evaluate()

    def _on_training_end(self) -> None:
        if not self.rows or self.rows[-1]["steps"] < self.model.num_timesteps:
            self.evaluate()

    def _on_step(self) -> bool:
        return True

    def evaluate(self) -> dict[str, Any]:
        """Drive the episodes with the present policy, and record the results."""
        before = self.best
        driven = drive(self.model, self._env, self._options.evaluation_episodes)
        row = {"steps": self.model.num_timesteps, **_summary(driven, self._options.override_penalty)}
        self.rows.append(row)
        file = self._file("evaluations.csv")
        file.parent.mkdir(parents=True, exist_ok=True)
        pd.DataFrame(self.rows).to_csv(file, index=False)
        if not before or better(row, before):
            self._save(self._file("best.zip"))
        if self._options.videos:
            self._film(row["steps"])
        for name in ("crash_rate", "return", "overrides"):
            self.logger.record(f"evaluation/{name}", row[name])
        return row

    def _file(self, name: str) -> Path:
        path = self._options.path
        return path.with_name(f"{path.stem}-{name}")

    def _save(self, path: Path) -> None:
        """Save the present model in a form that takes raw observations."""
        statistics = self.model.get_vec_normalize_env()
        if statistics is None or not statistics.norm_obs:
            self.model.save(path)
            return
        saved = io.BytesIO()
        self.model.save(saved)
        saved.seek(0)
        copy: BaseAlgorithm = type(self.model).load(saved, device="cpu")
        fold(copy, statistics)
        copy.save(path)

    def _film(self, steps: int) -> None:
        from evaluation.report.video import film_end

        folder, options = self._file("videos"), self._options
        folder.mkdir(parents=True, exist_ok=True)
        model = folder / f"{steps}.zip"
        self._save(model)
        config = ShieldConfig(mode="none") if options.shield == "none" else ShieldConfig.profile(options.shield)
        try:
            film_end(folder / f"{steps:010d}.gif", options.environment, str(model), FIRST_SEED, config)
        finally:
            model.unlink()


def drive(model: BaseAlgorithm, env: VecEnv, episodes: int, first: int = FIRST_SEED) -> pd.DataFrame:
    """Drive episodes of consecutive seeds, with the model's most likely actions.

    Parameters
    ----------
    model : the policy; observations are normalised as in its training, and MaskablePPO gets masks.
    env : a batch of environments as in the model's training, without normalisation.
    episodes : number of episodes.
    first : seed of the first episode.

    Returns
    -------
    A row for each: `seed`, `return`, `steps`, `crashed`, `overridden` (decisions), `speed` (mean over decisions, m/s).
    """
    statistics = model.get_vec_normalize_env()
    masked = type(model).__name__ == "MaskablePPO"
    rows: list[dict[str, Any]] = []
    for begun in range(0, episodes, env.num_envs):
        going = np.arange(env.num_envs) < episodes - begun
        batch: list[dict[str, Any]] = [
            {"seed": first + begun + i, "return": 0.0, "steps": 0, "crashed": False, "overridden": 0, "speed": 0.0}
            for i in np.flatnonzero(going)
        ]
        env.seed(first + begun)
        observations = env.reset()
        while going.any():
            seen = observations if statistics is None else statistics.normalize_obs(cast(Any, observations))
            more: dict[str, Any] = {"action_masks": np.stack(env.env_method("action_masks"))} if masked else {}
            actions, _ = model.predict(cast(Any, seen), deterministic=True, **more)
            observations, rewards, dones, infos = env.step(actions)
            for i in np.flatnonzero(going):
                row, info = batch[i], infos[i]
                row["return"] += float(rewards[i])
                row["steps"] += 1
                row["speed"] += (float(info["speed"]) - row["speed"]) / row["steps"]
                row["overridden"] += bool(info.get("shield", {}).get("overridden"))
                row["crashed"] = bool(dones[i] and info["crashed"])
            going &= ~dones
        rows += batch
    return pd.DataFrame(rows)


def _summary(driven: pd.DataFrame, penalty: float) -> dict[str, Any]:
    """A row of `PeriodicEvaluation.rows` without `steps`."""
    steps = float(driven["steps"].sum())
    returned, overrides = float(driven["return"].mean()), float(driven["overridden"].mean())
    return {
        "episodes": len(driven),
        "crashes": int(driven["crashed"].sum()),
        "crash_rate": float(driven["crashed"].mean()),
        "return": returned,
        "score": returned - penalty * overrides,
        "overrides": float(driven["overridden"].sum()) / steps,
        "speed": float((driven["speed"] * driven["steps"]).sum()) / steps,
        "length": steps / len(driven),
    }
