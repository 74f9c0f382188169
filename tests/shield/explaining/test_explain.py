"""`decision.explain()`: every override has a reason, in words and as data, and an explanation changes no decision."""

import copy
import math
import pickle

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from policies import Always, Playback, make

from evaluation.running.episodes import run_episode
from evaluation.running.records import variant_for
from shield import Reason, Shield, ShieldConfig, ShieldedEnv
from shield.decision import Decision, Tier
from shield.errors import ConfigError
from shield.explanation import LostGuarantee

INPUTS = {"action": {"type": "ContinuousAction"}}
EXACT = ShieldConfig.simulated_traffic()
ROADS = ShieldConfig.for_roads()
SEEN = {
    "type": "Kinematics",
    "see_behind": True,
    "vehicles_count": 15,
    "features": ["presence", "x", "y", "vx", "vy"],
    "normalize": False,
}
NOBODY = {"room", "edge", "gap of the map", "rollback", "road", "speed"}
"""Clauses that no vehicle is the cause of."""
CELLS = {
    "highway": ("highway-fast-v0", {"duration": 12}, None, "simulator"),
    "highway, observed": ("highway-fast-v0", {"duration": 8, "observation": SEEN}, None, "observation"),
    "highway, inputs": ("highway-fast-v0", {"duration": 6, **INPUTS}, None, "simulator"),
    "highway, rss": ("highway-fast-v0", {"duration": 20}, ShieldConfig(mode="rss"), "simulator"),
    "highway, ttc": ("highway-fast-v0", {"duration": 20}, ShieldConfig(mode="ttc"), "simulator"),
    "highway, distance": ("highway-fast-v0", {"duration": 12}, ShieldConfig(mode="distance", distance=40), "simulator"),
    "highway, simulated": ("highway-fast-v0", {"duration": 12}, EXACT, "simulator"),
    "highway, simulated inputs": ("highway-fast-v0", {"duration": 6, **INPUTS}, EXACT, "simulator"),
    "roundabout": ("roundabout-v1", {"duration": 8}, ROADS, "simulator"),
    "merge": ("merge-v1", {}, ROADS, "simulator"),
    "merge, simulated": ("merge-v1", {}, EXACT, "simulator"),
    "parking": ("parking-v0", {"duration": 8, "vehicles_count": 8}, None, "simulator"),
}  # fmt: skip


def actions_of(env, seed):
    rng, space = np.random.default_rng(seed), env.action_space
    if isinstance(space, gym.spaces.Discrete):
        return [int(space.n) - 2 if rng.random() < 0.6 else int(rng.integers(space.n)) for _ in range(100)]
    return [np.clip(rng.normal(0.7, 0.5, space.shape), -1, 1).astype(np.float32) for _ in range(100)]


def records(name, placement, seed, ask=True):
    """For each step of an episode the record, and its explanation if requested."""
    env_id, settings, config, perception = CELLS[name]
    bare = gym.make(env_id, config=settings)
    plan = actions_of(bare, seed)
    if placement == "env":
        env, shield = ShieldedEnv(bare, config, perception=perception), None
    else:
        env = bare
        shield = Shield(Playback(plan), bare, config, frames=placement == "policy", perception=perception)
    obs, _ = env.reset(seed=seed)
    for action in plan:
        if shield is not None:
            action, _ = shield.predict(obs)
            if ask and shield.last_decision.overridden:
                shield.last_decision.explain()  # between the decision and its frames, too
        obs, _, terminated, truncated, _ = env.step(action if np.ndim(action) else int(action))
        record = (shield or env).last_decision
        yield record, record.explain() if ask else None, bare.unwrapped
        if terminated or truncated:
            return


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("name", "placement"),
    [
        (name, placement)
        for name in CELLS
        for placement in ("env", "policy", "actions")
        # `Shield` of actions alone is refused where every frame is verified.
        if not (placement == "actions" and name in ("roundabout", "merge", "highway, simulated inputs"))
    ],
)
def test_every_override_names_its_vehicle_and_a_number(name, placement):
    """A refusal had no explanation once: `clause` and `vehicle` are those of the executed action."""
    told = 0
    for seed in range(912_100, 912_102):
        for record, why, base in records(name, placement, seed):
            if not record.overridden and not record.tier.fallback:
                assert why.refused == ""
                assert "executed as proposed" in why.text
                continue
            told += 1
            assert why.refused
            assert why.refused in why.text
            assert why.reason is record.reason
            assert why.done in why.text
            if why.clause in NOBODY:
                assert math.isfinite(why.after) or why.clause in ("rollback", "speed")
                continue
            assert why.cause is not None, why.text
            assert math.isfinite(why.cause.distance)
            assert math.isfinite(why.cause.speed)
            assert why.cause.text in why.text
            assert math.isfinite(why.short), why.text
            assert why.short > -1e-9
            if "observed" in name:
                assert isinstance(why.cause.vehicle, int)
            else:
                assert why.cause.vehicle in [*base.road.vehicles, *base.road.objects]
                assert why.cause.kind == type(why.cause.vehicle).__name__
            if not why.clause.startswith("rule"):
                assert 0 <= why.after <= 30
    assert told or placement == "actions"


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("placement", ["env", "policy"])
@pytest.mark.parametrize(
    "name", ["highway", "highway, inputs", "highway, simulated", "highway, simulated inputs", "roundabout", "parking"]
)
def test_an_explanation_changes_no_decision(name, placement):
    """The explanation has its own buffers: the next decision is the same as without it."""

    def driven(ask):
        return [
            (str(record.executed), record.tier, record.margin, record.frames_overridden)
            for record, _, _ in records(name, placement, 912_200, ask)
        ]

    assert str(driven(True)) == str(driven(False))


