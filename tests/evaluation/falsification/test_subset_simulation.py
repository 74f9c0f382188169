"""Subset simulation against known probabilities, and finds that are replayed in highway-env."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.stats import norm
from slowly import later
from typer.testing import CliRunner

from dynamics.highway_simulator.simulator import Simulator
from dynamics.traffic.assumptions import Assumptions
from evaluation.commands.cli import app
from evaluation.falsification.compliant_traffic import drive_compliant
from evaluation.falsification.falsify import crash_probability, falsify, falsify_among
from evaluation.falsification.finds import ANY, Find, replay
from evaluation.falsification.strata import Strata, stratified
from evaluation.falsification.subset_simulation import subset_simulation
from evaluation.running.batch_episodes import Many
from evaluation.settings import Setting, get_setting
from shield import ConfigError, ShieldConfig
from shield.config import Buffer

FAST = get_setting("highway-fast")
BARE = ShieldConfig(mode="none")


def side(beta):
    """The half-space with the probability of a standard normal beyond beta."""
    return lambda x: beta - x.sum(axis=1) / np.sqrt(x.shape[1])


@pytest.mark.parametrize(("beta", "spread"), [(2.0, 0.15), (3.719, 0.3), (4.5, 0.4)])
def test_the_subset_estimate_is_unbiased(beta, spread):
    found = [subset_simulation(side(beta), 50, 2000, seed=seed) for seed in range(40)]
    estimates, truth = np.array([x.probability for x in found]), norm.sf(beta)
    error = estimates.std() / truth
    assert error < spread
    assert abs(estimates.mean() / truth - 1) < 3 * error / np.sqrt(len(found)) + 0.02
    # The stated error is a lower bound of the true one, and near to it.
    assert 0.6 < np.mean([x.variation for x in found]) / error < 1.3


def test_two_ways_to_fail_are_both_found():
    truth = norm.sf(3.5) * 2
    found = [subset_simulation(lambda x: 3.5 - np.abs(x[:, 0]), 10, 2000, seed=seed).probability for seed in range(30)]
    assert np.mean(found) == pytest.approx(truth, rel=0.2)


def test_the_levels_descend_to_zero():
    found = subset_simulation(side(4.0), 20, 1000, seed=3)
    bounds = [level.bound for level in found.levels]
    assert bounds == sorted(bounds, reverse=True)
    assert bounds[-1] == 0
    assert found.evaluations == 1000 + 900 * (len(bounds) - 1)
    assert found.probability == pytest.approx(np.prod([level.probability for level in found.levels]))
    assert found.performance[0] == found.performance.min()
    assert np.allclose(side(4.0)(found.points), found.performance)


def test_a_common_event_is_counted():
    found = subset_simulation(lambda x: x[:, 0], 2, 1000, seed=0)
    assert len(found.levels) == 1
    assert found.probability == pytest.approx(0.5, abs=0.06)


def test_an_impossible_event_has_probability_zero():
    found = subset_simulation(lambda x: 1.0 + np.abs(x[:, 0]), 2, 100, seed=0, most=500)
    assert found.probability == 0.0
    assert found.variation == np.inf
    assert found.performance[0] < 1.01


@pytest.mark.parametrize(
    ("samples", "share", "performance"),
    [(1001, 0.1, side(2)), (10, 0.1, side(2)), (100, 0.1, lambda x: x), (100, 0.1, lambda x: x[:, 0] * np.nan)],
)
def test_numbers_that_do_not_fit_are_refused(samples, share, performance):
    with pytest.raises(ConfigError):
        subset_simulation(performance, 3, samples, share)


def test_scenes_of_ones_own_choice():
    """The shares that a generator would have drawn give the scene that it gives."""
    drawn, chosen = Simulator("highway-fast-v0", 1), Simulator("highway-fast-v0", 1, replay_draws=True)
    rng, m = np.random.default_rng(0), drawn.scenario.bodies
    assert chosen.draws == 2 + 4 * (m - 1)
    shares = rng.random(chosen.draws)
    chosen.reset_to(shares[None], [0])
    f, g = chosen.worlds.f[0], chosen.worlds.g[0]
    assert g[1, 0] == int(shares[0] * 3)  # the ego's lane, of three
    assert np.array_equal(g[1, 1:], (shares[2::4] * 3).astype(int))
    np.testing.assert_allclose(f[3, 1:], 30 * (0.7 + 0.1 * shares[3::4]))
    assert np.all(np.diff(f[0]) > 0)
    # The tape is at its end; the next seed has nothing to do with it.
    chosen.reset([5])
    drawn.reset([5])
    assert np.array_equal(chosen.worlds.f, drawn.worlds.f)


def test_chosen_scenes_are_distributed_as_drawn_ones():
    setting = Setting("short", "highway-fast-v0", {"vehicles_count": 8, "duration": 8})
    many, n = Many(setting, "idle", BARE, chosen=True), 1500
    gaps, times, offences, _ = many.run_chosen(np.random.default_rng(1).random((n, many.draws)))
    rate, drawn = (gaps == 0).mean(), many.run(range(n))["crashed"].mean()
    assert abs(rate - drawn) < 4 * np.sqrt(rate * (1 - rate) * 2 / n)
    assert ((times == 0) == (gaps == 0)).all()
    assert offences.sum() == 0


def test_the_crash_rate_of_an_unshielded_policy_is_inside_the_interval():
    """Some 24 % of the bundled PPO's episodes end in a crash, by plain counting."""
    counted = Many(FAST, "ppo-highway-fast", BARE).run(range(600))["crashed"].mean()
    found = crash_probability(FAST, "ppo-highway-fast", BARE, samples=400, seed=1)
    assert abs(found.probability - counted) < 3 * np.hypot(found.probability * found.variation, 0.018)


