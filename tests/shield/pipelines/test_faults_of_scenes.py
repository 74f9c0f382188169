"""A fault in a scene or in a stage verifies nothing, and the record says what happened."""

import numpy as np
import pytest
from cores import nowhere
from faults import INF, NAN, SLOWER, Policy, kind, spied

from dynamics.vehicle.rollouts import Rollouts
from shield import Shield, ShieldedEnv
from shield.certificate.road import verify
from shield.decision import Reason, Tier
from shield.errors import SceneError

# -- scenes that cannot be --------------------------------------------------------------------------------------


def corrupt(env, who, attribute, value):
    base = env.unwrapped
    base.vehicle.check_collisions = False  # the simulator's own test of polygons raises on NaN
    vehicle = base.vehicle if who == "ego" else next(v for v in base.road.vehicles if v is not base.vehicle)
    if attribute == "position":
        vehicle.position = np.array([value, vehicle.position[1]])
    else:
        setattr(vehicle, attribute, value)


BROKEN = [
    (who, attribute, value)
    for who in ("ego", "other")
    for attribute in ("position", "heading", "speed")
    for value in (NAN, INF)
] + [("other", "LENGTH", NAN), ("other", "WIDTH", NAN)]


@pytest.mark.parametrize(("who", "attribute", "value"), BROKEN)
def test_a_state_that_is_not_finite_falls_back_at_the_decision(who, attribute, value, spy):
    obs, _ = spy.reset(seed=0)
    shield = Shield(Policy(3), env=spy)
    shield.predict(obs)
    spy.step(1)
    corrupt(spy, who, attribute, value)
    with np.errstate(all="ignore"):
        executed, _ = shield.predict(obs)
    assert int(executed) != 3
    assert spy.action_space.contains(int(executed))
    assert shield.last_decision.reason == Reason.BAD_SCENE
    assert shield.last_decision.tier.fallback


@pytest.mark.parametrize(("who", "attribute", "value"), BROKEN)
def test_a_state_that_is_not_finite_falls_back_at_every_frame(who, attribute, value, spy, shielded):
    shielded.step(1)
    spy.seen.clear()
    corrupt(shielded, who, attribute, value)
    with np.errstate(all="ignore"):
        *_, info = shielded.step(3)
    assert spy.seen == [SLOWER]
    assert kind(info["shield"])[0] == "bad_scene"
    assert Tier(info["shield"]["tier"]).fallback
    if who == "ego":  # of the others, the simulator itself may lose the broken one's state
        assert info["shield"]["frames_overridden"] == 5


def test_a_state_that_breaks_between_two_decisions_is_noticed_at_that_frame(shielded):
    base, frames = shielded.unwrapped, []
    step = base.road.step

    def breaking(dt):
        step(dt)
        frames.append(dt)
        if len(frames) == 2:
            corrupt(shielded, "ego", "speed", NAN)

    base.road.step = breaking
    with np.errstate(all="ignore"):
        *_, info = shielded.step(1)
    assert kind(info["shield"]) == ("bad_scene", "emergency")
    assert info["shield"]["frames_overridden"] == 3


def test_a_broken_episode_does_not_affect_the_next_one(shielded):
    corrupt(shielded, "ego", "speed", NAN)
    with np.errstate(all="ignore"):
        shielded.step(3)
    shielded.reset(seed=0)
    *_, info = shielded.step(1)
    assert kind(info["shield"]) == ("none", "passed")


def test_a_missing_road_is_a_bad_scene_for_predict(spy):
    obs, _ = spy.reset(seed=0)
    shield = Shield(Policy(3), env=spy)
    spy.unwrapped.road = None
    executed, _ = shield.predict(obs)
    assert int(executed) == SLOWER
    assert (shield.last_decision.reason, shield.last_decision.tier) == (Reason.BAD_SCENE, Tier.EMERGENCY)


def test_a_missing_road_stops_the_shielded_environment(spy, shielded):
    spy.unwrapped.road = None
    with pytest.raises(SceneError, match=r"call reset\(\) first"):
        shielded.step(3)
    assert spy.seen == []


# -- stages that break ------------------------------------------------------------------------------------------


ROLLS = "run", "run_brakes"


def break_rollouts(monkeypatch):
    """All rollouts of the ego are NaN."""
    for name in ROLLS:
        run = getattr(Rollouts, name)
        monkeypatch.setattr(Rollouts, name, lambda self, *args, run=run: np.full_like(run(self, *args), NAN))


@pytest.fixture(params=["rollouts", "occupancy"])
def nan_stage(request, monkeypatch):
    """A stage that computes NaN: the ego's rollouts, or where the others can be."""
    if request.param == "rollouts":
        break_rollouts(monkeypatch)
    else:
        monkeypatch.setattr(verify, "evaluate_paths", nowhere(verify.evaluate_paths))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.usefixtures("nan_stage")
def test_a_stage_that_computes_nan_verifies_nothing(seed, spy):
    env = ShieldedEnv(spy)
    env.reset(seed=seed)
    with np.errstate(all="ignore"):
        *_, info = env.step(3)
    assert 3 not in spy.seen
    assert kind(info["shield"]) == ("no_safe_plan", "emergency")
    assert info["shield"]["overridden"]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.usefixtures("nan_stage")
@pytest.mark.parametrize(("frames", "tier"), [(True, Tier.EMERGENCY), (False, Tier.LARGEST_MARGIN)])
def test_a_stage_that_computes_nan_verifies_nothing_for_predict(seed, spy, frames, tier):
    shield = Shield(Policy(3), spy, "worst-case", frames)
    obs, _ = spy.reset(seed=seed)
    with np.errstate(all="ignore"):
        shield.predict(obs)
    assert (shield.last_decision.reason, shield.last_decision.tier) == (Reason.NO_SAFE_PLAN, tier)


@pytest.mark.parametrize("placement", ["env", "predict"])
def test_rollouts_that_are_nan_do_not_pass_on_an_empty_road(placement, monkeypatch):
    break_rollouts(monkeypatch)
    spy = spied(vehicles_count=0)
    obs, _ = spy.reset(seed=0)
    shield = Shield(Policy(3), env=spy)
    env = ShieldedEnv(spy)
    if placement == "env":
        env.reset(seed=0)
    with np.errstate(all="ignore"):
        env.step(3) if placement == "env" else shield.predict(obs)
    last = env.last_decision if placement == "env" else shield.last_decision
    assert last.tier.fallback
    assert last.reason == Reason.NO_SAFE_PLAN


@pytest.mark.parametrize("stage", [(Rollouts, *ROLLS), (verify, "evaluate_paths")], ids=["rollouts", "occupancy"])
def test_when_a_stage_raises_nothing_unfiltered_reaches_the_environment(stage, spy, shielded, monkeypatch):
    def broken(*args, **kwargs):
        raise RuntimeError("stage")

    for name in stage[1:]:
        monkeypatch.setattr(stage[0], name, broken)
    try:
        *_, info = shielded.step(3)
    except RuntimeError:
        assert spy.seen == []
    else:
        assert 3 not in spy.seen
        assert Tier(info["shield"]["tier"]).fallback
    shield = Shield(Policy(3), env=spy)
    try:
        executed, _ = shield.predict(spy.reset(seed=0)[0])
    except RuntimeError:
        pass
    else:
        assert int(executed) != 3
        assert shield.last_decision.tier.fallback
