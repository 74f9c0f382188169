"""The default settings of a shield: the strongest verification whose guarantee holds in the environment."""

import logging

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from stable_baselines3.common.vec_env import DummyVecEnv
from unknown_traffic import UNKNOWN

import evaluation.wrappers  # noqa: F401  (registers environments)
from evaluation.measuring.metrics import summarise
from evaluation.report.table import markdown
from evaluation.running.episodes import run_paired
from evaluation.running.records import make_variants
from evaluation.settings import get_setting
from shield import Shield, ShieldConfig, ShieldedEnv
from shield.decision import Verification
from shield.errors import ConfigError

LINEAR = {"other_vehicles_type": "highway_env.vehicle.behavior.LinearVehicle"}
AGGRESSIVE = {"other_vehicles_type": "highway_env.vehicle.behavior.AggressiveVehicle"}
TYRES = {"action": {"type": "ContinuousAction", "dynamical": True}}
NETWORKS = ("merge-v0", "exit-v0", "roundabout-v1", "two-way-v0", "u-turn-v1", "intersection-v0", "intersection-v2")


def idle(env):
    """An action of the environment that changes nothing."""
    space = env.action_space
    if isinstance(space, gym.spaces.Tuple):
        return tuple(1 for _ in space)
    return 1 if isinstance(space, gym.spaces.Discrete) else np.zeros(space.shape, np.float32)


@pytest.mark.parametrize(
    ("env_id", "config", "kind"),
    [
        *((env_id, {}, Verification.SIMULATED) for env_id in NETWORKS),
        ("intersection-multi-agent-v0", {}, Verification.SIMULATED),
        ("roundabout-continuous-v1", {}, Verification.SIMULATED),
        ("highway-fast-v0", TYRES, Verification.SIMULATED),
        ("highway-fast-v0", {}, Verification.WORST_CASE),
        ("highway-v0", {"action": {"type": "ContinuousAction"}}, Verification.WORST_CASE),
        ("highway-fast-v0", LINEAR, Verification.WORST_CASE),
        ("merge-v0", LINEAR, Verification.SIMULATED),
        ("roundabout-v1", AGGRESSIVE, Verification.SIMULATED),
        ("merge-v0", UNKNOWN, Verification.WORST_CASE),
        ("parking-v0", {}, Verification.STANDING),
    ],
)
def test_the_default_verification_of_each_environment(env_id, config, kind):
    """`info`, the records of the episode and both wrappers name the same one."""
    env = ShieldedEnv(gym.make(env_id, **({"config": config} if config else {})))
    env.reset(seed=0)
    *_, info = env.step(idle(env))
    assert env.verification is kind
    assert info["shield"]["verification"] == kind.value
    assert env.config.simulates is (kind is Verification.SIMULATED)
    if env_id == "intersection-multi-agent-v0":
        return
    bare = gym.make(env_id, **({"config": config} if config else {}))
    obs, _ = bare.reset(seed=0)
    action = idle(bare)
    shield = Shield(lambda observation: action, bare)
    shield.predict(obs)
    assert shield.verification is kind
    assert shield.report()["verification"] == kind.value


@pytest.mark.parametrize("env_id", ["highway-fast-v0", "merge-v0", "roundabout-v1", "intersection-v0"])
def test_the_traffic_is_simulated_without_supervised_frames(env_id):
    """Networks were refused once, since the worst case holds the ego back between two decisions. On a highway the
    worst case looked 4 s ahead, and crashed."""
    env = gym.make(env_id)
    obs, _ = env.reset(seed=0)
    shield = Shield(lambda observation: 1, env, frames=False)
    shield.predict(obs)
    assert shield.last_decision.tier.certified
    assert shield.verification is Verification.SIMULATED


def test_rules_models_and_observations_keep_the_worst_case():
    env = gym.make("highway-fast-v0")
    assert ShieldedEnv(env, ShieldConfig(mode="ttc")).verification is Verification.RULE
    assert ShieldedEnv(gym.make("highway-fast-v0"), perception="observation").verification is Verification.WORST_CASE
    assert ShieldedEnv(gym.make("highway-fast-v0"), ShieldConfig(mode="none")).verification is Verification.OFF


