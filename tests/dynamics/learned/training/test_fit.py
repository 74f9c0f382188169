"""Training learns, is repeatable, keeps the best weights, and reports errors in data."""

from __future__ import annotations

import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from driving_data import driving

from dynamics.errors import ConfigError, DataError, ModelError
from dynamics.learned.data.transitions import Transitions
from dynamics.learned.models.linear import ModelConfig
from dynamics.learned.training.fit import FitConfig, fit
from dynamics.learned.training.open_loop import open_loop

DATA = driving(16, 30)
FRESH = driving(10, 20, seed=9)
SMALL = ModelConfig(members=2, hidden=(16, 16))
NAMES = ("loss/train", "loss/held_out")
SHORT = FitConfig(epochs=60, finish_epochs=4, batch=64)


@pytest.fixture(scope="module")
def fitted():
    return fit(DATA, SMALL, SHORT)


def test_a_fitted_model_predicts_unseen_driving_at_unseen_places(fitted):
    """A prediction of no motion would be off by the travelled distance; the network was trained on neither episode."""
    states, _, after = FRESH.sequences(15)
    gone = np.median(np.hypot(*(after[:, -1, :2] - states[:, :2]).T))
    error = open_loop(fitted.model, FRESH, 15)
    assert error.position.shape == (len(states), 15)
    assert error.median[0] < 0.02
    assert error.median[-1] < min(0.2, 0.1 * gone)
    assert (error.quantile(0.95) >= error.median).all()


def test_the_same_seeds_give_the_same_weights(fitted):
    again = fit(DATA, SMALL, SHORT)
    for name, weights in fitted.model.state_dict().items():
        assert torch.equal(weights, again.model.state_dict()[name]), name
    other = fit(DATA, replace(SMALL, seed=1), SHORT)
    assert not torch.equal(other.model.networks[0].weights[0], fitted.model.networks[0].weights[0])


def test_the_kept_weights_are_those_of_the_best_check(fitted):
    one_step = [check for epoch, _, check in fitted.history if epoch <= 60]
    config = replace(SHORT, finish_epochs=0)
    only = fit(DATA, SMALL, config)
    assert [check for _, _, check in only.history] == pytest.approx(one_step)
    states, actions, after = only.held_out.sequences(1)
    # A constant rate that is too high ends far from its best.
    wild = fit(DATA, SMALL, replace(config, rate=0.2, constant_rate=True))
    checks = [check for _, _, check in wild.history]
    assert checks[-1] > min(checks)
    error = np.square(wild.model.step(states, actions[:, 0]) - after[:, 0]).mean()
    assert np.isfinite(error)
    assert error < np.square(states - after[:, 0]).mean()


def test_training_stops_without_improvement():
    stopped = fit(DATA, SMALL, replace(SHORT, epochs=1000, rate=0.5, constant_rate=True, patience=2, finish_epochs=0))
    assert stopped.history[-1][0] < 1000


def test_training_further_starts_from_the_weights_and_leaves_the_first_alone(fitted):
    before = {name: part.clone() for name, part in fitted.model.state_dict().items()}
    further = fit(DATA + FRESH, fitted.model, replace(SHORT, epochs=5, rate=1e-3, finish_epochs=0))
    assert further.history[0][2] < 10 * fitted.history[11][2]
    for name, part in fitted.model.state_dict().items():
        assert torch.equal(part, before[name]), name
    assert torch.equal(further.model.mean, fitted.model.mean)
    assert not any(parameter.requires_grad for parameter in further.model.parameters())


def test_the_held_out_episodes_are_never_trained_on():
    config = replace(SHORT, epochs=5, finish_epochs=0)
    clean = fit(DATA, SMALL, config)
    out = np.isin(DATA.episodes, np.unique(clean.held_out.episodes))
    assert {len(clean.train), len(clean.held_out)} == {np.sum(~out), np.sum(out)}
    actions = np.where(out[:, None], 0.0, DATA.actions)
    changed = Transitions(DATA.states, actions, DATA.next_states, DATA.episodes, DATA.dt)
    dirty = fit(changed, SMALL, config)
    losses = ([train for _, train, _ in f.history] for f in (clean, dirty))
    assert next(losses) == next(losses)
    assert clean.history[-1][2] != dirty.history[-1][2]


def test_the_number_of_torch_threads_is_left_as_it_was():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        fit(driving(3, 8), SMALL, FitConfig(epochs=1, finish_epochs=0))
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)


def test_data_that_do_not_fit_the_model_are_refused():
    with pytest.raises(DataError, match=r"takes widths \(6, 3\), the data have \(6, 2\)"):
        fit(DATA, replace(SMALL, action_dim=3), SHORT)
    with pytest.raises(DataError, match=r"take 0\.1 s, the data's 0\.2 s"):
        fit(DATA, replace(SMALL, dt=0.1), SHORT)
    with pytest.raises(DataError, match="two episodes"):
        fit(driving(1), SMALL, SHORT)
    with pytest.raises(DataError, match="needs 5 transitions in a row"):
        fit(driving(6, 3), SMALL, SHORT)


def test_a_diverging_training_is_an_error():
    with pytest.raises(ModelError, match="diverged"):
        fit(DATA, SMALL, replace(SHORT, rate=1e30, constant_rate=True))


def test_a_missing_tensorboard_is_an_error_before_training(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    with pytest.raises(ConfigError, match="TensorBoard is not installed"):
        fit(DATA, SMALL, SHORT, tensorboard="anywhere")


def test_losses_go_to_tensorboard(monkeypatch):
    """TensorBoard itself is an extra: a stand-in for its writer."""
    notes = []

    class Writer:
        def __init__(self, folder):
            notes.append(folder)

        def add_scalar(self, name, value, epoch):
            notes.append((name, value, epoch))

        def close(self):
            notes.append("closed")

    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", SimpleNamespace(SummaryWriter=Writer))
    done = fit(driving(3, 8), SMALL, FitConfig(epochs=10, finish_epochs=2), tensorboard="there")
    assert (notes[0], notes[-1]) == ("there", "closed")
    want = [(name, loss, e) for e, *both in done.history for name, loss in zip(NAMES, both, strict=True)]
    assert notes[1:-1] == want
    assert [e for e, _, _ in done.history] == [5, 10, 12]


def test_a_progress_bar_is_shown_on_request(capsys):
    fit(driving(3, 8), SMALL, FitConfig(epochs=2, finish_epochs=0), progress=True)
    assert "fit: 100%" in capsys.readouterr().err
    fit(driving(3, 8), SMALL, FitConfig(epochs=2, finish_epochs=0))
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    "change",
    [{"horizon": 0}, {"epochs": 0, "finish_epochs": 0}, {"rate": 0.0}, {"batch": 0}, {"patience": 0}, {"epochs": -1}],
)
def test_invalid_training_settings_are_refused(change):
    with pytest.raises(ConfigError, match="positive"):
        FitConfig(**change)


def test_an_open_loop_needs_episodes_long_enough(fitted):
    with pytest.raises(DataError, match="no episode has 40 transitions"):
        open_loop(fitted.model, DATA, 40)
