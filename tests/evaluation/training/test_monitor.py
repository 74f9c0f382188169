"""Safety monitors: labels of the simulator, calibration, measures, and training that learns."""

from __future__ import annotations

import gymnasium as gym
import highway_env  # noqa: F401
import numpy as np
import pytest
import torch

from dynamics.world_model.monitor import MonitorConfig, SafetyMonitor
from evaluation.training.monitor import (
    MIRRORED_ACTIONS,
    MonitorTraining,
    auroc,
    calibrated,
    calibration_error,
    conformal_threshold,
    false_alarms_at,
    filtered_driver,
    fit,
    grade,
    named_driver,
)
from evaluation.training.monitor_rounds import MonitorRounds, train_monitor
from evaluation.training.safety_labels import LabelledHighways, gather, gather_episodes
from shield import ShieldConfig, ShieldedEnv
from shield.errors import ConfigError

SMALL = MonitorConfig(depth=8, embedding=32, hidden=16)


@pytest.fixture(scope="module")
def world():
    return LabelledHighways(6)


@pytest.fixture(scope="module")
def states(world):
    return gather(world, named_driver("mixed"), 60, 5)


def test_labels_are_those_of_the_filter_of_simulated_traffic(world):
    """In the first scene of an episode, where a filter has no stored plan."""
    world.seed(40)
    world.reset()
    for i, unsafe in enumerate(world.labels()):
        env = ShieldedEnv(gym.make("highway-fast-v0"), ShieldConfig.simulated_traffic())
        env.reset(seed=40 + i)
        mask = env.action_masks()
        assert (~unsafe == mask).all() or unsafe.all()


def test_episodes_are_driven_without_a_shield_and_counted_once(world):
    found, outcomes = gather_episodes(world, named_driver("faster"), 7)
    assert outcomes.crashed.any()
    assert len(found.frames) == outcomes.lengths.sum()
    for k in range(world.num_envs):
        assert found.steps[found.episodes == k].tolist() == list(range(outcomes.lengths[k]))
    before_a_crash = (found.episodes == np.flatnonzero(outcomes.crashed)[0]).nonzero()[0][-1]
    assert found.unsafe[before_a_crash, 3]


def test_the_same_seed_gives_the_same_states(world, states):
    again = gather(world, named_driver("mixed"), 60, 5)
    for one, two in zip(states, again, strict=True):
        np.testing.assert_array_equal(one, two)


def test_safe_states_are_thinned_and_unsafe_ones_kept(world, states):
    thinned = gather(world, named_driver("mixed"), 60, 5, keep_safe=0.0)
    assert len(thinned.frames) == int(states.unsafe.any(axis=1).sum())
    assert thinned.unsafe.any(axis=1).all()


def test_a_threshold_misses_no_more_than_asked():
    """Over many draws of calibration and test risks from one distribution."""
    rng, missed = np.random.default_rng(0), []
    for _ in range(300):
        risks = rng.beta(4, 1, 240)
        missed.append((risks[200:] <= conformal_threshold(risks[:200], 0.05)).mean())
    assert 0.03 < np.mean(missed) <= 0.055


def test_too_few_unsafe_actions_calibrate_no_threshold():
    with pytest.raises(ConfigError, match="needs 19 of them, not 18"):
        conformal_threshold(np.full(18, 0.5), 0.05)
    assert 0 < conformal_threshold(np.full(19, 0.5), 0.05) < 0.5


def test_measures_of_known_scores():
    scores, positive = np.array([0.1, 0.4, 0.35, 0.8]), np.array([False, False, True, True])
    assert auroc(scores, positive) == 0.75
    assert false_alarms_at(scores, positive, 0.95) == 0.5
    assert np.isnan(auroc(scores, np.ones(4, bool)))
    rng = np.random.default_rng(1)
    p = rng.random(20_000)
    assert calibration_error(p, rng.random(20_000) < p) < 0.02
    assert calibration_error(p, rng.random(20_000) < 0.5) > 0.2


def test_mirrored_actions_exchange_the_lane_changes():
    names = ["LANE_LEFT", "IDLE", "LANE_RIGHT", "FASTER", "SLOWER"]
    assert list(gym.make("highway-fast-v0").unwrapped.action_type.ACTIONS_ALL.values()) == names
    assert [names[a] for a in MIRRORED_ACTIONS] == ["LANE_RIGHT", "IDLE", "LANE_LEFT", "FASTER", "SLOWER"]


def test_training_learns_what_is_unsafe():
    states, outcomes = gather_episodes(LabelledHighways(24), named_driver("mixed"), 5)
    training = MonitorTraining(epochs=25, batch=32, rate=3e-3, mirror=False)
    monitor = calibrated(fit(SafetyMonitor(SMALL), states, training), states, 0.1)
    before, after = grade(SafetyMonitor(SMALL), states, outcomes), grade(monitor, states, outcomes)
    assert after.auroc_action > max(0.9, before.auroc_action + 0.1)
    assert after.false_pass <= 0.1
    assert after.calibration < 0.1


def test_a_crash_is_near_in_the_last_two_decisions_of_its_episode(world):
    states, outcomes = gather_episodes(world, named_driver("faster"), 7)
    near = np.zeros(len(states.steps), bool)
    for episode in np.flatnonzero(outcomes.crashed):
        near[np.flatnonzero(states.episodes == episode)[-2:]] = True
    risk = np.where(near, 4.0, -4.0)[:, None].repeat(5, axis=1)
    monitor = SafetyMonitor(SMALL)
    monitor.forward = lambda frames: torch.from_numpy(risk)
    found = grade(monitor, states._replace(frames=states.frames[:, :1, :1, :1]), outcomes)
    assert found.auroc_crash == 1.0


def test_rounds_give_a_calibrated_monitor():
    options = MonitorRounds(
        rounds=2,
        environments=6,
        steps=80,
        calibration=16,
        miss=0.1,
        round_miss=0.2,
        training=MonitorTraining(epochs=2, batch=64),
    )
    lines = []
    monitor, notes = train_monitor(options, SMALL, lines.append)
    assert len(lines) == 5
    assert len(notes["states"]) == 2
    driven = filtered_driver(monitor, named_driver("faster"))(np.zeros((2, 5, 64, 64), np.uint8), None)
    assert driven.shape == (2,)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: named_driver("fast"), "random, faster, idle, slower, mixed, not 'fast'"),
        (lambda: MonitorRounds(rounds=8), "1 to 7 rounds, not 8"),
        (lambda: MonitorRounds(miss=1.0), "between 0 and 1, not 1.0"),
    ],
)
def test_parameters_that_train_no_monitor_are_refused(make, message):
    with pytest.raises(ConfigError, match=message):
        make()
