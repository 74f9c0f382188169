"""Evaluation during training: its measurements, the kept model, and its independence of the training."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from stable_baselines3 import PPO

from evaluation.running.episodes import run_paired
from evaluation.running.records import make_variants
from evaluation.settings import Setting
from evaluation.training.periodic_evaluation import FIRST_SEED, PeriodicEvaluation, better
from evaluation.training.train import train

TINY = Setting("tiny", "highway-fast-v0", {"vehicles_count": 10, "duration": 10})
ROLLOUT: dict[str, Any] = {"policy_kwargs": {"net_arch": [16]}, "n_steps": 32, "batch_size": 16, "n_epochs": 1}
EVALUATED = {"evaluate_every": 128, "evaluation_episodes": 5}

rows = st.fixed_dictionaries({"crashes": st.integers(0, 3), "score": st.floats(-5, 30)})


@given(rows, rows)
def test_the_better_of_two_evaluations_never_crashes_more_often(one, other):
    assert not (better(one, other) and better(other, one))
    if better(one, other):
        assert one["crashes"] <= other["crashes"]
        assert one["crashes"] < other["crashes"] or one["score"] > other["score"]


@pytest.mark.parametrize("shield", ["none", "default"])
def test_training_learns_the_same_with_evaluation_as_without(tmp_path, shield):
    weights = []
    for name, more in (("with", EVALUATED), ("without", {})):
        options = {"hyperparameters": ROLLOUT, "shield": shield, "envs": 2, "progress": False, **more}
        path = train(TINY, "ppo", 256, 3, output=tmp_path / name, **options).path
        weights.append(PPO.load(path, device="cpu").policy.state_dict())
    assert all(torch.equal(value, weights[1][key]) for key, value in weights[0].items())


def test_the_evaluation_equals_the_episodes_of_the_saved_model(tmp_path):
    """The last row, of a model with normalised observations, equals `run_paired` with the saved file."""
    trained = train(
        TINY, "ppo", 256, 3, output=tmp_path / "x", envs=2, hyperparameters=ROLLOUT, progress=False,
        normalise=("observations", "rewards"), **EVALUATED,
    )  # fmt: skip
    table = pd.read_csv(tmp_path / "x-evaluations.csv")
    assert table["steps"].tolist() == [128, 256]
    seeds = range(FIRST_SEED, FIRST_SEED + 5)
    driven = run_paired(TINY, str(trained.path), make_variants(["none"], ["env"]), seeds, jobs=1)
    last = table.iloc[-1]
    assert last["return"] == pytest.approx(driven["return"].mean())
    assert last["crashes"] == driven["crashed"].sum()
    assert last["length"] == pytest.approx(driven["steps"].mean())
    best = table.sort_values(["crashes", "score"], ascending=[True, False]).iloc[0]
    assert trained.manifest["best"]["steps"] == best["steps"]
    again = run_paired(TINY, str(tmp_path / "x-best.zip"), make_variants(["none"], ["env"]), seeds, jobs=1)
    assert again["return"].mean() == pytest.approx(best["return"])


def test_the_score_takes_the_penalty_off_the_return_and_the_return_does_not(tmp_path):
    trained = train(
        TINY, "ppo", 64, 1, output=tmp_path / "x", envs=2, hyperparameters=ROLLOUT, progress=False, shield="default",
        override_penalty=0.5, evaluate_every=64, evaluation_episodes=4,
    )  # fmt: skip
    row = trained.manifest["best"]
    assert row["overrides"] > 0
    assert row["score"] == pytest.approx(row["return"] - 0.5 * row["overrides"] * row["length"])
    assert row["return"] > 0.6 * row["length"]


def test_masks_are_used_in_evaluation(tmp_path, monkeypatch):
    asked = []
    drive = PeriodicEvaluation.evaluate

    def watched(self):
        method = self._env.env_method
        monkeypatch.setattr(self._env, "env_method", lambda name, *a, **k: asked.append(name) or method(name, *a, **k))
        return drive(self)

    monkeypatch.setattr(PeriodicEvaluation, "evaluate", watched)
    train(
        TINY, "ppo", 32, 0, output=tmp_path / "x", hyperparameters=ROLLOUT, progress=False, shield="default",
        masks=True, evaluate_every=32, evaluation_episodes=2,
    )  # fmt: skip
    assert "action_masks" in asked


def test_an_episode_of_each_evaluation_is_filmed(tmp_path):
    train(
        TINY.override({"duration": 3}), "ppo", 32, 0, output=tmp_path / "x", hyperparameters=ROLLOUT, progress=False,
        shield="default", evaluate_every=32, evaluation_episodes=1, videos=True,
    )  # fmt: skip
    films = sorted((tmp_path / "x-videos").iterdir())
    assert [film.name for film in films] == ["0000000032.gif"]
    with Image.open(films[0]) as film:
        assert film.n_frames >= 10
        assert np.ptp(np.asarray(film)) > 0
