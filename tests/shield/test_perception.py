"""Scenes of observations: decoded as the simulator has it, followed through, and honest about what is not seen."""

from __future__ import annotations

import math
from dataclasses import replace

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecNormalize

from dynamics.roads.straight import StraightRoad
from dynamics.scenes.scene import EgoControl, Scene, SceneReader, Target
from shield import ConfigError, SceneError, Shield, ShieldConfig, ShieldedEnv
from shield.decision import Reason, Tier
from shield.perception.perceiving import ObservationPerception, PerceptionConfig
from shield.perception.sighting import decode
from shield.perception.spec import ObservationSpec
from shield.perception.tracking import Motions, Tracks, follow, sides
from shield.perception.undoing import as_shown
from shield.perception.unseen import Behind, Unseen, ahead, edges
from shield.procedures.decide import Core
from shield.procedures.meta_actions import MetaActions
from shield.procedures.screen import Wish

SEEN = {"type": "Kinematics", "vehicles_count": 15, "see_behind": True}
EXTRAS = ("presence", "heading", "cos_h", "sin_h", "cos_d", "long_off", "lat_off", "ang_off")
ROAD = StraightRoad.from_lanes(4)
_ANY = 20.0, 1e4, 1e9
"""A usual speed that says nothing."""


def make(observation, **config):
    return gym.make("highway-fast-v0", config={"observation": observation, **config})


def truth(base):
    """x from the ego's, y, vx and vy of everybody else."""
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
def test_what_is_decoded_is_the_simulator_s_truth(extras, order, count, options, seed, decisions):
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
    # Whoever is left out is beyond the edges.
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
def test_what_cannot_be_used_says_what_to_change(options, match):
    env = make({"type": "Kinematics", **options})
    env.reset(seed=0)
    with pytest.raises(ConfigError, match=match):
        ObservationSpec.of(env)


def test_other_observations_are_refused_with_what_to_take():
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
def test_what_cannot_be_read_is_an_error_and_falls_back(bad):
    with pytest.raises(SceneError):
        decode(ObservationSpec(), bad)
    env = ShieldedEnv(gym.make("highway-fast-v0"), perception="observation")
    env.reset(seed=0)
    env._door.show(bad)
    decision = env._door.decide(3)
    assert decision.reason is Reason.BAD_SCENE
    assert decision.tier is Tier.EMERGENCY


def test_nobody_is_lost_when_rows_are_shuffled():
    """Who has been given a number keeps it, and the same scene is seen as of sorted rows."""
    observation = {**SEEN, "vehicles_count": 30, "order": "shuffled"}
    env = make(observation)
    for seed in range(4):
        obs, _ = env.reset(seed=seed)
        base, known = env.unwrapped, {}
        reader = SceneReader(base)
        reader.check()
        perception = ObservationPerception(ObservationSpec.of(env), reader.map, (0.2, 5))
        for _ in range(8):
            scene = perception.see(obs, base.steps, reader.control)
            real = [v for v in base.road.vehicles if v is not base.vehicle]
            places = np.array([v.position for v in real]) - base.vehicle.position + scene.ego[:2]
            for row, who in zip(scene.others, scene.ids.tolist(), strict=True):
                if who < 0:
                    continue
                apart = np.hypot(*(places - row[:2]).T)
                assert apart.min() < 1e-3
                assert known.setdefault(who, real[int(apart.argmin())]) is real[int(apart.argmin())]
            obs, _, over, _, _ = env.step(int(base.np_random.integers(5)))
            if over:
                break
        assert len(known) >= 5


def test_everybody_is_seen_as_by_the_simulator_s_state():
    """With everything observed, the shield does what it does with the simulator's state."""
    same = total = 0
    for seed in range(1):
        executed = []
        for perception in ("simulator", "observation"):
            env = ShieldedEnv(make({**SEEN, "vehicles_count": 40}), perception=perception)
            env.reset(seed=seed)
            over, done = False, []
            while not over:
                _, _, terminated, truncated, info = env.step(3)
                done.append((int(env.last_decision.executed), info["shield"]["frames_overridden"]))
                over = terminated or truncated
                assert not info["crashed"]
            executed.append(done)
        total += len(executed[0])
        same += sum(a == b for a, b in zip(*executed, strict=False))
    assert same >= 0.9 * total


