"""Configurations under which the ego does not execute verified decisions are refused, at every entry point."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from policies import Always
from stable_baselines3.common.vec_env import DummyVecEnv

from dynamics.highway_simulator.env import CompiledHighwayEnv
from shield import Shield, ShieldConfig, ShieldedEnv
from shield.batch.highways import ShieldedHighways
from shield.certificate.simulated.highways import SimulatedHighways
from shield.certificate.simulated.roads import SimulatedRoads
from shield.errors import ConfigError, SceneError
from shield.filters.supervision import limited_braking
from shield.perception.known import Known

META = {"type": "DiscreteMetaAction"}
REVERSING = {"action": {**META, "target_speeds": [-10, 0, 10, 20, 30]}}
BY_HAND = {"manual_control": True}
INPUTS = {"action": {"type": "ContinuousAction"}}
TEAM = {
    "controlled_vehicles": 2,
    "action": {"type": "MultiAgentAction", "action_config": META},
    "observation": {"type": "MultiAgentObservation", "observation_config": {"type": "Kinematics"}},
}
TEAM_REVERSING = {**TEAM, "action": {"type": "MultiAgentAction", "action_config": REVERSING["action"]}}
ENTRIES = {
    "env": lambda env: ShieldedEnv(env),
    "env, a rule": lambda env: ShieldedEnv(env, ShieldConfig(mode="rss")),
    "env, observations": lambda env: ShieldedEnv(env, perception="observation"),
    "env, simulated": lambda env: ShieldedEnv(env, ShieldConfig.simulated_traffic()),
    "policy": lambda env: Shield(Always(4), env=env),
    "policy, actions only": lambda env: Shield(Always(4), env=env, frames=False),
    "policy, simulated": lambda env: Shield(Always(4), env=env, config=ShieldConfig.simulated_traffic()),
    "policy, several": lambda env: Shield(Always(4), env=DummyVecEnv([lambda: env])),
}
ROADS = ("roundabout-v1", "merge-v1")


def made(env_id, config):
    return gym.make(env_id, config=config).unwrapped if config is None else gym.make(env_id, config=config)


@pytest.mark.parametrize("entry", ENTRIES)
@pytest.mark.parametrize(("config", "message"), [(REVERSING, "drives backwards"), (BY_HAND, "manual_control")])
def test_reversing_and_manual_control_are_refused_on_highways(entry, config, message):
    """Meta-actions that drive backwards crashed with tier "passed"; under manual control no action reaches the ego."""
    with pytest.raises(ConfigError, match=message):
        ENTRIES[entry](made("highway-fast-v0", config))


@pytest.mark.parametrize("entry", ["env", "env, simulated", "policy", "policy, simulated"])
@pytest.mark.parametrize("env_id", ROADS)
@pytest.mark.parametrize(("config", "message"), [(REVERSING, "drives backwards"), (BY_HAND, "manual_control")])
def test_reversing_and_manual_control_are_refused_on_networks(entry, env_id, config, message):
    """The same with simulated traffic on networks, and in the worst case there."""
    with pytest.raises(ConfigError, match=message):
        ENTRIES[entry](made(env_id, config))


@pytest.mark.parametrize(
    ("env_id", "config", "settings"),
    [
        ("highway-fast-v0", INPUTS, None),
        ("highway-fast-v0", INPUTS, ShieldConfig.simulated_traffic()),
        ("parking-v0", {}, None),
        ("racetrack-v1", {}, ShieldConfig.simulated_traffic()),
    ],
)
def test_throttle_and_steering_with_manual_control_are_refused(env_id, config, settings):
    """Throttle and steering are cut off from the ego in the same way."""
    with pytest.raises(ConfigError, match="manual_control"):
        ShieldedEnv(made(env_id, {**config, **BY_HAND}), settings)


@pytest.mark.parametrize(
    ("config", "message"), [(TEAM_REVERSING, "drives backwards"), ({**TEAM, **BY_HAND}, "manual_control")]
)
def test_several_egos_are_refused_in_the_same_way(config, message):
    """Each ego of a team has target speeds of its own."""
    with pytest.raises(ConfigError, match=message):
        ShieldedEnv(made("intersection-v2", config), ShieldConfig.simulated_traffic())


@pytest.mark.parametrize(
    "build",
    [
        lambda: ShieldedHighways("highway-fast-v0", 1, REVERSING),
        lambda: SimulatedHighways("highway-fast-v0", 1, REVERSING),
        lambda: SimulatedRoads("roundabout-v1", 1, REVERSING),
        lambda: ShieldedEnv(CompiledHighwayEnv("highway-fast-v0", REVERSING)),
        lambda: Known.from_config({**highway_config(), **REVERSING}),
    ],
    ids=["highways", "simulated highways", "roads", "compiled highway", "known"],
)
def test_batches_and_known_environments_refuse_reversing(build):
    """The compiled batches and environments that are out of reach decide as the entry points of one environment do."""
    with pytest.raises(ConfigError, match="drives backwards"):
        build()


def highway_config():
    return made("highway-fast-v0", {}).unwrapped.config


@pytest.mark.parametrize("speeds", [[30, 20, 0], [0, 20, 10, 30], [0, float("nan"), 20]])
def test_target_speeds_have_to_ascend(speeds):
    """SLOWER, the fallback of every stage, would otherwise be faster."""
    config = {"action": {**META, "target_speeds": speeds}}
    with pytest.raises(ConfigError, match="ascending order"):
        ShieldedEnv(made("highway-fast-v0", config))


@pytest.mark.parametrize("entry", ["env", "env, simulated", "policy", "policy, simulated"])
@pytest.mark.parametrize("env_id", ["highway-fast-v0", "merge-v1"])
@pytest.mark.parametrize(("config", "message"), [(REVERSING, "drives backwards"), (BY_HAND, "manual_control")])
def test_a_reset_that_changes_the_configuration_is_refused_too(entry, env_id, config, message):
    """The configuration that was checked at construction is not the one that is driven."""
    env = made(env_id, {})
    shielded = ENTRIES[entry](env)
    options = {"config": config}
    if isinstance(shielded, ShieldedEnv):
        shielded.reset(seed=0)
        with pytest.raises(ConfigError, match=message):
            shielded.reset(seed=0, options=options)
        return
    obs, _ = env.reset(seed=0, options=options)
    with pytest.raises(ConfigError, match=message):
        shielded.predict(obs)


class Repeated(gym.Wrapper):
    """Takes each action twice."""

    def step(self, action):
        self.env.step(action)
        return self.env.step(action)


class Inverted(gym.Wrapper):
    """Steers to the other side."""

    def step(self, action):
        return self.env.step(-np.asarray(action))


@pytest.mark.parametrize("settings", [None, ShieldConfig.simulated_traffic()])
def test_a_wrapper_that_repeats_actions_is_detected(settings):
    """The second of two equal actions is another decision, which was not verified."""
    env = ShieldedEnv(Repeated(gym.make("highway-fast-v0")), settings)
    env.reset(seed=0)
    with pytest.raises(ConfigError, match="10 frames in one step, and a decision has 5"):
        env.step(1)


def test_a_wrapper_that_changes_throttle_and_steering_is_detected():
    """`ActionWrapper`s are refused at construction; any other wrapper is detected by the action that the environment
    got."""
    env = ShieldedEnv(Inverted(gym.make("highway-fast-v0", config=INPUTS)))
    env.reset(seed=0)
    with pytest.raises(ConfigError, match="a wrapper inside changes it"):
        env.step(np.array([0.0, 0.01], np.float32))


@pytest.mark.parametrize("settings", [None, ShieldConfig.simulated_traffic()])
def test_steps_without_the_shield_are_detected(settings):
    """`Shield` decides once, and its action is executed twice: the second step is not verified."""
    env = gym.make("highway-fast-v0")
    obs, _ = env.reset(seed=0)
    shielded = Shield(Always(1), env=env, config=settings)
    action, _ = shielded.predict(obs)
    env.step(action)
    obs, *_ = env.step(action)
    with pytest.raises(ConfigError, match=r"10 frames since the last predict\(\), and a decision has 5"):
        shielded.predict(obs)


def fail():
    raise SceneError("a sensor is broken")


@pytest.mark.parametrize(
    ("env_id", "config", "reads"),
    [
        ("highway-fast-v0", {}, lambda action_filter: (action_filter.reader, "read")),
        ("highway-fast-v0", INPUTS, lambda action_filter: (action_filter._reader, "read")),
        ("roundabout-v1", {}, lambda action_filter: (action_filter, "_read")),
    ],
)
@pytest.mark.parametrize("speed", [20.0, 1.0, 0.0, -5.0])
def test_an_unreadable_scene_brings_the_ego_to_a_standstill(env_id, config, reads, speed, monkeypatch):
    """The fallback never drives backwards, and an ego that drives backwards is braked."""
    action = {**META, "target_speeds": [0, 10, 20]}
    env = ShieldedEnv(made(env_id, {"action": action, "duration": 40, **config}), ShieldConfig(failure_limit=100))
    env.reset(seed=0)
    ego = env.unwrapped.vehicle
    env.unwrapped.road.vehicles = [ego]
    monkeypatch.setattr(*reads(env.filter), fail)
    ego.speed, lowest = speed, 0.0
    for _ in range(6):
        *_, info = env.step([1.0, 0.0] if config else 3)
        assert info["shield"]["reason"] == "bad_scene"
        lowest = min(lowest, ego.speed)
    assert lowest >= min(speed, 0.0) - 1e-9
    assert abs(ego.speed) < 1e-9


@pytest.mark.parametrize("speed", [20.0, 1.0, 0.0, -5.0])
def test_braking_ends_in_a_standstill(speed):
    """In one frame the speed gets nearer to zero, and not beyond it."""
    after = speed + limited_braking(-9.8, speed, 5) / 5
    assert abs(after) <= abs(speed)
    assert after * speed >= 0
    assert limited_braking(3.0, speed, 5) == 3.0


@pytest.mark.parametrize("entry", ENTRIES)
@pytest.mark.parametrize("frequency", [1, 2, 2.9])
def test_fewer_frames_than_were_tested_are_refused(entry, frequency):
    """At 1 and 2 Hz every second episode crashed with `guarantee` "all vehicles seen"."""
    env = made("highway-fast-v0", {"simulation_frequency": frequency, "policy_frequency": 1})
    if entry == "env, a rule":
        ENTRIES[entry](env)
        return
    with pytest.raises(ConfigError, match="simulation_frequency"):
        ENTRIES[entry](env)


@pytest.mark.parametrize(
    ("env_id", "config"), [("merge-v1", {}), ("highway-fast-v0", INPUTS), ("parking-v0", {}), ("racetrack-v1", {})]
)
def test_the_worst_case_is_verified_from_5_hz_on_elsewhere_too(env_id, config):
    """On networks, and of throttle and steering."""
    env = made(env_id, {**config, "simulation_frequency": 4, "policy_frequency": 1})
    with pytest.raises(ConfigError, match="the worst case is verified from 5 Hz on"):
        ShieldedEnv(env, ShieldConfig())


@pytest.mark.parametrize(
    "build",
    [
        lambda slow: ShieldedHighways("highway-fast-v0", 1, slow),
        lambda slow: SimulatedHighways("highway-fast-v0", 1, slow),
        lambda slow: SimulatedRoads("merge-v1", 1, slow),
        lambda slow: Known.from_config({**highway_config(), **slow}),
    ],
)
def test_batches_and_known_environments_refuse_few_frames(build):
    """As the entry points of one environment do."""
    with pytest.raises(ConfigError, match="simulation_frequency 2 Hz"):
        build({"simulation_frequency": 2})


def test_an_episode_with_violations_has_another_guarantee_than_one_without():
    """With a violation the episode as a whole has no full guarantee, whatever each plan was verified against."""
    env = ShieldedEnv(made("highway-fast-v0", {"duration": 3}))
    env.reset(seed=0)
    over, labels = False, set()
    while not over:
        env.unwrapped.road.vehicles[3].speed -= 8.0
        *_, over, truncated, info = env.step(1)
        labels.add(info["shield"]["guarantee"])
        over = over or truncated
    assert info["shield_episode"]["violations"] > 0
    assert info["shield_episode"]["guarantee"] == ("none" if "none" in labels else "assumptions broken")
    env.reset(seed=0)
    for _ in range(3):
        *_, info = env.step(1)
    assert info["shield_episode"]["violations"] == 0
    assert info["shield_episode"]["guarantee"] == "all vehicles seen"
