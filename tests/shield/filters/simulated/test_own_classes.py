"""Environments of the user's own classes are simulated as long as highway-env's own methods move their traffic."""

from typing import ClassVar

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.highway_env import HighwayEnv, HighwayEnvFast
from highway_env.envs.intersection_env import IntersectionEnv
from highway_env.envs.merge_env import ConnectedLaneMergeEnv, MergeEnv
from highway_env.envs.roundabout_env import RoundaboutEnv
from highway_env.road.road import Road

from shield import ShieldConfig, ShieldedEnv
from shield.errors import ConfigError

INPUTS = {"action": {"type": "ContinuousAction"}}


def of_its_own(parent):
    class Mine(parent):
        """Its own reward, observation's extra information, end, and a setting that only it knows."""

        @classmethod
        def default_config(cls):
            return {**super().default_config(), "comfort_weight": 0.1}

        def _reward(self, action):
            return float(self.vehicle.speed / 30) - self.config["comfort_weight"]

        def _info(self, obs, action=None):
            return {**super()._info(obs, action), "mine": True}

        def _is_terminated(self):
            return bool(self.vehicle.crashed)

    return Mine


class Late(HighwayEnvFast):
    """Its own place for the ego, and more vehicles."""

    def _create_vehicles(self):
        super()._create_vehicles()
        self.vehicle.position[0] += 15.0


class Shaped(HighwayEnvFast):
    """A reward that is changed in `step`, which declares that it moves no vehicle."""

    changes_between_decisions_only = True

    def step(self, action):
        obs, reward, terminated, truncated, info = super().step(action)
        return obs, reward / 2, terminated, truncated, info


class Undeclared(HighwayEnvFast):
    def step(self, action):
        return super().step(action)


class Pushed(HighwayEnvFast):
    def _simulate(self, action=None):
        for vehicle in self.road.vehicles[1:]:
            vehicle.speed -= 1.0
        super()._simulate(action)


class PushedMerge(MergeEnv):
    _simulate = Pushed._simulate


class Crowded(IntersectionEnv):
    def _spawn_vehicle(self, *args, **kwargs):
        return super()._spawn_vehicle(*args, spawn_probability=1.0)


class Jammed(IntersectionEnv):
    def _clear_vehicles(self):
        pass


class SlowRoad(Road):
    def step(self, dt):
        super().step(dt / 2)


class OnSlowRoad(HighwayEnvFast):
    def _create_road(self):
        super()._create_road()
        self.road = SlowRoad(network=self.road.network, np_random=self.np_random)


class SlowMerge(MergeEnv):
    def _make_road(self):
        super()._make_road()
        self.road = SlowRoad(network=self.road.network, np_random=self.np_random)


class Bare(AbstractEnv):
    """A road of the user's own, moved by highway-env alone."""

    metadata: ClassVar = {"render_modes": []}

    def _reset(self):
        MergeEnv._make_road(self)
        MergeEnv._make_vehicles(self)

    def _reward(self, action):
        return 0.0

    def _is_terminated(self):
        return bool(self.vehicle.crashed)

    def _is_truncated(self):
        return False


def decisions(env, seed=3, count=6):
    env.reset(seed=seed)
    rng, found = np.random.default_rng(0), []
    for _ in range(count):
        inputs = not isinstance(env.action_space, gym.spaces.Discrete)
        action = rng.uniform(-1, 1, 2).astype(np.float32) if inputs else int(rng.integers(env.action_space.n))
        *_, terminated, _, info = env.step(action)
        told = info["shield"]["tier"], info["shield"]["reason"], info["shield"]["margin"]
        found.append(str([told, [(*v.position.tolist(), v.speed) for v in env.unwrapped.road.vehicles[:5]]]))
        if terminated:
            break
    return found


@pytest.mark.parametrize(
    ("parent", "config"),
    [
        (HighwayEnvFast, {}),
        (HighwayEnv, {"vehicles_count": 10}),
        (HighwayEnvFast, INPUTS),
        (MergeEnv, {}),
        (ConnectedLaneMergeEnv, {}),
        (RoundaboutEnv, {}),
        (IntersectionEnv, {}),
    ],
)
def test_a_class_with_its_own_reward_is_driven_as_its_parent(parent, config):
    """It was refused by its id on straight highways, and by settings that only it knows."""
    mine = ShieldedEnv(of_its_own(parent)(config), ShieldConfig.simulated_traffic())
    assert decisions(mine) == decisions(ShieldedEnv(parent(config), ShieldConfig.simulated_traffic()))


def test_users_ids_are_driven_with_their_registered_configuration():
    """Another id of highway-env's class, one of the user's class, and one whose entry point is a function."""
    mine = of_its_own(HighwayEnvFast)
    config = {"lanes_count": 5, "vehicles_count": 8}
    for name, entry in (("Same", HighwayEnvFast), ("Mine", mine), ("Made", lambda **kw: mine(**kw))):
        gym.register(f"{name}-v0", entry_point=entry, kwargs={"config": config})
        try:
            env = ShieldedEnv(gym.make(f"{name}-v0"), ShieldConfig.simulated_traffic())
            expected = ShieldedEnv(gym.make("highway-fast-v0", config=config), ShieldConfig.simulated_traffic())
            assert decisions(env) == decisions(expected)
        finally:
            gym.registry.pop(f"{name}-v0")


@pytest.mark.parametrize("kind", [Late, Shaped, Bare])
def test_users_classes_may_override_the_reset_and_the_step_between_decisions(kind):
    """Scenes are read from the environment."""
    env = ShieldedEnv(kind(), ShieldConfig.simulated_traffic())
    env.reset(seed=1)
    for _ in range(4):
        *_, terminated, _, info = env.step(3)
        assert info["shield"]["tier"] in ("passed", "alternative")
        assert info["shield"]["violations"] == 0
        assert not terminated


@pytest.mark.parametrize(
    ("kind", "named"),
    [
        (Undeclared, r"Undeclared\.step is not highway-env's.*changes_between_decisions_only"),
        (Pushed, r"Pushed\._simulate is not highway-env's"),
        (PushedMerge, r"PushedMerge\._simulate is not highway-env's"),
        (Crowded, r"Crowded\._spawn_vehicle is not highway-env's"),
        (Jammed, r"Jammed\._clear_vehicles is not highway-env's"),
        (OnSlowRoad, r"a SlowRoad, moves its vehicles in a way of its own: SlowRoad\.step"),
        (SlowMerge, r"a SlowRoad, moves its vehicles in a way of its own: SlowRoad\.step"),
    ],
)
def test_a_class_that_moves_its_traffic_itself_is_refused_by_the_method(kind, named):
    """A road of its own class was simulated as highway-env's."""
    with pytest.raises(ConfigError, match=named):
        ShieldedEnv(kind(), ShieldConfig.simulated_traffic())


def test_users_classes_with_throttle_and_steering_on_highways_are_refused_alike():
    """The network simulator simulates them, and once checked nothing on straight highways."""
    with pytest.raises(ConfigError, match=r"Pushed\._simulate is not highway-env's"):
        ShieldedEnv(Pushed(INPUTS), ShieldConfig.simulated_traffic())


def test_an_overridden_step_of_the_environment_is_detected():
    """An attribute hides the method of the class."""
    env = gym.make("highway-fast-v0")
    env.unwrapped.step = lambda action: None
    with pytest.raises(ConfigError, match=r"this HighwayEnvFast\.step is not highway-env's"):
        ShieldedEnv(env, ShieldConfig.simulated_traffic())