@pytest.mark.parametrize("seed", range(3))
def test_the_order_of_the_rows_changes_nothing(seed):
    """Whoever has a number is the same in every scene, wherever its row is."""
    rng, base = np.random.default_rng(seed), gym.make("highway-fast-v0").unwrapped
    base.reset(seed=seed)
    reader, config = SceneReader(base), ShieldConfig()
    cores = [Core(MetaActions(config)), Core(MetaActions(config))]
    lost = 0
    for k in range(40):
        scene = reader.read()
        many = len(scene.others)
        # Somebody is out of sight now and then.
        seen = np.sort(rng.permutation(many)[: many - (k % 7 == 3)])
        mixed = rng.permutation(seen)
        scenes = [replace(scene, others=scene.others[rows], ids=rows) for rows in (seen, mixed)]
        wish = Wish(3 if k % 9 else 0, reader.actions, None)
        one, other = (core.decide(each, wish) for core, each in zip(cores, scenes, strict=True))
        assert (one.executed, one.tier, one.reason) == (other.executed, other.tier, other.reason)
        assert one.margin == pytest.approx(other.margin, abs=1e-9, nan_ok=True)
        left, right = (core.memory.survey for core in cores)
        back = np.argsort(mixed)
        np.testing.assert_allclose(left.around.tables.numbers, right.around.tables.numbers[:, back])
        np.testing.assert_array_equal(left.comes, right.comes[:, back])
        np.testing.assert_array_equal(left.held, right.held[back])
        lost += many - len(seen)
        if k % 5 == 0:
            base.action_type.act(one.executed)
        base.road.act()
        base.road.step(0.2)
        base.steps += 1
    assert lost


@pytest.mark.parametrize("observation", [{"type": "Kinematics"}, SEEN])
@pytest.mark.parametrize("action", [0, 2, 3])
def test_nothing_but_the_observation_is_read_and_nobody_is_hit(observation, action, monkeypatch):
    def forbidden(self):
        raise AssertionError("the simulator's state was read")

    monkeypatch.setattr(SceneReader, "read", forbidden)
    env = ShieldedEnv(make(observation), perception="observation")
    for seed in range(300, 301):
        env.reset(seed=seed)
        over = False
        while not over:
            _, _, terminated, truncated, info = env.step(action)
            over = terminated or truncated
        assert not info["crashed"]


class Faster:
    def predict(self, obs, state=None, episode_start=None, deterministic=False):
        return (np.full(len(obs), 3) if np.ndim(obs) == 3 else 3), state


@pytest.mark.parametrize("frames", [True, False])
def test_a_shield_around_a_policy_reads_what_reaches_predict(frames):
    env = make(SEEN)
    obs, _ = env.reset(seed=5)
    shielded = Shield(Faster(), env=env, frames=frames, perception="observation")
    over = False
    while not over:
        action, _ = shielded.predict(obs)
        assert shielded.last_decision.reason is not Reason.BAD_SCENE
        obs, _, terminated, truncated, info = env.step(int(action))
        over = terminated or truncated
    assert not info["crashed"] or not frames


def test_normalised_and_stacked_observations_are_undone():
    inner = DummyVecEnv([lambda: make(SEEN)])
    world = VecFrameStack(VecNormalize(inner, norm_reward=False, clip_obs=1e6), 3)
    inner.seed(3)
    seen = world.reset()
    for _ in range(3):
        seen, *_ = world.step([1])
    base = inner.envs[0].unwrapped
    shown = as_shown(world, seen)
    np.testing.assert_allclose(shown[0], base.observation_type.observe(), atol=1e-4)
    world.reset()
    shielded = Shield(Faster(), env=world, perception="observation")
    action, _ = shielded.predict(seen)
    assert action.shape == (1,)


def test_scenes_are_observed_on_straight_highways_only():
    with pytest.raises(ConfigError, match="straight highway"):
        ShieldedEnv(gym.make("roundabout-v0"), perception="observation")
    with pytest.raises(ConfigError, match="unknown perception 'lidar'; have simulator, observation"):
        ShieldedEnv(gym.make("highway-fast-v0"), perception="lidar")


