"""The required number of episodes is the least after which the interval supports the statement."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from typer.testing import CliRunner

from evaluation.commands.cli import app
from evaluation.measuring.sample_size import POWER, episodes_to_tell_apart, episodes_without_a_crash
from evaluation.measuring.statistics import clopper_pearson
from shield.errors import ConfigError


@given(rate=st.floats(1e-5, 0.5))
def test_the_required_number_without_a_crash_is_minimal(rate):
    n = episodes_without_a_crash(rate)
    assert clopper_pearson(0, n).high <= rate * (1 + 1e-9)
    if n > 1:
        assert clopper_pearson(0, n - 1).high > rate * (1 - 1e-9)


@pytest.mark.parametrize(("one", "other"), [(0.3, 0.1), (0.05, 0.02), (0.5, 0.4)])
def test_the_required_number_detects_the_difference_with_the_stated_power(one, other):
    n, rng = episodes_to_tell_apart(one, other), np.random.default_rng(0)
    first, second = rng.binomial(n, one, 20_000) / n, rng.binomial(n, other, 20_000) / n
    mean = 0.5 * (first + second)
    z = np.abs(first - second) / np.sqrt(2 * mean * (1 - mean) / n)
    assert (z > stats.norm.ppf(0.975)).mean() == pytest.approx(POWER, abs=0.03)


def test_the_command_prints_both_numbers_and_refuses_invalid_rates():
    said = CliRunner().invoke(app, ["episodes", "--rate", "1e-3", "--versus", "0.01"])
    assert said.exit_code == 0
    assert "2,995 episodes without a crash" in said.output
    assert "tell 0.001 and 0.01 apart" in " ".join(said.output.split())
    with pytest.raises(ConfigError, match="between 0 and 1"):
        episodes_without_a_crash(0.0)
    with pytest.raises(ConfigError, match="cannot be told apart"):
        episodes_to_tell_apart(0.1, 0.1)
