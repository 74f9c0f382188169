"""Clauses of the certificate on road networks, one at a time, in constructed scenes."""

from __future__ import annotations

import gymnasium as gym
import highway_env  # noqa: F401
import numpy as np
import pytest
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.kinematics import Vehicle
from highway_env.vehicle.objects import Obstacle
from slowly import later

from dynamics.road_networks.reachable.prediction import distance_bounds
from dynamics.road_networks.reachable.strips import LOW, DrivingBounds
from shield import ShieldConfig
from shield.certificate.network.choice import choose, try_candidate
from shield.certificate.network.monitor import NetworkMonitor, NetworkRule
from shield.certificate.network.tolerances import CLEAR
from shield.filters.network import NetworkFilter

HARD = 9.8


def scene(env_id, lane, s, speed, others=(), things=(), config=None):
    """A filter whose ego is at s [m] of a lane, with other vehicles as (lane, s, speed)."""
    env = gym.make(env_id)
    env.reset(seed=0)
    base = env.unwrapped
    road, ego = base.road, base.vehicle
    at = road.network.get_lane(lane)
    ego.position, ego.heading, ego.speed = at.position(s, 0), at.heading_at(s), speed
    ego.lane_index = ego.target_lane_index = lane
    ego.lane, ego.route = at, None
    road.vehicles, road.objects = [ego], []
    for index, where, fast in others:
        road.vehicles.append(IDMVehicle.make_on_lane(road, index, where, fast))
        road.vehicles[-1].route = None
    for index, where in things:
        road.objects.append(Obstacle(road, road.network.get_lane(index).position(where, 0)))
    network_filter = NetworkFilter(base, config or ShieldConfig.for_roads())
    network_filter.reset()
    network_filter._read()
    network_filter._others.obliged[:] = False
    return network_filter


def margin(network_filter, seconds, speed, lenient=False):
    """The least separation if the ego keeps a speed for so long, and brakes then [m]."""
    lane = int(network_filter._alone.worlds.g[0, 2, 0])
    frames = 1 + round(seconds * network_filter._frequency)
    row = np.array([lane, speed, 1e3, frames, 0, HARD], float)
    return try_candidate(
        network_filter._alone, network_filter._road, network_filter._others, row, lenient, network_filter._rollout
    ).margin


RING, NEXT, ENTRY = ("se", "ex", 0), ("ex", "ee", 0), ("ses", "se", 0)


def test_a_leader_may_brake_on_a_network():
    """An ego that keeps its speed for two seconds behind an equally fast leader needs the leader's stopping
    distance."""
    lane = ("a", "b", 0)
    assert margin(scene("merge-v0", lane, 60.0, 20.0, [(lane, 90.0, 20.0)]), 2.0, 20.0) < CLEAR
    assert margin(scene("merge-v0", lane, 60.0, 20.0, [(lane, 115.0, 20.0)]), 2.0, 20.0) >= CLEAR


def test_a_vehicle_on_the_ring_does_not_wait_for_an_entering_ego():
    """An ego that enters and stops before a vehicle on the ring is refused: highway-env's traffic does not see the
    ego from the lane before. Traffic that looks ahead may be expected to brake."""
    before = ("sx", "se", 1)
    there = [(before, 2.0, 16.0)]
    blind = scene("roundabout-v0", ENTRY, 5.0, 6.0, there)
    assert margin(blind, 3.0, 8.0) < CLEAR
    assert margin(scene("roundabout-v0", ENTRY, 5.0, 6.0), 3.0, 8.0) >= CLEAR


@pytest.mark.parametrize("env_id", ["roundabout-v1", "roundabout-generic-v1"])
def test_a_vehicle_ahead_on_a_ring_does_not_count_as_a_follower(env_id):
    """A vehicle that looks beyond the end of its lane reaches the ego once around the ring too, and must keep its
    distance there, not at its present place. The path stays in the lane of that vehicle; in the next lane no vehicle
    has an obligation."""
    network_filter = scene(
        env_id, RING, 2.0, 3.0, [(RING, 9.0, 1.0)], config=ShieldConfig.for_roads(considers_connected_lanes=True)
    )
    alone = margin(network_filter, 1.0, 3.0)
    assert alone < CLEAR
    margin(network_filter, 0.0, 0.0)
    network_filter._keep_distance(network_filter.watch.last.identities, True)
    assert network_filter._others.obliged.any()
    assert margin(network_filter, 1.0, 3.0, lenient=True) == alone


