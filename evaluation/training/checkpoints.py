"""Checkpoints of a training: a killed run can be resumed, and ends with the same model."""

from __future__ import annotations

import json
import pickle
import random
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from evaluation.learning.algorithms import get_algorithm
from evaluation.names import FIRST_EVALUATION_SEED
from evaluation.running.identity import differences, of_environment, versions
from evaluation.training.counting import CountSteps
from evaluation.training.options import TrainingOptions
from evaluation.training.periodic_evaluation import PeriodicEvaluation
from shield.errors import ConfigError

__all__ = ["Checkpoints"]

_OF_THE_RUN = ("resume", "output", "tensorboard", "env_config", "setting", "env_id", "actions")
"""Options that may change, or that the identity contains as the environment."""
_KEPT = 2
"""Number of checkpoints that are kept: the last one, and the one before it."""


class Checkpoints:
    """The folder `OUTPUT-checkpoints` of a training.

    `identity.json` holds the specification of the training. `STEPS/` holds the model, the replay buffer, the statistics
    of `VecNormalize`, the state of all random generators, counts and evaluations. A checkpoint is written under another
    name and renamed when it is complete, so a killed process leaves no partial one.

    The simulator's state is not saved. So at each checkpoint all environments begin new episodes, with seeds that
    follow from the training seed and the step. An uninterrupted and a resumed run both do so, and their models are
    equal to the last bit.

    Attributes
    ----------
    last : folder of the last checkpoint, None without one.
    resumed : steps of the checkpoints from which the training was resumed.
    callback : callback for `learn` that writes checkpoints.

    Raises
    ------
    ConfigError
        If there are checkpoints and `resume` is not set, or they belong to another training, with the differences.
    """

    def __init__(self, options: TrainingOptions) -> None:
        self._options = options
        self._folder = options.path.with_name(options.path.stem + "-checkpoints")
        self._identity = _identity(options)
        self._steps = options.checkpoint_every
        self.resumed: list[int] = []
        self._counts: CountSteps | None = None
        self._evaluation: PeriodicEvaluation | None = None
        self.callback = _WriteCheckpoints(self)
        self._check()

    @classmethod
    def of(cls, options: TrainingOptions) -> Checkpoints | None:
        """The checkpoints of a training; None if the options set none.

        Raises
        ------
        ConfigError
            If `resume` is set without `checkpoint_every`, or for a reason of the class.
        """
        if options.checkpoint_every:
            return cls(options)
        if options.resume:
            raise ConfigError("resume goes with checkpoint_every: give the number of steps of the first run")
        return None

    @property
    def last(self) -> Path | None:
        """Folder of the last complete checkpoint."""
        whole = sorted(each for each in self._folder.glob("[0-9]*") if each.name.isdigit())
        return whole[-1] if whole else None

    @property
    def every(self) -> int:
        """Steps between two checkpoints."""
        return self._steps

    def attach(self, counts: CountSteps, evaluation: PeriodicEvaluation | None) -> None:
        """Set the counts and the evaluation that are saved and restored with the model."""
        self._counts, self._evaluation = counts, evaluation

    def load(self, env: VecEnv) -> BaseAlgorithm:
        """Load the model of the last checkpoint.

        Parameters
        ----------
        env : environments for the rest of the training.
        """
        folder = self.last
        assert folder is not None
        model = get_algorithm(self._options.learner).load(folder / "model.zip", env=env, device="cpu")
        if isinstance(model, OffPolicyAlgorithm):
            model.load_replay_buffer(folder / "replay_buffer.pkl")
        state = self._state(folder)
        self.resumed = [*state["resumed"], model.num_timesteps]
        if self._counts is not None:
            self._counts.counts.update(state["counts"])
        if self._evaluation is not None:
            self._evaluation.rows[:] = state["evaluations"]
        self.callback.begin_at(folder)
        return model

    def write(self, model: BaseAlgorithm) -> Path:
        """Write a checkpoint and return its folder."""
        name = f"{model.num_timesteps:010d}"
        partial, whole = self._folder / f".partial-{name}", self._folder / name
        self._folder.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir()
        identity = self._folder / "identity.json"
        if not identity.exists():
            draft = self._folder / ".partial-identity.json"
            draft.write_text(json.dumps(self._identity, indent=2) + "\n", encoding="utf-8")
            draft.replace(identity)
        model.save(partial / "model.zip")
        if isinstance(model, OffPolicyAlgorithm):
            model.save_replay_buffer(partial / "replay_buffer.pkl")
        statistics = model.get_vec_normalize_env()
        if statistics is not None:
            statistics.save(str(partial / "statistics.pkl"))
        state = {
            "generators": _generators(model),
            "resumed": self.resumed,
            "counts": {} if self._counts is None else self._counts.counts,
            "evaluations": [] if self._evaluation is None else self._evaluation.rows,
        }
        (partial / "state.pkl").write_bytes(pickle.dumps(state))
        shutil.rmtree(whole, ignore_errors=True)
        partial.replace(whole)
        for old in sorted(each for each in self._folder.glob("[0-9]*"))[:-_KEPT]:
            shutil.rmtree(old)
        return whole

    def restart(self, model: BaseAlgorithm, folder: Path) -> None:
        """Begin new episodes, with the random generators of the checkpoint."""
        _restore(model, self._state(folder)["generators"])
        env = model.get_env()
        assert env is not None
        # These seeds differ from those of the first episodes, and are below those of the evaluation.
        drawn = np.random.default_rng([self._options.seed, model.num_timesteps])
        env.seed(int(drawn.integers(FIRST_EVALUATION_SEED)))
        statistics = model.get_vec_normalize_env()
        if statistics is not None:
            # In a resumed run the statistics contain the first observations of `learn`, so they are restored.
            saved = VecNormalize.load(str(folder / "statistics.pkl"), statistics.venv)
            statistics.obs_rms, statistics.ret_rms = saved.obs_rms, saved.ret_rms
        writable: Any = model
        writable._last_obs = env.reset()
        writable._last_episode_starts = np.ones(env.num_envs, bool)
        if statistics is not None:
            writable._last_original_obs = statistics.get_original_obs()

    def _state(self, folder: Path) -> dict[str, Any]:
        found: dict[str, Any] = pickle.loads((folder / "state.pkl").read_bytes())
        return found

    def _check(self) -> None:
        file = self._folder / "identity.json"
        if not file.exists():
            return
        if not self._options.resume:
            raise ConfigError(f"{self._folder} has checkpoints: go on from them with resume (--resume), or remove it")
        different = differences(json.loads(file.read_text(encoding="utf-8")), self._identity)
        if different:
            raise ConfigError(f"{self._folder} is of another training; different are: {', '.join(different)}")


