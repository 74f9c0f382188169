"""After any fault, no unfiltered input reaches the actuators, and the record says what happened."""

from __future__ import annotations

from dataclasses import replace

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from continuous_world import random_continuous_world
from cores import ContinuousCore, nowhere

from dynamics.scenes.scene import Scene, SceneReader
from dynamics.state import Vehicle
from dynamics.vehicle.actuators import Actuators
from dynamics.vehicle.rollouts import Rollouts
from mpc.filter.predictive_filter import PredictiveFilter
from shield import Reason, Shield, ShieldConfig, ShieldedEnv, Tier
from shield.alternatives.nearest_input import NearestInputSearch
from shield.certificate.road import verify
from shield.errors import ConfigError, SceneError

NAN, INF = float("nan"), float("inf")
FULL = np.array([1.0, 0.0], dtype=np.float32)
CONTINUOUS = {
    "action": {"type": "ContinuousAction"},
    "simulation_frequency": 20,
    "policy_frequency": 10,
    "vehicles_count": 15,
    "duration": 10,
}


class Actions:
    """Records the inputs that reach the wheels: (acceleration, steering, tier) of each frame."""

    def __init__(self, env):
        self.env, self.base = env, env.unwrapped
        self.seen = []

    def __enter__(self):
        kind = type(self.base.vehicle)
        self.step = kind.step

        def step(vehicle, dt):
            if vehicle is self.base.vehicle:
                self.seen.append((float(vehicle.action["acceleration"]), float(vehicle.action["steering"])))
            return self.step(vehicle, dt)

        self.kind, kind.step = kind, step
        return self

    def __exit__(self, *_):
        self.kind.step = self.step


def make(seed=0, **config):
    env = ShieldedEnv(gym.make("highway-v0", config=CONTINUOUS | config))
    env.reset(seed=seed)
    return env


@pytest.fixture
def env():
    return make()


def shown(info):
    return info["shield"]["reason"], info["shield"]["tier"]


# -- actions that are none ----------------------------------------------------------------------------------------

BAD_ACTIONS = {
    "nan": [NAN, 0.0],
    "inf": [0.0, INF],
    "-inf": [-INF, 0.0],
    "short": [0.5],
    "long": [0.5, 0.0, 0.0],
    "column": [[0.5], [0.0]],
    "scalar": 0.5,
    "text": "full throttle",
    "none": None,
    "empty": [],
    "object": object(),
}


@pytest.mark.parametrize("action", BAD_ACTIONS.values(), ids=BAD_ACTIONS)
def test_no_bad_action_reaches_the_wheels_and_the_next_step_is_clean(action, env):
    env.step(FULL * 0)
    with Actions(env) as actions:
        *_, info = env.step(action)
        assert shown(info) == ("bad_action", "emergency")
        assert info["shield"]["overridden"]
        assert all(a == -ShieldConfig().braking and np.isfinite(delta) for a, delta in actions.seen)
        *_, info = env.step(FULL * 0)
        assert info["shield"]["tier"] in ("passed", "governed")


def test_out_of_the_box_is_cut_down_as_the_environment_does_it(env):
    with Actions(env) as actions:
        *_, info = env.step(np.array([7.0, 0.0]))
    assert info["shield"]["tier"] == "passed"
    assert actions.seen == [(5.0, 0.0)] * 2


def test_out_of_the_box_is_refused_where_the_environment_does_not_cut_it_down():
    env = make(action={"type": "ContinuousAction", "clip": False})
    with Actions(env) as actions:
        *_, info = env.step(np.array([7.0, 0.0]))
    assert shown(info) == ("bad_action", "emergency")
    assert max(a for a, _ in actions.seen) <= 0


def test_a_dynamical_bicycle_is_refused_in_the_worst_case():
    with pytest.raises(ConfigError, match="dynamical"):
        ShieldedEnv(
            gym.make("highway-fast-v0", config={"action": {"type": "ContinuousAction", "dynamical": True}}),
            "worst-case",
        )


# -- scenes that cannot be ----------------------------------------------------------------------------------------


