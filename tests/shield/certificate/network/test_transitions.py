"""One frame on a road network: the reachable set of a vehicle that keeps the rules does not grow, so a verified plan
stays verified."""

from dataclasses import replace

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from highway_env.road.lane import CircularLane
from highway_env.vehicle.kinematics import Vehicle
from slowly import later

from dynamics.road_networks.reachable.strips import START
from shield import ShieldConfig, ShieldedEnv
from shield.certificate.network.choice import try_candidate
from shield.certificate.network.monitor import NetworkMonitor, NetworkRule
from shield.certificate.network.tolerances import CLEAR
from shield.filters.network import NetworkFilter

HARD = 9.8


class Scene:
    """A filter in front of an environment with the ego and one other vehicle, both placed freely."""

    def __init__(self, env_id, size=(5.0, 2.0)):
        env = gym.make(env_id)
        env.reset(seed=0)
        self.base = env.unwrapped
        road, self.ego = self.base.road, self.base.vehicle
        self.network, self.ego.route = road.network, None
        self.other = Vehicle(road, road.network.lanes_list()[0].position(0, 0))
        self.other.LENGTH, self.other.WIDTH = size
        road.vehicles, road.objects = [self.ego, self.other], []
        self.network_filter = NetworkFilter(self.base, ShieldConfig.for_roads())
        self.network_filter.reset()

    def put(self, vehicle, lane, position, heading, speed):
        """A vehicle on a lane of highway-env's; the ego is bound for it."""
        vehicle.position, vehicle.heading, vehicle.speed = np.array(position, float), float(heading), float(speed)
        vehicle.lane_index, vehicle.lane, vehicle.route = lane, self.network.get_lane(lane), None
        if vehicle is self.ego:
            vehicle.target_lane_index = lane

    def on(self, vehicle, lane, s, r, speed):
        """A vehicle along a lane."""
        at = self.network.get_lane(lane)
        self.put(vehicle, lane, at.position(s, r), at.heading_at(s), speed)

    def see(self):
        """The scene, without obligations."""
        self.network_filter._read()
        self.network_filter._others.obliged[:] = False
        return self.network_filter._others

    def margin(self, lane, speed, frames):
        """The least separation if the ego is bound for a lane at a speed for so many frames, and brakes then [m]."""
        row = np.array([self.network_filter._index[lane], speed, 1e3, frames, 0, HARD], float)
        self.see()
        network_filter = self.network_filter
        return try_candidate(
            network_filter._alone, network_filter._road, network_filter._others, row, False, network_filter._rollout
        ).margin

    def rules(self, before, after):
        """The rules that the other one breaks between two scenes (`NetworkPredictor.look`) where the fail-safe
        suffers."""
        watch = NetworkMonitor()
        for seen in (before, after):
            watch.next(seen, {self.other}, np.array([-1.0]), self.network_filter._road, set())
        return set(watch.breaking.get(self.other, ()))

    def looks(self, *states):
        """The scene with the other one in each of these, (lane, position, heading, length, width), at rest."""
        for lane, position, heading, length, width in states:
            self.put(self.other, lane, position, heading, 0.0)
            self.other.LENGTH, self.other.WIDTH = length, width
            yield self.network_filter._predict()


def test_a_vehicle_that_narrows_at_the_outer_edge_of_an_arc_is_a_violator():
    """Its outline stays where it was, but its centre is further from the lane's centre: a metre driven there is more
    of the lane."""
    scene, length = Scene("u-turn-v0"), 1.556
    lane = scene.network.get_lane(("b", "c", 0))
    s, r = lane.local_coordinates(np.array([135.664, 44.529]))
    wide = ("b", "c", 0), lane.position(s, r), -0.083, length, 2.286
    narrow = ("b", "c", 1), lane.position(s, r + 0.3), -0.083, length, 0.5
    before, after = scene.looks(wide, narrow)
    assert after.others.most[0, -1] > before.others.most[0, -1] + 1.0
    assert scene.rules(before, after) == {NetworkRule.WAYS}
    # The other way round, the body grows.
    assert NetworkRule.GROWN in scene.rules(after, before)


@pytest.mark.parametrize("column", range(5))
def test_every_quantity_that_bounds_a_vehicle_s_travel_is_monitored(column):
    """Each column of `NetworkVehicles.drive`, changed to the side on which the vehicle reaches further, or less far,
    than before."""
    scene, lane = Scene("merge-v0"), ("b", "c", 2)
    at = scene.network.get_lane(lane).position(30.0, 0.0)
    before, after = scene.looks((lane, at, 0.0, 5.0, 2.0), (lane, at, 0.0, 5.0, 2.0))
    assert scene.rules(before, after) == {NetworkRule.UNFORESEEN}
    worse = -1 if column in (1, 4) else 1
    after.others.drive[0, column] += 1e-9 * worse
    assert scene.rules(before, after) == {NetworkRule.WAYS}
    after.others.drive[0, column] -= 2e-9 * worse
    assert scene.rules(before, after) == {NetworkRule.UNFORESEEN}


