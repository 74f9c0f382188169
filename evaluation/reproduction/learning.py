"""Training of a variant's policy, with a manifest beside the model."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from evaluation.learning.algorithms import get_algorithm
from evaluation.learning.manifests import manifest_path
from evaluation.reproduction.env import ReportEnv
from evaluation.reproduction.presets import Preset
from evaluation.reproduction.variants import ReportVariant
from evaluation.running.identity import file_hash, versions
from evaluation.threads import one_thread
from evaluation.training.counting import CountSteps

__all__ = ["hyperparameters", "is_trained", "train_variant"]


def hyperparameters(preset: Preset, variant: ReportVariant) -> dict[str, Any]:
    """Keyword arguments of a variant's algorithm.

    PPO and MaskablePPO have the preset's. DQN has those of highway-env's own example, and TRPO those of sb3-contrib,
    both with the preset's discount and network size.
    """
    given: Mapping[str, Any] = preset.hyperparameters
    if variant.learner in ("ppo", "maskableppo"):
        return deepcopy(dict(given))
    if variant.learner == "trpo":
        return {"gamma": preset.gamma, "n_steps": given["n_steps"], "policy_kwargs": {"net_arch": [256, 256]}}
    return {
        "learning_rate": given["learning_rate"],
        "gamma": preset.gamma,
        "buffer_size": 15_000,
        "learning_starts": 200,
        "batch_size": 32,
        "train_freq": 1,
        "gradient_steps": 1,
        "target_update_interval": 50,
        "policy_kwargs": {"net_arch": [256, 256]},
    }


def is_trained(path: Path) -> bool:
    """Whether a model exists and matches the hash in its manifest, which is written after it."""
    manifest = manifest_path(path)
    if not (path.is_file() and manifest.is_file()):
        return False
    recorded = json.loads(manifest.read_text(encoding="utf-8"))
    return bool(recorded.get("sha256") == file_hash(path))


def train_variant(preset: Preset, variant: ReportVariant, seed: int, steps: int, path: Path) -> dict[str, Any]:
    """Train one model, and write it and its manifest.

    Parameters
    ----------
    preset, variant : the variant.
    seed : training seed.
    steps : number of decisions; with skills, of skills.
    path : path of the zip file.

    Returns
    -------
    The manifest.
    """
    parameters = hyperparameters(preset, variant)
    envs = 1 if variant.learner == "dqn" else preset.envs
    began, counting = time.perf_counter(), CountSteps()
    world = DummyVecEnv([lambda: Monitor(ReportEnv(preset, variant)) for _ in range(envs)])
    with one_thread():
        arguments = {"policy": "MlpPolicy", **deepcopy(parameters)}
        model = get_algorithm(variant.learner)(**arguments, env=world, seed=seed, device="cpu")
        model.learn(steps, callback=counting)
    path.parent.mkdir(parents=True, exist_ok=True)
    model.save(path)
    manifest = {
        "preset": preset.name,
        "variant": variant.as_dict(),
        "algorithm": variant.learner,
        "seed": seed,
        "steps": steps,
        "steps_taken": int(model.num_timesteps),
        "environments": envs,
        "hyperparameters": parameters,
        "crashes_in_training": counting.counts["crashes"],
        "episodes": counting.counts["episodes"],
        "overrides": counting.counts["overridden"],
        "training_seconds": round(time.perf_counter() - began, 1),
        "sha256": file_hash(path),
        "versions": versions(),
    }
    partial = manifest_path(path).with_suffix(".partial")
    partial.write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")
    partial.replace(manifest_path(path))
    return manifest