def test_a_follower_sees_the_ego_in_its_own_lane_only():
    """The ego stops just beyond the end of the follower's lane."""
    lane, after = ("a", "b", 0), ("b", "c", 0)
    behind = [(lane, 180.0, 20.0)]
    network_filter = scene("merge-v0", after, 6.0, 5.0, behind)
    assert margin(network_filter, 0.0, 0.0) < CLEAR
    ahead = scene("merge-v0", after, 6.0, 5.0, behind, config=ShieldConfig.for_roads(considers_connected_lanes=True))
    assert margin(ahead, 0.0, 0.0) >= CLEAR
    # In its own lane the follower sees the ego.
    assert margin(scene("merge-v0", after, 60.0, 5.0, [(after, 10.0, 20.0)]), 0.0, 0.0) >= CLEAR


def test_bounds_on_travel_are_those_of_hardest_braking_and_acceleration():
    """Frame by frame. A creeping vehicle may steer so hard that it gains less along its lane."""
    rows, drive = np.array([[0.0, 0.0, 0.0, 10.0, 5.0, 2.0, 0.0]]), np.array([[14.0, 1.0, 1.0, 3.0, 0.34]])
    least, most = np.zeros((1, 60)), np.zeros((1, 60))
    distance_bounds(DrivingBounds(6.0, 3.0, 30.0, 0.6, 0.15), rows, drive, 0.1, least, most)
    for rate, low, high, bound in ((3.0, 0.0, 14.0, most), (-6.0, 0.0, 14.0, least)):
        speed, way = 10.0, 0.0
        for k in range(60):
            assert bound[0, k] == pytest.approx(way)
            gained = 0.34 if bound is least and speed < 3.0 else 1.0
            way, speed = way + gained * speed * 0.1, min(max(speed + rate * 0.1, low), high)


def test_a_vehicle_that_has_to_merge_does_not_wait_for_the_ego():
    """Beside the ego on merge's ramp, which ends. Beside the ego in a lane that does not end, a vehicle stays."""
    lane = ("b", "c", 1)
    ramp = scene("merge-v0", lane, 20.0, 20.0, [(("b", "c", 2), 22.0, 20.0)])
    assert margin(ramp, 0.0, 20.0) < CLEAR
    road = scene("merge-v0", lane, 20.0, 20.0, [(("b", "c", 0), 22.0, 20.0)])
    assert margin(road, 0.0, 20.0) >= CLEAR


def test_a_follower_that_has_to_merge_has_no_obligation():
    """On merge's ramp a follower may drive past the ego and merge then; in the ego's own lane it brakes."""
    lane, ramp = ("b", "c", 1), ("b", "c", 2)
    for behind, owes in ((ramp, False), (lane, True)):
        network_filter = scene("merge-v0", lane, 60.0, 5.0, [(behind, 10.0, 20.0)])
        assert (margin(network_filter, 0.0, 0.0) >= CLEAR) == owes
        assert network_filter.has_distance_obligation(network_filter._base.road.vehicles[1]) == owes


def test_a_vehicle_that_rolls_back_does_so_until_it_stands():
    """At -3 m/s, with 6 m/s² of braking, a vehicle rolls back 0.85 m in frames of 1/15 s, long after the ego stands."""
    lane = ("a", "b", 0)
    standing, rolling = (
        margin(scene("merge-v0", lane, 60.0, 0.0, [(lane, 69.0, speed)]), 0.0, 0.0) for speed in (0.0, -3.0)
    )
    speeds = -3.0 + 6.0 / 15 * np.arange(8)
    assert standing - rolling == pytest.approx(-speeds.sum() / 15, rel=0.15)


def test_an_obstacle_ahead_blocks_a_path():
    lane = ("a", "b", 0)
    assert margin(scene("merge-v0", lane, 60.0, 20.0, things=[(lane, 75.0)]), 0.0, 20.0) < CLEAR
    assert margin(scene("merge-v0", lane, 60.0, 20.0, things=[(lane, 120.0)]), 0.0, 20.0) >= CLEAR


