"""A killed training continues from its checkpoint, and ends with the model of an uninterrupted one."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import torch

from evaluation.learning.algorithms import get_algorithm
from evaluation.settings import Setting
from evaluation.training.checkpoints import Checkpoints
from evaluation.training.train import train
from shield.errors import ConfigError

TINY = Setting("tiny", "highway-fast-v0", {"vehicles_count": 5, "duration": 10})
SMALL: dict[str, Any] = {"policy_kwargs": {"net_arch": [16]}}
ROLLOUT = {**SMALL, "n_steps": 16, "batch_size": 16, "n_epochs": 2}
CASES: dict[str, dict[str, Any]] = {
    "ppo": {"hyperparameters": ROLLOUT, "envs": 2, "shield": "default"},
    "ppo-normalised": {
        "hyperparameters": ROLLOUT, "envs": 2, "normalise": ("observations", "rewards"), "evaluate_every": 64,
        "evaluation_episodes": 3,
    },
    "maskableppo": {"hyperparameters": ROLLOUT, "shield": "default", "override_penalty": 0.1, "envs": 2},
    "dqn": {
        "hyperparameters": {**SMALL, "learning_starts": 20, "buffer_size": 500}, "shield": "default",
        "learn_from": "executed",
    },
    "live": {"hyperparameters": ROLLOUT, "simulator": "highway-env"},
}  # fmt: skip


class Killed(Exception):
    """In place of a signal, within one process."""


def trained(path: Path, case: str, **more: Any) -> dict[str, Any]:
    algorithm = case.partition("-")[0] if case != "live" else "ppo"
    options = {**CASES[case], "checkpoint_every": 50, "progress": False, **more}
    return dict(train(TINY, algorithm, 160, 3, output=path, **options).manifest)


def weights(path: Path, algorithm: str) -> dict[str, torch.Tensor]:
    return dict(get_algorithm(algorithm).load(path, device="cpu").policy.state_dict())


@pytest.mark.parametrize("case", CASES)
def test_a_resumed_training_ends_with_the_same_model_bit_for_bit(tmp_path, monkeypatch, case):
    """Killed just after its second checkpoint, when more has been learned since the first."""
    whole = trained(tmp_path / "whole", case)
    assert whole["resumed"] == []
    write, written = Checkpoints.write, []

    def kill(self, model):
        if written:
            raise Killed
        written.append(write(self, model))
        return written[0]

    with monkeypatch.context() as patch:
        patch.setattr(Checkpoints, "write", kill)
        with pytest.raises(Killed):
            trained(tmp_path / "killed", case)
    assert not (tmp_path / "killed.zip").exists()
    resumed = trained(tmp_path / "killed", case, resume=True)
    assert resumed["resumed"] == [int(written[0].name)]
    assert resumed["steps_taken"] == whole["steps_taken"]
    assert resumed["in_training"] == whole["in_training"]
    assert resumed.get("best", {}).get("return") == whole.get("best", {}).get("return")
    one, two = (weights(tmp_path / f"{name}.zip", whole["algorithm"]) for name in ("whole", "killed"))
    assert all(torch.equal(value, two[key]) for key, value in one.items())


def test_a_process_killed_at_any_moment_leaves_a_usable_checkpoint(tmp_path):
    """kill -9 as soon as a checkpoint exists; the next run finishes, with the model of an uninterrupted one."""
    output, folder = tmp_path / "killed.zip", tmp_path / "killed-checkpoints"
    command = [
        *(sys.executable, "-m", "evaluation.commands.cli", "train", "--setting", "highway-fast", "--steps", "1024"),
        *("--envs", "2", "--shield", "default", "--set", "n_steps=32", "--set", "batch_size=32", "--set", "n_epochs=5"),
        *("--checkpoint-every", "64", "--output", str(output), "--resume"),
    ]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, env=dict(os.environ))
    deadline = time.monotonic() + 120
    while not list(folder.glob("[0-9]*")):
        assert process.poll() is None, "it ended before a checkpoint was seen"
        assert time.monotonic() < deadline
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not output.exists()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env=dict(os.environ))
    killed = json.loads(output.with_suffix(".json").read_text())
    options = {"hyperparameters": {"n_steps": 32, "batch_size": 32, "n_epochs": 5}, "envs": 2, "shield": "default"}
    whole = train(
        "highway-fast", "ppo", 1024, 0, output=tmp_path / "whole", checkpoint_every=64, progress=False, **options
    )
    assert len(killed["resumed"]) == 1 > len(whole.manifest["resumed"]) == 0
    assert killed["in_training"] == whole.manifest["in_training"]
    one, two = (weights(tmp_path / f"{name}.zip", "ppo") for name in ("killed", "whole"))
    assert all(torch.equal(value, two[key]) for key, value in one.items())


def test_checkpoints_of_another_training_are_refused_and_the_differences_named(tmp_path):
    trained(tmp_path / "x", "ppo")
    with pytest.raises(ConfigError, match=r"has checkpoints.*--resume"):
        trained(tmp_path / "x", "ppo")
    with pytest.raises(ConfigError, match=r"different are: envs \(2, now 3\), override_penalty \(0.0, now 0.5\)"):
        trained(tmp_path / "x", "ppo", resume=True, override_penalty=0.5, envs=3)
    other = TINY.override({"vehicles_count": 6})
    with pytest.raises(ConfigError, match="environment configuration vehicles_count"):
        train(other, "ppo", 160, 3, output=tmp_path / "x", resume=True, checkpoint_every=50, **CASES["ppo"])


def test_an_incomplete_checkpoint_is_ignored(tmp_path):
    """A file that a process was killed while writing has another name."""
    whole = trained(tmp_path / "x", "ppo")
    folder = tmp_path / "x-checkpoints"
    (folder / ".partial-0000009999").mkdir()
    resumed = trained(tmp_path / "x", "ppo", resume=True)
    assert resumed["steps_taken"] == whole["steps_taken"]
    assert len([each for each in folder.glob("[0-9]*")]) == 2
