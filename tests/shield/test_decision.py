"""One record a step: every report of it agrees, and matches the action that the environment got."""

import copy
import math

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from policies import Playback

from evaluation.running.counting import Tally
from shield import Shield, ShieldConfig, ShieldedEnv
from shield.decision import Decision, Intervention, Reason, Tier

INPUTS = {"action": {"type": "ContinuousAction"}}
EXACT = ShieldConfig.simulated_traffic()
CELLS = {
    "highway": ("highway-fast-v0", {"duration": 12}, None),
    "highway, simulated": ("highway-fast-v0", {"duration": 12}, EXACT),
    "highway, a rule": ("highway-fast-v0", {"duration": 12}, ShieldConfig(mode="ttc")),
    "highway, no shield": ("highway-fast-v0", {"duration": 6}, ShieldConfig(mode="none")),
    "highway, inputs": ("highway-fast-v0", {"duration": 6, **INPUTS}, None),
    "highway, simulated inputs": ("highway-fast-v0", {"duration": 6, **INPUTS}, EXACT),
    "racetrack, wheel alone": ("racetrack-v0", {"duration": 6}, None),
    "roundabout": ("roundabout-v1", {"duration": 8}, None),
    "intersection, simulated": ("intersection-v2", {"duration": 8}, EXACT),
    "parking": ("parking-v0", {"duration": 20}, None),
}
WRAPPERS = ("env", "policy", "actions")
TOLD = ("overridden", "intervention", "reason", "tier", "margin", "frames_overridden", "guarantee")


def same(a, b):
    return a == b or (isinstance(a, float) and isinstance(b, float) and math.isnan(a) and math.isnan(b))


def plan_for(env, seed):
    """Mostly eager actions, with random ones between."""
    rng = np.random.default_rng(seed)
    space = env.action_space
    if isinstance(space, gym.spaces.Discrete):
        eager = int(space.n) - 2
        return [eager if rng.random() < 0.6 else int(rng.integers(space.n)) for _ in range(200)]
    low, high = space.low, space.high
    return [np.clip(rng.normal(0.7, 0.5, space.shape), low, high).astype(np.float32) for _ in range(200)]


def steps(name, placement, seed):
    """Drive an episode. For each step: proposal, record, report, frames, the action that the environment got, the
    ego's state, and the state of an unshielded copy that executes the proposal."""
    env_id, settings, config = CELLS[name]
    bare = gym.make(env_id, config=settings)
    base = bare.unwrapped
    plan = plan_for(bare, seed)
    shielded = ShieldedEnv(bare, config) if placement == "env" else None
    policy = Playback(list(plan))
    shield = None if placement == "env" else Shield(policy, bare, config, frames=placement == "policy")
    obs, _ = (shielded or bare).reset(seed=seed)
    for action in plan:
        twin = copy.deepcopy(base)
        twin.step(action)
        if shielded is not None:
            obs, _, terminated, truncated, info = shielded.step(action)
            record, told, frames = shielded.last_decision, info["shield"], shielded.frame_decisions
            counted, given = info.get("shield_episode"), shielded.decisions[0].executed
        else:
            given, _ = shield.predict(obs)
            obs, _, terminated, truncated, _ = bare.step(given if np.ndim(given) else int(given))
            record, told, frames = shield.last_decision, shield.report(), shield.frame_decisions[0]
            counted = None
        done = terminated or truncated
        if done and shield is not None:
            counted = shield.statistics.summary()
        place, other = (np.array([*each.vehicle.position, each.vehicle.speed]) for each in (base, twin))
        yield action, record, told, frames, given, bool(np.array_equal(place, other)), counted
        if done:
            return


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("name", "placement"),
    [
        (name, placement)
        for name in CELLS
        for placement in WRAPPERS
        # `Shield` of actions alone is refused where every frame is verified.
        if not (placement == "actions" and name in ("highway, simulated inputs", "roundabout"))
    ],
)
def test_every_report_of_a_step_agrees_with_the_executed_action(name, placement):
    """The README's `last_decision` said "passed", "executed unchanged", for steps that `info["shield"]` called
    overridden. `3 -> 3` was reported as an override although no frame had changed."""
    reports, tally, met = [], Tally(), set()
    for seed in (912_000, 912_001):
        reports.clear()
        for action, record, told, frames, given, as_bare, counted in steps(name, placement, seed):
            for key in TOLD:
                assert same(told[key], getattr(record, key)), key
            held, other = [frame for frame in frames if frame.overridden], not np.array_equal(given, action)
            done = Intervention.OTHER_ACTION if other else Intervention.HELD_BACK if held else Intervention.NONE
            assert record.intervention is done
            assert record.overridden == (done is not Intervention.NONE)
            assert (record.reason is Reason.NONE) == (record.tier in (Tier.PASSED, Tier.OFF))
            assert np.array_equal(record.proposed, action)
            if done is Intervention.NONE:
                assert as_bare
            elif placement == "env" and not record.tier.fallback:
                assert not as_bare
            reports.append(told)
            tally.add({**told, "latency_ms": 0.0})
            met.add(done)
            if counted is not None and placement == "env":
                assert counted["decisions"] == len(reports)
                assert counted["overridden"] == sum(each["overridden"] for each in reports)
                assert counted["held_back"] == sum(each["intervention"] == "held back" for each in reports)
                assert counted["frames_overridden"] == sum(each["frames_overridden"] for each in reports)
        if counted is not None and placement != "env":
            assert counted["overridden"] == sum(each["overridden"] for each in reports)
    assert tally.held_back <= tally.overridden
    if "no shield" in name:
        assert met == {Intervention.NONE}