def test_the_buffer_behind_a_standing_vehicle_is_kept():
    """Behind a standing vehicle the ego comes no nearer than its buffer."""
    lane = ("a", "b", 0)
    room = 2.5 + 2.7 + 2.0
    least = [margin(scene("merge-v0", lane, 60.0, 0.0, [(lane, 60.0 + room + d, 0.0)]), 0.0, 0.0) for d in (-0.3, 0.3)]
    assert least[0] < CLEAR <= least[1]


def test_a_vehicle_near_the_end_of_its_lane_is_in_that_lane_and_the_next():
    """Two metres before the end of its lane a vehicle may begin to turn into the next lane."""
    network_filter = scene("intersection-v0", ("o1", "ir1", 0), 10.0, 0.0, [(("o0", "ir0", 0), 98.0, 1.0)])
    marks = network_filter._others.marks
    lanes = [network_filter._names[lane] for lane in marks[:, 1]]
    own = lanes.index(("o0", "ir0", 0))
    assert marks[own, 2] == -1
    for lane in ("il1", "il2", "il3"):
        assert marks[lanes.index(("ir0", lane, 0)), 2] == own


def test_a_vehicle_beside_its_lane_has_to_return():
    """A vehicle that drives straight on astride a marking breaks this rule and no other."""
    lane, seen = ("a", "b", 0), []
    network_filter = scene("merge-v0", lane, 150.0, 0.0, [(lane, 20.0, 15.0)])
    base = network_filter._base
    body = base.road.vehicles[1]
    for k in range(2):
        body.position = base.road.network.get_lane(lane).position(20.0 + k, -1.2)
        seen.append(network_filter._predict())
    for clear, broken in (({body}, {NetworkRule.WAYS: 1}), (set(), {})):
        watch = NetworkMonitor()
        for k in range(2):
            watch.next(seen[k], clear, np.array([-1.0]), network_filter._road, set())
        assert watch.by_rule == broken


def test_the_ego_does_not_evade_into_a_lane_that_ends():
    """At the end of that lane the ego would stand for good."""
    network_filter = scene("merge-v0", ("b", "c", 1), 20.0, 20.0)
    lanes = []
    for aside in (-1, 1):
        row = np.array([network_filter._index["b", "c", 1], 20.0, 1e3, 5, aside, HARD], float)
        try_candidate(
            network_filter._alone, network_filter._road, network_filter._others, row, False, network_filter._rollout
        )
        lanes.append(network_filter._names[int(network_filter._rollout.bound[10])])
    assert lanes == [("b", "c", 0), ("b", "c", 1)]


@pytest.mark.parametrize("gap", [9.0, 12.0, 15.0])
def test_the_largest_margin_fallback_brakes(gap):
    """Too near behind a slower vehicle for any plan to verify, with the buffer lost or not."""
    lane = ("a", "b", 1)
    network_filter = scene("two-way-v0", lane, 60.0, 30.0, [(lane, 60.0 + gap, 20.0)])
    assert not network_filter.decide(3).tier.verified
    command, decision = network_filter.frame()
    assert not decision.tier.verified
    assert command["acceleration"] < -9.0


def test_a_path_off_the_road_is_none():
    network_filter = scene("roundabout-v0", ("ser", "ses", 0), 40.0, 8.0)
    network_filter._alone.worlds.f[0, 0, 0] += 300.0
    assert margin(network_filter, 2.0, 16.0) < -100


WAITS = ShieldConfig.for_roads(gives_way=True)
BEFORE = ("ees", "ee", 0)


def on_ring(others, config=None):
    """The ego on the ring, before an entry, at 8 m/s."""
    return margin(scene("roundabout-v0", RING, 8.0, 8.0, others, config=config), 3.0, 8.0)


def test_an_entering_vehicle_waits_for_the_ego_where_waiting_is_assumed():
    """No vehicle waits without that assumption, nor a vehicle that can no longer stop."""
    comes, late = [(("eer", "ees", 0), 100.0, 8.0)], [(BEFORE, 14.0, 12.0)]
    assert on_ring(comes) < CLEAR <= on_ring(comes, WAITS)
    assert on_ring(late, WAITS) < CLEAR


def test_a_vehicle_with_equal_or_higher_priority_does_not_wait():
    """A vehicle on the ring does not wait for an entering ego, nor for an ego ahead on the ring that it does not
    see."""
    there = [(("sx", "se", 1), 2.0, 16.0)]
    assert margin(scene("roundabout-v0", ENTRY, 5.0, 6.0, there, config=WAITS), 3.0, 8.0) < CLEAR
    assert on_ring([(("we", "sx", 0), 10.0, 16.0)], WAITS) == on_ring([(("we", "sx", 0), 10.0, 16.0)])


