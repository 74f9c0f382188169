"""Checkpoints of world models: what is written is read back, and what is damaged or foreign is refused."""

from __future__ import annotations

import json

import pytest
import torch

from dynamics.errors import ModelError
from dynamics.world_model.config import WorldModelConfig
from dynamics.world_model.files import CONFIG_FILE, WEIGHTS_FILE, load_world_model, read_config, save_world_model
from dynamics.world_model.model import WorldModel
from dynamics.world_model.view import FrameView

TINY = WorldModelConfig(
    view=FrameView(size=16), actions=3, depth=8, embedding=8, recurrent=8, groups=2, classes=4, hidden=8
)


@pytest.fixture
def folder(tmp_path):
    return save_world_model(WorldModel(TINY), tmp_path / "model", {"seed": 3})


def test_a_model_is_read_back_with_its_configuration_and_notes(folder):
    model, read = WorldModel(TINY), load_world_model(folder)
    assert read.config == TINY
    assert all(torch.equal(weight, read.state_dict()[name]) for name, weight in model.state_dict().items())
    assert read_config(folder)["notes"] == {"seed": 3}


def test_no_file_is_pickled(folder):
    assert {path.name for path in folder.iterdir()} == {CONFIG_FILE, WEIGHTS_FILE}
    assert (folder / WEIGHTS_FILE).read_bytes()[8:9] == b"{"


def rewrite(folder, **changes):
    path = folder / CONFIG_FILE
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda f: (f / CONFIG_FILE).unlink(), "no checkpoint"),
        (lambda f: (f / CONFIG_FILE).write_text("{"), "cannot be read"),
        (lambda f: rewrite(f, format="other/1"), "'other/1'"),
        (lambda f: (f / WEIGHTS_FILE).unlink(), "cannot be read"),
        (lambda f: (f / WEIGHTS_FILE).write_bytes(b"abc"), "checksum differs"),
        (lambda f: rewrite(f, world_model=None), "has the keys"),
        (lambda f: rewrite(f, world_model={**TINY.to_json(), "depth": -8}), "positive whole number"),
        (lambda f: rewrite(f, world_model={**TINY.to_json(), "view": {"size": 16, "angle": 1}}), "invalid value"),
        (lambda f: rewrite(f, world_model={**TINY.to_json(), "hidden": 16}), "no weights of these networks"),
    ],
)
def test_damaged_checkpoints_are_refused(folder, damage, message):
    damage(folder)
    with pytest.raises(ModelError, match=message):
        load_world_model(folder)


def test_weights_that_are_not_finite_are_not_written(tmp_path):
    model = WorldModel(TINY)
    with torch.no_grad():
        model.prior[0].bias[0] = torch.nan
    with pytest.raises(ModelError, match=r"prior\.0\.bias"):
        save_world_model(model, tmp_path)
