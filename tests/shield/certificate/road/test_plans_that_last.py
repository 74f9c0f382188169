"""Changes that take no verified plan away: the frame that executes it, a follower that takes less room, more frames
at rest."""

import numpy as np
from clause_scenes import CONFIG, DT, along, scene_of, verifier_of
from cores import ShieldCore
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from dynamics.scenes.scene import EgoControl, Scene, Target
from dynamics.vehicle.controllers import KP_SPEED
from dynamics.vehicle.rollouts import Rollouts
from shield.certificate.road.manoeuvres import brake_candidates
from shield.pipelines.frames import _accelerations, capped_speeds

LANES = 3
OWNED = {"visible": np.full(LANES, 10**6), "owned": np.array([True, True, False]), "stored": 1}


@settings(deadline=None, max_examples=300)
@given(seed=st.integers(0, 10**9))
def test_a_verified_decision_verifies_in_its_first_frame(seed):
    rng = np.random.default_rng(seed)
    v, lane = rng.uniform(8, 32), int(rng.integers(LANES))
    cars = [
        (
            rng.uniform(-40, 60),
            4.0 * rng.integers(LANES) + rng.uniform(-0.4, 0.4),
            rng.normal(0, 0.03),
            v + rng.normal(0, 5),
        )
        for _ in range(rng.integers(1, 6))
    ]
    scene = scene_of((0.0, 4.0 * lane + rng.uniform(-1, 1), rng.normal(0, 0.05), v), *cars, lanes=LANES)
    core = ShieldCore()
    decision = core.decide(scene, int(rng.choice([0, 2, 2, 0, 3])))
    assume(decision.tier.verified)
    target = scene.target_of(int(decision.executed))
    _, frame = core.supervise(Scene(scene.ego, scene.others, scene.road, EgoControl(target), scene.dt, 5))
    assert frame.tier.verified


def stopping(ego, follower, owned):
    """The margin of braking to a stop in lane 1 with a follower that owes the ego its distance; its strip, (2,) [m]."""
    scene = scene_of(ego, follower, lanes=LANES, lane=1)
    verifier = verifier_of(scene, CONFIG, followers=np.ones(1, bool), **{**OWNED, "owned": owned})
    candidates = brake_candidates(scene, [1], [0.0], [1], 0, CONFIG.braking)
    paths = candidates.paths(Rollouts(DT), scene.ego_road)
    margin = verifier.without_cut_ins().clearance(paths, candidates.lanes, candidates.fails).margin[0]
    return float(margin), np.array([verifier.around.low[0], verifier.around.high[0]]), bool(verifier.in_owned_lane[0])


@settings(deadline=None, max_examples=300, suppress_health_check=[HealthCheck.filter_too_much])
@given(
    r=st.floats(2.0, 4.0),
    psi=st.floats(-0.1, 0.5),
    v=st.floats(8.0, 32.0),
    gap=st.floats(8.0, 40.0),
    at=st.floats(-1.0, 4.0),
    turned=st.floats(-1.5, 1.5),
    beside=st.booleans(),
)
def test_a_follower_that_takes_less_room_takes_no_plan_away(r, psi, v, gap, at, turned, beside):
    """A follower in the ego's lanes turns straight, and its strip shrinks: it owes the ego its distance as before.
    The ego touches the lane that it stops in, and owns it by that."""
    owned = np.array([not beside, True, False])
    wide, strip, held = stopping((0.0, r, psi, v), (-gap, at, turned, v + 3.0), owned)
    narrow, less, still = stopping((0.0, r, psi, v), (-gap, at, 0.0, v + 3.0), owned)
    assume(held and still and strip[0] <= less[0] and less[1] <= strip[1])
    assume(wide >= 0)
    assert narrow >= 0


@settings(deadline=None, max_examples=300)
@given(
    start=st.floats(2.0, 3.0),
    r=st.floats(3.0, 4.0),
    psi=st.floats(-0.1, 0.1),
    v=st.floats(5.0, 30.0),
    gap=st.floats(8.0, 60.0),
    faster=st.floats(0.0, 10.0),
    more=st.integers(1, 5),
)
def test_fewer_frames_at_rest_take_no_plan_away(start, r, psi, v, gap, faster, more):
    """The ego stands, a little turned, beside a lane in which a follower goes on: no coming frame has all that way."""
    assume(r - 4.5 * abs(np.sin(psi)) - 1.3 * np.cos(psi) > 1.3)
    scene = scene_of((0.0, start, psi, v), (-gap, 0.0, 0.0, v + faster), lanes=LANES, lane=1)
    speeds = np.append(np.arange(v, 0.0, -CONFIG.braking * DT), [0.0, 0.0])
    s = np.cumsum(np.append(0.0, speeds[:-1])) * DT * np.cos(psi)
    across = np.minimum(np.linspace(start, 2 * r - start, len(s)), r)
    path = np.column_stack([s, across, np.full_like(s, psi), speeds])
    longer = np.vstack([path, np.repeat(path[-1:] * [1.0, 1.0, 0.0, 1.0], more, axis=0)])
    own = {**OWNED, "owned": np.array([False, True, False])}
    assume(along(scene, longer, 1, **own) >= 0)
    assert along(scene, path, 1, **own) >= 0


@settings(deadline=None)
@given(v=st.floats(0.0, 40.0), speed=st.floats(0.0, 40.0))
def test_a_lane_change_is_held_back_to_speeds_that_its_first_frame_tries(v, speed):
    now = ShieldCore().observe(scene_of((0.0, 4.0, 0.0, v), lanes=LANES))
    tried = v + _accelerations(now, Target(0, speed)) / KP_SPEED
    assert capped_speeds(now, Target(0, speed)) <= set(tried.tolist())