def broken_scene(who: str, column: Vehicle, value: float) -> Scene:
    scene = random_continuous_world(np.random.default_rng(3), cars=4).scene()
    ego, others = scene.ego.copy(), scene.others.copy()
    (ego if who == "ego" else others[0])[column] = value
    with np.errstate(all="ignore"):
        return replace(scene, ego=ego, others=others)


@pytest.mark.parametrize("value", [NAN, INF, -INF])
@pytest.mark.parametrize(
    "column", [Vehicle.X, Vehicle.Y, Vehicle.HEADING, Vehicle.SPEED, Vehicle.LENGTH, Vehicle.WIDTH]
)
@pytest.mark.parametrize("who", ["ego", "other"])
@pytest.mark.parametrize("predictive", [False, True])
def test_a_scene_that_is_not_finite_brakes_and_does_not_affect_the_next_one(predictive, who, column, value):
    scene = random_continuous_world(np.random.default_rng(3), cars=4).scene()
    core, fresh = (ContinuousCore(ShieldConfig(), Actuators(), predictive) for _ in range(2))
    proposal = np.array([5.0, 0.02])
    inputs, decision = core.filter(broken_scene(who, column, value), proposal)
    assert inputs is not proposal
    assert np.isfinite(inputs).all()
    assert inputs[0] <= 0
    assert (decision.reason, decision.tier) == (Reason.BAD_SCENE, Tier.EMERGENCY)
    after, first = core.filter(scene, proposal), fresh.filter(scene, proposal)
    assert np.array_equal(after[0], first[0])
    assert after[1].tier is first[1].tier


def test_the_ego_steers_to_its_lane_if_only_another_vehicle_is_unreadable():
    scene = broken_scene("other", Vehicle.X, NAN)
    scene = replace(scene, ego=scene.ego + np.array([0, 0, 0.2, 20.0 - scene.ego[Vehicle.SPEED], 0, 0, 0]))
    inputs, _ = ContinuousCore().filter(scene, np.array([5.0, 0.3]))
    assert inputs[0] == -ShieldConfig().braking
    assert inputs[1] < -0.01


@pytest.mark.parametrize("error", [SceneError("gone"), RuntimeError("boom"), AttributeError("road")])
def test_a_reader_that_raises_brakes_to_a_stop_and_never_backwards(error, env, monkeypatch):
    env.step(FULL * 0)
    with monkeypatch.context() as patch, Actions(env) as actions:
        patch.setattr(SceneReader, "read", lambda self: (_ for _ in ()).throw(error))
        for _ in range(30):
            *_, info = env.step(FULL)
            assert info["shield"]["tier"] == "emergency"
            assert info["shield"]["reason"] == ("bad_scene" if isinstance(error, SceneError) else "stage_failed")
        assert env.unwrapped.vehicle.speed >= -1e-9
    assert all(a <= 0 for a, _ in actions.seen)
    *_, info = env.step(FULL * 0)
    assert not Tier(info["shield"]["tier"]).fallback


# -- stages that break --------------------------------------------------------------------------------------------


def must_repair() -> tuple[Scene, np.ndarray]:
    """A scene in which full throttle does not verify, and braking does."""
    for seed in range(200):
        scene = random_continuous_world(np.random.default_rng(seed), cars=6).scene()
        proposal = np.array([5.0, 0.0])
        _, decision = ContinuousCore(predictive=False).filter(scene, proposal)
        if decision.tier is Tier.GOVERNED:
            return scene, proposal
    raise AssertionError("no scene found")


def not_a_plan(self, problem, guess=None, elapsed=None):
    result = SOLVE(self, problem, guess, elapsed)
    return replace(result, status=type(result.status).SOLVED, inputs=np.full_like(result.inputs, NAN))


def too_much(self, problem, guess=None, elapsed=None):
    result = SOLVE(self, problem, guess, elapsed)
    return replace(result, status=type(result.status).SOLVED, inputs=np.full_like(result.inputs, 5.0))


SOLVE = PredictiveFilter.solve