class _WriteCheckpoints(BaseCallback):
    """Writes a checkpoint between two rollouts, after the steps have passed the next multiple of `every`."""

    def __init__(self, checkpoints: Checkpoints) -> None:
        super().__init__()
        self._checkpoints, self._next, self._resume_at = checkpoints, checkpoints.every, Path()

    def begin_at(self, folder: Path) -> None:
        """Continue from a checkpoint."""
        self._resume_at = folder
        self._next = _after(int(folder.name), self._checkpoints.every)

    def _on_rollout_start(self) -> None:
        if self._resume_at != Path():
            self._checkpoints.restart(self.model, self._resume_at)
            self._resume_at = Path()
        elif self.model.num_timesteps >= self._next:
            self._checkpoints.restart(self.model, self._checkpoints.write(self.model))
            self._next = _after(self.model.num_timesteps, self._checkpoints.every)

    def _on_step(self) -> bool:
        return True


def _after(steps: int, every: int) -> int:
    """The next multiple of `every` after `steps`."""
    return (steps // every + 1) * every


def _identity(options: TrainingOptions) -> dict[str, Any]:
    """The values that determine the final model, as plain values."""
    own = {key: value for key, value in options.plain().items() if key not in _OF_THE_RUN}
    return json.loads(  # type: ignore[no-any-return]
        json.dumps({**own, "environment": of_environment(options.environment), "versions": versions()})
    )


def _generators(model: BaseAlgorithm) -> dict[str, Any]:
    """States of the random generators of the training."""
    return {
        "python": random.getstate(),
        "numpy": np.random.get_state(),  # noqa: NPY002 - Stable-Baselines3 draws from it
        "torch": torch.get_rng_state(),
        "actions": model.action_space.np_random.bit_generator.state,
    }


def _restore(model: BaseAlgorithm, states: dict[str, Any]) -> None:
    random.setstate(states["python"])
    np.random.set_state(states["numpy"])  # noqa: NPY002 - Stable-Baselines3 draws from it
    torch.set_rng_state(states["torch"])
    model.action_space.np_random.bit_generator.state = states["actions"]