@pytest.mark.parametrize(("turned", "r", "gap"), [(0.2, 2.6, 7.1), (0.1, 2.8, 7.5), (0.3, 2.8, 7.0)])
def test_a_last_frame_of_rolling_back_lowers_no_margin(turned, r, gap):
    """A vehicle brakes to a standstill and still moves by its former speed, while the ego turns out of its lane. The
    separation stays the same."""
    own, beside, dt, back = ("a", "b", 0), ("a", "b", 1), 1 / 15, -0.19
    scene = Scene("merge-v0")
    scene.put(scene.ego, own, [60.0, r], turned, 10.0)
    scene.put(scene.other, own, [60.0 + gap, 0.0], 0.0, back)
    scene.ego.target_lane_index = beside
    then = scene.margin(beside, 10.0, 30)
    x, y, heading, speed = scene.network_filter._rollout.path[1]
    scene.put(scene.ego, own, [x, y], heading, speed)
    scene.put(scene.other, own, [60.0 + gap + back * dt, 0.0], 0.0, 0.0)
    scene.ego.target_lane_index = beside
    assert scene.margin(beside, 10.0, 29) >= then - 1e-9


@pytest.mark.parametrize(
    ("env_id", "length"), [("intersection-v0", 5.0), ("roundabout-v0", 12.0), *later(("u-turn-v0", 12.0))]
)
def test_a_follower_that_shifts_towards_the_centre_of_an_arc_comes_no_nearer(env_id, length):
    """The ego counts on a follower in an arc to brake, from the first frame in which it sees the ego. The follower's
    front moves ahead as it shifts, which is permitted."""
    scene = Scene(env_id, (length, 2.0))
    tried, arcs = 0, [(key, lane) for key, lane in scene.network.lanes_dict().items() if type(lane) is CircularLane]
    for key, lane in arcs[:4]:
        inside = 1.0 if lane.direction > 0 else -1.0
        scene.on(scene.ego, key, lane.length, 0.0, 4.0)
        for s in np.linspace(0.0, 0.5, 3) * lane.length:
            margins = []
            for r in (-0.5, 0.0, 0.5):
                scene.on(scene.other, key, s, inside * r, 4.0)
                margins.append(scene.margin(key, 4.0, 1))
            tried += margins[0] < np.inf
            assert margins == pytest.approx(margins[:1] * 3, abs=1e-9)
    assert tried


@pytest.mark.parametrize(
    ("lane", "ego", "other", "then"),
    [
        (("k", "b", 0), (-6.96, -2.96, 0.0), (-19.86, -1.31), -0.39),
        (("b", "c", 2), (-8.415, 1.704, 0.155), (-16.13, -1.527), -1.192),
        (("b", "c", 2), (-7.74, 1.54, 0.2), (-17.23, -1.77), -1.22),
    ],
)
def test_a_vehicle_that_newly_fits_past_the_ego_is_a_violator(lane, ego, other, then):
    """The ego rests off-centre before the end of a lane, and another vehicle stands behind it, off-centre too. Lanes
    beyond are left out where that vehicle has to stop behind the ego. A frame later it is further inside its band,
    and can pass."""
    scene = Scene("merge-v0")
    on = scene.network.get_lane(lane)
    s, r, turned = on.length + ego[0], ego[1], ego[2]
    scene.put(scene.ego, lane, on.position(s, r), on.heading_at(s) + turned, 0.0)
    margins, seen = [], []
    for across in (other[1], then):
        scene.on(scene.other, lane, on.length + other[0], across, 0.0)
        margins.append(scene.margin(lane, 0.0, 1))
        seen.append(replace(scene.network_filter._predict(), others=scene.network_filter._others))
    assert not margins[0] >= CLEAR > margins[1] or scene.rules(*seen) == {NetworkRule.WAYS}


@pytest.mark.parametrize(("r", "shut"), [(0.0, True), (-2.96, False)])
def test_the_ego_closes_a_lane_where_it_covers_its_middle(r, shut):
    """One behind it could pass beside it, once back in the middle."""
    scene, lane = Scene("merge-v0"), ("k", "b", 0)
    length = scene.network.get_lane(lane).length
    scene.on(scene.ego, lane, length - 6.96, r, 0.0)
    scene.on(scene.other, lane, length - 19.86, -1.31, 0.0)
    assert (scene.margin(lane, 0.0, 1) >= CLEAR) == shut
    others = scene.network_filter._others
    assert others.shut[others.marks[:, 1] != scene.network_filter._index[lane]].any() == shut


def test_the_traffic_of_highway_env_on_an_arc_causes_no_prediction_mismatch():
    """A car in the right turn before the ego's lane is counted on to brake, and drifts by a centimetre."""
    seed, rng = 1820003, np.random.default_rng(1820003)
    env = ShieldedEnv(gym.make("intersection-v0"), config="worst-case")
    env.reset(seed=seed)
    actions = list(env.unwrapped.action_type.actions_indexes.values())
    over = False
    while not over:
        *_, terminated, truncated, _ = env.step(actions[rng.integers(len(actions))])
        over = terminated or truncated
    assert "unforeseen" not in env.filter.by_rule


@pytest.mark.parametrize("env_id", ["roundabout-v0", "u-turn-v0", "intersection-v0"])
def test_the_place_where_a_vehicle_can_enter_a_lane_does_not_move_back(env_id):
    """Several lanes end at different places of a ring. A vehicle along one of them arrives on the ring no further
    back than was predicted."""
    scene = Scene(env_id)
    checked = 0
    for key, lane in scene.network.lanes_dict().items():
        last = {}
        for left in np.arange(12.0, 0.0, -0.5):
            if left > lane.length:
                continue
            scene.on(scene.other, key, lane.length - left, 0.0, 7.5)
            others = scene.see()
            now = {}
            for (_, number, _), numbers in zip(others.marks.tolist(), others.numbers, strict=True):
                now[number] = min(now.get(number, np.inf), numbers[START])
            for number in now.keys() & last.keys():
                assert now[number] >= last[number] - 1e-9
                checked += 1
            last = now
    assert checked