@pytest.mark.filterwarnings("ignore")
def test_each_of_several_egos_is_explained():
    env, told = ShieldedEnv(gym.make("intersection-multi-agent-v0"), EXACT), 0
    for seed in range(912_000, 912_004):
        env.reset(seed=seed)
        rng, done = np.random.default_rng(seed), False
        while not done:
            *_, truncated, _ = env.step(tuple(int(rng.integers(3)) for _ in range(2)))
            done = truncated or env.unwrapped._is_terminated()
            for each in env.last_decisions:
                if each.overridden:
                    why, told = each.explain(), told + 1
                    assert why.clause == "road" or why.cause.vehicle in env.unwrapped.road.vehicles
            if env.last_decision.overridden:
                first = next(each for each in env.last_decisions if each.overridden)
                assert env.last_decision.explain().text == first.explain().text
    assert told


def test_the_numbers_are_those_of_the_certificate():
    """The proposal, judged again in the scene of the decision, falls short by the explained margin, at the explained
    time, because of the explained vehicle."""
    compared = 0
    for seed in range(912_300, 912_304):
        for record, why, _ in records("highway", "env", seed):
            at = record.refusal[0] if record.refusal else None
            if at is None or why.clause != "separation" or at.reason is Reason.BUFFER or "expected" in why.why:
                continue
            scene = at.source.scene
            row = scene.bodies.index(why.cause.vehicle)
            gap = abs(scene.others_road[row, 0] - scene.ego_road[0]) - 5.0
            if why.cause.where in ("ahead", "behind"):
                assert why.cause.distance == pytest.approx(gap)
            assert why.cause.speed == scene.others[row, 3]
            made = at.source
            view = made.procedure.observe(made.memory, scene)[0]
            first = next(iter(made.procedure.plans(view, made.proposal))).plan
            # A lane change is expected to last for the whole decision, besides.
            lasts = getattr(made.procedure, "lasts", lambda *_: False)(view, getattr(made.proposal, "action", 0))
            assert first.margin <= -why.short + 1e-9
            assert lasts or first.margin == pytest.approx(-why.short)
            compared += 1
    assert compared > 10


def test_an_invalid_action_and_an_unreadable_scene_are_explained_in_words():
    env = ShieldedEnv(make())
    env.reset(seed=0)
    env.step(17)
    why = env.last_decision.explain()
    assert why.reason is Reason.BAD_ACTION
    assert "outside the action space" in why.text
    shield = Shield(Always(float("nan")), env=make())
    obs, _ = shield._env.reset(seed=0)
    shield.predict(obs)
    assert "the policy raised or returned NaN" in shield.last_decision.explain().text


def test_the_data_of_an_explanation_are_not_pickled():
    """A pickled or copied environment continues as before, and an error says why no explanation exists."""
    env = ShieldedEnv(make())
    env.reset(seed=3)
    while not env.last_decision or not env.last_decision.overridden:
        env.step(3)
    copied = pickle.loads(pickle.dumps(env.last_decision))
    with pytest.raises(ConfigError, match=r"before the decision is copied or pickled"):
        copied.explain()
    assert copy.deepcopy(env.last_decision).overridden
    with pytest.raises(ConfigError, match="was not kept"):
        Decision(3, 1, Reason.UNVERIFIED, Tier.ALTERNATIVE, 0.5, 0.0).explain()


@pytest.mark.parametrize(
    ("seed", "lost"),
    [(1790, LostGuarantee.PRECAUTION), (2840, LostGuarantee.PRECAUTION)],
)
def test_a_fallback_says_that_a_precaution_was_lost(seed, lost):
    """No plan verifies because of a possible cut-in that does not happen, with margins of -2.0 m."""
    found = []

    def after(time, record):
        if record.tier.fallback:
            found.append(record.explain())

    run_episode("highway-fast", "random", variant_for(ShieldConfig()), seed, simulator="highway-env", after=after)
    assert [each.lost for each in found] == [lost]
    (why,) = found
    assert "could cut in" in why.text
    assert "a precaution is lost and the guarantee is not" in why.text


def test_a_fallback_says_that_the_guarantee_was_lost():
    """The leader stops dead before the ego: it has broken a rule, and nothing verifies."""
    env = ShieldedEnv(gym.make("highway-fast-v0", config={"duration": 20, "lanes_count": 1, "vehicles_count": 3}))
    env.reset(seed=3)
    told = []
    for k in range(12):
        if k == 3:
            leader = min((v for v in env.unwrapped.road.vehicles[1:]), key=lambda v: v.position[0])
            ego = env.unwrapped.vehicle
            leader.position = ego.position + np.array([12.0, 0.0])
            leader.speed = leader.target_speed = 0.0
        *_, terminated, truncated, _ = env.step(3)
        if env.last_decision.tier.fallback:
            told.append(env.last_decision.explain())
        if terminated or truncated:
            break
    assert any(
        why.lost is LostGuarantee.GUARANTEE and "has broken a rule" in why.text and "the guarantee is lost" in why.text
        for why in told
    ), [w.text for w in told]
