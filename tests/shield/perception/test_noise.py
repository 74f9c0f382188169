"""Observations with noise and delay."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from observed_roads import ANY, ROAD, SEEN, make

from dynamics.scenes.scene import EgoControl, Scene, SceneReader, Target
from evaluation.wrappers import SENSORS, SensorNoise
from shield import ShieldConfig
from shield.decision import Tier
from shield.perception.perceiving import ObservationPerception, PerceptionConfig
from shield.perception.scenes import ObservedScenes, observe_now
from shield.perception.spec import ObservationSpec
from shield.perception.tracking import MotionModels, Tracks, bounds_of, update_tracks
from shield.pipelines.decide import DecisionCore
from shield.pipelines.frames import FramePipeline
from shield.pipelines.meta_actions import MetaActionPipeline
from shield.pipelines.screen import MetaActionProposal


@pytest.mark.parametrize("sigma", [0.5, 2.0])
def test_a_lane_change_is_detected_under_noise(sigma):
    """A vehicle that has left its lane is not assumed inside it because of the prior."""
    rng, noise, dt = np.random.default_rng(1), np.eye(4) * sigma**2, 0.2
    motions, found = MotionModels(centers=np.array([0.0, 4.0, 8.0])), []
    for _ in range(30):
        tracks, y = Tracks(), 0.0
        for k in range(50):
            vy = 2.0 if 10 <= k < 20 else 0.0
            y += vy * dt
            seen = np.array([[20.0 * k * dt, y, 20.0, vy]]) + rng.normal(0, sigma, (1, 4))
            tracks = update_tracks(tracks, seen, noise, dt, motions, missed_limit=3)
        found.append(abs(tracks.mean[0, 1] - 4.0))
        assert len(tracks.ids) == 1
    assert np.mean(found) < 0.7
    assert max(found) < 2.0


def test_bounds_are_no_wider_than_those_predicted_from_the_frame_before():
    """A leader of constant speed, observed with noise: its rear bound is never behind the reachable one."""
    rng, config = np.random.default_rng(2), ShieldConfig()
    core, control = DecisionCore(MetaActionPipeline(config)), EgoControl(Target(0, 25.0))
    wish, back = MetaActionProposal(1, control.actions, None), None
    widest = 0.0
    for k in range(60):
        ego = np.array([25.0 * 0.2 * k, 0.0, 0.0, 25.0, 5.0, 2.0, 0.0])
        shift, slower = rng.normal(0, 0.3), rng.normal(0, 0.4)
        row = np.array([[60.0 + 25.0 * 0.2 * k + shift, 0.0, 0.0, 24.0 + slower, 6.0, 2.5, 0.0]])
        scene = Scene(ego, row, ROAD, control, 0.2, 5, k, np.array([1]), blurred=True)
        core.decide(scene, wish)
        verifier = core.memory.verifier
        rear = float(verifier.around.states[0, 0]) - 3.0
        if back is not None:
            assert rear >= back - 1e-9
            assert rear >= row[0, 0] - 3.0 - 1e-9
        widest = max(widest, rear - (row[0, 0] - 3.0))
        back = float(verifier.around.rear(1)[0, 0])
    assert widest > 0.1


def test_newcomers_and_scenes_that_are_exact_are_not_narrowed():
    control, around = EgoControl(Target(0, 25.0)), []
    for blurred, ids in ((True, [1]), (True, [2]), (False, [2])):
        row = np.array([[60.0, 0.0, 0.0, 24.0, 6.0, 2.5, 0.0]])
        ego = np.array([0.0, 0.0, 0.0, 25.0, 5.0, 2.0, 0.0])
        around.append(Scene(ego, row, ROAD, control, 0.2, 5, len(around), np.array(ids), blurred))
    core = DecisionCore(MetaActionPipeline(ShieldConfig()))
    for scene in around:
        core.decide(scene, MetaActionProposal(1, control.actions, None))
        assert float(core.memory.verifier.around.states[0, 0]) == 60.0


def test_a_delayed_observation_is_extrapolated_to_the_present():
    """Other vehicles keep their speed and are observed relative to the ego's place 5 frames ago, while the ego
    accelerates."""
    spec = ObservationSpec(rows=3, see_behind=True)
    perception = ObservationPerception(spec, ROAD, (0.2, 5), PerceptionConfig(delay=5, usual_speed=ANY))
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


@given(low=st.floats(0.02, 20.0), times=st.floats(1.05, 10.0), seed=st.integers(0, 10**6), steps=st.integers(1, 8))
@settings(max_examples=25, deadline=None)
def test_bounds_shrink_as_the_noise_does(low, times, seed, steps):
    """For each vehicle and side, for any observation: a better sensor gives bounds that reach less far."""
    rng, widths = np.random.default_rng(seed), []
    drawn = rng.standard_normal((steps, 4))
    for sigma in (low, low * times):
        tracks, noise = Tracks(), np.eye(4) * sigma**2
        for k in range(steps):
            state = np.array([[40.0 + 21.0 * 0.2 * k, 4.0, 21.0, 0.0]])
            # The same draws, relative to the prediction, so that all motions are as likely as under the other noise.
            seen = state + 0.01 * low * drawn[k]
            tracks = update_tracks(tracks, seen, noise, 0.2, MotionModels())
        below, above = bounds_of(tracks, 2.0)
        widths.append((above - below)[0])
    assert (widths[0] < widths[1]).all()


@given(seed=st.integers(0, 10**6), corners=st.booleans(), sigma=st.sampled_from([0.3, 1.0, 3.0]))
@settings(max_examples=30, deadline=None)
def test_a_vehicle_within_the_bounds_is_covered_by_the_body_of_the_scene(seed, corners, sigma):
    """The body in the scene contains the body of a car anywhere within the stated bounds, and its speed is the worse
    one."""
    rng = np.random.default_rng(seed)
    perception = ObservationPerception(
        ObservationSpec(rows=3, see_behind=True), ROAD, (0.2, 5), PerceptionConfig(noise=(sigma,) * 4)
    )
    control = EgoControl(Target(1, 25.0))
    for k in range(6):
        seen = np.zeros((3, 5))
        seen[0] = [1, 0.0, 4.0, 21.0, 0.0]
        seen[1:, 0], seen[1:, 1:3] = 1, [[50.0, 0.0], [-50.0, 4.0]]
        seen[1:, 1:] += sigma * rng.standard_normal((2, 4))
        scene = perception.see(seen, k, control)
    low, high = bounds_of(perception.tracks, perception.bounds)
    body = perception.spec.body
    for row, below, above in zip(scene.others[scene.ids >= 0], low, high, strict=True):
        shares = rng.random(4)
        true = below + (np.round(shares) if corners else shares) * (above - below)
        assert row[0] - row[4] / 2 <= true[0] - body[0] / 2 + 1e-9
        assert row[0] + row[4] / 2 >= true[0] + body[0] / 2 - 1e-9
        assert row[1] - row[5] / 2 <= true[1] - body[1] / 2 + 1e-9
        assert row[1] + row[5] / 2 >= true[1] + body[1] / 2 - 1e-9
        along = row[3] * math.cos(row[2])
        assert along <= true[2] + 1e-9 if row[0] > scene.ego[0] else along >= true[2] - 1e-9


@pytest.mark.parametrize("seed", range(5000, 5003))
def test_the_certificate_holds_for_any_vehicle_within_the_bounds(seed):
    """A plan verified in a scene of bounds also verifies with cars anywhere within them."""
    rng, config = np.random.default_rng(seed), ShieldConfig()
    env = make(SEEN)
    env.reset(seed=seed)
    base = env.unwrapped
    reader = SceneReader(base)
    reader.check()
    verified = 0
    for _ in range(15):
        exact = reader.read()
        half = rng.uniform(0.2, 2.0, (len(exact.others), 2))
        slower = rng.uniform(0.0, 1.0, len(exact.others))
        ahead = exact.others[:, 0] > exact.ego[0]
        rows = exact.others.copy()
        # Bounds that contain the truth at a random place.
        rows[:, :2] += rng.uniform(-1, 1, half.shape) * half
        rows[:, 4:6] += 2 * half
        rows[:, 3] += np.where(ahead, -slower, slower)
        ids = np.arange(len(rows))
        wide = replace(exact, others=rows, ids=ids, blurred=True)
        true = replace(exact, ids=ids)
        for action in range(len(exact.control.actions)):
            wish = MetaActionProposal(action, exact.control.actions, None)
            one, other = (DecisionCore(MetaActionPipeline(config)).decide(scene, wish) for scene in (wide, true))
            if one.tier is Tier.PASSED:
                verified += 1
                assert other.tier is Tier.PASSED
                assert other.margin >= 0.0
        env.step(int(rng.integers(5)))
        if base.vehicle.crashed:
            break
    assert verified >= 5


def hemmed(beside, ahead, speed=20.0):
    """An ego in the middle lane, bounds all over the road, one vehicle likely beside it and one likely ahead."""
    likely = np.array([[*beside, 0.0, 20.0, 5.0, 2.0, 0.0], [*ahead, 0.0, 18.0, 5.0, 2.0, 0.0]])
    rows = likely.copy()
    rows[:, 4:6] += [[80.0, 6.0]]
    ego = np.array([0.0, 4.0, 0.0, speed, 5.0, 2.0, 0.0])
    control = EgoControl(Target(1, 30.0))
    return Scene(ego, rows, ROAD, control, 0.2, 5, 0, np.array([1, 2]), blurred=True, likely=likely)


@pytest.mark.parametrize(("side", "free"), [(0.0, 2), (8.0, 0)])
def test_the_ego_does_not_swerve_into_a_likely_vehicle_beside_it(side, free):
    """With bounds over the whole road the largest margin does not discriminate; the likely places do."""
    scene = hemmed((1.0, side), (9.0, 4.0))
    frames = FramePipeline(ShieldConfig())
    decision = DecisionCore(frames).decide(scene, Target(1, 30.0))
    assert decision.tier is Tier.LARGEST_MARGIN
    assert not decision.tier.verified
    assert decision.margin < 0.0
    assert decision.executed.lane in (1, free)
    # At 2 m/s more than the leader, the ego does not continue its proposal.
    assert decision.executed.acceleration < 0.0 or decision.executed.lane == free


@pytest.mark.parametrize(("side", "free"), [(0.0, 2), (8.0, 0)])
def test_the_fallback_uses_the_likely_places_inside_bounds(side, free):
    """No plan clears the bounds. Behind a near leader the ego takes the free lane; for a likely distant one it does
    not brake hardest."""
    near, far = (
        DecisionCore(FramePipeline(ShieldConfig())).decide(hemmed((1.0, side), (gap, 4.0)), Target(1, 30.0))
        for gap in (7.0, 40.0)
    )
    assert near.tier is far.tier is Tier.LARGEST_MARGIN
    assert near.executed.lane == free
    assert far.executed.lane == 1
    assert far.executed.acceleration > -1.0


def test_a_likely_place_in_the_way_is_braked_for():
    decisions = [
        DecisionCore(FramePipeline(ShieldConfig())).decide(hemmed((1.0, 0.0), (gap, 4.0)), Target(1, 30.0)).executed
        for gap in (6.0, 60.0)
    ]
    assert decisions[0].acceleration < -4.0 or decisions[0].lane == 2


def test_bounds_are_narrowed_towards_the_likely_place():
    scene = hemmed((1.0, 0.0), (9.0, 4.0))
    np.testing.assert_array_equal(scene.with_shrunk_bounds(1.0).others, scene.others)
    np.testing.assert_array_equal(scene.with_shrunk_bounds(0.0).others, scene.likely)
    lengths = [scene.with_shrunk_bounds(share).others[0, 4] for share in (0.0, 0.25, 0.5, 1.0)]
    assert lengths == pytest.approx([5.0, 25.0, 45.0, 85.0])
    exact = replace(scene, likely=None)
    assert exact.with_shrunk_bounds(0.5) is exact


def test_a_noisy_observation_has_likely_places():
    env = SensorNoise(make(SEEN), SENSORS["metric-2"])
    env.reset(seed=3)
    scenes = ObservedScenes(env)
    scenes.check()
    for _ in range(5):
        scenes.show(observe_now(env))
        scene = scenes.read()
        assert scene.likely is not None
        assert scene.likely.shape == scene.others.shape
        assert (scene.likely[:, 4] <= scene.others[:, 4] + 1e-9).all()
        env.unwrapped.road.act()
        env.unwrapped.road.step(0.2)
        env.unwrapped.steps += 1