@pytest.mark.parametrize(("ego", "other", "waits"), [("1", "0", True), ("0", "1", False), ("0", "2", True)])
def test_the_priorities_of_an_intersection_decide_which_vehicle_waits(ego, other, waits):
    """The crossing road has the right of way, and an oncoming vehicle waits before it turns left."""
    there = [((f"o{other}", f"ir{other}", 0), 60.0, 9.0)]
    config = ShieldConfig.for_roads(6.0, gives_way=True)
    network_filter = scene("intersection-v0", (f"o{ego}", f"ir{ego}", 0), 99.0, 9.0, there, config=config)
    alone = scene("intersection-v0", (f"o{ego}", f"ir{ego}", 0), 99.0, 9.0, there, config=ShieldConfig.for_roads(6.0))
    seconds = 1.0
    assert margin(alone, seconds, 9.0) < CLEAR
    assert (margin(network_filter, seconds, 9.0) >= CLEAR) == waits


def test_a_vehicle_that_waits_has_its_reaction_time_first():
    """A vehicle whose reaction time has passed stops where another does not."""
    clear = None
    for s in range(112, 124):
        network_filter = scene("roundabout-v0", RING, 8.0, 8.0, [(("eer", "ees", 0), float(s), 14.0)], config=WAITS)
        fresh = margin(network_filter, 3.0, 8.0, lenient=True)
        network_filter._others.gives[:] = network_filter._road.response.reaction
        known = margin(network_filter, 3.0, 8.0, lenient=True)
        assert known >= CLEAR or fresh < CLEAR
        if known >= CLEAR > fresh:
            clear = s
    assert clear is not None


FIRST, SECOND = ("a", "b", 0), ("b", "c", 0)


def from_the_lane_before(ego):
    """The length of the lane before that of an ego that stands so far along it at merge; and how far one there stays
    from it, by where that is and its speed."""
    length = gym.make("merge-v0").unwrapped.road.network.get_lane(FIRST).length
    return length, lambda s, v: margin(scene("merge-v0", SECOND, ego, 0.0, [(FIRST, s, v)]), 0.0, 0.0)


@pytest.mark.parametrize(("way", "speed"), [(40.0, 0.0), (3.0, 0.4), *later((3.0, 0.0), (41.3, 8.0), (118.0, 11.47))])
def test_the_margin_to_a_vehicle_of_the_lane_before_does_not_drop_in_a_frame(way, speed):
    """The vehicle brakes, keeps its speed or accelerates for a frame; the ego stands ahead of it."""
    dt, (end, stays) = 1 / 15, from_the_lane_before(70.0)
    then = stays(end - way, speed)
    for rate in (-6.0, -1.7, 0.0, 1.1, 3.0):
        now = stays(end - way + speed * dt, max(speed + rate * dt, 0.0))
        assert now >= then - 1e-6


@pytest.mark.parametrize("way", [10.0, *later(25.0, 40.0)])
@pytest.mark.parametrize("speed", [2.9, *later(1.0, 2.0)])
def test_a_creeping_vehicle_of_the_lane_before_lowers_no_margin(way, speed):
    """A vehicle that steers hard covers a third of its way along its lane."""
    dt, (end, stays) = 1 / 15, from_the_lane_before(40.0)
    then = stays(end - way, speed)
    assert then > 0
    for rate in (-6.0, 0.0, 3.0):
        assert stays(end - way + 0.34 * speed * dt, max(speed + rate * dt, 0.0)) >= then - 1e-6


