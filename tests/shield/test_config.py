"""Settings survive TOML unchanged, and an error names the wrong setting together with the valid ones."""

import pickle
from dataclasses import FrozenInstanceError, fields

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.traffic.assumptions import Assumptions
from evaluation.running.named_policies import ConstantPolicy
from shield import Shield, ShieldedEnv
from shield.config import MODES, Buffer, ShieldConfig
from shield.errors import ConfigError, ShieldError

LIMITS = settings(deadline=None, max_examples=100, derandomize=True)
positive = st.floats(1e-3, 1e6) | st.integers(1, 1000)
natural = st.floats(0, 1e6) | st.integers(0, 1000)
buffers = st.builds(Buffer, longitudinal=natural, lateral=natural)
speeds = st.tuples(natural, natural).map(sorted)
assumptions = st.one_of(
    st.sampled_from([Assumptions.idm(), Assumptions.rss()]),
    st.builds(
        lambda pair, **kwargs: Assumptions(min_speed=pair[0], max_speed=pair[1], **kwargs),
        speeds,
        braking=positive,
        acceleration=natural,
        follower_braking=positive,
        reaction_time=natural,
        visible_distance=natural,
        turning_loss=natural,
        slow_speed=natural,
        marking_tolerance=natural,
        lateral_deviation=natural,
        simultaneous_merge=st.booleans(),
    ),
)
configs = st.builds(
    ShieldConfig,
    mode=st.sampled_from(MODES),
    buffer=buffers,
    assumptions=assumptions,
    braking=positive,
    perception_range=positive,
    distance=positive,
    time_to_collision=positive,
    response_time=positive,
    horizon=positive,
    record=st.booleans(),
    clearance=positive,
)


@LIMITS
@given(configs)
def test_toml_round_trip(config):
    again = ShieldConfig.from_toml(config.to_toml())
    assert again == config
    assert again.to_toml() == config.to_toml()


@LIMITS
@given(configs)
def test_pickle_round_trip(config):
    assert pickle.loads(pickle.dumps(config)) == config


def test_file_round_trip(tmp_path):
    config = ShieldConfig(mode="rss", buffer=Buffer(3.0, 0.5), assumptions=Assumptions.rss())
    config.save(tmp_path / "shield.toml")
    assert ShieldConfig.load(tmp_path / "shield.toml") == config
    assert ShieldConfig.load(str(tmp_path / "shield.toml")) == config


def test_a_setting_left_out_keeps_its_default():
    assert ShieldConfig.from_toml("") == ShieldConfig()
    config = ShieldConfig.from_toml("braking = 5.0\n[buffer]\nlateral = 1.0\n[assumptions]\nbraking = 3.0")
    assert config == ShieldConfig(braking=5.0, buffer=Buffer(lateral=1.0), assumptions=Assumptions(braking=3.0))


@pytest.mark.parametrize("name", ["idm", "moderate", "rss"])
def test_assumptions_can_be_a_profile(name):
    config = ShieldConfig.from_toml(f'assumptions = "{name}"')
    assert config.assumptions == Assumptions.profile(name) == getattr(Assumptions, name)()


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("mode = ", "not a TOML document"),
        ("brakes = 5.0", "unknown key 'brakes' in config; valid are mode, buffer, assumptions, braking"),
        ("[buffer]\nlong = 5.0", "unknown key 'long' in buffer; valid are longitudinal, lateral"),
        ("[assumptions]\nbrake = 5.0", "unknown key 'brake' in assumptions; valid are braking, comfortable_braking"),
        ("[extra]\nx = 1", "unknown key 'extra'"),
        ("buffer = 2.0", "buffer must be a table"),
        ("assumptions = 2.0", "assumptions must be a table"),
        ('assumptions = "reckless"', "valid are 'idm', 'roads', 'moderate', 'rss'"),
        ('mode = "off"', "valid are none, distance, rss, ttc, ttc-ranking, full"),
        ('braking = "hard"', "ShieldConfig.braking must be a finite number above 0"),
        ("braking = 0", "above 0"),
        ("braking = nan", "finite"),
        ("horizon = inf", "finite"),
        ("distance = true", "finite number"),
        ('record = "yes"', "true or false"),
        ("[buffer]\nlateral = -0.1", "Buffer.lateral must be a finite number at least 0"),
        ("[assumptions]\nsimultaneous_merge = 1", "true or false"),
        ("[assumptions]\nbraking = -1", "at least 0"),
        ("mode = []", "unknown shield mode"),
        ('norm = "euclid"', "unknown norm 'euclid'; valid are range, acceleration"),
    ],
)
def test_an_invalid_setting_is_named(text, word):
    with pytest.raises(ConfigError, match=word):
        ShieldConfig.from_toml(text)


OTHERS = ("mode", "buffer", "assumptions", "repair", "norm", "record", "failure_limit")
NUMBERS = [f.name for f in fields(ShieldConfig) if f.name not in OTHERS]


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("value", [0, -1.0, float("nan"), float("inf"), "1", None, True, [1.0]])
def test_numbers_are_finite_and_positive(name, value):
    with pytest.raises(ConfigError, match=f"ShieldConfig.{name}"):
        ShieldConfig(**{name: value})


@pytest.mark.parametrize(
    "changes",
    [{"buffer": 2.0}, {"buffer": None}, {"assumptions": "idm"}, {"record": 1}, {"mode": None}, {"mode": "FULL"}],
)
def test_parts_are_of_their_kind(changes):
    with pytest.raises(ConfigError):
        ShieldConfig(**changes)


def test_settings_are_frozen_and_replaced():
    config = ShieldConfig()
    with pytest.raises(FrozenInstanceError):
        config.braking = 1.0
    assert config.replace(braking=1.0) == ShieldConfig(braking=1.0)
    assert config == ShieldConfig()
    with pytest.raises(ConfigError):
        config.replace(braking=-1.0)


def test_a_configuration_error_is_a_value_error_and_a_shield_error():
    assert issubclass(ConfigError, ValueError)
    assert issubclass(ConfigError, ShieldError)


def test_two_configurations_do_not_share_their_parts_by_mutation():
    assert hash(ShieldConfig()) == hash(ShieldConfig())


@pytest.mark.parametrize("wrap", [ShieldedEnv, lambda env, config: Shield(ConstantPolicy(1), env=env, config=config)])
def test_both_wrappers_take_settings_or_their_file_and_refuse_anything_else(wrap, tmp_path):
    env, path = gym.make("highway-fast-v0"), tmp_path / "shield.toml"
    ShieldConfig(braking=5.0).save(path)
    for config in (ShieldConfig(braking=5.0), path, str(path)):
        assert wrap(env, config).config.braking == 5.0
    with pytest.raises(ConfigError, match="there is no shield configuration full; `shield config` prints one"):
        wrap(env, "full")
    with pytest.raises(ConfigError, match="must be a ShieldConfig or the path of a TOML file, got 3"):
        wrap(env, 3)


def test_the_names_of_the_profiles_are_settings():
    assert ShieldConfig.of("simulated") == ShieldConfig.simulated_traffic()
    assert ShieldConfig.of("worst-case") == ShieldConfig()
    with pytest.raises(ConfigError, match="worst_case"):
        ShieldConfig.of("worst_case")
