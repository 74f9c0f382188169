"""`shield dynamics`: a small model is fitted, stored, tested and drawn; errors are reported before any driving."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import dynamics.learned.training.variants as variants
from dynamics.errors import ConfigError, ShieldError
from dynamics.learned.data.transitions import Transitions
from dynamics.learned.models.files import load_model, read_config
from dynamics.learned.models.linear import ModelConfig
from dynamics.learned.training.fit import FitConfig
from dynamics.learned.training.fit import fit as original
from dynamics.learned.training.on_policy_rounds import RoundsConfig
from dynamics.learned.training.open_loop import OpenLoop
from dynamics.learned.training.variants import VARIANTS, LearningVariant, variant
from evaluation.commands.cli import app
from evaluation.measuring.dynamics_study import HORIZON, ModelTest, errors, study
from evaluation.report.error_curves import plot_errors

TINY = LearningVariant(
    "small",
    ModelConfig(members=1, hidden=(16, 16)),
    FitConfig(epochs=60, finish_epochs=0, batch=64),
    RoundsConfig(transitions=200, rounds=1, per_round=60),
)


def shield(*words: object):
    return CliRunner().invoke(app, ["dynamics", *map(str, words)])


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dynamics") / "model"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(variants, "VARIANTS", {"rounds": TINY})
        result = shield("fit", "--seed", 3, "--output", folder)
    assert result.exit_code == 0, result.output
    return folder, result.output


def test_fit_writes_a_model_with_its_data_and_says_how_good_it_is(model):
    folder, output = model
    data = Transitions.load(folder / "transitions.npz")
    assert len(data) == 260
    assert load_model(folder).config == replace(TINY.model, seed=3)
    assert read_config(folder)["notes"]["transitions"] == 260
    assert re.search(r"│ 1 +│ 260 +│", output)
    assert f"wrote {folder}" in output.replace("\n", "")


def test_evaluate_tests_a_stored_model_on_fresh_driving(model, tmp_path):
    folder, _ = model
    table = tmp_path / "errors.csv"
    result = shield("evaluate", "--model", folder, "--transitions", 60, "--output", table, "--markdown")
    assert result.exit_code == 0, result.output
    (row,) = pd.read_csv(table).to_dict("records")
    assert 0 < row["random_1"] < row["random_15"] < 5
    assert row["on_policy_15"] <= row["on_policy_15_p95"]
    assert f"{row['random_15']:.3f}" in result.output


def test_plot_draws(model, tmp_path):
    folder, _ = model
    picture = tmp_path / "a" / "errors.png"
    result = shield("plot", picture, "--model", folder, "--transitions", 60)
    assert result.exit_code == 0, result.output
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["fit", "--env", "highway-v0"], "can be learned in parking-v0"),
        (["fit", "--variant", "best"], "unknown variant 'best'; have notebook"),
        (["fit", "--transitions", 0], "must be positive"),
        (["evaluate", "--variant", "best"], "unknown variant"),
        (["evaluate", "--variant", "body", "--model", "x"], "either --variant or --model"),
        (["evaluate", "--output", "errors.xlsx"], "must end in"),
        (["evaluate", "--model", "nowhere"], "nowhere is no model"),
        (["plot", "errors.gif"], "a plot is written as"),
    ],
)
def test_an_invalid_argument_is_refused_with_its_reason(words, message):
    result = shield(*words)
    assert isinstance(result.exception, ShieldError)
    assert message in str(result.exception)


@pytest.mark.slow
def test_a_study_tests_all_on_the_same_driving_and_fits_nothing_twice(monkeypatch):
    first = replace(TINY, data=replace(TINY.data, rounds=0))
    other = replace(first, model=replace(TINY.model, form="plain"))
    apart = replace(first, data=RoundsConfig(transitions=150, rounds=0))
    monkeypatch.setattr(variants, "VARIANTS", {"first": first, "other": other, "apart": apart, "rounds": TINY})
    fits = []
    for module in ("dynamics.learned.training.on_policy_rounds", "evaluation.measuring.dynamics_study"):
        monkeypatch.setattr(f"{module}.fit", lambda *a, **k: fits.append(len(a[0])) or original(*a, **k))
    (trials,) = study(("first", "other", "apart", "rounds"), (1,), transitions=60)
    # Rounds 0 and 1 of the default, then the two that are something else.
    assert fits == [200, 260, 200, 150]
    assert [(t.name, t.seed, t.transitions) for t in trials] == [
        ("first", 1, 200),
        ("other", 1, 200),
        ("apart", 1, 150),
        ("rounds", 1, 260),
        ("true bicycle", 1, 0),
    ]
    assert len({t.random.position.shape for t in trials}) == len({t.on_policy.position.shape for t in trials}) == 1
    assert max(trials[-1].random.position.max(), trials[-1].on_policy.position.max()) < 1e-3
    medians = [t.random.median[-1] for t in trials]
    assert len(set(medians)) == 5


def test_a_stopped_evaluation_is_continued(monkeypatch, tmp_path):
    monkeypatch.setattr(variants, "VARIANTS", {"a": TINY, "b": TINY})
    asked = []

    def pretend(names, seeds, *rest):
        for seed in seeds:
            asked.append(seed)
            if seed == 2 and asked == [0, 1, 2]:
                raise KeyboardInterrupt
            yield [_trial(name, seed, 0.1 * (seed + 1)) for name in (*names, "true bicycle")]

    monkeypatch.setattr("evaluation.measuring.dynamics_study.study", pretend)
    table = tmp_path / "errors.csv"
    assert shield("evaluate", "--seeds", 3, "--output", table).exit_code != 0
    assert len(pd.read_csv(table)) == 6
    result = shield("evaluate", "--seeds", 3, "--output", table, "--markdown")
    assert result.exit_code == 0, result.output
    assert asked == [0, 1, 2, 2]
    assert "| a | 100 | 1.0 | 0.200 |" in result.output  # the median of 0.1, 0.2 and 0.3
    for words in (["--variant", "a"], ["--transitions", 100]):
        result = shield("evaluate", "--output", table, *words)
        assert "other models or tests" in str(result.exception)
    table.write_text("x,y\n1,2\n")
    assert "no table of this command" in str(shield("evaluate", "--output", table).exception)


def _trial(name: str, seed: int, scale: float) -> ModelTest:
    error = scale * np.outer(np.ones(5), np.arange(1, HORIZON + 1))
    return ModelTest(name, seed, 100, 1.0, OpenLoop(error), OpenLoop(2 * error))


def test_the_table_has_the_errors_after_one_and_all_decisions():
    (row,) = errors([_trial("a", 0, 0.1)]).to_dict("records")
    assert row["random_1"] == pytest.approx(0.1)
    assert row[f"on_policy_{HORIZON}"] == pytest.approx(3.0)


def test_a_picture_of_another_kind_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="a plot is written as"):
        plot_errors([_trial("a", 0, 0.1)], tmp_path / "a.gif")


def test_every_variant_can_be_seeded_and_has_a_description():
    assert len({v.what for v in VARIANTS.values()}) == len(VARIANTS)
    for name in VARIANTS:
        seeded = variant(name).seeded(7)
        assert {seeded.model.seed, seeded.fit.seed, seeded.data.seed} == {7}
        assert variant(name).model.seed == 0
