"""A shield whose predictive filter plans on another model: the bicycle verifies every plan."""

from __future__ import annotations

import gymnasium as gym
import highway_env  # noqa: F401
import numpy as np
import pytest
from continuous_world import random_continuous_world
from cores import ContinuousCore

from dynamics.vehicle import bicycle
from dynamics.vehicle.actuators import Actuators
from shield import ShieldConfig, ShieldedEnv
from shield.alternatives.nearest_input import NearestInputSearch
from shield.decision import Tier
from shield.errors import ConfigError


class Told:
    """The bicycle with other brakes, or NaN."""

    def __init__(self, factor: float) -> None:
        self.factor = factor

    def held(self, state, control, duration):
        frames = max(1, round(duration / 0.05))
        for _ in range(frames):
            state = bicycle.step_expression(state, self.factor * control[0], control[1], duration / frames)
        return state


MODELS = {"honest": Told(1.0), "strong brakes": Told(3.0), "no brakes": Told(0.0), "nan": Told(np.nan)}


def must_repair(count=16):
    """Scenes in which full throttle does not verify, and braking does."""
    found = []
    for seed in range(2000):
        scene = random_continuous_world(np.random.default_rng(seed), cars=6).scene()
        proposal = np.array([5.0, 0.0])
        if ContinuousCore(predictive=False).filter(scene, proposal)[1].tier is Tier.GOVERNED:
            found.append((scene, proposal))
        if len(found) == count:
            return found
    raise AssertionError("too few scenes found")


SCENES = must_repair()


@pytest.mark.parametrize("name", MODELS)
def test_a_plan_of_another_model_is_verified_on_the_bicycle(name, monkeypatch):
    """The search is patched to find nothing, so that the plan is needed. The result has passed, or is a fallback."""
    asked, used = [], 0
    core = ContinuousCore(model=MODELS[name])
    predictor = core.inputs.predictor
    plan = predictor.plan
    monkeypatch.setattr(predictor, "plan", lambda *args: asked.append(plan(*args)) or asked[-1])
    for scene, proposal in SCENES:
        core.reset()
        with monkeypatch.context() as patch:
            patch.setattr(
                NearestInputSearch, "run", lambda self, lanes, *_: self._judge(self._proposal[None], lanes, False)
            )
            inputs, decision = core.filter(scene, proposal)
        assert np.isfinite(inputs).all()
        if decision.tier is Tier.GOVERNED:
            used += 1
            np.testing.assert_array_equal(inputs[1:], asked[-1][0, 1:])
            assert decision.margin >= 0
            assert ContinuousCore(predictive=False).filter(scene, inputs)[1].tier is Tier.PASSED
        else:
            assert decision.tier.fallback
    assert len(asked) == len(SCENES)
    if name == "honest":
        assert used
    if name == "nan":
        assert not used
        assert all(plan is None for plan in asked)


def test_a_model_without_a_filter_that_would_use_it_is_refused():
    meta = gym.make("highway-fast-v0")
    with pytest.raises(ConfigError, match="ContinuousAction"):
        ShieldedEnv(meta, model=MODELS["honest"])
    lot = gym.make("parking-v0")
    with pytest.raises(ConfigError, match="leave it out"):
        ShieldedEnv(lot, model=MODELS["honest"])


def test_the_environment_hands_the_model_to_its_filter():
    env = gym.make("highway-fast-v0", config={"action": {"type": "ContinuousAction"}})
    shielded = ShieldedEnv(env, ShieldConfig(), model=MODELS["honest"])
    assert shielded.core.procedure.predictor.model is MODELS["honest"]
    assert ContinuousCore(ShieldConfig(), Actuators()).inputs.predictor.model is None