@pytest.mark.parametrize("broken", [not_a_plan, too_much])
def test_a_plan_that_is_nan_or_wrong_is_not_used(broken, monkeypatch):
    scene, proposal = must_repair()
    core = ContinuousCore(predictive=True)
    with monkeypatch.context() as patch:
        patch.setattr(PredictiveFilter, "solve", broken)
        inputs, decision = core.filter(scene, proposal)
    assert np.isfinite(inputs).all()
    assert decision.tier is Tier.GOVERNED
    assert ContinuousCore(predictive=False).filter(scene, inputs)[1].tier is Tier.PASSED
    core.reset()
    clean, decision = core.filter(scene, proposal)
    assert decision.tier is Tier.GOVERNED
    assert np.array_equal(clean, ContinuousCore(predictive=True).filter(scene, proposal)[0])


STAGES = [(PredictiveFilter, "solve"), (Rollouts, "run_inputs"), (Rollouts, "stop"), (verify, "evaluate_paths")]


@pytest.mark.parametrize("stage", STAGES, ids=lambda s: f"{s[0].__name__}.{s[1]}")
def test_a_stage_that_raises_is_labelled_and_the_next_step_is_clean(stage, monkeypatch):
    env, calls = make(vehicles_count=40), []
    env.step(FULL * 0)

    def raising(*args, **kwargs):
        calls.append(stage)
        raise RuntimeError("stage")

    with monkeypatch.context() as patch, Actions(env) as actions:
        patch.setattr(*stage, raising)
        if stage[0] is PredictiveFilter:  # The plan is needed where the search finds nothing.
            patch.setattr(
                NearestInputSearch, "run", lambda self, lanes, *_: self._judge(self._proposal[None], lanes, False)
            )
        for _ in range(60):
            frames, called = len(actions.seen), len(calls)
            *_, terminated, _, info = env.step(FULL)
            if len(calls) > called:  # not every frame uses every stage
                assert shown(info) == ("stage_failed", "emergency")
                records = zip(actions.seen[frames:], env.frame_decisions, strict=True)
                assert all(record.tier is Tier.PASSED or a <= 0 for (a, _), record in records)
            if terminated or len(calls) > 5:
                break
    assert calls
    assert not terminated
    for _ in range(3):
        *_, info = env.step(FULL * 0)
    assert info["shield"]["reason"] != "stage_failed"


@pytest.mark.parametrize("stage", [(Rollouts, "run_inputs"), (Rollouts, "stop"), (verify, "evaluate_paths")])
def test_a_stage_that_computes_nan_verifies_nothing(stage, env, monkeypatch):
    right = getattr(*stage)
    with monkeypatch.context() as patch, Actions(env) as actions, np.errstate(all="ignore"):
        broken = nowhere(right) if stage[0] is verify else lambda *a, **k: np.full_like(right(*a, **k), NAN)
        patch.setattr(*stage, broken)
        *_, info = env.step(FULL)
    assert Tier(info["shield"]["tier"]).fallback
    assert all(a < 5.0 for a, _ in actions.seen)


# -- forgetting ---------------------------------------------------------------------------------------------------


def states(env, seed):
    env.reset(seed=seed)
    rng, out = np.random.default_rng(seed), []
    for _ in range(40):
        *_, terminated, truncated, info = env.step(rng.uniform(-1, 1, 2).astype(np.float32))
        v = env.unwrapped.vehicle
        out.append((*v.position, v.heading, v.speed, info["shield"]["tier"], info["shield"]["margin"]))
        if terminated or truncated:
            break
    return out


def test_reset_forgets_everything_so_that_two_runs_are_bitwise_equal():
    used, fresh = make(), make()
    states(used, 5)
    first, second = states(used, 7), states(fresh, 7)
    assert any(tier == "governed" for *_, tier, _ in first)
    assert first == second


def test_a_policy_that_raises_brakes_in_the_policy_wrapper():
    env = gym.make("highway-v0", config=CONTINUOUS)
    obs, _ = env.reset(seed=0)

    class Broken:
        def predict(self, *args, **kwargs):
            raise RuntimeError("policy")

    shield = Shield(Broken(), env=env)
    action, _ = shield.predict(obs)
    assert action[0] == -1.0
    assert shield.last_decision.reason is Reason.POLICY_FAILED
    assert shield.last_decision.tier.fallback
