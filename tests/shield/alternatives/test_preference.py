"""Alternatives are tried in the order of the policy's own scores."""

from collections import Counter
from dataclasses import replace

import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
import torch
from cores import MetaCore
from hypothesis import given
from hypothesis import strategies as st
from policies import Always, Ranked, make

from dynamics.scenes.scene import Scene, Target
from shield import Shield, ShieldedEnv
from shield.alternatives.preference import default_order
from shield.wrappers.ranking import order_from_scores, orders_from_scores, ranking_of


@pytest.mark.parametrize("name", ["PPO", "A2C", "TRPO", "MaskablePPO", "DQN", "QRDQN"])
def test_the_order_is_that_of_the_models_own_scores(name, models):
    model, obs = models[name], make().reset(seed=2)[0]
    scores = np.asarray(ranking_of(model, obs)).reshape(-1)
    tensor, _ = model.policy.obs_to_tensor(obs)
    with torch.no_grad():
        if name == "DQN":
            want = model.policy.q_net(tensor)
        elif name == "QRDQN":
            want = model.policy.quantile_net(tensor).mean(dim=1)
        else:
            want = model.policy.get_distribution(tensor).distribution.probs
    np.testing.assert_allclose(scores, want.numpy().reshape(-1))
    best = int(model.predict(obs, deterministic=True)[0])
    assert best == int(scores.argmax())
    order = order_from_scores(scores, best)
    assert sorted([*order, best]) == list(range(5))
    assert (np.diff(scores[order]) <= 0).all()


def test_scores_that_are_not_numbers_come_last():
    assert order_from_scores([0.1, np.nan, 0.3, 0.2, np.nan], proposed=2) == [3, 0, 1, 4]


@given(st.data())
def test_the_orders_of_many_are_those_of_each(data):
    n, k = data.draw(st.integers(1, 5)), data.draw(st.integers(2, 6))
    score = st.one_of(st.sampled_from([0.0, 0.5, 1.0, np.nan]), st.floats(-3, 3))
    scores = np.array(data.draw(st.lists(st.lists(score, min_size=k, max_size=k), min_size=n, max_size=n)))
    proposed = np.array(data.draw(st.lists(st.integers(0, k - 1), min_size=n, max_size=n)))
    each = [[*order_from_scores(s, a), -1] for s, a in zip(scores, proposed, strict=True)]
    assert orders_from_scores(scores, proposed).tolist() == each


def test_an_object_without_scores_has_no_ranking(env):
    assert ranking_of(Always(3), env.reset(seed=0)[0]) is None


@pytest.mark.parametrize(
    ("room", "doubt", "blurred", "first"),
    [
        ((90.0, 60.0, 50.0), 0.0, False, "LANE_LEFT"),  # more room on the left
        ((90.0, 60.0, 50.0), 2.0, True, "LANE_LEFT"),  # and the bounds leave no doubt
        ((90.0, 60.0, 50.0), 40.0, True, "LANE_RIGHT"),  # with unclear gains the order keeps right
        ((90.0, 60.0, 10.0), 40.0, True, "FASTER"),  # but not where there is less of it for certain
    ],
)
def test_the_default_order_keeps_right_if_neither_lane_is_clearly_better(env, room, doubt, blurred, first):
    env.reset(seed=0)
    scene = Scene.from_env(env)
    x, y = scene.road.to_world(np.array([100.0, scene.road.centers[1], 0.0, 25.0]))[:2]
    others = np.array([[x + d, y + 4.0 * k, 0.0, 25.0, 5.0 + 2 * doubt, 2.0, 0.0] for k, d in enumerate(room, -1)])
    told = replace(scene.control, target=Target(1, 25.0))
    ego = np.array([x, y, 0.0, 25.0, 5.0, 2.0, 0.0])
    scene = replace(scene, ego=ego, others=others, control=told, blurred=blurred, ids=None)
    order = default_order(scene, 1, [scene.target_of(a) for a in range(5)])
    assert scene.control.actions[order[0]] == first


@pytest.mark.parametrize("scores", [None, [4, 3, 2, 0, 1], [0, 1, 4, 0, 3], [0, 2, 1, 0, 4]])
def test_an_override_is_the_first_in_order_that_verifies(scores):
    env, seen = make(duration=20), 0
    for seed in range(2):
        obs, _ = env.reset(seed=seed)
        shielded = Shield(Always(3) if scores is None else Ranked(3, scores), env, "worst-case", frames=False)
        done = False
        while not done:
            scene = Scene.from_env(env)
            action, _ = shielded.predict(obs)
            decision = shielded.last_decision
            if decision.tier == "alternative":
                seen += 1
                targets = [scene.target_of(a) for a in range(5)]
                order = default_order(scene, 3, targets) if scores is None else order_from_scores(scores, 3)
                passed = [MetaCore().decide(scene, a).tier == "passed" for a in order]
                assert decision.executed == order[passed.index(True)]
            obs, _, terminated, truncated, _ = env.step(int(action))
            done = terminated or truncated
    assert seen > 3
    env.close()


def test_the_order_of_a_policy_reaches_shielded_env():
    executed = {}
    for name, scores in {"left": [4, 0, 1, 0, 2], "slower": [0, 1, 0, 0, 4]}.items():
        env = ShieldedEnv(make(duration=20), policy=Ranked(3, scores))
        chosen = Counter()
        for seed in range(4):
            env.reset(seed=seed)
            done = False
            while not done:
                _, _, terminated, truncated, _ = env.step(3)
                chosen[env.last_decision.executed] += env.last_decision.overridden
                done = terminated or truncated
        executed[name] = chosen
        env.close()
    assert executed["left"][0] > executed["slower"][0]
    assert executed["slower"][4] > executed["left"][4]
