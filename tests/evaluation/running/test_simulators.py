"""Episodes are the same in every simulator, and the record names the simulator."""

import pandas as pd
import pytest

from evaluation.running.episodes import run_episode, run_paired
from evaluation.running.records import ShieldVariant, make_variants
from evaluation.settings import Setting, get_setting
from shield.config import ShieldConfig
from shield.errors import ConfigError

SEEDS = (0, 9, 26)
SHORT = Setting("short", "highway-fast-v0", {"duration": 15})


@pytest.mark.parametrize("policy", ["random", "ppo-highway-fast"])
def test_rows_are_the_same_in_both(policy):
    tables = []
    for simulator in ("highway-env", "compiled"):
        table = run_paired(SHORT, policy, make_variants(["none", "full"], ["env"]), SEEDS, simulator=simulator)
        assert set(table.pop("simulator")) == {simulator}
        tables.append(table.drop(columns=[name for name in table if name.startswith("latenc")]))
    pd.testing.assert_frame_equal(*tables, check_exact=True)
    assert tables[0]["crashed"].any(), "nothing to tell apart happens on these seeds"


@pytest.mark.parametrize("order", ["sorted", "shuffled"])
@pytest.mark.parametrize("sensor", ["exact", "metric-2-late"])
def test_observations_at_each_frame_are_the_same_in_both(sensor, order):
    kinematics = {"type": "Kinematics", "vehicles_count": 8, "see_behind": True, "order": order}
    setting = Setting("observed", "highway-fast-v0", {"duration": 10, "observation": kinematics})
    variant, tables = ShieldVariant("env", ShieldConfig(), "observation"), []
    for simulator in ("highway-env", "compiled"):
        table = run_paired(setting, "faster", [variant], (0, 26), simulator=simulator, sensor=sensor)
        assert set(table.pop("simulator")) == {simulator}
        tables.append(table.drop(columns=[name for name in table if name.startswith("latenc")]))
    pd.testing.assert_frame_equal(*tables, check_exact=True)
    assert (tables[0]["frames_overridden"] > 0).all()


@pytest.mark.parametrize(
    ("setting", "policy", "variant"),
    [
        (SHORT, "faster", ShieldVariant("policy", ShieldConfig())),
        (get_setting("parking"), "random", ShieldVariant()),
        (
            Setting("mpc", "highway-fast-v0", {"duration": 1, "action": {"type": "ContinuousAction"}}),
            "mpc",
            ShieldVariant(),
        ),
    ],
    ids=["placement", "road", "policy"],
)
def test_an_episode_that_is_not_compiled_is_driven_in_highway_env(setting, policy, variant):
    assert run_episode(setting, policy, variant, seed=1).simulator == "highway-env"
    with pytest.raises(ConfigError, match=r"compiled|follow from its state"):
        run_episode(setting, policy, variant, seed=1, simulator="compiled")


def test_an_unknown_simulator_is_answered_with_the_valid_ones():
    with pytest.raises(ConfigError, match=r"unknown simulator 'fast'; have auto, compiled, highway-env"):
        run_episode(SHORT, "faster", simulator="fast")