# -- who is who ------------------------------------------------------------------------------------------------


def test_the_filter_is_calibrated():
    """The squared distance between what is expected and seen has the mean that its covariance says: 4."""
    rng, noise = np.random.default_rng(0), np.diag(np.square([0.5, 0.4, 0.6, 0.3]))
    a, dt, n = (2.0, 1.0), 0.2, 40
    truth = rng.normal(0, 50, (n, 4)) + np.array([0, 0, 25, 0])
    truth[:, 0] += 1_000 * np.arange(n)  # so far apart that nobody is taken for another
    tracks, found, outside = Tracks(), [], 0
    for k in range(60):
        seen = truth + rng.multivariate_normal(np.zeros(4), noise, n)
        tracks = follow(tracks, seen, noise, dt, Motions(a, a, a, cruise=_ANY, sideways=1e3))
        if k > 20:
            found.append(tracks.innovation)
            spread = np.sqrt(np.einsum("nii->ni", tracks.covariance))
            outside += int((np.abs(tracks.mean - truth) > 3 * spread).sum())
        push = rng.normal(0, a, (n, 2))
        extra = rng.normal(0, np.array(a) * dt * dt / 4, (n, 2))
        truth[:, :2] += truth[:, 2:] * dt + push * dt * dt / 2 + extra
        truth[:, 2:] += push * dt
    values = np.concatenate(found)
    assert len(tracks.ids) == n
    assert not np.isnan(values).any()
    # The mean of so many chi^2 with 4 degrees is within this of 4 in 95 % of the cases; 1.5 times as wide.
    assert abs(values.mean() - 4) < 1.5 * 1.96 * math.sqrt(8 / len(values))
    assert outside <= 0.01 * 4 * len(values)


def test_who_leaves_is_forgotten_and_who_comes_is_new():
    noise = np.eye(4) * 1e-4
    one, two = [0.0, 0.0, 20.0, 0.0], [30.0, 4.0, 20.0, 0.0]
    tracks = follow(Tracks(), np.array([one, two]), noise, 0.1, Motions())
    assert tracks.ids.tolist() == [1, 2]
    tracks = follow(tracks, np.array([[33.0, 4.0, 20.0, 0.0]]) - [1.0, 0, 0, 0], noise, 0.1, Motions())
    assert tracks.ids.tolist() == [2]
    tracks = follow(tracks, np.array([[34.0, 4.0, 20.0, 0.0], [2.0, 0.0, 20.0, 0.0]]), noise, 0.1, Motions())
    assert tracks.ids.tolist() == [2, 3]


@given(patience=st.integers(0, 4), gone=st.integers(1, 6))
def test_somebody_may_be_missing_for_as_long_as_there_is_patience(patience, gone):
    noise, state = np.eye(4) * 0.01, np.array([[0.0, 0.0, 20.0, 0.0]])
    motions = Motions(cruise=_ANY)
    tracks = follow(Tracks(), state, noise, 0.1, motions, patience)
    for _ in range(gone):
        tracks = follow(tracks, np.zeros((0, 4)), noise, 0.1, motions, patience)
    assert len(tracks.ids) == (gone <= patience)
    if gone <= patience:
        assert tracks.mean[0, 0] == pytest.approx(2.0 * gone)


# -- who is not seen -------------------------------------------------------------------------------------------


def test_somebody_slow_may_be_beyond_the_last_row_in_every_lane():
    spec = ObservationSpec(rows=3)
    ego, others = np.array([100.0, 4.0, 0.0, 25.0]), np.array([[130.0, 4.0, 0.0, 20.0], [150.0, 8.0, 0.0, 12.0]])
    states = ahead(spec, 50.0, Unseen(slowest=15.0), ROAD, ego, others)
    assert states[:, 0].tolist() == [150.0, 150.0, 155.5, 150.0]
    assert states[:, 1].tolist() == [0.0, 4.0, 8.0, 12.0]
    assert set(states[:, 3].tolist()) == {12.0}
    assert not len(ahead(spec, spec.distance, Unseen(), ROAD, ego, others))


