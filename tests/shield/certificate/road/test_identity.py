"""The monitor recognises vehicles where their number changes, and names a vehicle that appears in the ego's way."""

from __future__ import annotations

import pytest
from hand_driven import Driven, drive, inputs
from highway_env.vehicle.objects import Obstacle

RATES = pytest.mark.parametrize("hz", [5, 15, 30])
WRAPPERS = pytest.mark.parametrize("placement", ["env", "policy"])


@RATES
@WRAPPERS
def test_a_distant_car_that_appears_and_vanishes_hides_no_violation(hz, placement):
    """The leader brakes at 60 m/s^2 while a car 400 m away is put in and out of the road's list."""

    def cast(road):
        far = Driven(road, 400.0, 0, 25.0)

        def brake(own, frame):
            if far in road.vehicles:
                road.vehicles = [v for v in road.vehicles if v is not far]
            else:
                road.vehicles = [*road.vehicles, far]
            if frame > hz:
                inputs(-60.0, 0.0)(own, frame)

        return [Driven(road, 40.0, 1, 25.0, brake), far]

    out = drive(cast, hz, placement=placement)
    assert out.verified
    assert out.violations > 0
    assert not out.unnamed
    assert set(out.rules) & {"speed", "braking"}


@RATES
@WRAPPERS
@pytest.mark.parametrize("kind", [Driven, Obstacle])
def test_a_body_that_appears_in_the_way_on_a_highway_is_a_violator(hz, placement, kind):
    """15 m ahead of an ego at 25 m/s no body may appear; 200 m ahead, or in another lane, it may."""
    for ahead, lane, named in ((15.0, 1, True), (200.0, 1, False), (15.0, 2, False)):

        def cast(road, ahead=ahead, lane=lane):
            ego = road.vehicles[0]

            def spawn(own, frame):
                if frame == hz:
                    if kind is Driven:
                        road.vehicles = [*road.vehicles, Driven(road, ego.position[0] - 400.0 + ahead, lane, 0.0)]
                    else:
                        road.objects = [Obstacle(road, [ego.position[0] + ahead, 4.0 * lane])]

            return [Driven(road, -200.0, 0, 25.0, spawn)]

        out = drive(cast, hz, seconds=2.5, placement=placement)
        assert out.verified
        assert out.rules.get("appeared", 0) == named
        assert named or not out.rules
        assert not out.unnamed
