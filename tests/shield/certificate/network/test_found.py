"""Failures that attacks on the network certificate have found, driven again."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from highway_env.vehicle.kinematics import Vehicle
from highway_env.vehicle.objects import Obstacle

from shield import ShieldedEnv

IDLE, RIGHT = 1, 2
DENSE = {"vehicles_density": 2.5, "vehicles_count": 50}


@pytest.mark.parametrize(
    ("env_id", "config", "seed", "action"),
    [
        *(("exit-v0", DENSE, seed, RIGHT) for seed in (60, 72, 106)),
        *(("exit-v0", {}, seed, RIGHT) for seed in (25, 43, 56, 60)),
    ],
)
def test_the_lane_of_the_ego_is_tried_where_the_lane_beside_is_occupied(env_id, config, seed, action):
    """At the first decision no plan is stored. Once only the proposed lane was tried, and the ego steered into the
    vehicle there; in the first three cases it crashed."""
    env = ShieldedEnv(gym.make(env_id, config=config), "worst-case")
    env.reset(seed=seed)
    mask = env.action_masks()
    assert mask[IDLE]
    assert not mask[action]
    env.reset(seed=seed)
    *_, info = env.step(action)
    assert info["shield"]["guarantee"] == "all vehicles seen"
    for _ in range(3):
        *_, info = env.step(IDLE)
    assert not info["crashed"]


class Weaving(Vehicle):
    """Speeds up to a limit while it swings about in its lane, ever further and back; all of it as is assumed."""

    TURNED, LIMIT, ACCELERATION = (0.08, 0.2, 0.32, 0.43), 19.8, 3.0
    frames, side, route = 0, 1.0, None

    def act(self, action=None):
        self.frames += 1
        turned, dt = self.TURNED[self.frames % 4], 1 / 15
        if self.frames % 4 == 0:
            self.side = -np.sign(self.position[1] - 4.0 + 1e-9)
        rate = (turned * self.side - self.heading) / dt
        slip = np.clip(rate * self.LENGTH / 2 / max(self.speed, 0.5), -0.95, 0.95)
        throttle = self.ACCELERATION if self.speed < self.LIMIT else 0.0
        super().act({"acceleration": throttle, "steering": float(np.arctan(2 * np.tan(np.arcsin(slip))))})


@pytest.mark.parametrize("start", [21.86, 21.88, 21.89, 21.9, 21.91, 21.93])
def test_a_follower_that_turns_and_gets_shorter_takes_no_plan_away(start):
    """The ego was to rest with its rear just beyond the end of a lane. A vehicle that would have reached the ego
    from there was assumed to wait, and so never to enter the next lane. As it turned, its body became too short to
    reach the ego, and it entered the next lane without breaking a rule."""
    env = ShieldedEnv(gym.make("merge-v0"), "worst-case")
    env.reset(seed=1)
    base, lane = env.unwrapped, ("b", "c", 1)
    ego, road = base.vehicle, base.road
    road.vehicles, road.objects = [ego], [Obstacle(road, [810.0, 4.0])]
    ego.position, ego.heading, ego.speed = road.network.get_lane(lane).position(start, 0.0), 0.0, 30.0
    ego.lane_index = ego.target_lane_index = lane
    ego.lane, ego.speed_index, ego.target_speed = road.network.get_lane(lane), ego.speed_to_index(30.0), 30.0
    before = road.network.get_lane(("a", "b", 1))
    small = Weaving(road, before.position(150.0 + start - 80.0, 0.0), 0.0, 14.0)
    small.LENGTH = small.WIDTH = 0.5
    small.diagonal = float(np.hypot(0.5, 0.5))
    road.vehicles.append(small)
    verified = 0
    for _ in range(12):
        *_, terminated, truncated, _ = env.step(IDLE)
        verified += sum(decision.tier.verified for decision in env.frame_decisions)
        if terminated or truncated:
            break
    assert verified > 30
    assert "unforeseen" not in env.filter.by_rule


@pytest.mark.parametrize("kind", ["sound", "wreck", "object"])
def test_a_body_that_appears_in_the_way_is_a_violator(kind):
    env = ShieldedEnv(gym.make("merge-v0"), "worst-case")
    env.reset(seed=1)
    base = env.unwrapped
    ego, road = base.vehicle, base.road
    road.vehicles = [ego]
    env.filter.reset()
    env.step(IDLE)
    assert env.filter.by_rule == {}
    at = ego.position + np.array([14.0, 0.0])
    if kind == "object":
        road.objects.append(Obstacle(road, at))
    else:
        body = Vehicle(road, at, 0.0, 0.0)
        body.route, body.crashed = None, kind == "wreck"
        road.vehicles.append(body)
    env.step(IDLE)
    assert env.filter.by_rule["appeared"] == 1


def alone_with(body_of, steps=3):
    """The rules that a body breaks which `body_of(road, ego)` puts on a merge; also whether the ego crashed."""
    env = ShieldedEnv(gym.make("merge-v0"), "worst-case")
    env.reset(seed=1)
    base = env.unwrapped
    ego, road = base.vehicle, base.road
    road.vehicles, road.objects = [ego], []
    body = body_of(road, ego)
    (road.objects if isinstance(body, Obstacle) else road.vehicles).append(body)
    env.filter.reset()
    for _ in range(steps):
        env.step(IDLE)
    return env.filter.by_rule


def creeping(road, at, way, growth):
    """An object that comes towards the ego, or grows, a little in each frame [m/s]."""
    body, step = Obstacle(road, at), road.step

    def creep(dt):
        step(dt)
        body.position = body.position - np.array([way * dt, 0.0])
        body.LENGTH += growth * dt

    road.step = creep
    return body


class Sliding(Vehicle):
    """A wreck that slides as in highway-env, or drives on."""

    brakes = True

    def clip_actions(self):
        if self.brakes:
            super().clip_actions()


@pytest.mark.parametrize(("way", "growth"), [(0.0, 0.0), (0.05, 0.0), (5.0, 0.0), (0.0, 0.05)])
def test_an_object_that_moves_or_grows_is_a_violator(way, growth):
    """However little it moves: a tolerance in each frame would add up."""
    rules = alone_with(lambda road, ego: creeping(road, ego.position + np.array([90.0, 0.0]), way, growth))
    assert rules == ({"moved": 1} if way or growth else {})


@pytest.mark.parametrize("speed", [0.0, 4.0, 12.0])
@pytest.mark.parametrize("brakes", [True, False])
def test_a_wreck_slides_as_highway_env_has_it_or_is_named(speed, brakes):
    def wreck(road, ego):
        body = Sliding(road, ego.position + np.array([90.0, 0.0]), 0.0, speed)
        body.route, body.crashed, body.brakes = None, True, brakes
        return body

    assert alone_with(wreck) == ({} if brakes or not speed else {"moved": 1})


class Growing(Vehicle):
    """A standing vehicle that grows towards the ego; no other code moves it."""

    growth = 0.0

    def step(self, dt):
        self.LENGTH += self.growth * dt
        super().step(dt)


@pytest.mark.parametrize("growth", [0.0, 1.0, 40.0])
def test_a_body_that_grows_into_the_way_of_the_fail_safe_is_named(growth):
    def standing(road, ego):
        body = Growing(road, ego.position + np.array([75.0, 0.0]), 0.0, 0.0)
        body.route, body.growth = None, growth
        return body

    assert alone_with(standing, 6).get("grown", 0) == (1 if growth else 0)


def test_no_plan_is_verified_beyond_the_end_of_the_road():
    """highway-env turns an ego at the end of a two-way road back to the other side. A vehicle that stands there has
    broken no rule, and the certificate has not failed."""
    env = ShieldedEnv(gym.make("two-way-v0", config={"policy_frequency": 15}), "worst-case")
    env.reset(seed=0)
    base = env.unwrapped
    road, ego, lane = base.road, base.vehicle, ("a", "b", 1)
    ego.position, ego.speed = road.network.get_lane(lane).position(776.0, 0.0), 24.0
    ego.lane_index = ego.target_lane_index = lane
    ego.lane = road.network.get_lane(lane)
    other = Vehicle.make_on_lane(road, ("b", "a", 0), 6.6, 0.0)
    road.vehicles = [ego, other]
    env.filter.reset()
    for _ in range(20):
        _, _, terminated, truncated, _ = env.step(3)
        if terminated or truncated:
            break
    assert ego.position[0] > 797.0
    assert "unforeseen" not in env.filter.by_rule