@given(st.lists(st.tuples(st.floats(15, 30), st.floats(-3, 3)), min_size=1, max_size=40), st.floats(15, 28))
def test_who_was_passed_is_never_nearer_than_it_is_thought_to_be(steps, speed):
    """Whatever it does below the speed that is assumed, and whatever the ego does."""
    unseen, behind, nobody = Unseen(), Behind(), np.zeros((0, 3))
    behind.go_on(unseen, 10.0, 25.0, 0.0, nobody, nobody)
    behind.go_on(unseen, 10.0, 25.0, 0.2, np.array([[-10.5, 4.0, speed]]), nobody)
    place, now = -10.5, speed
    for ego_speed, push in steps:
        now = min(max(now + min(push, unseen.acceleration) * 0.2, 0.0), speed + unseen.surge)
        place += (now - ego_speed) * 0.2
        behind.go_on(unseen, 10.0, ego_speed, 0.2, nobody, nobody)
        if place > -10.0:
            return  # it is in sight
        assert behind.passed[0, 0] >= place - 1e-9
        assert behind.passed[0, 0] <= -10.0


def test_who_comes_back_into_sight_is_no_longer_unseen():
    unseen, behind, nobody = Unseen(), Behind(), np.zeros((0, 3))
    behind.go_on(unseen, 10.0, 25.0, 0.0, nobody, nobody)
    behind.go_on(unseen, 10.0, 25.0, 0.2, np.array([[-10.5, 4.0, 24.0], [-11.0, 8.0, 24.0]]), nobody)
    assert len(behind.passed) == 2
    behind.go_on(unseen, 10.0, 20.0, 0.2, nobody, np.array([[-9.9, 4.1, 24.0]]))
    assert behind.passed[:, 1].tolist() == [8.0]


def test_in_the_worst_case_somebody_fast_is_right_behind():
    spec, perception = ObservationSpec(), PerceptionConfig(Unseen.worst())
    seen = np.zeros((5, 5))
    seen[0] = [1, 0.1, 4 / 16, 25 / 80, 0]
    control = EgoControl(Target(1, 25.0))
    scene = ObservationPerception(
        ObservationSpec(ranges={"x": (-200, 200), "y": (-16, 16), "vx": (-80, 80), "vy": (-80, 80)}),
        ROAD,
        (0.2, 5),
        perception,
    ).see(seen, 0, control)
    assert spec.behind == 10.0
    assert (scene.others_road[:, 0] - scene.ego_road[0]).tolist() == [-10.0] * 4
    assert set(scene.others_road[:, 3].tolist()) == {40.0}
    assert scene.ids.tolist() == [-1] * 4


@pytest.mark.parametrize("bad", [{"slowest": -1.0}, {"slowest": 31.0}, {"room": float("nan")}, {"surge": True}])
def test_assumptions_about_the_unseen_are_checked(bad):
    with pytest.raises(ConfigError):
        Unseen(**bad)


# -- what is seen through noise --------------------------------------------------------------------------------


@pytest.mark.parametrize("sigma", [0.5, 2.0])
def test_a_lane_change_is_found_under_noise(sigma):
    """One who has left its lane is not thought to be in it because it is likely to be."""
    rng, noise, dt = np.random.default_rng(1), np.eye(4) * sigma**2, 0.2
    motions, found = Motions(centers=np.array([0.0, 4.0, 8.0])), []
    for _ in range(30):
        tracks, y = Tracks(), 0.0
        for k in range(50):
            vy = 2.0 if 10 <= k < 20 else 0.0
            y += vy * dt
            seen = np.array([[20.0 * k * dt, y, 20.0, vy]]) + rng.normal(0, sigma, (1, 4))
            tracks = follow(tracks, seen, noise, dt, motions, patience=3)
        found.append(abs(tracks.mean[0, 1] - 4.0))
        assert len(tracks.ids) == 1
    assert np.mean(found) < 0.7
    assert max(found) < 2.0


