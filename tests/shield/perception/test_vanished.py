"""A sensor that loses a vehicle within sight raises an alarm, and nothing is guaranteed while it lasts."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from policies import Always

from shield import Shield, ShieldedEnv
from shield.perception.perceiving import ObservationPerception
from shield.perception.vanished import VanishedVehicles

ROWS = {"type": "Kinematics", "vehicles_count": 15, "see_behind": True}


def made(duration=15, **config):
    return gym.make("highway-fast-v0", config={"duration": duration, "observation": ROWS, **config})


def blind_from(env, frame):
    """The sensor shows no vehicle from this simulation frame on."""
    kind, base = env.unwrapped.observation_type, env.unwrapped
    inner = kind.observe

    def observe():
        rows = inner().copy()
        if base.steps >= frame:
            rows[1:] = 0.0
        return rows

    kind.observe = observe


def without_leader(env, share, rng):
    """In a share of the frames the sensor misses the nearest vehicle ahead in the ego's lane."""
    kind, base = env.unwrapped.observation_type, env.unwrapped
    inner, last = kind.observe, [-1, False]

    def observe():
        rows = inner().copy()
        if base.steps != last[0]:
            last[:] = base.steps, rng.random() < share
        ahead = [i for i in range(1, len(rows)) if rows[i, 0] > 0.5 and rows[i, 1] > 0 and abs(rows[i, 2]) * 12 < 2]
        if last[1] and ahead:
            nearest = min(ahead, key=lambda i: rows[i, 1])
            rows = np.vstack([np.delete(rows, nearest, axis=0), np.zeros((1, rows.shape[1]), rows.dtype)])
        return rows

    kind.observe = observe


@pytest.mark.parametrize("seed", [0, 1])
def test_an_observation_that_becomes_empty_raises_an_alarm_and_ends_the_guarantee(seed):
    """The ego crashed with `guarantee` "all vehicles seen" and without an alarm."""
    env = ShieldedEnv(made(), perception="observation")
    env.reset(seed=seed)
    blind_from(env, 15)
    for k in range(10):
        *_, terminated, _, info = env.step(3)
        if k > 2:
            assert info["shield"]["guarantee"] == "none"
            assert env.frame_decisions[-1].alarm
        if terminated:
            break
    assert k > 5


@pytest.mark.parametrize("seed", range(3))
def test_a_leader_missing_in_some_frames_is_remembered(seed):
    """Once three of six episodes crashed: the ego drove into a leader that was not shown for a frame."""
    env = ShieldedEnv(made(), perception="observation")
    env.reset(seed=seed)
    without_leader(env, 0.15, np.random.default_rng(seed))
    alarms, over = 0, False
    while not over:
        *_, terminated, truncated, info = env.step(3)
        over = terminated or truncated
        alarmed = any(decision.alarm for decision in env.frame_decisions)
        assert not alarmed or info["shield"]["guarantee"] == "none"
        alarms += alarmed
        assert not terminated
    assert alarms > 0


@pytest.mark.parametrize(
    "config", [{}, {"vehicles_density": 2, "vehicles_count": 40}, {"observation": {"type": "Kinematics"}}]
)
def test_a_working_sensor_raises_no_alarm(config):
    """A vehicle that leaves sight at an edge, or has no row left, has not vanished."""
    env = ShieldedEnv(made(**{"duration": 20, **config}), perception="observation")
    for seed in range(2):
        env.reset(seed=seed)
        over = False
        while not over:
            *_, terminated, truncated, _ = env.step(3)
            over = terminated or truncated
            assert not any(decision.alarm for decision in env.frame_decisions)


def test_a_sensor_read_once_a_decision_raises_no_alarm():
    """A second passes between two observations."""
    env = made(20)
    obs, _ = env.reset(seed=3)
    shielded = Shield(Always(3), env=env, perception="observation", frames=False)
    over = False
    while not over:
        action, _ = shielded.predict(obs)
        assert not shielded.last_decision.alarm
        obs, _, terminated, truncated, _ = env.step(action)
        over = terminated or truncated


def test_an_empty_road_has_no_full_guarantee():
    """No vehicle was shown since the reset, so whether the sensor works is unknown."""
    env = ShieldedEnv(made(vehicles_count=0), perception="observation")
    env.reset(seed=0)
    *_, info = env.step(3)
    assert info["shield"]["guarantee"] == "assumed"


def test_a_vanished_vehicle_may_be_anywhere_in_its_reachable_interval():
    """Until it is shown again, or may have left sight."""
    vanished, nobody = VanishedVehicles(), np.zeros((0, 2))
    vanished.go_on(np.array([[30.0, 4.0, 20.0]]), nobody, 0.0, (200.0, 200.0), 0.2)
    for _ in range(5):
        vanished.go_on(np.zeros((0, 3)), nobody, 0.0, (200.0, 200.0), 0.2)
    (low, high), (slow, fast) = vanished.ends[0], vanished.speeds[0]
    assert low < 30.0 + 20.0 - 3.0 + 1.0 < 30.0 + 20.0 + 3.0 - 1.0 < high
    assert slow <= 14.0
    assert fast >= 26.0
    assert vanished.states(0.0)[0].tolist() == [low, 4.0, slow, 0.0]
    assert vanished.states(100.0)[0].tolist() == [high, 4.0, fast, 0.0]
    vanished.go_on(np.zeros((0, 3)), np.array([[55.0, 4.5]]), 0.0, (200.0, 200.0), 0.2)
    assert len(vanished) == 0
    vanished.go_on(np.array([[196.0, 4.0, 20.0]]), nobody, 0.0, (200.0, 200.0), 0.2)
    assert len(vanished) == 0


def test_a_reset_forgets_vanished_vehicles():
    """The next episode begins without an alarm."""
    env = ShieldedEnv(made(), perception="observation")
    env.reset(seed=0)
    blind_from(env, 10)
    for _ in range(4):
        env.step(1)
    assert isinstance(env.filter.reader.perception, ObservationPerception)
    assert len(env.filter.reader.perception.vanished) > 0
    env.reset(seed=1)
    env.step(1)
    assert not env.last_decision.alarm
