"""What attacks on the certificate of road networks have found, driven again."""

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
def test_the_lane_that_the_ego_is_in_is_tried_where_the_one_beside_is_taken(env_id, config, seed, action):
    """At the first decision nothing is stored: only the lane that was asked for was tried, and the ego steered into
    whoever was there. In the first three it crashed."""
    env = ShieldedEnv(gym.make(env_id, config=config), "worst-case")
    env.reset(seed=seed)
    mask = env.action_masks()
    assert mask[IDLE]
    assert not mask[action]
    env.reset(seed=seed)
    *_, info = env.step(action)
    assert info["shield"]["guarantee"] == "full"
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
def test_who_gets_shorter_takes_nothing_away_from_what_is_verified(start):
    """The ego was to rest with its rear just beyond the end of a lane. Whoever would have reached it from there was
    taken to wait before it, and so never to come to the next lane; as it turned its body grew too short to reach it,
    and then it did come, and had broken no rule."""
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
    assert "unforeseen" not in env.door.by_rule


@pytest.mark.parametrize("kind", ["sound", "wreck", "object"])
def test_whatever_appears_is_named(kind):
    env = ShieldedEnv(gym.make("merge-v0"), "worst-case")
    env.reset(seed=1)
    base = env.unwrapped
    ego, road = base.vehicle, base.road
    road.vehicles = [ego]
    env.door.reset()
    env.step(IDLE)
    assert env.door.by_rule == {}
    at = ego.position + np.array([14.0, 0.0])
    if kind == "object":
        road.objects.append(Obstacle(road, at))
    else:
        body = Vehicle(road, at, 0.0, 0.0)
        body.route, body.crashed = None, kind == "wreck"
        road.vehicles.append(body)
    env.step(IDLE)
    assert env.door.by_rule["appeared"] == 1
