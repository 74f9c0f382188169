"""Multilevel splitting against known probabilities, and noise that is redrawn from some decision on."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom
from slowly import later
from typer.testing import CliRunner

from evaluation.commands.cli import app
from evaluation.falsification.sensor_noise_crashes import NoisyEpisodes, crash_probability_through
from evaluation.falsification.splitting import SplitPath, multilevel_splitting
from evaluation.running.driver import DriverSpec
from evaluation.running.episodes import run_episode
from evaluation.running.records import ShieldVariant
from evaluation.settings import get_setting
from shield import ConfigError, ShieldConfig

SEEN = get_setting("highway-fast-seen")
STEPS = 20


def drawn(path, steps):
    """The sum of the steps of a path, each drawn by the last fork before it."""
    forks = sorted({1: path.seed, **dict(path.forks)}.items())
    ends = [*(k for k, _ in forks[1:]), STEPS + 1]
    parts = [steps(np.random.default_rng(seed), end - k) for (k, seed), end in zip(forks, ends, strict=True)]
    return np.cumsum([0.0, *np.concatenate(parts)])


def coins(paths):
    return [drawn(path, lambda rng, n: 2.0 * rng.integers(2, size=n) - 1.0) for path in paths]


def normals(paths):
    return [drawn(path, lambda rng, n: rng.standard_normal(n)) for path in paths]


def of_coins(b):
    """P(max >= b) of a walk of coins, by reflection."""
    return sum(binom.pmf(k, STEPS, 0.5) * ((2 * k - STEPS >= b) + (2 * k - STEPS > b)) for k in range(STEPS + 1))


def of_normals(b, cells=4001, least=-40.0):
    """P(max >= b) of a walk of normal steps, by convolution on a grid of the paths below b."""
    x, dx = np.linspace(least, b, cells, endpoint=False, retstep=True)
    x = x + dx / 2
    step = np.exp(-0.5 * (dx * np.arange(-cells + 1, cells)) ** 2) * dx / np.sqrt(2 * np.pi)
    left = np.exp(-0.5 * x**2) / np.sqrt(2 * np.pi)
    for _ in range(STEPS - 1):
        left = np.convolve(left, step, mode="same" if len(step) == cells else "valid")
    return 1 - left.sum() * dx


@pytest.mark.parametrize(
    ("walk", "b", "truth", "share"),
    [
        (coins, 14, of_coins(14), 0.01),
        (coins, 14, of_coins(14), 0.3),
        (normals, 15.0, of_normals(15.0), 0.3),
        *later((normals, 15.0, of_normals(15.0), 0.01)),
    ],
)
def test_the_splitting_estimate_is_unbiased(walk, b, truth, share):
    found = [multilevel_splitting(walk, b, 100, share, seed=1000 * k) for k in range(20)]
    estimates = np.array([each.probability for each in found])
    error = estimates.std() / np.sqrt(len(found))
    assert error < 0.3 * truth
    assert abs(estimates.mean() - truth) < 3 * error


def test_a_common_event_is_counted():
    found = multilevel_splitting(coins, 0.0, 50, seed=3)
    assert found.probability == 1.0
    assert found.evaluations == 50
    assert found.levels == ()


def test_paths_that_are_level_are_dropped_together():
    found = multilevel_splitting(lambda paths: [np.zeros(3) for _ in paths], 1.0, 20, seed=0)
    assert found.probability == 0.0
    assert found.dropped == (20,)
    assert found.variation == np.inf


def test_the_last_paths_lead_where_they_say():
    found = multilevel_splitting(normals, 10.0, 60, 0.2, seed=5)
    assert (np.diff(found.reached) <= 0).all()
    assert np.array_equal([each.max() for each in normals(found.paths)], found.reached)
    assert any(path.forks for path in found.paths)
    assert list(found.levels) == sorted(found.levels)


def test_a_fork_keeps_the_noise_before_it():
    path = SplitPath(7).fork(5, 11).fork(9, 12)
    assert path.fork(6, 13).forks == ((5, 11), (6, 13))
    before, after = normals([path, path.fork(6, 13)])
    assert np.array_equal(before[:6], after[:6])
    assert not np.array_equal(before[6:], after[6:])


@pytest.mark.parametrize(
    ("paths", "share", "drive"),
    [
        (1, 0.1, coins),
        (10, 0.0, coins),
        (10, 1.0, coins),
        (10, 0.1, lambda paths: [np.zeros(3)]),
        (10, 0.1, lambda paths: [np.full(3, np.nan) for _ in paths]),
        (10, 0.1, lambda paths: [np.zeros(0) for _ in paths]),
    ],
)
def test_numbers_that_do_not_fit_are_refused(paths, share, drive):
    with pytest.raises(ConfigError):
        multilevel_splitting(drive, 8.0, paths, share)


def test_noise_is_drawn_anew_from_a_decision_on():
    episodes = NoisyEpisodes(
        DriverSpec(SEEN, "faster", ShieldVariant("env", ShieldConfig(), "observation"), sensor="metric-2")
    )
    first, forked = episodes.drive(SplitPath(4)), episodes.drive(SplitPath(4, ((9, 1),)))
    assert np.array_equal(first, episodes.drive(SplitPath(4)))
    assert np.array_equal(first[:9], forked[:9])
    assert not np.array_equal(first, forked)
    episodes.close()


def test_an_episode_is_that_of_the_evaluation():
    variant = ShieldVariant("env", ShieldConfig(), "observation")
    episodes = NoisyEpisodes(DriverSpec(SEEN, "faster", variant, sensor="metric-2"))
    scores = episodes.drive(SplitPath(4))
    record = run_episode(SEEN, "faster", variant, seed=4, sensor="metric-2")
    assert len(scores) == record.steps + 1
    assert (scores.max() == 0) == record.crashed
    episodes.close()


def test_the_rate_of_crashes_is_that_of_counting():
    found = crash_probability_through(DriverSpec(SEEN, "faster", ShieldVariant(), sensor="metric-0.5"), paths=30)
    counted = [run_episode(SEEN, "faster", ShieldVariant(), seed=k, sensor="metric-0.5").crashed for k in range(30)]
    # Most crash without a shield: no path has to be split for that.
    assert found.probability == pytest.approx(np.mean(counted))
    assert found.reached[0] == 0.0


def test_an_exact_sensor_is_refused():
    with pytest.raises(ConfigError, match="noisy"):
        NoisyEpisodes(DriverSpec(SEEN, "faster", ShieldVariant()))


def test_the_command_prints_the_probability():
    args = ["rare", "--setting", "highway-fast-seen", "--sensor", "metric-0.5", "--samples", "4", "--jobs", "1"]
    done = CliRunner().invoke(app, args)
    assert done.exit_code == 0, done.output
    assert "probability" in done.output


@pytest.mark.parametrize(
    "path",
    [
        # The largest margin among bounds was a swerve into a car beside the ego, or the way up to its leader.
        SplitPath(3116, ((1, 731301565), (16, 319935010))),
        SplitPath(3131, ((4, 1276625462), (12, 1892360940), (17, 793439595))),
        # With bounds narrowed, another lane looked freer than the ego's own.
        SplitPath(3165, ((6, 3525401518), (15, 3103392660))),
        SplitPath(3086, ((13, 1735297215), (26, 2771435021))),
    ],
    ids=lambda path: str(path.seed),
)
def test_crashes_that_splitting_has_found_are_avoided(path):
    episodes = NoisyEpisodes(
        DriverSpec(SEEN, "faster", ShieldVariant("env", ShieldConfig(), "observation"), sensor="normalised-0.5")
    )
    assert episodes.drive(path).max() < 0.0
    episodes.close()
