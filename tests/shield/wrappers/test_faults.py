"""After any fault of a policy, the unfiltered action does not reach the environment, and the record says what
happened."""

import numpy as np
import pytest
from faults import INF, NAN, SLOWER, Policy, kind, spied

from shield import Shield, ShieldedEnv
from shield.decision import Reason, Tier
from shield.errors import PolicyError

# -- actions that are none -----------------------------------------------------------------------------------


NO_ACTIONS = {
    "nan": NAN,
    "inf": INF,
    "-inf": -INF,
    "text": "LANE_LEFT",
    "none": None,
    "half": 1.5,
    "unknown": 99,
    "negative": -1,
    "dict": {},
    "bytes": b"x",
    "object": object(),
    "nan array": np.array([NAN]),
    "unknown array": np.array([99]),
    "0-d nan": np.array(NAN, dtype=np.float32),
}
SHAPES = {"pair": [1, 2], "pair array": np.array([3, 3]), "empty": np.array([])}


@pytest.mark.parametrize("action", [*NO_ACTIONS.values(), *SHAPES.values()], ids=[*NO_ACTIONS, *SHAPES])
def test_shielded_env_takes_no_bad_action(action, spy, shielded):
    *_, info = shielded.step(action)
    assert spy.seen == [SLOWER]
    assert kind(info["shield"]) in {("bad_action", "largest_margin"), ("bad_action", "emergency")}
    assert info["shield"]["overridden"]
    assert shielded.last_decision.tier.fallback


@pytest.mark.parametrize("action", [*NO_ACTIONS.values(), *SHAPES.values()], ids=[*NO_ACTIONS, *SHAPES])
def test_shield_returns_no_bad_action(action, spy):
    obs, _ = spy.reset(seed=0)
    shield = Shield(Policy(action), env=spy)
    executed, _ = shield.predict(obs)
    assert int(executed.reshape(-1)[0]) == SLOWER
    assert executed.dtype == np.int64
    decision = shield.last_decision
    assert decision.reason in (Reason.BAD_ACTION, Reason.POLICY_FAILED)
    assert decision.tier == Tier.EMERGENCY
    assert decision.overridden


@pytest.mark.parametrize("action", [NAN, 99])
def test_a_bad_action_after_a_verified_decision_executes_the_stored_plan(action, spy):
    obs, _ = spy.reset(seed=0)
    policy = Policy(1)
    shield = Shield(policy, env=spy)
    assert int(shield.predict(obs)[0]) == 1
    assert shield.last_decision.tier == Tier.PASSED
    policy.action = action
    executed, _ = shield.predict(obs)
    assert spy.action_space.contains(int(executed))
    assert shield.last_decision.tier == Tier.STORED_PLAN


@pytest.mark.parametrize(
    "error", [RuntimeError("boom"), ValueError("bad"), MemoryError()], ids=lambda e: type(e).__name__
)
@pytest.mark.parametrize("batched", [False, True])
def test_a_policy_that_raises_leads_to_the_fallback(error, batched, spy):
    obs, _ = spy.reset(seed=0)
    shield = Shield(Policy(error), env=spy)
    executed, _ = shield.predict(obs[None] if batched else obs)
    assert executed.shape == ((1,) if batched else ())
    assert int(executed.reshape(-1)[0]) == SLOWER
    assert (shield.last_decision.reason, shield.last_decision.tier) == (Reason.POLICY_FAILED, Tier.EMERGENCY)


def test_a_policy_that_returns_no_pair_has_failed(spy):
    class Half:
        def predict(self, observation, **kwargs):
            return 3

    obs, _ = spy.reset(seed=0)
    shield = Shield(Half(), env=spy)
    assert int(shield.predict(obs)[0]) == SLOWER
    assert shield.last_decision.reason == Reason.POLICY_FAILED


def test_an_interrupt_is_not_swallowed(spy):
    class Interrupted:
        def predict(self, observation, **kwargs):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Shield(Interrupted(), env=spy).predict(spy.reset(seed=0)[0])


def test_a_bad_row_of_a_batch_does_not_affect_other_rows():
    from stable_baselines3.common.vec_env import DummyVecEnv

    vec = DummyVecEnv([spied, spied])
    vec.seed(0)
    obs = vec.reset()
    shield, untouched = (Shield(Policy(np.array([first, 1.0])), env=vec) for first in (NAN, 1.0))
    executed, _ = shield.predict(obs)
    untouched.predict(obs)
    assert executed[0] == SLOWER
    assert shield.last_decisions[0].tier.fallback
    mine, theirs = shield.last_decisions[1], untouched.last_decisions[1]
    assert (mine.proposed, mine.executed, mine.tier) == (1, theirs.executed, theirs.tier)


@pytest.mark.parametrize("policy", [object(), None, 3])
def test_a_policy_without_predict_is_refused(policy, spy):
    with pytest.raises(PolicyError, match="has no predict"):
        Shield(policy, env=spy)


# -- scores that break -------------------------------------------------------------------------------------------


class Scored(Policy):
    def __init__(self, scores):
        super().__init__(3)
        self.scores = scores

    def action_scores(self, obs):
        if isinstance(self.scores, Exception):
            raise self.scores
        return self.scores


BAD_SCORES = {
    "raise": RuntimeError("boom"),
    "nan": np.full((1, 5), NAN),
    "text": "none",
    "too many": np.arange(7.0)[None],
    "too few": np.arange(2.0)[None],
}


@pytest.mark.parametrize("scores", BAD_SCORES.values(), ids=BAD_SCORES)
@pytest.mark.parametrize("placement", ["env", "predict"])
def test_scores_that_break_do_not_stop_an_override(scores, placement):
    overridden = 0
    inner = spied()
    env = ShieldedEnv(inner, policy=Scored(scores)) if placement == "env" else inner
    policy = Scored(scores) if placement == "env" else Shield(Scored(scores), env=env)
    obs, _ = env.reset(seed=0)
    done = False
    while not done:
        obs, _, terminated, truncated, _ = env.step(policy.predict(obs)[0])
        done = terminated or truncated
        last = env.last_decision if placement == "env" else policy.last_decision
        overridden += last.overridden
    assert all(inner.action_space.contains(int(a)) for a in inner.seen)
    assert overridden
