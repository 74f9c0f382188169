"""The verdict of all clauses together: every pipeline accepts a plan only with a margin of at least 0."""

from __future__ import annotations

import numpy as np
import pytest
from clause_scenes import along, braked, driven, scene_of
from cores import ContinuousCore, MetaCore, ShieldCore

from shield import Decision, Reason, Tier
from shield.pipelines.frames import first_verified


def frame(scene):
    return ShieldCore().supervise(scene)[1]


def action(index):
    return lambda scene: ShieldCore().decide(scene, index)


def held_action(index):
    return lambda scene: MetaCore().decide(scene, index)


def inputs(a, wheel):
    return lambda scene: ContinuousCore(predictive=False).filter(scene, np.array([a, wheel]))[1]


def masked(scene):
    core = ShieldCore()
    mask = core.mask(scene)
    margins = core.meta._verify(core.observe(scene), range(5), [scene.target_of(a) for a in range(5)])
    worst = min((v.margin for v, m in zip(margins, mask, strict=True) if m), default=-np.inf)
    return Decision(0, 0, Reason.NONE, Tier.PASSED if mask.any() else Tier.EMERGENCY, worst, 0.0)


PIPELINES = {
    "frame": frame,
    "lane change": action(2),
    "faster": action(3),
    "slower": action(4),
    "held lane change": held_action(2),
    "held faster": held_action(3),
    "throttle": inputs(5.0, 0.0),
    "throttle and wheel": inputs(1.0, 0.01),
    "mask": masked,
}


@pytest.mark.parametrize("pipeline", PIPELINES)
def test_no_verified_decision_has_a_negative_margin(pipeline):
    found, far = [], 150.0 if pipeline.startswith("held") else 60.0
    for gap in np.arange(9.0, far, 0.21):
        cars = (gap, 0.0, 0.0, 14.0), (gap + 4.0, 4.0, 0.0, 14.0), (gap - 60.0, 4.0, 0.0, 26.0)
        found.append(PIPELINES[pipeline](scene_of((0.0, 0.0, 0.0, 20.0), *cars, speed=25.0, lanes=2)))
    verified = [d for d in found if d.tier.verified]
    assert verified
    assert len(verified) < len(found)
    assert min(d.margin for d in verified) >= 0


@pytest.mark.parametrize("pipeline", ["frame", "throttle"])
def test_a_plan_that_nearly_verifies_does_not_displace_one_that_does(pipeline):
    """Where braking verifies, a verified plan is executed."""
    found = []
    for gap in np.arange(9.0, 30.0, 0.1):
        scene = scene_of((0.0, 0.0, 0.0, 20.0), (gap, 0.0, 0.0, 14.0), speed=25.0, lanes=1)
        if along(scene, braked(scene)) >= 1e-6:
            found.append(PIPELINES[pipeline](scene).tier)
    assert all(tier.verified for tier in found)
    assert Tier.GOVERNED in found


def test_the_first_verified_plan_is_taken_or_else_the_largest_margin():
    assert first_verified(np.array([-0.1, 0.2, 0.3])) == 1
    assert first_verified(np.array([-0.2, -0.1])) == 1


def test_an_input_passes_if_its_fail_safe_stops_in_any_lane():
    """Astride of a marking, behind one in the lane that comes first."""
    passed = []
    for gap in np.arange(9.0, 40.0, 0.1):
        core, scene = ContinuousCore(predictive=False), scene_of((0, 1.9, 0.05, 20), (gap, 0, 0, 0), lanes=2)
        proposal = np.zeros(2)
        verifies = [core.judge(scene, proposal[None], [lane]).margin[0] >= 0 for lane in (0, 1)]
        passed.append((any(verifies), verifies[0]))
        assert (core.filter(scene, proposal)[1].tier is Tier.PASSED) == any(verifies)
    assert (True, False) in passed


def test_the_fail_safe_of_inputs_is_the_motion_of_the_bicycle():
    scene = scene_of((0, 0, 0, 20))
    plan = ContinuousCore(predictive=False).filter(scene, np.zeros(2))[1].plan
    np.testing.assert_allclose(plan[len(driven(scene, 0)) :, 0], driven(scene, 0)[-1, 0], atol=1e-6)
