"""Both wrappers in highway-env's parking lots: parked vehicles are not hit, and parking still succeeds."""

from __future__ import annotations

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from slowly import later
from stable_baselines3.common.vec_env import DummyVecEnv

from dynamics.errors import SceneError
from dynamics.scenes.parking_lot import ParkingScene, ParkingSceneReader
from evaluation.running.episodes import run_episode
from evaluation.running.records import make_variants
from evaluation.settings import SETTINGS, get_setting
from mpc.cem_policy import CEMPolicy
from shield import Shield, ShieldConfig, ShieldedEnv
from shield.errors import ConfigError
from shield.pipelines.parking_lot import ParkingLotPipeline

FULL = np.array([1.0, 0.0], dtype=np.float32)
SHORT = replace(get_setting("parking-parked"), config={"vehicles_count": 10, "duration": 6})
(BARE,) = make_variants(["none"], ["env"])
WRAPPERS = {placement: make_variants(["full"], [placement])[0] for placement in ("env", "policy")}


class Random:
    """Random inputs, with a record of the proposals."""

    def __init__(self, seed=0):
        self.rng, self.asked = np.random.default_rng(seed), []

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        self.asked.append(self.rng.uniform(-1, 1, 2).astype(np.float32))
        return self.asked[-1], state


class Always(Random):
    def __init__(self, action):
        super().__init__()
        self.action = action

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return self.action, state


def lot_env(seed=0, config=None, **changes):
    env = ShieldedEnv(gym.make("parking-v0", config={"vehicles_count": 10} | changes), config)
    env.reset(seed=seed)
    return env


@pytest.mark.parametrize("placement", WRAPPERS)
@pytest.mark.parametrize("seed", [1, *later(4)])
def test_full_throttle_crashes_without_the_shield_and_never_with_it(placement, seed):
    assert run_episode(SHORT, Always(FULL), BARE, seed=seed).crashed
    record = run_episode(SHORT, Always(FULL), WRAPPERS[placement], seed=seed)
    assert not record.crashed
    assert record.steps >= 30
    assert record.overridden > 0
    assert record.min_gap >= 0.1 - 1e-6
    assert set(record.tiers) <= {"passed", "governed", "stored_plan"}
    assert record.violations == 0


@pytest.mark.parametrize("placement", WRAPPERS)
@pytest.mark.parametrize("seed", [2, 3])
def test_random_inputs_never_hit_anything(placement, seed):
    record = run_episode(SHORT, Random(seed), WRAPPERS[placement], seed=seed)
    assert not record.crashed
    assert record.min_gap >= 0.1 - 1e-6
    assert set(record.tiers) <= {"passed", "governed", "stored_plan"}


@pytest.mark.parametrize("placement", WRAPPERS)
@pytest.mark.parametrize("name", ["parking", "parking-parked"])
def test_a_planner_parks_behind_the_shield_as_it_does_without(placement, name):
    bare, shielded = (run_episode(name, "cem-oracle", v, seed=13) for v in (BARE, WRAPPERS[placement]))
    assert bare.success
    assert shielded.success
    assert not shielded.crashed
    if shielded.overridden == 0:
        assert (shielded.return_, shielded.steps) == (bare.return_, bare.steps)


def test_an_action_that_passes_is_the_policys_own_array_and_a_planner_can_be_wrapped():
    env = gym.make("parking-v0", config={"vehicles_count": 10})
    observation, _ = env.reset(seed=11)
    policy = Random()
    shielded = Shield(policy, env)
    for _ in range(5):
        action, _ = shielded.predict(observation)
        assert action is policy.asked[-1]
        observation, *_ = env.step(action)
    planner = Shield(CEMPolicy.parking(env), env)
    assert planner.predict(observation)[0].shape == (2,)
    assert not planner.last_decision.tier.fallback


def test_frames_that_pass_are_the_environments_own():
    bare, shielded = gym.make("parking-v0"), ShieldedEnv(gym.make("parking-v0"))
    bare.reset(seed=3)
    shielded.reset(seed=3)
    for action in np.random.default_rng(0).uniform(-1, 1, (8, 2)).astype(np.float32):
        a, b = bare.step(action), shielded.step(action)
        assert not b[-1]["shield"]["overridden"]
        assert np.array_equal(a[0]["observation"], b[0]["observation"])


@pytest.mark.parametrize("clearance", [0.3, *later(1.0)])
def test_the_clearance_is_a_setting(clearance):
    env = lot_env(seed=4, config=ShieldConfig(clearance=clearance), duration=10)
    least = np.inf
    for _ in range(50):
        *_, info = env.step(FULL)
        least = min(least, info["shield"]["margin"])
        assert not info["crashed"]
    assert 0 <= least < 0.2


