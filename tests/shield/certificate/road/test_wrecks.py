"""Wrecks that drive on, and bodies that grow: the monitor judges everything that the bound assumes."""

from __future__ import annotations

import numpy as np
import pytest
from hand_driven import Driven, drive

from dynamics.roads.straight import StraightRoad
from dynamics.traffic.assumptions import Assumptions
from dynamics.traffic.occupancy import OtherVehicles
from dynamics.traffic.rules_of_the_road import EgoFootprint, RoadRule, rule_violations

FAR = EgoFootprint(1e6, 0.0, 0.0, 20.0, 4.5, 1.3, 2.5, 1.0, False)


class Wreck(Driven):
    """A crashed vehicle that is still driven by hand; without `drive` it slides as in highway-env."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.crashed = True

    def clip_actions(self):
        if self.drive is None:
            super().clip_actions()


def around(row, dt, before=None):
    return OtherVehicles(row, row[:, :4], StraightRoad.from_lanes(3), Assumptions.idm(), dt, before)


DRIVES = {
    "brakes at 40 m/s^2": lambda own, f: own.action.update(acceleration=-min(40.0, max(own.speed, 0.0) / own.dt)),
    "goes backwards": lambda own, f: own.action.update(acceleration=-6.0 if own.speed > -5.5 else 0.0),
    "stands where it was": lambda own, f: setattr(own, "position", own.position - [own.speed * own.dt, 0.0]),
}


@pytest.mark.parametrize("kind", DRIVES)
@pytest.mark.parametrize("hz", [5, 15])
@pytest.mark.parametrize("placement", ["env", "policy"])
def test_a_wreck_that_drives_on_against_the_rules_is_a_violator(kind, hz, placement):
    out = drive(lambda road: [Wreck(road, 45.0, 1, 20.0, DRIVES[kind])], hz, seconds=6.0, placement=placement)
    assert out.verified
    assert out.violations > 0 or (kind == "goes backwards" and out.clearance > 0)
    assert not out.unnamed


@pytest.mark.parametrize("hz", [5, 15, 30])
@pytest.mark.parametrize("speed", [8.0, 20.0, 38.0])
def test_a_wreck_that_slides_as_highway_env_has_it_breaks_no_rule(hz, speed):
    """Above 6 m/s it brakes harder than any other vehicle, 25 m/s² at 25 m/s, and the plan has counted on that."""
    out = drive(lambda road: [Wreck(road, 60.0, 1, speed)], hz, seconds=5.0)
    assert out.verified
    assert out.rules == {}
    assert out.clearance > -1e-6
    assert not out.crashed


@pytest.mark.parametrize("dt", [1 / 5, 1 / 15])
def test_the_permitted_motion_of_a_wreck_stays_inside_its_bound(dt):
    """In each frame a wreck may brake at the larger of 6 m/s² and its speed times 1/s, and no harder."""
    for rate in (1.0, 1.02):
        row = np.array([[0.0, 4.0, 0.0, 12.0, 5.0, 2.0, 1.0]])
        old, broken = around(row, dt), 0
        rears = old.rear(30)[0]
        for k in range(25):
            v = row[0, 3]
            row = row + np.array([[max(v, 0.0) * dt, 0, 0, -min(rate * max(6.0, v) * dt, max(v, 0.0)), 0, 0, 0]])
            new = around(row, dt, old)
            broken |= int(rule_violations(old, new, dt, np.zeros(1, bool), FAR).broken[0])
            if rate == 1.0:
                assert row[0, 0] - 2.5 >= rears[k] - 1e-9
            old = new
        assert (broken != 0) == (rate > 1)


@pytest.mark.parametrize(("length", "width", "grown"), [(5.0, 2.0, 0), (5.1, 2.0, 1), (5.0, 2.1, 1), (4.0, 1.5, 0)])
def test_growth_of_a_body_is_noticed(length, width, grown):
    row = np.array([[0.0, 4.0, 0.0, 10.0, 5.0, 2.0, 0.0]])
    later = np.array([[1.0, 4.0, 0.0, 10.0, length, width, 0.0]])
    first = around(row, 0.1)
    found = rule_violations(first, around(later, 0.1, first), 0.1, np.zeros(1, bool), FAR)
    assert bool(found.grown[0] & int(RoadRule.SIZE)) == grown


@pytest.mark.parametrize("hz", [5, 15])
@pytest.mark.parametrize("placement", ["env", "policy"])
def test_a_leader_that_grows_is_a_violator(hz, placement):
    """By ten metres a second, at both ends."""

    def act(own, frame):
        own.LENGTH = 5.0 + 20.0 * max(frame / hz - 1.0, 0.0)

    out = drive(lambda road: [Driven(road, 30.0, 1, 20.0, act)], hz, seconds=5.0, speed=20.0, placement=placement)
    assert out.verified
    assert out.rules.get("size", 0) > 0
    assert not out.unnamed
