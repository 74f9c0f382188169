"""Simulated traffic: a body that appears is named if it leaves the ego no verified plan, and only then."""

from __future__ import annotations

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.kinematics import Vehicle
from highway_env.vehicle.objects import Obstacle

from shield import Shield, ShieldConfig, ShieldedEnv
from shield.decision import Reason

EXACT = ShieldConfig.simulated_traffic()
INPUTS = {"action": {"type": "ContinuousAction"}}
CASES = {
    "highway": ("highway-fast-v0", {"vehicles_count": 5}),
    "highway inputs": ("highway-fast-v0", {"vehicles_count": 5, **INPUTS}),
    "merge": ("merge-v0", {}),
    "roundabout": ("roundabout-v1", {}),
    "intersection inputs": ("intersection-v1", {}),
}


def standing(base, at, kind):
    """A body at rest, of the given kind, at a position."""
    if kind is Obstacle:
        return Obstacle(base.road, at)
    body = kind(base.road, at, base.vehicle.heading, 0.0)
    body.target_speed = 0.0
    if hasattr(base.vehicle, "route"):
        body.route = base.vehicle.route
    return body


def put(base, ahead, kind):
    """Put a row of bodies across the road, so far ahead of the ego [m]."""
    ego = base.vehicle
    across = np.array([-ego.direction[1], ego.direction[0]])
    for k in range(-4, 5):
        body = standing(base, ego.position + ahead * ego.direction + 4.0 * k * across, kind)
        (base.road.objects if kind is Obstacle else base.road.vehicles).append(body)


class Runs:
    """An environment behind a shield of either kind, one decision after the other."""

    def __init__(self, case, placement, seed=0):
        env_id, config = CASES[case]
        env = gym.make(env_id, config=config, disable_env_checker=True)
        self.base = env.unwrapped
        inputs = config.get("action") or type(self.base.action_type).__name__ == "ContinuousAction"
        self.action = np.zeros(2, np.float32) if inputs else 1
        self.env = ShieldedEnv(env, EXACT) if placement == "env" else env
        self.obs, _ = self.env.reset(seed=seed)
        self.shield = None if placement == "env" else Shield(lambda _: self.action, env=env, config=EXACT)

    @property
    def rules(self):
        """The violations of the episode so far."""
        return (self.env._filter if self.shield is None else self.shield._filters[0]).by_rule

    def step(self):
        """The report of the next decision."""
        action = self.action if self.shield is None else self.shield.predict(self.obs)[0]
        self.obs, _, self.over, _, info = self.env.step(action)
        return info["shield"] if self.shield is None else self.shield.report()


@pytest.mark.parametrize("kind", [IDMVehicle, Obstacle])
@pytest.mark.parametrize("placement", ["env", "policy"])
@pytest.mark.parametrize("case", CASES)
def test_a_body_that_appears_in_the_way_in_simulated_traffic_is_a_violator(case, placement, kind):
    """A wall appears close ahead of the ego between two decisions; the stored plan no longer keeps the buffer."""
    run = Runs(case, placement)
    assert run.step()["violations"] == 0
    put(run.base, 6.5, kind)
    run.step()
    assert run.rules.get("appeared", 0) > 0


@pytest.mark.parametrize("placement", ["env", "policy"])
@pytest.mark.parametrize("case", ["highway", "merge", "roundabout"])
def test_a_body_that_appears_within_a_decision_and_is_hit_is_a_violator(case, placement):
    """No decision falls between its appearance and the crash that ends the episode."""
    run = Runs(case, placement)
    own, frames = run.base.road.step, []
    assert run.step()["violations"] == 0

    def step(dt):
        frames.append(dt)
        if len(frames) == 2:
            put(run.base, 6.0, Obstacle)
        own(dt)

    run.base.road.step = step
    told = run.step()
    assert run.base.vehicle.crashed
    assert told["rules"].get("appeared", 0) > 0


