"""Many roads in one batch, verified by simulation: each episode is that of a shield around a single environment."""

from dataclasses import replace

import numpy as np
import pytest

from dynamics.errors import ConfigError
from dynamics.highway_simulator.layout import LANE, SPEED
from dynamics.road_networks.episodes.simulator import RoadSimulator
from dynamics.road_networks.geometry.layout import CROSSES
from dynamics.road_networks.simulation.frame_kernels import ego_of
from evaluation.running.batch_episodes import UNMEASURED, Many
from evaluation.running.certify import COLUMNS, FALLBACKS
from evaluation.running.episodes import run_paired
from evaluation.running.records import ShieldVariant, variant_for
from evaluation.settings import get_setting
from shield.batch.codes import TIERS
from shield.certificate.simulated.closest import best_plan, stopping_cost
from shield.certificate.simulated.decision_kernels import longest_sequence
from shield.certificate.simulated.highways import SimulatedHighways
from shield.certificate.simulated.roads import SimulatedRoads
from shield.certificate.simulated.search import (
    PreferredActions,
    depth_first,
    find_sequence,
    set_root_scene,
    simulate_action,
)
from shield.certificate.simulated.workspace import ANY, LaneSpeedTarget
from shield.config import ShieldConfig
from shield.decision import Tier

CONFIG = ShieldConfig.simulated_traffic()
FASTER = 3


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
        # Vehicles of the linear model.
        ("roundabout aggressive", "faster", range(2)),
        ("intersection linear", "random", range(2)),
    ],
)
def test_a_batch_drives_the_episodes_of_single_environments(name, policy, seeds):
    road, _, traffic = name.partition(" ")
    setting = get_setting(road).with_traffic(traffic) if traffic else get_setting(road)
    many = Many(setting, policy, CONFIG, envs=2).run(seeds)
    alone = run_paired(setting, policy, [variant_for(CONFIG)], seeds, simulator="auto", jobs=1)
    alone = alone[list(COLUMNS)].assign(fallbacks=alone[FALLBACKS].sum(axis=1))
    assert many[list(UNMEASURED)].isna().all().all()
    for column in alone.columns.drop(list(UNMEASURED)):
        one, other = many[column].to_numpy(), alone[column].to_numpy()
        if one.dtype.kind == "f":
            np.testing.assert_allclose(one, other.astype(float), rtol=0, atol=1e-9, err_msg=column)
        else:
            assert one.tolist() == other.tolist(), column


def test_a_batch_without_a_shield_drives_the_episodes_of_single_environments():
    """Crashes are attributed as well."""
    setting, bare = get_setting("roundabout").with_traffic("aggressive"), ShieldConfig(mode="none")
    many = Many(setting, "faster", bare, envs=2).run(range(4))
    alone = run_paired(setting, "faster", [ShieldVariant()], range(4), simulator="auto", jobs=1)
    for column in ("seed", "crashed", "off_road", "attribution", "steps", "simulator"):
        assert many[column].tolist() == alone[column].tolist(), column
    np.testing.assert_allclose(many["return"], alone["return"], rtol=0, atol=1e-9)
    assert many["crashed"].any()
    assert not many["overridden"].any()


@pytest.mark.parametrize("seed", [6663, 86_003_496])
def test_an_ego_in_the_path_of_sliding_wrecks_drives_away(seed):
    """No plan keeps the buffer, and the plan that is clear for longest, to stand, is hit. The check of where plans
    end is off, since the ego would not come there otherwise."""
    roads = SimulatedRoads("intersection-v0", 1)
    roads._searches[0].rules.network.ids[:, CROSSES] = 0
    roads.reset([seed])
    boxed_in, crashed, over = 0, False, False
    while not over:
        _, _, terminated, truncated = roads.step([2])
        boxed_in += TIERS[roads.records.tier[0]] == Tier.LARGEST_MARGIN
        crashed, over = crashed or bool(roads.rows[0, :, 0, 6].any()), bool(terminated[0] or truncated[0])
    assert boxed_in > 0
    assert not crashed


