"""Unreadable observations lead to the labelled fallback, and clipped values are marked as cut."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from seen_highway import FRAMELESS, SEEN, Actions, configured, make

from evaluation.learning.fast_vec_env import FastHighwayVecEnv
from shield import ConfigError, Known, ObservationSpec, SceneError, Shield, ShieldConfig
from shield.decision import Reason, Tier
from shield.perception.sighting import decode
from shield.perception.unseen import edges

BAD = {
    "nan": np.full((30, 5), np.nan),
    "infinity": np.where(np.eye(30, 5) > 0, np.inf, 0.5),
    "all zero": np.zeros((30, 5)),
    "another shape": np.zeros((5, 5)),
    "turned": np.full((5, 30), 0.6),
    "one row": np.ones(5),
    "booleans": np.ones((30, 5), bool),
    "words": np.full((30, 5), "1.0"),
    "complex": np.ones((30, 5), complex),
    "objects": np.full((30, 5), None),
    "ragged": [[1, 2], [3]],
    "a batch": np.ones((2, 30, 5)),
    "nothing": None,
}


@pytest.mark.parametrize("bad", BAD.values(), ids=BAD)
def test_an_unreadable_observation_leads_to_the_labelled_fallback(bad):
    known = Known.from_config(configured())
    with pytest.raises(SceneError):
        decode(known.spec, bad)
    policy = Actions([3])
    policy.predict = lambda *args, **kwargs: (3, None)
    shielded = Shield(
        policy, config=replace(ShieldConfig.for_meta_actions(), failure_limit=2), known=known, **FRAMELESS
    )
    for _ in range(2):
        action, _ = shielded.predict(bad)
        assert action == 4
        assert (shielded.last_decision.reason, shielded.last_decision.tier) == (Reason.BAD_SCENE, Tier.EMERGENCY)
        assert shielded.last_decision.guarantee.value == "none"
    with pytest.raises(SceneError, match="3 decisions in a row"):
        shielded.predict(bad)


def test_a_batch_has_a_row_for_each_environment():
    env = FastHighwayVecEnv(2, "highway-fast-v0", {"observation": SEEN})
    shielded, obs = Shield(lambda obs: np.array([1, 1]), env=env, **FRAMELESS), env.reset()
    shielded.predict(obs)
    for bad in (obs[:1], np.concatenate([obs, obs])):
        with pytest.raises(ConfigError, match="for 2 environments; a batch has one row for each"):
            shielded.predict(bad)
    shielded.predict(np.stack([obs[0], np.full_like(obs[1], np.nan)]))
    reasons = [each.reason is Reason.BAD_SCENE for each in shielded.last_decisions]
    assert reasons == [False, True]


@given(
    reach=st.floats(20, 150),
    fast=st.floats(26, 60),
    absolute=st.booleans(),
    seed=st.integers(0, 500),
    turns=st.integers(0, 4),
    obstacles=st.booleans(),
)
@settings(max_examples=20, deadline=None)
def test_a_clipped_value_is_exact_or_marked_as_cut(reach, fast, absolute, seed, turns, obstacles):
    """A vehicle inside the ranges is decoded to 1e-5, or to the precision of 32 bits; one outside is not invented."""
    ranges = {"x": [-reach, reach], "y": [-14.0, 16.0], "vx": [-fast, fast], "vy": [-20.0, 20.0]}
    if absolute:
        del ranges["x"]
    observation = {**SEEN, "features_range": ranges, "absolute": absolute, "include_obstacles": obstacles}
    env = make(observation)
    obs, _ = env.reset(seed=seed)
    for _ in range(turns):
        obs, *_ = env.step(0 if seed % 2 else 2)
    base, spec = env.unwrapped, ObservationSpec.of(env)
    ego, sighting = base.vehicle, decode(ObservationSpec.of(env), obs)
    assert spec == ObservationSpec.from_config(observation, 3)
    # Half an ulp of a range, of x in the world where that is shown, and of the sum of two.
    scale = np.array([ego.position[0] + 200 if absolute else reach, 16.0, fast, 20.0])
    allowed = 1e-5 + 2 * np.spacing(scale.astype(np.float32))
    np.testing.assert_array_less(np.abs(sighting.ego - [*ego.position, *ego.velocity])[1:], allowed[1:])
    others = [v for v in base.road.vehicles if v is not ego and abs(v.position[0] - ego.position[0]) < spec.distance]
    truth = np.array([[v.position[0] - ego.position[0], v.position[1], *v.velocity] for v in others]).reshape(-1, 4)
    shown = truth - np.array([0.0, *([0.0] * 3 if absolute else [ego.position[1], *ego.velocity])])
    known = np.ones(len(truth), bool)
    for k, name in enumerate(("x", "y", "vx", "vy")):
        low, high = ranges.get(name, (-np.inf, np.inf))
        known &= (shown[:, k] > low + 1e-3) & (shown[:, k] < high - 1e-3)
    apart = np.abs(sighting.others[:, None] - truth[known]) / allowed
    np.testing.assert_array_less(apart.max(axis=2).min(axis=0, initial=np.inf), 1.0)
    assert len(sighting.others) >= known.sum()
    # A range of x shorter than sight ends it: vehicles beyond count neither as seen nor as cut.
    beyond = np.zeros(len(truth), bool) if absolute else np.abs(truth[:, 0]) > reach - 1e-3
    if not (known | beyond).all():
        assert sighting.cut or len(sighting.others) > known.sum()
    else:
        assert not sighting.cut
    assert absolute or max(edges(spec, sighting)) <= reach
