"""Models on disk: every bit is preserved, and nothing else is accepted as a model."""

from __future__ import annotations

import hashlib
import json
import pickle

import numpy as np
import pytest
import torch
from driving_data import driving
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.errors import ModelError, ShieldError
from dynamics.learned.models.files import CONFIG_FILE, WEIGHTS_FILE, load_model, read_config, save_model
from dynamics.learned.models.linear import LinearStructuredModel, ModelConfig

configs = st.builds(
    ModelConfig,
    form=st.sampled_from(["plain", "body"]),
    hidden=st.sampled_from([(4,), (3, 5)]),
    members=st.integers(1, 3),
    shared=st.booleans(),
    units=st.sampled_from([None, (100.0, 100, 5, 5, 1, 1)]),
    seed=st.integers(0, 9),
)


@pytest.fixture
def folder(tmp_path):
    return save_model(LinearStructuredModel(ModelConfig(hidden=(4,))), tmp_path / "model", {"seed": 3})


@settings(deadline=None)
@given(configs)
def test_a_model_comes_back_with_its_configuration_and_every_bit(tmp_path_factory, config):
    model, data = LinearStructuredModel(config), driving(2, 5)
    model.normalise(
        *(torch.tensor(part, dtype=torch.float32) for part in (data.states, data.actions, data.next_states))
    )
    back = load_model(save_model(model, tmp_path_factory.mktemp("model")))
    assert back.config == config
    np.testing.assert_array_equal(back.step(data.states, data.actions), model.step(data.states, data.actions))


def test_notes_are_kept(folder):
    assert read_config(folder)["notes"] == {"seed": 3}


def test_a_missing_file_of_a_model_is_named(tmp_path, folder):
    with pytest.raises(ModelError, match="is no model: a model is a folder with"):
        load_model(tmp_path / "nowhere")
    (folder / WEIGHTS_FILE).unlink()
    with pytest.raises(ShieldError, match=f"{WEIGHTS_FILE} cannot be read"):
        load_model(folder)


@settings(deadline=None)
@given(st.data())
def test_no_damaged_weights_are_read(tmp_path_factory, data):
    folder = save_model(LinearStructuredModel(ModelConfig(hidden=(4,))), tmp_path_factory.mktemp("model"))
    path = folder / WEIGHTS_FILE
    content = bytearray(path.read_bytes())
    place = data.draw(st.integers(0, len(content) - 1))
    content[place] ^= data.draw(st.integers(1, 255))
    path.write_bytes(bytes(content[: data.draw(st.sampled_from([len(content), place]))]))
    with pytest.raises(ModelError, match="checksum"):
        load_model(folder)


@pytest.mark.parametrize("content", ["", "{", "[]", "3", '{"format": "other"}', '{"model": {}}'])
def test_a_foreign_configuration_is_refused(folder, content):
    (folder / CONFIG_FILE).write_text(content)
    with pytest.raises(ModelError, match=CONFIG_FILE):
        load_model(folder)


def _rewrite(folder, **changes):
    """Change the configuration; None takes a key out."""
    path = folder / CONFIG_FILE
    values = json.loads(path.read_text()) | changes
    path.write_text(json.dumps({key: value for key, value in values.items() if value is not None}))


@pytest.mark.parametrize(
    "change",
    [
        {"form": "polar"},
        {"members": 0},
        {"hidden": "x"},
        {"hidden": None},
        {"layout": {}},
        {"extra": 1},
        {"hidden": [5]},
    ],
)
def test_a_configuration_of_another_model_is_refused(folder, change):
    _rewrite(folder, model=read_config(folder)["model"] | change)
    with pytest.raises(ModelError):
        load_model(folder)


def test_a_configuration_without_checksum_is_refused(folder):
    _rewrite(folder, weights_sha256=None)
    with pytest.raises(ModelError, match="checksum"):
        load_model(folder)


class _Evil:
    def __reduce__(self):
        return (pytest.fail, ("code from a pickle was run",))


def _with_weights(folder, content: bytes):
    (folder / WEIGHTS_FILE).write_bytes(content)
    _rewrite(folder, weights_sha256=hashlib.sha256(content).hexdigest())


def test_pickled_code_is_not_run(folder):
    _with_weights(folder, pickle.dumps(_Evil(), protocol=2))
    with pytest.raises(ModelError, match="holds no weights of this model"):
        load_model(folder)


def test_weights_that_are_not_finite_are_neither_written_nor_read(folder, tmp_path):
    model = LinearStructuredModel(ModelConfig(hidden=(4,)))
    model.networks[0].weights[0].data[0, 0, 0] = float("nan")
    with pytest.raises(ModelError, match="not finite"):
        save_model(model, tmp_path / "other")
    assert not (tmp_path / "other").exists()
    torch.save(model.state_dict(), tmp_path / "w.pt")
    _with_weights(folder, (tmp_path / "w.pt").read_bytes())
    with pytest.raises(ModelError, match="not finite"):
        load_model(folder)
