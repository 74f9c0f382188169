"""The end of a road in simulated traffic: highway-env drives on straight, so verification does not end there."""

import numpy as np
import pytest
from placed import Body, placed

from shield.decision import Guarantee, Tier

EXIT = ("nxs", "nxr", 0)
SPEEDS = (20, 25, 30)


def scene(ahead, speed, left=10.0):
    """The ego `left` metres before the end of an exit road, and a slower vehicle ahead of it, if there is one."""
    length = placed("roundabout-v0", "exact", Body(EXIT, 0.0, 20.0, "nxr"), speeds=SPEEDS).unwrapped.vehicle.lane.length
    ego = Body(EXIT, length - left, 20.0, "nxr")
    others = [] if ahead is None else [Body(EXIT, length - left + ahead, speed, "nxr")]
    return placed("roundabout-v0", "exact", ego, others, speeds=SPEEDS)


@pytest.mark.parametrize("left", [60.0, 10.0, 1.0, -3.0])
@pytest.mark.parametrize("action", ["SLOWER", "IDLE", "FASTER"])
def test_a_collision_after_the_end_of_the_road_refuses_every_plan(left, action):
    """The ego drives at 20 m/s at least, and has no lane beside it."""
    env = scene(40.0, 5.0, left)
    env.step(env.unwrapped.action_type.actions_indexes[action])
    record = env.last_decision
    assert record.tier is Tier.LARGEST_MARGIN
    assert record.guarantee is Guarantee.NONE
    assert not record.margin >= 0


@pytest.mark.parametrize("left", [60.0, 10.0, 1.0, -3.0])
def test_a_vehicle_that_drives_faster_ahead_has_a_finite_margin_after_the_end_of_the_road(left):
    env = scene(40.0, 29.0, left)
    for _ in range(4):
        env.step(env.unwrapped.action_type.actions_indexes["IDLE"])
        record = env.last_decision
        assert record.tier is Tier.PASSED
        assert record.guarantee is Guarantee.ALL_SEEN
        assert np.isfinite(record.margin)
        assert record.margin > 20


def test_the_explanation_of_a_refusal_names_the_vehicle_after_the_end_of_the_road():
    env = scene(40.0, 5.0)
    env.step(env.unwrapped.action_type.actions_indexes["IDLE"])
    assert "IDMVehicle 35.0 m ahead in lane 0 from nxs to nxr" in str(env.last_decision.explain())
