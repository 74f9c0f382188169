"""No tolerance of the monitor adds up: a vehicle that approaches in small steps is named before it touches the
buffer."""

from __future__ import annotations

import numpy as np
import pytest
from hand_driven import Driven, drive

from dynamics.roads.straight import StraightRoad
from dynamics.traffic.assumptions import Assumptions
from dynamics.traffic.occupancy import OtherVehicles
from dynamics.traffic.rules_of_the_road import EgoFootprint, RoadRule, rule_violations
from shield import ShieldConfig

IDLE, FASTER = 1, 3


def rolling_back(step):
    """Rolls back by so many metres a frame."""

    def act(own, frame):
        own.action["acceleration"] = (-step / own.dt - own.speed) / own.dt

    return act


@pytest.mark.parametrize(("hz", "step"), [(5, 0.018), (15, 0.018), (15, 0.007), (60, 0.01)])
@pytest.mark.parametrize("placement", ["env", "policy"])
def test_a_leader_that_rolls_back_slowly_is_a_violator(hz, step, placement):
    """At 0.09 to 0.6 m/s: each frame is less than 2 cm."""
    out = drive(
        lambda road: [Driven(road, 12.0, 1, -step * hz, rolling_back(step))],
        hz,
        seconds=9.0,
        speed=3.0,
        action=lambda k: FASTER,
        placement=placement,
    )
    assert out.verified
    assert out.clearance < -0.1
    assert not out.unnamed
    assert set(out.rules) <= {"reversing", "braking"}


@pytest.mark.parametrize(("hz", "period"), [(5, 1), (15, 1), (15, 5)])
def test_a_leader_that_rolls_back_is_a_violator_for_a_filter_of_actions(hz, period):
    """With one frame a decision, and with several."""
    step = 0.018 / period
    out = drive(
        lambda road: [Driven(road, 14.0, 1, -step * hz, rolling_back(step))],
        hz,
        period=period,
        seconds=15.0 if hz == 15 else 30.0,
        speed=3.0,
        action=lambda k: IDLE,
        placement="actions",
        config=ShieldConfig.for_meta_actions(),
    )
    assert out.verified
    assert out.clearance < 1.0
    assert out.violations > 0
    assert not out.unnamed


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        ((-1e-7, 0, 0, 0), RoadRule.REVERSING),  # the place that it stands in
        ((0, 1e-7, 0, 0), RoadRule.LANES),  # out of the middle of its lane, and no further
        ((0, 0, 0, -1e-6), RoadRule.REVERSING),
    ],
)
@pytest.mark.parametrize("frames", [1, 3])
def test_growth_of_any_size_is_noticed(change, rule, frames):
    """A vehicle stands at the edge of the region that it may touch, and takes a little more in a frame."""
    row = np.array([[30.0, 4.25, 0.0, 0.0, 5.0, 2.0, 0.0]])

    def around(rows, before=None):
        return OtherVehicles(rows, rows[:, :4], StraightRoad.from_lanes(3), Assumptions.idm(), 0.1, before)

    later = row + np.array([[*change, 0, 0, 0]])
    first, far = around(row), EgoFootprint(1e6, 0.0, 0.0, 20.0, 4.5, 1.3, 2.5, 1.0, False)
    found = rule_violations(first, around(later, first if frames == 1 else None), 0.1 * frames, np.zeros(1, bool), far)
    assert RoadRule(int(found.grown[0])) & rule