def test_bounds_are_no_wider_than_what_was_known_before():
    """A leader of constant speed, shown with noise: its rear is never thought further back than it can have come."""
    rng, config = np.random.default_rng(2), ShieldConfig()
    core, control = Core(MetaActions(config)), EgoControl(Target(0, 25.0))
    wish, back = Wish(1, control.actions, None), None
    widest = 0.0
    for k in range(60):
        ego = np.array([25.0 * 0.2 * k, 0.0, 0.0, 25.0, 5.0, 2.0, 0.0])
        shift, slower = rng.normal(0, 0.3), rng.normal(0, 0.4)
        row = np.array([[60.0 + 25.0 * 0.2 * k + shift, 0.0, 0.0, 24.0 + slower, 6.0, 2.5, 0.0]])
        scene = Scene(ego, row, ROAD, control, 0.2, 5, k, np.array([1]), blurred=True)
        core.decide(scene, wish)
        survey = core.memory.survey
        rear = float(survey.around.states[0, 0]) - 3.0
        if back is not None:
            assert rear >= back - 1e-9
            assert rear >= row[0, 0] - 3.0 - 1e-9
        widest = max(widest, rear - (row[0, 0] - 3.0))
        back = float(survey.around.rear(1)[0, 0])
    assert widest > 0.1


def test_newcomers_and_scenes_that_are_exact_are_not_narrowed():
    control, around = EgoControl(Target(0, 25.0)), []
    for blurred, ids in ((True, [1]), (True, [2]), (False, [2])):
        row = np.array([[60.0, 0.0, 0.0, 24.0, 6.0, 2.5, 0.0]])
        ego = np.array([0.0, 0.0, 0.0, 25.0, 5.0, 2.0, 0.0])
        around.append(Scene(ego, row, ROAD, control, 0.2, 5, len(around), np.array(ids), blurred))
    core = Core(MetaActions(ShieldConfig()))
    for scene in around:
        core.decide(scene, Wish(1, control.actions, None))
        assert float(core.memory.survey.around.states[0, 0]) == 60.0


def test_what_is_late_is_taken_to_where_it_is_by_now():
    """Others that keep their speed, shown relative to where the ego was 5 frames ago, while the ego accelerates."""
    spec = ObservationSpec(rows=3, see_behind=True)
    perception = ObservationPerception(spec, ROAD, (0.2, 5), PerceptionConfig(delay=5, cruise=_ANY))
    control, egos, x = EgoControl(Target(1, 25.0)), [], 0.0
    start, speeds = np.array([40.0, -30.0]), np.array([22.0, 18.0])
    for k in range(40):
        v = 20.0 + 0.1 * k
        egos.append((x, v))
        then = max(k - 5, 0)
        place, speed = egos[then]
        obs = np.zeros((3, 5))
        obs[0] = [1, 0.0, 4.0, v, 0.0]
        obs[1:, 0] = 1
        obs[1:, 1], obs[1:, 3] = start + speeds * 0.2 * then - place, speeds - speed
        obs[1:, 2] = [0.0, 4.0]
        scene = perception.see(obs, k, control)
        seen = scene.others[scene.ids >= 0]
        truth = start + speeds * 0.2 * k
        if k > 8:
            order = np.argsort(-seen[:, 0])
            np.testing.assert_allclose(seen[order, 0], truth, atol=0.05)
            np.testing.assert_allclose(seen[order, 1], [4.0, 8.0], atol=0.05)
            assert (seen[:, 4] > 6.0).all()
            assert seen[order[0], 3] < 22.0
            assert seen[order[1], 3] > 18.0
        assert scene.ego[3] == pytest.approx(v)
        x += v * 0.2


def test_a_stranger_comes_nearer_as_fast_as_it_may():
    unseen, behind, nobody = Unseen(fastest=30.0, room=100.0), Behind(), np.zeros((0, 3))
    behind.go_on(unseen, 10.0, 20.0, 0.0, nobody, nobody)
    for _ in range(20):
        behind.go_on(unseen, 10.0, 20.0, 0.2, nobody, nobody)
    assert behind.stranger == pytest.approx(-60.0)
    states = behind.states(unseen, ROAD, np.array([500.0, 4.0, 0.0, 20.0]), 200.0)
    assert states[:, 0].tolist() == pytest.approx([440.0] * 4)
    assert not len(behind.states(unseen, ROAD, np.array([500.0, 4.0, 0.0, 20.0]), 50.0))
    for _ in range(100):
        behind.go_on(unseen, 10.0, 20.0, 0.2, nobody, nobody)
    assert behind.stranger == -10.0