@pytest.mark.parametrize(
    ("start", "speed", "rate"), [(20.0, 8.0, 0.0), (60.0, 20.0, -6.0), *later((5.0, 4.0, 3.0), (70.0, 15.0, 3.0))]
)
def test_a_merge_from_a_lane_that_ends_is_no_violation(start, speed, rate):
    """With highway-env's own controller, anywhere on merge's ramp, at any throttle."""
    network_filter = scene("merge-v0", ("a", "b", 0), 20.0, 0.0, [(("b", "c", 2), start, speed)])
    body, frames = network_filter._base.road.vehicles[1], 0
    while body.lane_index == ("b", "c", 2) and body.speed > 0.5:
        since = network_filter.watch.last
        wheel = body.steering_control(("b", "c", 1))
        Vehicle.act(body, {"acceleration": rate, "steering": float(np.clip(wheel, -np.pi / 3, np.pi / 3))})
        body.step(1 / network_filter._frequency)
        network_filter._base.steps += 1  # the filter judges each frame once
        network_filter._read()
        assert not network_filter.have_broken([body], since)
        frames += 1
    assert frames > 5


@pytest.mark.parametrize("lane", [("k", "b", 0), ("b", "c", 2)])
def test_a_vehicle_that_stands_in_a_lane_that_ends_waits_there(lane):
    """A vehicle as slow before that lane does not wait: it has the time to accelerate."""
    network_filter = scene("merge-v0", ("a", "b", 0), 20.0, 0.0, [(lane, 40.0, 0.4)])
    lanes = {network_filter._names[each] for each in network_filter._others.marks[:, 1]}
    assert (("b", "c", 1) in lanes) == (lane == ("k", "b", 0))


def test_a_vehicle_that_stands_astride_a_marking_may_merge():
    """It has not kept to its lane, so it does not count as waiting there."""
    lane = ("b", "c", 2)
    network_filter = scene("merge-v0", ("a", "b", 0), 20.0, 0.0, [(lane, 40.0, 0.3)])
    body = network_filter._base.road.vehicles[1]
    for r, least in ((0.0, -1.6), (-1.0, -5.6)):
        body.position = body.lane.position(40.0, r)
        network_filter._read()
        rows = network_filter._others.numbers[
            [network_filter._names[k] == lane for k in network_filter._others.marks[:, 1]]
        ]
        assert rows[0, LOW] == pytest.approx(least)


@pytest.mark.parametrize(("gap", "clear"), [(16.0, False), (20.0, True), (28.0, True)])
def test_a_follower_is_asked_for_no_more_braking_than_it_can_do(gap, clear):
    """The ego brakes from 20 m/s; the follower is as fast and brakes at 6 m/s² at most. With an obligation, and
    braking at once, it needs 14 m and a body length."""
    lane = ("a", "b", 0)
    network_filter = scene("merge-v0", lane, 60.0, 20.0, [(lane, 60.0 - gap, 20.0)])
    index = network_filter._index[lane]
    row = np.array([[index, 0.0, 1e3, 0, 0, HARD]])
    for owes in (False, True):
        network_filter._others.obliged[0, index] = owes
        found = choose(
            network_filter._alone,
            network_filter._road,
            network_filter._without_buffer.body,
            network_filter._others,
            row,
            network_filter._rollout,
            network_filter._braking.bodies,
        )
        assert (found.margin >= CLEAR) == (clear and (owes or gap > 25.0))


@pytest.mark.parametrize("brakes", [True, False])
def test_a_follower_that_does_not_brake_is_a_violator(brakes):
    """It is named once braking no longer helps: at 15 m/s, 19 m before the ego, which cannot go on."""
    lane = ("a", "b", 0)
    network_filter = scene("merge-v0", lane, 100.0, 0.0, [(lane, 60.0, 15.0)], [(lane, 106.0)])
    body, named, verified = network_filter._base.road.vehicles[1], [], []
    network_filter.reset()
    network_filter.decide(1)
    while body.position[0] < 94.9 and body.speed > 0.1:
        verified.append(network_filter.frame()[1].tier.verified)
        room = 95.0 - body.position[0]
        if network_filter.watch.by_rule and not named:
            named.append(room)
            assert network_filter.watch.offenders == {body}
        # The follower is counted on for as long as it can stop.
        assert verified[-1] == (not named)
        hard = brakes and room - 1.0 < body.speed * 2 / 15 + (body.speed + 0.2) ** 2 / 12
        Vehicle.act(body, {"acceleration": -6.0 if hard else 0.0, "steering": 0.0})
        body.step(1 / network_filter._frequency)
        network_filter._base.steps += 1  # the filter judges each frame once
    network_filter.frame()
    assert set(network_filter.watch.by_rule) == (set() if brakes else {NetworkRule.DISTANCE})
    assert brakes or named[0] == pytest.approx(15.0**2 / 12, abs=1.5)