def test_settings_by_name():
    for env_id, worst in (("merge-v0", ShieldConfig.for_roads()), ("highway-fast-v0", ShieldConfig())):
        assert ShieldedEnv(gym.make(env_id), "worst-case").config == worst
        assert ShieldedEnv(gym.make(env_id), "simulated").config == ShieldConfig.simulated_traffic()
    with pytest.raises(ConfigError, match="there is no shield configuration worst"):
        ShieldedEnv(gym.make("merge-v0"), "worst")


def test_unknown_traffic_is_warned_of_at_construction(caplog):
    """One warning: the guarantee, why the traffic is not simulated, and the choices. For known traffic no warning."""
    with caplog.at_level(logging.INFO, "shield"):
        ShieldedEnv(gym.make("merge-v0"))
        assert not [each for each in caplog.records if each.levelno > logging.INFO]
        ShieldedEnv(gym.make("merge-v0", config=UNKNOWN))
    (said,) = [each.getMessage() for each in caplog.records if each.levelno == logging.WARNING]
    for part in ("MergeEnv", "worst case", "held back more often", "Dozy", 'config="worst-case"'):
        assert part in said


@pytest.mark.parametrize("placement", ["env", "policy"])
def test_a_reset_that_changes_the_traffic_changes_the_settings(placement):
    """Traffic that is no longer known left every decision without a scene."""
    env = gym.make("merge-v0")
    shielded = ShieldedEnv(env) if placement == "env" else Shield(lambda observation: 1, env)
    before = {"other_vehicles_type": env.unwrapped.config["other_vehicles_type"]}
    for config, kind in ((UNKNOWN, Verification.WORST_CASE), (before, Verification.SIMULATED)):
        env.unwrapped.config.update(config)
        if placement == "env":
            shielded.reset(seed=1)
            *_, info = shielded.step(1)
            report = info["shield"]
        else:
            obs, _ = env.reset(seed=1)
            env.step(int(shielded.predict(obs)[0]))
            report = shielded.report()
        assert report["tier"] == "passed"
        assert shielded.verification is kind
        assert report["verification"] == kind.value


def test_each_of_several_environments_has_its_own_settings():
    env = DummyVecEnv([lambda: gym.make("merge-v0"), lambda: gym.make("merge-v0", config=UNKNOWN)])
    shield = Shield(lambda observation: [1, 1], env)
    shield.predict(env.reset())
    kinds = [Verification.SIMULATED, Verification.WORST_CASE]
    assert [shield.report(i)["verification"] for i in range(2)] == [kind.value for kind in kinds]


def test_settings_of_another_road_are_warned_of(caplog):
    """`ShieldConfig(record=True)` on a road network selects the worst case of a straight highway, in place of the
    default there."""
    with caplog.at_level(logging.WARNING, "shield"):
        for config in (
            ShieldConfig.simulated_traffic(),
            ShieldConfig.for_roads(),
            "worst-case",
            ShieldConfig(mode="none"),
        ):
            ShieldedEnv(gym.make("merge-v0"), config)
        ShieldedEnv(gym.make("highway-fast-v0"), ShieldConfig(record=True))
        assert not caplog.records
        ShieldedEnv(gym.make("merge-v0"), ShieldConfig(record=True))
    assert "ShieldConfig.simulated_traffic().replace" in caplog.text


def test_records_and_tables_name_the_verification():
    for setting, kind in (("roundabout", Verification.SIMULATED), ("highway-fast", Verification.WORST_CASE)):
        setting = get_setting(setting)
        modes = ["none", "full", *(["ttc"] if setting.name == "highway-fast" else [])]
        frame = run_paired(setting, "faster", make_variants(modes, ["env"], setting=setting), [5])
        expected = {"none": Verification.OFF, "full": kind, "ttc": Verification.RULE}
        assert all(expected[mode] == name for mode, name in zip(frame["mode"], frame["verification"], strict=True))
        told = markdown(summarise(frame))
        assert kind.value.replace("_", " ") in told