def test_a_decision_says_which_guarantee_it_has():
    def guarantees(observation, perception, action=3, mode="full"):
        env = ShieldedEnv(make(observation, vehicles_count=20), ShieldConfig(mode=mode), perception=perception)
        env.reset(seed=0)
        return {env.step(action)[4]["shield"]["guarantee"] for _ in range(4)}

    assert guarantees(SEEN, "simulator") == {"full"}
    assert guarantees({**SEEN, "vehicles_count": 50}, "observation") == {"full"}
    assert guarantees({"type": "Kinematics"}, "observation") == {"assumed"}
    noisy = PerceptionConfig(noise=(0.5, 0.5, 0.5, 0.5), bound=2.0)
    assert guarantees({**SEEN, "vehicles_count": 50}, noisy) <= {"probabilistic", "none"}
    assert guarantees(SEEN, "simulator", action=9) == {"none"}
    assert guarantees(SEEN, "simulator", mode="distance") == {"none"}
    env = ShieldedEnv(make(SEEN), perception=noisy)
    env.reset(seed=0)
    env.step(1)
    assert env.last_decision.level == pytest.approx(0.9772, abs=1e-4)


def test_shuffled_rows_of_too_many_say_nothing_of_who_is_left_out():
    seen = np.zeros((3, 5))
    seen[:, 0], seen[1:, 1] = 1, [60.0, -40.0]
    known, shuffled = ObservationSpec(rows=3, see_behind=True), ObservationSpec(rows=3, see_behind=True, sorted=False)
    assert edges(known, decode(known, seen)) == (60.0, 60.0)
    assert edges(shuffled, decode(shuffled, seen)) == (5.0, 5.0)
    seen[2] = 0.0
    assert edges(shuffled, decode(shuffled, seen)) == (200.0, 200.0)


def test_somebody_slow_beyond_the_edge_is_in_the_scene():
    seen = np.zeros((2, 5))
    seen[:, 0], seen[0, 2:4], seen[1, 1:4] = 1, [4.0, 25.0], [50.0, 0.0, -3.0]
    spec, control = ObservationSpec(rows=2, see_behind=True), EgoControl(Target(1, 25.0))
    scene = ObservationPerception(spec, ROAD, (0.2, 5)).see(seen, 0, control)
    far = scene.others[(scene.ids < 0) & (scene.others[:, 0] > scene.ego[0])]
    assert sorted(far[:, 0].tolist()) == pytest.approx([50.0, 50.0, 50.0, 55.5])
    assert set(far[:, 3].tolist()) == {18.0}
    assert (scene.ids >= 0).sum() == 1


def test_what_is_remembered_of_those_known_again_is_what_is_remembered_in_exact_scenes():
    base = gym.make("highway-fast-v0").unwrapped
    base.reset(seed=4)
    reader = SceneReader(base)
    exact, known = (Core(MetaActions(ShieldConfig())) for _ in range(2))
    spent = 0.0
    for k in range(30):
        scene = reader.read()
        mixed = np.random.default_rng(k).permutation(len(scene.others))
        wish = Wish(1, reader.actions, None)
        exact.decide(scene, wish)
        known.decide(replace(scene, others=scene.others[mixed], ids=mixed), wish)
        one, other = exact.memory.survey.around.tables, known.memory.survey.around.tables
        np.testing.assert_allclose(one.numbers[:, mixed], other.numbers, atol=1e-9)
        np.testing.assert_allclose(one.recent[mixed], other.recent, atol=1e-9)
        spent = max(spent, float(one.recent.max(initial=0.0)))
        base.road.act()
        base.road.step(0.2)
        base.steps += 1
    assert spent > 0.1


# -- what is known where a sensor says little ------------------------------------------------------------------


