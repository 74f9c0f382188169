"""A decision can be repeated, bit for bit, from its memory, scene and proposal: no other state exists.

2,000 recorded decisions (10,000 with the slow tests) are repeated in another order, by procedures that have decided
nothing before.
"""

from __future__ import annotations

import pickle

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from slowly import later

from evaluation.policies import load_reference
from shield import Shield, ShieldConfig, ShieldedEnv
from shield.config import WORST_CASE
from shield.filters.meta_actions import MetaActionFilter
from shield.pipelines.decide import DecisionCore, decide

DENSE = {"vehicles_density": 1.5}
CONTINUOUS = {"action": {"type": "ContinuousAction"}}


class Random:
    """A policy that does anything."""

    def __init__(self, space, seed=0):
        self.space = space
        self.space.seed(seed)

    def predict(self, obs, state=None, episode_start=None, deterministic=False):
        return self.space.sample(), state


def behind_env(kind, config=None, shield=None, policy=None):
    env = gym.make(kind, config=config or {})
    scores = load_reference(policy) if policy else None
    shielded = ShieldedEnv(env, shield or ShieldConfig(), policy=scores)
    acts = scores or Random(env.action_space)
    return shielded, acts, lambda: ShieldedEnv(env, shield or ShieldConfig(), policy=scores)


def behind_policy(kind, config=None):
    env = gym.make(kind, config=config or {})
    policy = Random(env.action_space)
    return env, Shield(policy, env, WORST_CASE, frames=False), lambda: Shield(policy, env, WORST_CASE, frames=False)


CASES = {
    "meta-actions": (4000, lambda: behind_env("highway-fast-v0", DENSE)),
    "meta-actions of PPO": (1500, lambda: behind_env("highway-fast-v0", DENSE, policy="ppo-highway-fast")),
    "nearest inputs": (300, lambda: behind_env("highway-fast-v0", shield=ShieldConfig(repair="filter"))),
    "inputs": (1200, lambda: behind_env("highway-fast-v0", CONTINUOUS)),
    "inputs on a bend": (300, lambda: behind_env("racetrack-v1", CONTINUOUS)),
    "parking lot": (1200, lambda: behind_env("parking-v0")),
    "meta-actions only": (900, lambda: behind_policy("highway-fast-v0")),
    "held inputs": (300, lambda: behind_policy("highway-fast-v0", CONTINUOUS)),
    "held inputs in a parking lot": (300, lambda: behind_policy("parking-v0")),
}


def recorded(case, count, monkeypatch):
    """Decisions as (memory, scene, proposal, procedure), and their results."""
    env, policy, again = case()
    found, own = [], DecisionCore.decide

    def record(self, scene, proposal, procedure=None):
        memory, used = self.memory, procedure or self.procedure
        if hasattr(proposal, "order") and callable(proposal.order):
            # The order is evaluated when it is needed, on the observation of that moment.
            proposal = type(proposal)(proposal.action, proposal.labels, proposal.order())
        decision = own(self, scene, proposal, procedure)
        found.append(((memory, scene, proposal), type(used).__name__, decision, self.memory))
        return decision

    monkeypatch.setattr(DecisionCore, "decide", record)
    seed = 0
    while len(found) < count:
        obs, _ = env.reset(seed=seed)
        seed, done = seed + 1, False
        while not done and len(found) < count:
            action, _ = policy.predict(obs, deterministic=True)
            obs, _, terminated, truncated, _ = env.step(action)
            done = terminated or truncated
    monkeypatch.undo()
    return found, again()


def procedures(shielded):
    """The procedures of a filter, by name."""
    action_filters = shielded._filters if isinstance(shielded, Shield) else [shielded._filter]
    kinds = [action_filter.core.procedure for action_filter in action_filters] + [
        action_filter._frames for action_filter in action_filters if isinstance(action_filter, MetaActionFilter)
    ]
    return {type(each).__name__: each for each in kinds}


def told(decision, memory):
    """All that is said of a decision, but the time that it took."""
    record = decision.executed, decision.reason, decision.tier, decision.margin, decision.plan, decision.clause
    left = memory.frame, memory.stored, memory.watch.count, memory.plan
    return pickle.dumps((*record, decision.vehicle, *left))


@pytest.mark.parametrize("some", [True, *later(False)])
@pytest.mark.parametrize("name", CASES)
def test_a_decision_can_be_made_again_from_its_record(name, some, monkeypatch):
    count, case = CASES[name]
    found, fresh = recorded(case, min(count // 5, 240) if some else count, monkeypatch)
    named = procedures(fresh)
    overridden = 0
    for i in np.random.default_rng(0).permutation(len(found)):
        made_from, procedure, decision, memory = found[i]
        again, left = decide(*made_from, named[procedure])
        assert told(again, left) == told(decision, memory), (i, again, decision)
        overridden += decision.overridden
    assert overridden
    assert sum(count for count, _ in CASES.values()) == 10_000


def test_neither_memory_nor_scene_is_changed(monkeypatch):
    found, fresh = recorded(CASES["meta-actions"][1], 300, monkeypatch)
    named = procedures(fresh)
    for (memory, scene, proposal), procedure, *_ in found:
        before = pickle.dumps((memory.stored, memory.watch.offenders, memory.watch.by_rule, scene.ego, scene.others))
        decide(memory, scene, proposal, named[procedure])
        after = pickle.dumps((memory.stored, memory.watch.offenders, memory.watch.by_rule, scene.ego, scene.others))
        assert before == after