def test_a_parked_vehicle_that_drives_off_is_a_violator_and_the_ego_brakes():
    env = lot_env()
    for _ in range(5):
        env.step(FULL)
    other = next(v for v in env.unwrapped.road.vehicles if v is not env.unwrapped.vehicle)
    other.speed = 0.5
    *_, info = env.step(FULL)
    assert (info["shield"]["reason"], info["shield"]["tier"]) == ("bad_scene", "emergency")
    assert info["shield"]["violations"] == 1
    *_, info = env.step(FULL)
    assert info["shield"]["violations"] == 0
    assert abs(env.unwrapped.vehicle.speed) < 5.0
    other.speed = 0.0
    *_, info = env.step(FULL)
    assert info["shield"]["tier"] in ("passed", "governed")


@pytest.mark.parametrize("error", [SceneError("gone"), RuntimeError("boom")])
@pytest.mark.parametrize("way", [1, -1])
def test_a_reader_that_raises_stops_it_either_way_and_not_beyond(error, way, monkeypatch):
    env = lot_env()
    for _ in range(4):
        env.step(way * FULL)
    with monkeypatch.context() as patch:
        patch.setattr(ParkingSceneReader, "read", lambda self: (_ for _ in ()).throw(error))
        for _ in range(5):
            *_, info = env.step(way * FULL)
            assert info["shield"]["tier"] == "emergency"
            assert info["shield"]["reason"] == ("bad_scene" if isinstance(error, SceneError) else "stage_failed")
        assert abs(env.unwrapped.vehicle.speed) < 1e-9
    *_, info = env.step(way * FULL)
    assert info["shield"]["tier"] == "passed"


def test_a_stage_that_breaks_brakes(monkeypatch):
    env = lot_env()
    for _ in range(4):
        env.step(FULL)
    monkeypatch.setattr(ParkingLotPipeline, "judge", lambda *_: (_ for _ in ()).throw(ZeroDivisionError()))
    before = env.unwrapped.vehicle.speed
    *_, info = env.step(FULL)
    assert info["shield"]["reason"] == "stage_failed"
    assert 0 <= env.unwrapped.vehicle.speed < before


@pytest.mark.parametrize("bad", [np.array([np.nan, 0.0]), np.array([0.5])])
def test_a_broken_action_stops_it(bad):
    env = lot_env()
    for _ in range(4):
        env.step(FULL)
    for _ in range(6):
        *_, info = env.step(bad)
        assert info["shield"]["reason"] == "bad_action"
    assert abs(env.unwrapped.vehicle.speed) < 1e-9


def test_a_policy_that_raises_stops_every_car_of_a_batch():
    class Broken(Random):
        def predict(self, observation, state=None, episode_start=None, deterministic=False):
            raise RuntimeError("boom")

    venv = DummyVecEnv([lambda: gym.make("parking-v0")] * 2)
    observations = venv.reset()
    shielded = Shield(Broken(), venv)
    actions, _ = shielded.predict(observations)
    assert actions.shape == (2, 2)
    assert [d.reason.value for d in shielded.last_decisions] == ["policy_failed"] * 2
    assert np.array_equal(actions, np.zeros((2, 2)))  # they stand


def test_an_episode_begins_with_nothing_remembered():
    env = lot_env()
    for _ in range(5):
        env.step(FULL)
    assert env.core.memory.stored is not None
    env.reset(seed=1)
    assert env.core.memory.stored is None
    base = gym.make("parking-v0")
    observation, _ = base.reset(seed=0)
    shielded = Shield(Random(), base)
    shielded.predict(observation)
    assert shielded._filters[0].core.memory.stored is not None
    observation, _ = base.reset(seed=1)
    shielded.policy = Always(np.array([np.nan, 0.0]))
    shielded.predict(observation)
    assert shielded._filters[0].core.memory.stored is None


@pytest.mark.parametrize(
    "make",
    [ShieldedEnv, lambda env: Shield(Random(), env), lambda env: ShieldedEnv(env, ShieldConfig.simulated_traffic())],
)
def test_meta_actions_in_a_lot_are_refused(make):
    env = gym.make("parking-v0", config={"action": {"type": "DiscreteMetaAction"}})
    with pytest.raises(ConfigError, match="in a parking lot the shield filters ContinuousAction"):
        make(env)


def test_several_cars_are_refused():
    with pytest.raises(SceneError, match="one controlled vehicle, got 2"):
        ShieldedEnv(gym.make("parking-v0", config={"controlled_vehicles": 2}))


def test_actions_without_a_brake_are_refused_unless_every_frame_is_supervised():
    config = {"action": {"type": "ContinuousAction", "longitudinal": False}}
    with pytest.raises(ConfigError, match="cannot brake"):
        Shield(Random(), gym.make("parking-v0", config=config), frames=False)
    Shield(Random(), gym.make("parking-v0", config=config))
    ShieldedEnv(gym.make("parking-v0", config=config))


def test_the_lot_of_a_shielded_environment_is_that_of_the_simulator():
    env = lot_env(seed=5)
    assert len(ParkingScene.from_env(env).obstacles) == 14


def test_parking_is_compared_with_and_without_the_shield_by_default():
    assert all(SETTINGS[name].road for name in ("parking", "parking-parked"))
