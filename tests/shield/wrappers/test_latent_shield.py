"""`LatentShield`: actions that the monitor accepts pass; others are replaced by the preferred accepted one, or by the
least risky one."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from shield.errors import ConfigError, PolicyError
from shield.wrappers.latent_shield import LatentShield, filtered_actions

RISKS = st.integers(1, 6).flatmap(lambda n: arrays(float, (n, 4), elements=st.floats(0, 1) | st.just(float("nan"))))


class Policy:
    """Proposes one action, and has preferences."""

    def __init__(self, action, scores=None):
        self._action, self._scores = action, scores

    def predict(self, obs, state=None, episode_start=None, deterministic=False):
        single = np.ndim(obs) == 1
        return (self._action if single else np.full(len(obs), self._action)), state

    def action_scores(self, obs):
        return None if self._scores is None else np.tile(self._scores, (len(obs), 1))


def monitor(*risks, threshold=0.1):
    return SimpleNamespace(
        probabilities=lambda obs: np.tile(np.array(risks), (len(obs), 1)), config=SimpleNamespace(threshold=threshold)
    )


@given(RISKS, st.integers(0, 3), st.floats(0.01, 0.99), st.booleans())
def test_the_executed_action_is_accepted_where_any_is(risks, action, threshold, preferred):
    known = np.nan_to_num(risks, nan=1.0)
    proposed = np.full(len(risks), action)
    scores = np.random.default_rng(0).normal(size=risks.shape) if preferred else None
    executed = filtered_actions(risks, proposed, scores, threshold)
    for row, one in zip(known, executed, strict=True):
        if row[action] <= threshold:
            assert one == action
        elif (row <= threshold).any():
            assert row[one] <= threshold
        else:
            assert row[one] == row.min()


def test_the_preferred_accepted_action_replaces_a_refused_one():
    shielded = LatentShield(Policy(3, [0.2, 0.9, 0.5, 1.0]), monitor(0.05, 0.5, 0.09, 0.8))
    action, _ = shielded.predict(np.zeros(2))
    assert action == 2
    decision = shielded.decisions[0]
    assert (decision.proposed, decision.executed, decision.overridden, decision.fallback) == (3, 2, True, False)
    assert (decision.risk_proposed, decision.risk_executed) == (0.8, 0.09)


def test_without_preferences_the_least_risky_action_replaces_a_refused_one():
    assert LatentShield(Policy(3), monitor(0.05, 0.5, 0.04, 0.8)).predict(np.zeros(2))[0] == 2


def test_the_least_risky_action_is_a_fallback_where_none_is_accepted():
    shielded = LatentShield(Policy(3, [0, 0, 1, 2]), monitor(0.6, 0.5, 0.9, 0.8))
    assert shielded.predict(np.zeros((2, 2)))[0].tolist() == [1, 1]
    assert [each.fallback for each in shielded.decisions] == [True, True]


def test_an_accepted_proposal_passes():
    shielded = LatentShield(Policy(0), monitor(0.05, 0.5, 0.01, 0.8))
    assert shielded.predict(np.zeros(2))[0] == 0
    assert not shielded.decisions[0].overridden


@pytest.mark.parametrize("threshold", [0.0, 1.0, 2.0])
def test_a_threshold_outside_of_0_and_1_is_refused(threshold):
    with pytest.raises(ConfigError, match="threshold of a LatentShield is between 0 and 1"):
        LatentShield(Policy(0), monitor(0.1), threshold)


@pytest.mark.parametrize("action", [4, -1, 0.5])
def test_an_action_that_the_monitor_does_not_know_is_refused(action):
    with pytest.raises(PolicyError, match="one action from 0 to 3 for each of 1 observations"):
        LatentShield(Policy(action), monitor(0.1, 0.2, 0.3, 0.4)).predict(np.zeros(2))