def test_random_actions_are_drawn_anew_in_each_episode():
    """The rate by plain counting, and from scenes and actions that are drawn."""
    counted = Many(FAST, "random", BARE).run(range(600))["crashed"].mean()
    found = crash_probability(FAST, "random", BARE, samples=400, seed=1)
    error = np.hypot(np.sqrt(counted * (1 - counted) / 600), np.sqrt(counted * (1 - counted) / 400))
    assert abs(found.probability - counted) < 3 * error
    with pytest.raises(ConfigError, match="have actions="):
        Many(FAST, "random", BARE, chosen=True).run_chosen(np.full((1, 200), 0.5))


@pytest.mark.parametrize(
    "weak",
    [
        {"simultaneous_merge": False, "cut_in": False},
        pytest.param({"visible_distance": 6.0}, marks=pytest.mark.slow),
        pytest.param({"min_speed": 20.0}, marks=pytest.mark.slow),
        pytest.param({"settle_time": 0.0, "reaction_time": 0.0}, marks=pytest.mark.slow),
        pytest.param({"cut_in": False}, marks=pytest.mark.slow),
    ],
)
def test_a_weak_assumption_is_found_out(weak, tmp_path):
    setting = get_setting("abz-idm") if weak == {"cut_in": False} else FAST
    found = falsify(setting, ANY, ShieldConfig(assumptions=Assumptions(**weak)), episodes=5_000, seed=1)
    assert found.find.clearance == 0.0
    assert found.median > 1.5
    found.find.save(tmp_path / "find.json")
    again = Find.load(tmp_path / "find.json")
    assert again == found.find
    assert replay(again).clearance == 0.0


@pytest.mark.parametrize(
    "weak",
    [
        {"braking": 2.0, "comfortable_braking": 2.0},
        {"turning_loss": 0.0, "turning_action": 0.0, "turning_action_in_one_second": 0.0},
        {"acceleration": 1.0},
    ],
)
def test_an_assumption_that_the_traffic_breaks_is_detected(weak):
    """The monitor detects it without a crash: each episode has a violation, and under the defaults fewer than one in
    a hundred."""
    told = [
        falsify(FAST, ANY, ShieldConfig(assumptions=Assumptions(**x)), episodes=500, samples=500).offended
        for x in (weak, {})
    ]
    assert told[0] > 0.9
    assert told[1] < 0.01


@pytest.mark.parametrize(
    ("policy", "config", "budget"),
    [
        ("faster", ShieldConfig(), 500),
        (ANY, ShieldConfig.simulated_traffic(), 40),
        *later((ANY, ShieldConfig.simulated_traffic(), 500), ("faster", ShieldConfig.simulated_traffic(), 500)),
    ],
)
def test_a_find_is_replayed(policy, config, budget):
    found = falsify(FAST, policy, config, episodes=budget, samples=budget)
    assert 0 < found.find.clearance < found.median
    assert replay(found.find).clearance == pytest.approx(found.find.clearance, abs=1e-9)


def test_the_commands(tmp_path):
    run, find = CliRunner(), tmp_path / "find.json"
    result = run.invoke(app, ["falsify", str(find), "--policy", "weaving", "--episodes", "500"])
    assert result.exit_code == 0, result.output
    assert len(json.loads(find.read_text())["shares"]) > 10
    result = run.invoke(app, ["replay", "--find", str(find)])
    assert result.exit_code == 0, result.output
    assert "smallest clearance" in result.output
    bare = tmp_path / "bare.toml"
    BARE.save(bare)
    result = run.invoke(app, ["rare", "--policy", "slower", "--samples", "100", "--config", str(bare)])
    assert result.exit_code == 0, result.output
    assert "probability" in result.output


