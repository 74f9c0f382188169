"""Episodes and training on networks of roads are the same with compiled frames as in highway-env."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from stable_baselines3 import DQN

from evaluation.running.episodes import run_episode
from evaluation.running.records import ShieldVariant
from evaluation.running.simulators import environment
from evaluation.settings import get_setting
from evaluation.training.train import train
from shield import ShieldConfig
from shield.errors import ConfigError

EXACT = ShieldConfig.simulated_traffic()


def row_of(setting, variant, simulator, policy="random"):
    row = run_episode(setting, policy, variant, 7, simulator=simulator).row()
    assert row["simulator"] == simulator
    return {k: v for k, v in row.items() if k != "simulator" and not k.startswith("latenc")}


@pytest.mark.parametrize("setting", ["roundabout", "intersection", "merge"])
@pytest.mark.parametrize(
    "variant", [ShieldVariant(), ShieldVariant(placement="actions", config=EXACT)], ids=["bare", "exact"]
)
def test_an_episode_has_the_same_record(setting, variant):
    one, other = (row_of(setting, variant, simulator) for simulator in ("highway-env", "compiled"))
    np.testing.assert_equal(one, other)


def test_an_episode_off_the_road_has_the_same_record():
    one, other = (
        row_of("roundabout-continuous", ShieldVariant(), simulator) for simulator in ("highway-env", "compiled")
    )
    np.testing.assert_equal(one, other)
    assert one["off_road"]


def test_a_shield_that_supervises_frames_is_driven_in_highway_env():
    setting, variant = get_setting("roundabout"), ShieldVariant(placement="env", config=ShieldConfig.for_roads())
    assert environment(setting, "faster", variant, None, "auto")[0] == "highway-env"
    with pytest.raises(ConfigError, match="one by one"):
        environment(setting, "faster", variant, None, "compiled")


def test_a_model_learns_the_same(tmp_path):
    paths = {}
    for simulator in ("highway-env", "compiled"):
        made = train("roundabout", "dqn", 60, 3, output=tmp_path / simulator, simulator=simulator, progress=False,
                     hyperparameters={"learning_starts": 20, "buffer_size": 100})  # fmt: skip
        assert made.manifest["simulator"] == simulator
        paths[simulator] = DQN.load(made.path).policy.state_dict()
    for key, value in paths["highway-env"].items():
        assert torch.equal(value, paths["compiled"][key]), key
