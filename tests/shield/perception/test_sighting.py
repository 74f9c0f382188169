"""Decoded observations equal the simulator's state."""

from __future__ import annotations

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from observed_roads import SEEN, make

from shield import ConfigError, SceneError, ShieldedEnv
from shield.decision import Reason, Tier
from shield.perception.sighting import decode
from shield.perception.spec import ObservationSpec
from shield.perception.unseen import edges

EXTRAS = ("presence", "heading", "cos_h", "sin_h", "cos_d", "long_off", "lat_off", "ang_off")


def truth(base):
    """x relative to the ego, y, vx and vy of all other vehicles."""
    ego = base.vehicle
    return np.array(
        [[v.position[0] - ego.position[0], v.position[1], *v.velocity] for v in base.road.vehicles if v is not ego]
    )


@given(
    extras=st.lists(st.sampled_from(EXTRAS), unique=True),
    order=st.randoms(use_true_random=False),
    count=st.integers(2, 25),
    options=st.fixed_dictionaries(
        {
            "normalize": st.booleans(),
            "absolute": st.booleans(),
            "see_behind": st.booleans(),
            "order": st.sampled_from(["sorted", "shuffled"]),
        }
    ),
    seed=st.integers(0, 200),
    decisions=st.integers(0, 3),
)
@settings(max_examples=25, deadline=None)
def test_a_decoded_observation_is_the_state_of_the_simulator(extras, order, count, options, seed, decisions):
    features = ["x", "y", "vx", "vy", *extras]
    order.shuffle(features)
    observation = {"type": "Kinematics", "features": features, "vehicles_count": count, "clip": False, **options}
    env = make(observation)
    obs, _ = env.reset(seed=seed)
    for _ in range(decisions):
        obs, *_ = env.step(1)
    spec = ObservationSpec.of(env)
    sighting, base = decode(spec, obs), env.unwrapped
    ego = [*base.vehicle.position, *base.vehicle.velocity]
    np.testing.assert_allclose(sighting.ego, ego, rtol=2e-7, atol=5e-5)
    there = truth(base)
    apart = np.abs(sighting.others[:, None] - there[None]).max(axis=2)
    # 32 bits of a range of 200 m, and of the ego's own place.
    assert (apart.min(axis=1, initial=np.inf) < 1e-4).all()
    assert len(set(apart.argmin(axis=1).tolist())) == len(sighting.others) if len(there) else True
    if {"cos_h", "sin_h"} <= set(features) or "heading" in features:
        assert abs(sighting.heading - base.vehicle.heading) < 1e-5
    if not spec.sorted:
        return
    # A vehicle that is left out is beyond the edges.
    far, back = edges(spec, sighting)
    left_out = np.delete(there, apart.argmin(axis=1), axis=0) if len(sighting.others) else there
    ahead_by = left_out[:, 0]
    assert ((ahead_by >= far - 10.1) | (ahead_by <= -back + 1e-3)).all()


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"features": ["presence", "x", "y"]}, "lacks vx, vy: add them"),
        ({"features": ["x", "y", "vx", "vy"], "absolute": True}, "'absolute' or 'clip'"),
        ({"vehicles_count": 1}, "at least 2"),
    ],
)
def test_an_unusable_observation_is_refused_with_the_setting_to_change(options, match):
    env = make({"type": "Kinematics", **options})
    env.reset(seed=0)
    with pytest.raises(ConfigError, match=match):
        ObservationSpec.of(env)


def test_other_observation_types_are_refused_with_the_supported_ones():
    env = make({"type": "TimeToCollision"})
    env.reset(seed=0)
    with pytest.raises(ConfigError, match="not TimeToCollisionObservation"):
        ObservationSpec.of(env)


@pytest.mark.parametrize("observation", [{"type": "Kinematics"}, SEEN, {**SEEN, "order": "shuffled"}])
def test_the_configuration_says_the_same_as_the_environment(observation):
    env = make(observation)
    env.reset(seed=0)
    assert ObservationSpec.from_config(observation, lanes=3) == ObservationSpec.of(env)


@pytest.mark.parametrize(
    "bad",
    [
        np.full((5, 5), np.nan),
        np.full((5, 5), np.inf),
        np.zeros((5, 5)),
        np.zeros((4, 5)),
        np.zeros((2, 5, 5)),
        "rows",
        None,
    ],
)
def test_an_unreadable_observation_is_an_error_and_falls_back(bad):
    with pytest.raises(SceneError):
        decode(ObservationSpec(), bad)
    env = ShieldedEnv(gym.make("highway-fast-v0"), perception="observation")
    env.reset(seed=0)
    env._filter.show(bad)
    decision = env._filter.decide(3)
    assert decision.reason is Reason.BAD_SCENE
    assert decision.tier is Tier.EMERGENCY