def test_a_file_that_is_no_find_is_refused(tmp_path):
    path = tmp_path / "find.json"
    path.write_text("{}")
    with pytest.raises(ConfigError, match="no find"):
        Find.load(path)
    with pytest.raises(ConfigError, match="at least 500"):
        falsify(FAST, ANY, ShieldConfig(), episodes=100)


def test_bold_drivers_keep_to_the_rules_and_find_nothing_in_the_default():
    met = falsify_among(FAST, ShieldConfig(), episodes=4, seed=11)
    assert (met.episodes, met.began) == (4, 4)
    assert (met.holes, met.named) == ((), 0)
    assert 0 <= met.find.clearance < 4


@pytest.mark.slow
def test_bold_drivers_find_nothing_in_the_default_for_longer():
    met = falsify_among(FAST, ShieldConfig(), episodes=150, seed=5_000)
    assert met.holes == ()


@pytest.mark.parametrize(
    ("weak", "rule"),
    [
        ({"acceleration": 1.0}, "SPEED"),
        ({"comfortable_braking": 0.5}, "BRAKING"),
        pytest.param({"marking_tolerance": 1.0}, "LANES", marks=pytest.mark.slow),
    ],
)
def test_bold_drivers_find_a_weak_assumption_out_by_the_monitor(weak, rule):
    met = falsify_among(FAST, ShieldConfig(assumptions=Assumptions(**weak)), episodes=30)
    assert rule in met.by_rule


def test_bold_drivers_find_a_loophole_and_it_is_replayed(tmp_path):
    """A shield without a distance has no violator to name."""
    run, find, none = CliRunner(), tmp_path / "find.json", tmp_path / "none.toml"
    ShieldConfig(buffer=Buffer(0.0, 0.0)).save(none)
    asked = ["falsify", str(find), "--drivers", "bold", "--episodes", "20", "--jobs", "1", "--config", str(none)]
    result = run.invoke(app, asked)
    assert result.exit_code == 1, result.output
    found = Find.load(find)
    assert found.clearance < 0
    assert replay(found) == found
    assert drive_compliant(Setting("again", found.env_id, found.config), found.seed, ShieldConfig()).clearance >= 0


def test_bold_drivers_that_do_not_fit_are_refused():
    with pytest.raises(ConfigError, match="straight highway"):
        drive_compliant(FAST, 0, BARE)
    with pytest.raises(ConfigError, match="at least 1 episode"):
        falsify_among(FAST, ShieldConfig(), episodes=0)


def of_lanes(shares):
    """How many of five others are in the ego's lane, of four."""
    lanes = (shares * 4).astype(int)
    return (lanes[:, 2::4] == lanes[:, :1]).sum(axis=1)


def test_strata_are_drawn_as_resets_draw_them():
    strata, rng = Strata(5, 4), np.random.default_rng(0)
    drawn = np.bincount(of_lanes(rng.random((40_000, 22))), minlength=6) / 40_000
    np.testing.assert_allclose(strata.probabilities, drawn, atol=0.01)
    for k in range(6):
        scenes = strata.draw(k, 500, rng)
        assert (of_lanes(scenes) == k).all()
        assert ((scenes >= 0) & (scenes < 1)).all()
    # All other vehicles are elsewhere.
    assert set(np.unique((strata.draw(0, 500, rng)[:, [0, 2, 18]] * 4).astype(int))) == {0, 1, 2, 3}


def test_counting_by_strata_is_right_on_the_average():
    def happens(shares):
        return (of_lanes(shares) >= 4) & (shares[:, 3] < 0.1)

    strata = Strata(5, 4)
    truth = 0.1 * strata.probabilities[4:].sum()
    found = [stratified(happens, strata, 200, 3000, seed) for seed in range(40)]
    estimates = np.array([x.probability for x in found])
    error = estimates.std() / truth
    assert error < 0.2
    assert abs(estimates.mean() / truth - 1) < 3 * error / np.sqrt(40)
    assert np.mean([x.error for x in found]) == pytest.approx(estimates.std(), rel=0.3)
    for each in found:
        assert each.evaluations == 1200 + each.counted.sum()
    with pytest.raises(ConfigError, match="pilot"):
        stratified(happens, strata, 0)
    with pytest.raises(ConfigError, match="2 lanes"):
        Strata(3, 1)
