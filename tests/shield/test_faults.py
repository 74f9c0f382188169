"""Whatever breaks, the unfiltered action does not reach the environment, and the record says what happened."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from cores import nowhere

from dynamics.vehicle.rollouts import Rollouts
from shield import Shield, ShieldedEnv
from shield.certificate import verify
from shield.decision import Reason, Tier
from shield.errors import ConfigError, PolicyError, SceneError

NAN, INF = float("nan"), float("inf")
SLOWER = 4
LABELS = {"type": "DiscreteMetaAction"}


class Spy(gym.Wrapper):
    """Remembers what reached the environment."""

    def __init__(self, env):
        super().__init__(env)
        self.seen = []

    def step(self, action):
        self.seen.append(action)
        return self.env.step(action)


class Policy:
    """Returns, or raises, what it is told to."""

    def __init__(self, action):
        self.action = action

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        if isinstance(self.action, Exception):
            raise self.action
        return self.action, state


def spied(**config):
    env = Spy(gym.make("highway-fast-v0", config={"duration": 20, **config}))
    env.reset(seed=0)
    return env


@pytest.fixture
def spy():
    return spied()


@pytest.fixture
def shielded(spy):
    env = ShieldedEnv(spy)
    env.reset(seed=0)
    return env


def kind(record):
    return record["reason"], record["tier"]


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


@pytest.mark.parametrize("action", NO_ACTIONS.values(), ids=NO_ACTIONS)
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


@pytest.mark.parametrize("action", SHAPES.values(), ids=SHAPES)
def test_a_batch_of_the_wrong_size_is_refused(action, spy):
    obs, _ = spy.reset(seed=0)
    with pytest.raises(ConfigError, match="actions for 1 environments"):
        Shield(Policy(action), env=spy).predict(obs)


@pytest.mark.parametrize("action", [NAN, 99])
def test_after_a_verified_decision_a_bad_action_plays_the_stored_plan(action, spy):
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
def test_a_policy_that_raises_does_not_take_the_car_with_it(error, batched, spy):
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


def test_one_bad_row_of_a_batch_spoils_no_other():
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
@pytest.mark.parametrize("door", ["env", "predict"])
def test_scores_that_break_do_not_stop_an_override(scores, door):
    overridden = 0
    inner = spied()
    env = ShieldedEnv(inner, policy=Scored(scores)) if door == "env" else inner
    policy = Scored(scores) if door == "env" else Shield(Scored(scores), env=env)
    obs, _ = env.reset(seed=0)
    done = False
    while not done:
        obs, _, terminated, truncated, _ = env.step(policy.predict(obs)[0])
        done = terminated or truncated
        last = env.last_decision if door == "env" else policy.last_decision
        overridden += last.overridden
    assert all(inner.action_space.contains(int(a)) for a in inner.seen)
    assert overridden


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


def test_after_a_broken_episode_the_next_one_is_as_good_as_new(shielded):
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
        monkeypatch.setattr(verify, "judged", nowhere(verify.judged))


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
    shield = Shield(Policy(3), env=spy, frames=frames)
    obs, _ = spy.reset(seed=seed)
    with np.errstate(all="ignore"):
        shield.predict(obs)
    assert (shield.last_decision.reason, shield.last_decision.tier) == (Reason.NO_SAFE_PLAN, tier)


@pytest.mark.parametrize("door", ["env", "predict"])
def test_rollouts_that_are_nan_do_not_pass_on_an_empty_road(door, monkeypatch):
    break_rollouts(monkeypatch)
    spy = spied(vehicles_count=0)
    obs, _ = spy.reset(seed=0)
    shield = Shield(Policy(3), env=spy)
    env = ShieldedEnv(spy)
    if door == "env":
        env.reset(seed=0)
    with np.errstate(all="ignore"):
        env.step(3) if door == "env" else shield.predict(obs)
    last = env.last_decision if door == "env" else shield.last_decision
    assert last.tier.fallback
    assert last.reason == Reason.NO_SAFE_PLAN


@pytest.mark.parametrize("stage", [(Rollouts, *ROLLS), (verify, "judged")], ids=["rollouts", "occupancy"])
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
