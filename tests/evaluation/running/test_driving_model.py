"""Learned models of driving: collected, fitted, found by setting, and used for planning; a misfit is refused."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

import evaluation.running.driving_model as driving
from dynamics.errors import ConfigError, DataError, ModelError
from dynamics.learned.models.bicycle import BicycleModel
from dynamics.learned.models.casadi_steps import LearnedStep
from dynamics.learned.models.files import load_model
from dynamics.learned.tasks.driving_state import RandomDriver, state
from dynamics.vehicle.actuators import Actuators
from evaluation.commands.cli import app
from evaluation.running.driving_model import (
    BUNDLED,
    collect_driving,
    driving_model,
    load_driving,
    measure,
    train_driving,
)
from evaluation.running.episodes import run_episode, run_paired
from evaluation.running.records import make_variants
from evaluation.settings import get_setting

FAST = "highway-fast-continuous"
WIDE = Actuators(acceleration=(-10.0, 5.0))


@given(st.floats(0, 39), st.floats(-3, 3), st.integers(1, 8), st.integers(0, 999))
@settings(max_examples=60, deadline=None)
def test_random_driving_stays_between_standstill_and_top_speed(speed, heading, hold, seed):
    driver = RandomDriver(WIDE, 0.2, np.random.default_rng(seed), hold)
    x = np.array([0.0, 0, speed * np.cos(heading), speed * np.sin(heading), np.cos(heading), np.sin(heading)])
    model = BicycleModel(WIDE, 0.2, 1)
    for k in range(30):
        action, _ = driver.predict([x], episode_start=np.array([k == 0]))
        assert action.shape == (2,)
        assert np.abs(action).max() <= 1
        x = model.step(x[None], action[None])[0]
        assert -1e-3 <= x[2] * x[4] + x[3] * x[5] <= 39 + 1e-3


def test_random_drivers_and_states_that_cannot_be_are_refused():
    with pytest.raises(DataError, match="cos_h"):
        state(np.zeros((5, 5)))
    with pytest.raises(ConfigError, match="throttle and steering"):
        RandomDriver(Actuators(lateral=False), 0.2, np.random.default_rng(0))
    with pytest.raises(ConfigError, match="hold must"):
        RandomDriver(WIDE, 0.2, np.random.default_rng(0), hold=0)


def test_driving_is_collected_at_highway_speeds_and_the_same_for_a_seed():
    one, two = (collect_driving(FAST, 1, 150, seed=3) for _ in range(2))
    assert one[0].states.tobytes() == two[0].states.tobytes()
    assert one[1] == WIDE
    speed = np.hypot(one[0].states[:, 2], one[0].states[:, 3])
    assert speed.max() > 20
    exact = BicycleModel(WIDE, 0.2, 1).step(one[0].states, one[0].actions)
    np.testing.assert_allclose(one[0].next_states, exact, atol=2e-3)


@pytest.mark.parametrize(("frequency", "frames", "setting"), [(5, 1, FAST), (20, 4, "highway-continuous")])
def test_the_bundled_models_predict_fresh_driving(frequency, frames, setting):
    model = load_model(BUNDLED / f"driving-{frequency}hz-{frames}")
    error = measure(model, setting, frames, WIDE, 300)
    assert error.median[0] < 0.01
    assert error.median[-1] < 0.4
    # A car that goes on as it is would be somewhere else: the test can fail.
    data, _ = collect_driving(setting, frames, 300, 900_001)
    still = data.states[:, :2] + frames / frequency * data.states[:, 2:4]
    assert np.median(np.linalg.norm(still - data.next_states[:, :2], axis=1)) > 5 * error.median[0]


def test_a_small_fit_is_written_found_and_its_steps_are_of_the_right_durations(tmp_path, monkeypatch):
    monkeypatch.setattr(driving, "_FIT", {"epochs": 3, "finish_epochs": 0})
    trained = list(train_driving("highway-continuous", 1, tmp_path, 450))
    assert [t.name for t in trained] == ["driving-20hz-1", "driving-20hz-4"]
    assert [step.dt for step in load_driving(20, tmp_path).steps] == pytest.approx([0.2, 0.05])
    assert LearnedStep.load(tmp_path / "driving-20hz-4").actuators == WIDE
    assert trained[0].model.config.seed == 1


def test_an_unavailable_model_is_refused_with_the_reason(tmp_path):
    env = get_setting("highway-fast").make()
    with pytest.raises(ConfigError, match=r"DiscreteMetaAction.*highway-fast-continuous"):
        next(train_driving("highway-fast"))
    assert driving_model(None, env) is driving_model("bicycle", env) is None
    with pytest.raises(ConfigError, match="unknown model 'best'; have bicycle, learned"):
        driving_model("best", env)
    odd = gym.make("highway-v0", config={"simulation_frequency": 15})
    with pytest.raises(ModelError, match=r"15 simulation frames.*driving-20hz-1.*fit --setting"):
        driving_model("learned", odd)
    with pytest.raises(ModelError, match="have none"):
        load_driving(5, tmp_path)


def test_mpc_drives_on_the_learned_model_and_is_reported_so():
    short = get_setting(FAST).override({"duration": 3}, "short")
    exact, learned = (run_episode(short, "mpc", seed=5001, model=model) for model in ("bicycle", "learned"))
    assert (exact.policy, learned.policy) == ("mpc", "mpc-learned")
    assert not learned.crashed
    assert not learned.off_road
    assert learned.mean_speed > 20
    assert learned.return_ != exact.return_  # it is another model indeed
    assert learned.return_ == pytest.approx(exact.return_, rel=0.2)


def test_a_model_without_a_user_is_refused():
    with pytest.raises(ConfigError, match="none of the two drives"):
        run_paired(FAST, "idle", make_variants(["none"], ["env"]), [1], model="learned")
    short = get_setting(FAST).override({"duration": 1}, "short")
    (row,) = run_paired(short, "idle", make_variants(["full"], ["env"]), [1], model="learned").to_dict("records")
    assert (row["policy"], row["crashed"]) == ("idle-learned", False)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["fit", "--setting", FAST, "--rounds", "1"], "not with rounds"),
        (["fit", "--setting", FAST, "--env", "parking-v0"], "not with env"),
        (["fit", "--setting", "nowhere"], "unknown setting"),
        (["export", "nowhere.npz", "a-v0"], "no file"),
    ],
)
def test_the_command_names_the_invalid_argument(words, message):
    result = CliRunner().invoke(app, ["dynamics", *words])
    assert message in str(result.exception)


@pytest.mark.slow
def test_the_command_fits_and_measures(tmp_path, monkeypatch):
    monkeypatch.setattr(driving, "_FIT", {"epochs": 3, "finish_epochs": 0})
    words = ["dynamics", "fit", "--setting", FAST, "--transitions", "120", "--output", str(tmp_path)]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    assert result.output.count("│ true") == 1
    assert (tmp_path / "driving-5hz-1" / "weights.pt").is_file()