@pytest.mark.parametrize("placement", ["env", "policy"])
@pytest.mark.parametrize("case", CASES)
def test_a_body_that_appears_behind_the_ego_is_no_violator(case, placement):
    """Behind the ego a body takes no plan away."""
    run = Runs(case, placement)
    run.step()
    ego = run.base.vehicle
    run.base.road.objects.append(Obstacle(run.base.road, ego.position - 30.0 * ego.direction))
    for _ in range(2):
        run.step()
        assert "appeared" not in run.rules
    assert not ego.crashed


@pytest.mark.parametrize("placement", ["env", "policy"])
def test_only_the_new_body_in_the_way_is_a_violator(placement):
    """Of two that appear at once, one wall of bodies in the way, and one behind."""
    run = Runs("highway", placement)
    run.step()
    ego = run.base.vehicle
    run.base.road.objects.append(Obstacle(run.base.road, ego.position - 60.0 * ego.direction))
    wide = Obstacle(run.base.road, ego.position + 12.0 * ego.direction)
    wide.LENGTH, wide.WIDTH = 2.0, 40.0
    run.base.road.objects.append(wide)
    run.step()
    assert run.rules["appeared"] == 1


@pytest.mark.parametrize("placement", ["env", "policy"])
def test_a_new_vehicle_that_cannot_be_simulated_is_a_violator(placement):
    """A vehicle of an unknown class makes the scene unreadable; without it the scene would be simulated."""

    class Stranger(Vehicle):
        """A vehicle with its own driver model."""

    run = Runs("highway", placement)
    run.step()
    ego = run.base.vehicle
    run.base.road.vehicles.append(Stranger(run.base.road, ego.position - 60.0 * ego.direction, 0.0, 20.0))
    told = run.step()
    assert told["reason"] == Reason.BAD_SCENE
    assert run.rules == {"appeared": 1}


@pytest.mark.parametrize("placement", ["env", "policy"])
@pytest.mark.parametrize("case", ["highway", "merge", "roundabout"])
def test_a_body_that_grows_or_an_obstacle_that_moves_is_a_prediction_mismatch(case, placement):
    """A vehicle grows, and then a standing obstacle is moved; neither was predicted."""
    run = Runs(case, placement)
    ego = run.base.vehicle
    stone = Obstacle(run.base.road, ego.position - 60.0 * ego.direction)
    run.base.road.objects.append(stone)
    run.step()
    assert run.step()["violations"] == 0
    grown = max(run.base.road.vehicles, key=lambda v: np.hypot(*(v.position - ego.position)))
    grown.LENGTH = 7.0
    run.step()
    assert run.rules["unforeseen"] == 1
    stone.position = stone.position + 1.0
    run.step()
    assert run.rules["unforeseen"] >= 2


def test_a_vehicle_that_highway_env_spawns_is_no_violator():
    """Intersections spawn vehicles between two decisions, which no simulation predicts."""
    env = ShieldedEnv(gym.make("intersection-v0", config={"spawn_probability": 1.0, "duration": 15}), EXACT)
    for seed in range(2):
        env.reset(seed=seed)
        done = False
        while not done:
            *_, terminated, truncated, info = env.step(1)
            assert not info["shield"]["rules"]
            done = terminated or truncated


def test_a_body_that_appears_before_one_of_several_egos_is_a_violator():
    """The shield of several egos verifies all plans together."""
    env = ShieldedEnv(gym.make("intersection-multi-agent-v2", config={"controlled_vehicles": 2}), EXACT)
    env.reset(seed=0)
    base = env.unwrapped
    *_, info = env.step((1, 1))
    assert info["shield"]["violations"] == 0
    ego = base.controlled_vehicles[1]
    ego.speed = 9.0
    env._filter.reset()
    env._filter.decide((1, 1))
    base.road.objects.append(Obstacle(base.road, ego.position + 5.5 * ego.direction))
    before = env._filter.by_rule
    env._filter.decide((1, 1))
    assert not before
    assert env._filter.by_rule == {"appeared": 1}