@pytest.mark.parametrize(("seed", "duration"), [(252_049_686, 13), (5011, 30), (5296, 30), (5337, 30)])
def test_no_plan_ends_inside_a_crossing(seed, duration):
    """An ego that stops there behind wrecks is clear of all present vehicles, and is hit by a later one."""
    roads, over, crashed = SimulatedRoads("intersection-v0", 1, {"duration": duration}), False, False
    roads.reset([seed])
    while not over:
        *_, terminated, truncated = roads.step([2])
        crashed, over = crashed or bool(roads.rows[0, :, 0, 6].any()), bool(terminated[0] or truncated[0])
    assert not crashed


def test_an_ego_that_stands_inside_a_crossing_may_stay_there():
    """A plan that ends inside a crossing is also taken where no other exists."""
    roads = SimulatedRoads("intersection-v0", 1)
    (search,), crossing, stood, forced = roads._searches, False, 0, 0
    for seed in range(40):
        roads.reset([seed])
        over = False
        while not over:
            worlds = roads.worlds
            ego = ego_of(worlds.g[0])
            crossing = search.rules.network.ids[worlds.g[0, LANE, ego], CROSSES] != 0
            stands = crossing and abs(worlds.f[0, SPEED, ego]) < 1.0
            *_, terminated, truncated = roads.step([int(np.random.default_rng(seed).integers(3))])
            assert search.resting.allowed[0] == stands
            stood += stands
            forced += search.resting.margin[0] >= 0 and roads.plans.verified[0]
            over = bool(terminated[0] or truncated[0])
    assert stood > 0
    assert forced > 0


@pytest.mark.parametrize("seed", [35, 103, 185])
def test_the_longest_clear_plan_lasts_as_long_as_the_stored_plan(seed):
    """Wrecks lie in the bend: no plan keeps the buffer. A decision exceeds its node budget only by the actions of
    its last state."""
    roads, boxed_in, over = SimulatedRoads("u-turn-v0", 1), 0, False
    (search,) = roads._searches
    bounds, most = search.bounds, 0
    roads.reset([seed])
    while not over:
        planned = roads.plans.length[0]
        *_, terminated, truncated = roads.step([FASTER])
        over, most = bool(terminated[0] or truncated[0]), max(most, search.nodes_used[0])
        if TIERS[roads.records.tier[0]] == Tier.LARGEST_MARGIN and not over:
            boxed_in += 1
            assert roads.plans.length[0] >= planned - 1
    assert boxed_in > 1
    assert bounds.node_budget < most <= bounds.node_budget + 2 * (bounds.last + len(search.order))


def driven(env_id, seed, decisions):
    """The road after a number of decisions of always FASTER, and the stored plan."""
    roads = SimulatedRoads(env_id, 1)
    roads.reset([seed])
    for _ in range(decisions):
        roads.step([FASTER])
    assert roads.plans.verified[0]
    return roads, roads._searches[0], roads.plans.actions[0], int(roads.plans.length[0])


def keeps_buffer(search, actions):
    return all(
        simulate_action(search, k, k + 1, a, LaneSpeedTarget(0.0, 0.0, 0.0), 0.0)[0] >= 0 for k, a in enumerate(actions)
    )


@pytest.mark.parametrize("env_id", ["two-way-v0", "u-turn-v0"])
def test_another_first_action_is_continued_with_the_stored_plan(env_id):
    """Where the stored plan can be continued after another action, the search finds exactly that."""
    joined = 0
    for seed in range(12):
        roads, search, stored, length = driven(env_id, seed, 2)
        for first in set(range(5)) - {int(stored[0])}:
            set_root_scene(search, roads.worlds, 0)
            sequence = [first, *stored[1:length].tolist()]
            if any(keeps_buffer(search, [*sequence, last]) for last in range(5)):
                set_root_scene(search, roads.worlds, 0)
                assert find_sequence(search, first, stored, length)[0] >= 0
                assert search.plan[:length].tolist() == sequence
                joined += len(set(sequence)) > 2
    assert joined > 3


@pytest.mark.parametrize(
    ("env_id", "seed", "decisions"), [("two-way-v0", 1, 2), ("u-turn-v0", 9, 3), ("u-turn-v0", 36, 2)]
)
def test_a_proposal_that_cannot_join_the_stored_plan_slows_down(env_id, seed, decisions):
    """On these seeds the whole node budget spent on joining the stored plan finds nothing."""
    roads, search, stored, length = driven(env_id, seed, decisions)
    budget = search.bounds.budget
    set_root_scene(search, roads.worlds, 0)
    assert depth_first(search, PreferredActions(FASTER, stored, length), 0, 0.0, budget)[0] < search.bounds.depth
    set_root_scene(search, roads.worlds, 0)
    assert find_sequence(search, FASTER, stored, length)[0] >= 0
    assert search.nodes_used[0] <= budget + len(search.order)