def _mistakes(places):
    """How far two who drive 25 m apart in one lane are thought to be from where they are, through noise of 40 m."""
    rng, sigma, dt, found = np.random.default_rng(5), np.array([40.0, 2.4, 16.0, 16.0]), 0.2, []
    noise, motions = np.diag(sigma**2), Motions(centers=np.array([0.0, 4.0, 8.0]))
    for _ in range(20):
        tracks = Tracks()
        for k in range(50):
            truth = np.array([[30.0, 4.0, 21.0, 0.0], [55.0, 4.0, 21.0, 0.0]])
            truth[:, 0] += 21.0 * k * dt
            seen = truth + rng.normal(0, sigma, (2, 4))
            tracks = follow(tracks, seen, noise, dt, motions, 3, np.arange(2) if places else None)
        if len(tracks.ids) == 2:
            found.append(np.diff(np.sort(tracks.mean[:, 0]))[0] - 25.0)
    return np.sqrt(np.mean(np.square(found)))


def test_rows_that_are_sorted_say_who_is_who_where_what_they_show_does_not():
    assert _mistakes(places=True) < 0.7 * _mistakes(places=False)


def test_nobody_is_taken_to_be_as_fast_as_a_bad_sensor_shows():
    """A velocity through noise of 16 m/s says less than how fast somebody drives."""
    noise = np.diag(np.square([40.0, 2.4, 16.0, 16.0]))
    seen = np.array([[50.0, 4.0, 40.0, -12.0]])
    tracks = follow(Tracks(), seen, noise, 0.2, Motions())
    assert abs(tracks.mean[0, 2] - 21.0) < 1.0
    assert abs(tracks.mean[0, 3]) < 0.2
    exact = follow(Tracks(), seen, np.eye(4) * 1e-8, 0.2, Motions())
    np.testing.assert_allclose(exact.mean, seen, atol=1e-6)


@given(
    chances=st.tuples(st.floats(0.01, 1), st.floats(0.01, 1), st.floats(0.01, 1)),
    means=st.tuples(*[st.floats(-5, 5)] * 3),
    spread=st.tuples(*[st.floats(0.1, 4)] * 3),
    bound=st.floats(0.5, 3),
)
@settings(max_examples=40, deadline=None)
def test_the_sides_of_a_mixture_are_exceeded_as_often_as_they_say(chances, means, spread, bound):
    weights = np.array(chances) / sum(chances)
    tracks = Tracks(
        ids=np.array([1]),
        means=np.repeat(np.array(means)[None, :, None], 4, axis=2),
        covariances=(np.array(spread) ** 2)[None, :, None, None] * np.eye(4),
        chances=weights[None],
        missed=np.array([0]),
    )
    low, high = sides(tracks, bound)
    for edge, sign in ((low[0, 0], -1), (high[0, 0], 1)):
        beyond = [0.5 * math.erfc(sign * (edge - m) / s / math.sqrt(2)) for m, s in zip(means, spread, strict=True)]
        wanted = 0.5 * math.erfc(bound / math.sqrt(2))
        assert weights @ beyond == pytest.approx(wanted, rel=0.02)
        assert weights @ beyond <= wanted + 1e-12


def test_bounds_grow_with_the_noise():
    """The same draws, larger: bodies are never taken to reach less far."""
    control, last = EgoControl(Target(1, 25.0)), None
    for sigma in (0.1, 0.5, 1.0, 2.0, 4.0):
        rng, spec = np.random.default_rng(3), ObservationSpec(rows=2, see_behind=True)
        config = PerceptionConfig(noise=(sigma,) * 4)
        perception = ObservationPerception(spec, ROAD, (0.2, 5), config)
        for k in range(20):
            seen = np.zeros((2, 5))
            seen[0], seen[1] = [1, 0.0, 4.0, 21.0, 0.0], [1, 40.0, 0.0, 0.0, 0.0]
            seen[1, 1:] += 0.05 * sigma * rng.standard_normal(4)
            scene = perception.see(seen, k, control)
        size = scene.others[scene.ids >= 0, 4:6][0]
        if last is not None:
            assert (size > last).all()
        last = size