@pytest.mark.filterwarnings("ignore")
def test_several_egos_have_a_joint_record_and_one_record_each():
    env = ShieldedEnv(gym.make("intersection-multi-agent-v0"), EXACT)
    overridden = 0
    for seed in range(912_000, 912_004):
        env.reset(seed=seed)
        rng, done = np.random.default_rng(seed), False
        while not done:
            action = tuple(int(rng.integers(3)) for _ in range(2))
            *_, truncated, info = env.step(action)
            done = truncated or env.unwrapped._is_terminated()
            told, record = info["shield"], env.last_decision
            assert all(same(told[key], getattr(record, key)) for key in TOLD)
            assert record.proposed == action
            assert record.executed == tuple(each.executed for each in env.decisions)
            for own, each in zip(told["agents"], env.last_decisions, strict=True):
                assert all(same(own[key], getattr(each, key)) for key in TOLD)
            assert record.overridden == any(each.overridden for each in env.last_decisions)
            overridden += record.overridden
    assert overridden


def decision(tier, reason=Reason.UNVERIFIED, proposed=3, executed=3, margin=1.0):
    return Decision(proposed, executed, Reason.NONE if tier is Tier.PASSED else reason, tier, margin, 0.5)


def test_the_intervention_of_a_step_follows_from_its_frames():
    """Each intervention: none, held back, another action. A fallback comes before any other reason."""
    passed, governed, other = (decision(tier) for tier in (Tier.PASSED, Tier.GOVERNED, Tier.PASSED))
    other = decision(Tier.ALTERNATIVE, executed=1)
    assert passed.with_frames([passed] * 3).intervention is Intervention.NONE
    assert governed.with_frames([passed] * 3).tier is Tier.PASSED
    assert governed.with_frames([]).intervention is Intervention.HELD_BACK
    later = passed.with_frames([passed, governed])
    assert (later.intervention, later.tier, later.reason) == ("held back", Tier.GOVERNED, Reason.UNVERIFIED)
    assert later.latency == 1.5
    assert other.with_frames([passed]).intervention is Intervention.OTHER_ACTION
    stored = decision(Tier.STORED_PLAN, Reason.NO_SAFE_PLAN, margin=math.nan)
    fell = passed.with_frames([governed, stored])
    assert (fell.tier, fell.reason, fell.guarantee) == (Tier.STORED_PLAN, Reason.NO_SAFE_PLAN, "none")
    assert fell.margin == 1.0
    assert decision(Tier.LARGEST_MARGIN, Reason.NO_SAFE_PLAN, 4, 4).with_frames([]).intervention is Intervention.NONE
    assert math.isnan(decision(Tier.PASSED, margin=math.inf).with_frames([]).margin)
    assert decision(Tier.PASSED, margin=math.inf).with_frames([]).guarantee == "all vehicles seen"