@pytest.mark.parametrize("seed", [52, 130])
def test_the_longest_clear_plan_is_searched_beyond_one_state_per_lane_and_speed(seed):
    """Boxed in without a stored plan, the ego with the largest clearance so far would be hit."""
    roads = SimulatedRoads("u-turn-v0", 1)
    roads.reset([seed])
    for _ in range(9):
        roads.step([FASTER])
    (search,) = roads._searches
    assert not roads.plans.verified[0]
    set_root_scene(search, roads.worlds, 0)
    of_each, _ = best_plan(search, ANY, ANY, search.bounds.depth, stopping_cost(search), -1e9)
    set_root_scene(search, roads.worlds, 0)
    lasts, _ = longest_sequence(search, roads.plans.actions[0], 0)
    assert 0 < of_each < lasts


@pytest.mark.parametrize("seed", [135, 271, 287, 347])
def test_the_stored_plan_is_continued_and_stays_verified(seed):
    """On these seeds the node budget of a decision finds nothing from the present state, and little from the end of
    the plan."""
    roads, over = SimulatedRoads("u-turn-v0", 1), False
    roads.reset([seed])
    while not over:
        *_, terminated, truncated = roads.step([FASTER])
        over = bool(terminated[0] or truncated[0])
        assert TIERS[roads.records.tier[0]].verified


@pytest.mark.parametrize(("env_id", "decisions"), [("intersection-v0", 7), ("u-turn-v0", 7), ("highway-fast-v0", 9)])
def test_the_lookahead_of_each_road(env_id, decisions):
    config = replace(CONFIG, horizon=9.0, network_horizon=7.0)
    of = SimulatedHighways if env_id == "highway-fast-v0" else SimulatedRoads
    assert of(env_id, 1, shield=config)._searches[0].bounds.depth == decisions


def test_an_ego_that_proposes_the_exit_takes_it():
    """On these seeds the fastest plan passes the exit."""
    seeds = [5009, 5011, 5026]
    found = run_paired(get_setting("exit"), "right", [variant_for(CONFIG)], seeds, simulator="auto", jobs=1)
    assert found["success"].all()


def test_a_finished_episode_is_followed_by_the_next():
    roads = SimulatedRoads("roundabout-v1", 1, {"duration": 2})
    roads.reset([3])
    for _ in range(3):
        _, _, terminated, truncated = roads.step([1], again=True)
    assert truncated[0] or terminated[0] or roads.plans.length[0]
    assert roads.simulator.episodes.decisions[0] < 3


@pytest.mark.parametrize("name", ["roundabout", "intersection"])
def test_the_proposal_is_executed_without_a_shield(name):
    """The same episodes as in the simulator alone."""
    setting = get_setting(name)
    roads = SimulatedRoads(setting.env_id, 2, setting.configured, ShieldConfig(mode="none"))
    alone = RoadSimulator(setting.env_id, 2, setting.configured)
    assert np.array_equal(roads.reset([3, 4]), alone.reset([3, 4]))
    for k in range(6):
        actions = np.array([k % 3, (k + 1) % 3])
        for one, other in zip(roads.step(actions), alone.step(actions), strict=True):
            assert np.array_equal(one, other)
        assert np.array_equal(roads.records.executed, actions)
        assert {TIERS[tier] for tier in roads.records.tier} == {Tier.OFF}
    assert roads.masks().all()
    with pytest.raises(ConfigError, match="meta-actions from 0 to"):
        roads.step(np.array([9, 0]))


def test_unsupported_roads_and_options_are_refused():
    with pytest.raises(ConfigError, match="straight highways only"):
        SimulatedRoads("merge-v0", 1, replay_draws=True)
    with pytest.raises(ConfigError, match="straight highways only"):
        SimulatedRoads("merge-v0", 1).reset_to(np.zeros((1, 3)), [0])
    with pytest.raises(ConfigError, match="filter meta-actions"):
        SimulatedRoads("intersection-v1", 1)
