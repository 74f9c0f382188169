"""Many roads side by side, verified by simulation: each episode is the one that a shield around one of them drives."""

import numpy as np
import pytest

from dynamics.errors import ConfigError
from evaluation.running.certify import COLUMNS, FALLBACKS
from evaluation.running.episodes import run_paired
from evaluation.running.many import Many
from evaluation.running.records import variant_for
from evaluation.settings import get_setting
from shield.batch.vocabulary import TIERS
from shield.config import ShieldConfig
from shield.decision import Tier
from shield.exact.roads import ExactRoads

CONFIG = ShieldConfig.exact()


@pytest.mark.parametrize(
    ("name", "policy", "seeds"),
    [
        ("merge", "faster", range(2)),
        ("roundabout", "random", range(4)),
        ("exit", "random", range(2)),
        ("two-way", "faster", range(2)),
        ("u-turn", "random", range(4, 5)),
        # Vehicles come, and go.
        ("intersection", "faster", range(6)),
        ("intersection", "ppo-intersection", range(2)),
    ],
)
def test_side_by_side_is_one_by_one(name, policy, seeds):
    setting = get_setting(name)
    many = Many(setting, policy, CONFIG, envs=2).run(seeds)
    alone = run_paired(setting, policy, [variant_for(CONFIG)], seeds, simulator="auto", jobs=1)
    alone = alone[list(COLUMNS)].assign(fallbacks=alone[FALLBACKS].sum(axis=1))
    for column in alone.columns:
        one, other = many[column].to_numpy(), alone[column].to_numpy()
        if one.dtype.kind == "f":
            np.testing.assert_allclose(one, other.astype(float), rtol=0, atol=1e-9, err_msg=column)
        else:
            assert one.tolist() == other.tolist(), column


@pytest.mark.parametrize("seed", [6663, 86_003_496])
def test_who_stands_where_wrecks_will_slide_to_leaves(seed):
    """Nothing keeps the buffer, and what is most clear until then, to stand, is hit."""
    roads = ExactRoads("intersection-v0", 1)
    roads.reset([seed])
    boxed_in, crashed, over = 0, False, False
    while not over:
        _, _, terminated, truncated = roads.step([2])
        boxed_in += TIERS[roads.records.tier[0]] == Tier.LARGEST_MARGIN
        crashed, over = crashed or bool(roads.rows[0, :, 0, 6].any()), bool(terminated[0] or truncated[0])
    assert boxed_in > 0
    assert not crashed


def test_who_asks_for_the_exit_gets_there():
    """On these seeds what is as fast as can be passes it by."""
    seeds = [5009, 5011, 5026]
    found = run_paired(get_setting("exit"), "right", [variant_for(CONFIG)], seeds, simulator="auto", jobs=1)
    assert found["success"].all()


def test_episodes_follow_one_another():
    roads = ExactRoads("roundabout-v1", 1, {"duration": 2})
    roads.reset([3])
    for _ in range(3):
        _, _, terminated, truncated = roads.step([1], again=True)
    assert truncated[0] or terminated[0] or roads.plans.length[0]
    assert roads.simulator.episodes.decisions[0] < 3


def test_what_cannot_be_is_refused():
    with pytest.raises(ConfigError, match="straight highways only"):
        ExactRoads("merge-v0", 1, tape=True)
    with pytest.raises(ConfigError, match="straight highways only"):
        ExactRoads("merge-v0", 1).reset_to(np.zeros((1, 3)), [0])
    with pytest.raises(ConfigError, match="filter meta-actions"):
        ExactRoads("intersection-v1", 1)
