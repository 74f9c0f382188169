"""Networks that highway-env does not have: a lane that ends pointing at the ego's road, a lane that ends close beside
the ego's, and a loop.

A verified plan stays verified, or the monitor names a violator.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hand_driven import Placed
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.road.lane import CircularLane, StraightLane
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.objects import Obstacle

from dynamics.errors import SceneError
from dynamics.road_networks.reachable.strips import CENTRED_FROM, FRONT, START, Strip, add, empty_strips
from shield import ShieldConfig, ShieldedEnv
from shield.certificate.network.monitor import _inside

FASTER, SLOWER = 3, 4
SLOW = {"type": "DiscreteMetaAction", "target_speeds": [0, 5, 10]}
VERIFIED = ("passed", "governed")


class Network(AbstractEnv):
    """An ego on a network that a test builds, without other vehicles."""

    build, start, speed = None, None, 0.0

    @classmethod
    def default_config(cls):
        own = {"action": {"type": "DiscreteMetaAction", "target_speeds": [0, 5, 10, 15]}, "duration": 1000}
        return {**super().default_config(), **own, "observation": {"type": "Kinematics"}}

    def _reset(self):
        self.road = Road(network=RoadNetwork(), np_random=self.np_random)
        type(self).build(self.road.network)
        index, s = self.start
        lane = self.road.network.get_lane(index)
        ego = self.action_type.vehicle_class(self.road, lane.position(s, 0), lane.heading_at(s), self.speed)
        self.controlled_vehicles = [ego]
        self.road.vehicles.append(ego)

    def _reward(self, action):
        return 0.0

    def _rewards(self, action):
        return {}

    def _is_terminated(self):
        return self.vehicle.crashed

    def _is_truncated(self):
        return False


def shielded(builder, start, speed, frequency, settings="worst-case", **config):
    """An ego at (lane, s) of a network, decided on in each frame unless `config` has another frequency."""
    kind = type("Built", (Network,), {"build": staticmethod(builder), "start": start, "speed": speed})
    given = {"simulation_frequency": frequency, "policy_frequency": frequency, **config}
    env = ShieldedEnv(kind(given), settings)
    env.reset(seed=0)
    return env


def scripted(env, place):
    """A vehicle whose place in each frame is a function of the test."""
    road = env.unwrapped.road
    vehicle = Placed(road, place(0), place=place)
    road.vehicles.append(vehicle)
    return vehicle


def drive(env, action, frames):
    """The tiers of the decisions, until the ego crashes."""
    tiers = []
    while len(tiers) < frames and not env.unwrapped.vehicle.crashed:
        env.step(action)
        tiers.append(str(env.frame_decisions[-1].tier))
    return tiers


def dead_end(gap):
    """A road to the east, and a lane to the north that ends so far before it [m]."""

    def build(network):
        network.add_lane("w", "e", StraightLane([-100, 0], [200, 0], speed_limit=20))
        network.add_lane("d0", "d1", StraightLane([0, -100], [0, -gap], speed_limit=20))

    return build


def north(gap, away, speed, frequency):
    """Along that lane and straight on, from so far before its end."""
    return lambda frame: (0.0, -gap - away + frame * speed / frequency, math.pi / 2, speed)


@pytest.mark.parametrize(("gap", "speed", "frequency"), [(11, 10.0, 10), (17, 20.0, 5), (40, 20.0, 15)])
def test_a_vehicle_that_drives_off_a_dead_end_is_predicted(gap, speed, frequency):
    """The vehicle keeps its heading and speed, and reaches an ego that cannot get away. No plan verified, and the
    vehicle has left no lane of its route."""
    env = shielded(dead_end(gap), (("w", "e", 0), 100.0), 0.0, frequency)
    scripted(env, north(gap, 30.0, speed, frequency))
    tiers = drive(env, SLOWER, 8 * frequency)
    assert env.unwrapped.vehicle.crashed
    assert set(env.filter.by_rule) == {"crash"}
    assert not set(tiers) & set(VERIFIED)


@pytest.mark.parametrize("away", [2.0, 30.0])
def test_the_ego_lets_a_vehicle_pass_that_drives_off_a_dead_end(away):
    """Each frame is verified, and no vehicle is named."""
    env = shielded(dead_end(25), (("w", "e", 0), 60.0), 10.0, 10)
    vehicle = scripted(env, north(25, away, 10.0, 10))
    tiers = drive(env, FASTER, 80)
    assert set(tiers) <= set(VERIFIED)
    assert not env.unwrapped.vehicle.crashed
    assert not env.filter.by_rule
    assert vehicle.position[1] > 10.0


def narrow(network):
    """Two lanes 3 m apart, of which the right one ends."""
    for k in range(2):
        network.add_lane("a", "b", StraightLane([0, 3 * k], [300, 3 * k], width=3, speed_limit=20))
    network.add_lane("b", "c", StraightLane([300, 0], [500, 0], width=3, speed_limit=20))


def beside(away, speed, frequency, brakes_from=math.inf):
    """In the lane that ends, so far behind an ego at 200 m, braking at 6 m/s^2 from a frame on."""

    def place(frame):
        x, v = 200.0 - away, speed
        for k in range(frame):
            x += v / frequency
            v = max(v - 6 / frequency, 0.0) if k >= brakes_from else v
        return x, 3.0, 0.0, v

    return place


@pytest.mark.parametrize("away", [45.0, 60.0])
def test_a_follower_in_a_lane_that_ends_has_an_obligation_in_the_lane_beside(away):
    """The ego rests in the lane beside, visible in both. A follower that has to merge may do so. A follower that
    drives on breaks the distance rule, one that brakes in time does not."""
    for brakes_from, rules in ((math.inf, {"distance"}), (1, set())):
        env = shielded(narrow, (("a", "b", 0), 200.0), 0.0, 15)
        scripted(env, beside(away, 18.0, 15, brakes_from))
        tiers = drive(env, SLOWER, 50)
        assert tiers[0] in VERIFIED
        assert set(env.filter.by_rule) == rules
        if not rules:
            assert set(tiers) <= set(VERIFIED)


def loop(network):
    """A road to the east, and a loop of 304 m across it."""
    network.add_lane("w", "e", StraightLane([-100, 0], [200, 0], speed_limit=20))
    network.add_lane("a", "b", StraightLane([0, -20], [0, 85], speed_limit=30))
    network.add_lane("b", "c", CircularLane([15, 85], 15, np.pi, 0, clockwise=False, speed_limit=30))
    network.add_lane("c", "d", StraightLane([30, 85], [30, -20], speed_limit=30))
    network.add_lane("d", "a", CircularLane([15, -20], 15, 0, -np.pi, clockwise=False, speed_limit=30))


LOOP = (("a", "b", 0), ("b", "c", 0), ("c", "d", 0), ("d", "a", 0))


def around(network, start, way):
    """Along the loop, `way(frame)` [m] and a speed [m/s] from a place on."""
    lanes = [network.get_lane(index) for index in LOOP]

    def place(frame):
        driven, speed = way(frame)
        s = (start + driven) % sum(lane.length for lane in lanes)
        for lane in lanes:
            if s < lane.length:
                break
            s -= lane.length
        return *lane.position(s, 0), lane.heading_at(s), speed

    return place


def test_a_second_pass_over_a_lane_is_predicted_at_any_distance():
    """A vehicle has just crossed the ego's road, and returns after a loop of more than 250 m. An ego that cannot
    leave the crossing does not enter it."""
    env = shielded(loop, (("w", "e", 0), 92.0), 0.0, 10)
    base = env.unwrapped
    base.road.objects.append(Obstacle(base.road, [6.8, 0]))
    scripted(env, around(base.road.network, 44.0, lambda frame: (frame, 10.0)))
    tiers = drive(env, FASTER, 60)
    assert not env.filter.by_rule
    assert set(tiers) <= set(VERIFIED)
    assert base.vehicle.position[0] < -5.0


@pytest.mark.parametrize("rate", [0.0, 3.0, -6.0])
def test_reachable_intervals_around_a_loop_lie_inside_those_of_the_frame_before(rate):
    """A later pass is left out where an earlier one contains it, and is kept once the vehicle may leave the earlier
    one. This holds along the whole loop."""
    env = shielded(loop, (("w", "e", 0), 0.0), 0.0, 10)
    network, dt, passes = env.unwrapped.road.network, 0.1, set()
    vehicle = scripted(env, around(network, 0.0, lambda frame: (0.0, 10.0)))
    vehicle.act(), vehicle.step(0.0)
    for start in range(0, 304, 2):
        seen = []
        for frame in range(2):
            vehicle.place = around(network, start, lambda frame: (frame * 10.0 * dt, 10.0 + frame * rate * dt))
            vehicle.frame = frame - 1
            vehicle.step(dt)
            seen.append(env.filter._predict().others)
        assert _inside(seen[0], 0, seen[1], 0, env.filter._road), start
        passes |= {tuple(np.unique(others.marks[:, 1], return_counts=True)[1]) for others in seen}
    assert len(passes) > 1


def test_a_later_pass_is_left_out_only_where_an_earlier_one_contains_it():
    """Not if the vehicle can leave the earlier one before it stands, nor if the later one is wider, longer or begins
    sooner."""
    strip = Strip(0, 5, 0, 60.0, 60.0, -1.6, 1.6, 2.7, -3.0, 0.0, 1.6, 2.7)
    later, strips = strip._replace(near=300.0, far=302.0), empty_strips(8)
    strips.marks[0] = [0, 4, -1]
    assert add(strips, 0, 1, strip, 20.0) == 2
    assert add(strips, 0, 2, later, 20.0) == 2
    for change, stop in (({}, 80.0), ({"low": -1.7}, 20.0), ({"half": 2.8}, 20.0), ({"start": -4.0}, 20.0)):
        assert add(strips, 0, 2, later._replace(**change), stop) == 3


def with_side_road(network):
    """A straight road, which a side road joins after 400 m."""
    network.add_lane("a", "b", StraightLane([0, 0], [400, 0], speed_limit=30))
    network.add_lane("b", "c", StraightLane([400, 0], [900, 0], speed_limit=30))
    network.add_lane("z", "b", StraightLane([200, 200], [400, 0], speed_limit=30))


def test_a_plan_with_weak_braking_is_judged_until_the_ego_rests():
    """At 2.25 m/s^2 the ego needs 13 s from 30 m/s. A plan that was cut off after 11 s verified, and the ego hit a
    standing vehicle."""
    action = {"type": "DiscreteMetaAction", "target_speeds": [10, 20, 30]}
    weak = ShieldConfig.for_roads().replace(braking=2.25)
    env = shielded(with_side_road, (("a", "b", 0), 5.0), 30.0, 5, weak, policy_frequency=1, action=action)
    scripted(env, lambda frame: (210.0, 0.0, 0.0, 0.0))
    tiers = drive(env, FASTER, 16)
    assert "unforeseen" not in env.filter.by_rule
    assert not set(tiers[:1]) & set(VERIFIED)


def bend(degrees):
    """A road that bends sharply after 100 m, and a road across its straight continuation."""

    def build(network):
        turned = math.radians(degrees)
        joint = np.array([100 + 20 * math.cos(turned), 20 * math.sin(turned)])
        end = joint + 60 * np.array([math.cos(turned + 0.6), math.sin(turned + 0.6)])
        network.add_lane("a", "b", StraightLane([0, 0], [100, 0], speed_limit=15))
        network.add_lane("b", "d", StraightLane([100, 0], joint, speed_limit=15))
        network.add_lane("d", "e", StraightLane(joint, end, speed_limit=15))
        network.add_lane("p", "q", StraightLane([106.5, -60], [106.5, 200], speed_limit=15))

    return build


@pytest.mark.parametrize("degrees", [35, 60, 85])
@pytest.mark.parametrize("stop", [102.5, 104.8])
def test_a_vehicle_that_drives_straight_on_past_a_sharp_bend_is_predicted_or_reported(degrees, stop):
    """It is predicted up to 3 m past the joint, unless it counts as on the next lane before, beside the predicted band.
    Further, it has left its ways."""

    def place(frame):
        driven, braked = 58.4 + 8.0 * frame / 15, stop - 8.0**2 / 12
        if driven <= braked:
            return driven, 0.0, 0.0, 8.0
        t = min((driven - braked) / 8.0, 8.0 / 6)
        return braked + 8.0 * t - 3 * t * t, 0.0, 0.0, 8.0 - 6 * t

    env = shielded(bend(degrees), (("p", "q", 0), 5.0), 10.0, 15, action=SLOW)
    vehicle = scripted(env, place)
    drive(env, 1, 150)
    assert vehicle.position[0] == pytest.approx(stop, abs=0.3)
    assert set(env.filter.by_rule) <= ({"ways"} if stop > 103 or degrees < 60 else set())
    assert not env.unwrapped.vehicle.crashed


def test_two_ways_of_equal_length_to_one_lane_leave_room_for_both():
    """A strip is widened, unless strips that it leads to are stored already."""
    strip = Strip(0, 5, 0, 60.0, 60.0, -1.6, 3.0, 2.7, -3.0, 0.0, 1.6, 2.7)
    for change, column in (({"back": 85.0}, CENTRED_FROM), ({"start": -4.0}, START), ({"front": 3.0}, FRONT)):
        for parent, count in ((0, 2), (3, 3)):
            strips = empty_strips(8)
            strips.marks[0] = [0, 4, -1]
            assert add(strips, 0, 1, strip, 20.0) == 2
            other = strip._replace(parent=parent, **change)
            assert add(strips, 0, 2, other, 20.0) == count
            (value,) = change.values()
            assert strips.numbers[count - 1, column] == value


def kinked(angle, gap, side):
    """A road that goes on at an angle, and a lane across its straight continuation, `gap` metres after the joint."""

    def build(network):
        far = [80 * math.cos(angle), -80 * math.sin(angle)]
        network.add_lane("a", "b", StraightLane([-80, 0], [0, 0], speed_limit=20))
        network.add_lane("b", "c", StraightLane([0, 0], far, speed_limit=20))
        network.add_lane("p", "q", StraightLane([gap + 1, side - 2.5], [gap + 1, 80], speed_limit=20))

    return build


def round_the_joint(angle, speed, frequency, frames):
    """Along that road, 0.1 m before the joint after so many frames."""

    def place(frame):
        way = (frame - frames) * speed / frequency - 0.1
        if way <= 0:
            return way, 0.0, 0.0, speed
        return way * math.cos(angle), -way * math.sin(angle), -angle, speed

    return place


def bow(network):
    """Two lanes of a half circle that go on as straight lanes."""
    for k, radius in enumerate((20.0, 24.0)):
        arc = CircularLane([0, 20], radius, math.pi / 2, -math.pi / 2, clockwise=False, speed_limit=20)
        network.add_lane("a", "b", arc)
        network.add_lane("b", "c", StraightLane([0, -4.0 * k], [-120, -4.0 * k], speed_limit=20))


def out_of_the_bow(speed, frequency, frames, before):
    """Along the inner lane near its outer marking, so far before the end of the arc after so many frames [m]."""

    def place(frame):
        way = (frame - frames) * speed / frequency - before
        if way > 0:
            return -way, 0.0, math.pi, speed
        turned = way / 20
        return -20.88 * math.sin(turned), 20 - 20.88 * math.cos(turned), math.pi + turned, speed

    return place


def crash_with_a_verified_plan(env, frames):
    """Whether the ego crashes in the frame after a verified decision, and nobody had violated a rule."""
    for _ in range(frames):
        clean = not env.filter.by_rule
        env.step(SLOWER)
        if env.unwrapped.vehicle.crashed:
            return clean and str(env.frame_decisions[-1].tier) in VERIFIED
    return False


@pytest.mark.parametrize("angle", [0.8, 0.45])
@pytest.mark.parametrize(("speed", "frequency"), [(20.0, 5), (30.0, 10)])
def test_straight_motion_past_a_joint_crashes_no_ego_with_a_verified_plan(angle, speed, frequency):
    for over in (0.3, 0.8, 1.5):
        for side in (2.9, 3.2):
            gap = max(2.4 + speed / frequency - over, 2.9)
            env = shielded(kinked(angle, gap, side), (("p", "q", 0), 2.5), 0.0, frequency, action=SLOW)
            scripted(env, round_the_joint(angle, speed, frequency, 3))
            assert not crash_with_a_verified_plan(env, 6)


@pytest.mark.parametrize(("speed", "before", "ahead"), [(40.0, 3.0, 6.5), (40.0, 1.5, 7.0), (30.0, 1.5, 6.0)])
def test_straight_motion_out_of_a_bend_crashes_no_ego_with_a_verified_plan(speed, before, ahead):
    env = shielded(bow, (("b", "c", 1), ahead + 2.5), 0.0, 5, action=SLOW)
    scripted(env, out_of_the_bow(speed, 5, 3, before))
    assert not crash_with_a_verified_plan(env, 6)


def nearly_a_circle(turn):
    """A lane into an arc."""

    def build(network):
        network.add_lane("a", "b", StraightLane([-60, 0], [0, 0], speed_limit=15))
        arc = CircularLane([0, 12], 12, -math.pi / 2, turn - math.pi / 2, speed_limit=15)
        network.add_lane("b", "c", arc)

    return build


def test_an_arc_of_nearly_a_circle_is_refused():
    """A body at its start can reach across its end: an attack drove the ego into its tail with a verified plan."""
    with pytest.raises(SceneError, match=r"lane \('b', 'c', 0\) is an arc of 338 degrees.*divide it into two lanes"):
        shielded(nearly_a_circle(5.9), (("a", "b", 0), 10.0), 5.0, 10)
    assert shielded(nearly_a_circle(4.9), (("a", "b", 0), 10.0), 5.0, 10)
