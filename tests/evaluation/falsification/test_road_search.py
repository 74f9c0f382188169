"""The search for the worst case on road networks: its coordinates, its finds, and their replay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from highway_env.vehicle.controller import MDPVehicle
from highway_env.vehicle.objects import Obstacle
from scipy.stats import norm
from slowly import later
from typer.testing import CliRunner

from evaluation.commands.cli import app
from evaluation.falsification.falsify import crash_probability, falsify
from evaluation.falsification.fault_oracle import FaultOracle
from evaluation.falsification.finds import ANY, Find
from evaluation.falsification.finds import replay as drive_again
from evaluation.falsification.network_adversaries import install_drivers
from evaluation.falsification.road_episode import SCENES, RoadNumbers, Script, drive_numbers
from evaluation.falsification.road_search import LEVEL, has_network, search_roads
from evaluation.falsification.subset_simulation import subset_simulation
from evaluation.running.batch_episodes import Many
from evaluation.settings import Setting, get_setting
from shield import ConfigError, ShieldConfig, ShieldedEnv, Tier

EXACT = ShieldConfig.simulated_traffic()
MERGE, ROUNDABOUT, EXIT = map(get_setting, ("merge", "roundabout", "exit"))
TOLD = ShieldConfig.for_roads()
PLANTED = TOLD.replace(assumptions=replace(TOLD.assumptions, visible_distance=8.0))
"""A shield that counts on being seen in a lane from two lanes beside it."""
LOOKS_AHEAD = TOLD.replace(assumptions=replace(TOLD.assumptions, considers_connected_lanes=True))
"""On merge-v0 no vehicle looks beyond the end of its own lane."""


def drawn(numbers, seed):
    """The numbers of an episode at random."""
    return np.random.default_rng(seed).random(numbers.count)


def test_coordinates_without_neighbours_are_kept_or_redrawn():
    """The estimate is right where one coordinate selects among 50 seeds with different bounds."""
    bounds = 2.0 + np.random.default_rng(0).random(50)
    truth, asked = norm.sf(bounds).mean(), []

    def performance(x):
        asked.append(x[:, 0].copy())
        return bounds[np.minimum((norm.cdf(x[:, 0]) * 50).astype(int), 49)] - x[:, 1:].sum(axis=1) / 2

    found = [subset_simulation(performance, 5, 500, seed=seed, jumps=1).probability for seed in range(40)]
    assert np.mean(found) == pytest.approx(truth, rel=0.15)
    with pytest.raises(ConfigError, match="from 0 to 5 dimensions"):
        subset_simulation(performance, 5, 500, jumps=6)
    assert np.isin(asked[1], asked[0]).mean() > 0.8
    assert not np.isin(asked[1], asked[0]).all()


def test_a_script_draws_the_distributions_of_a_generator():
    """Uniform shares are transformed to the draws of a generator."""
    script, n = Script(np.random.default_rng(1).random(4001)), 4000
    held = np.array([script.integers(2, 20) for _ in range(n)])
    assert set(held) == set(range(2, 20))
    assert held.mean() == pytest.approx(10.5, abs=0.3)
    assert np.std([script.normal(1.0, 0.3) for _ in range(n)]) == pytest.approx(0.3, rel=0.1)
    assert {script.choice([-6.0, 0.0, 3.0]) for _ in range(n)} == {-6.0, 0.0, 3.0}


@pytest.mark.parametrize("drivers", ["bold", *later("wild", "mixed")])
def test_the_numbers_say_everything(drivers):
    numbers = RoadNumbers(drivers, 50, decisions=6)
    shares = drawn(numbers, 0)
    found = drive_numbers(MERGE, numbers, shares)
    assert drive_numbers(MERGE, numbers, shares) == found
    assert 50 <= found.seed < 50 + SCENES
    others = [drive_numbers(MERGE, numbers, shares * part) for part in parts(numbers)]
    assert all(each != found for each in others)


def parts(numbers):
    """All numbers but those of the scene, of the ego, and of the drivers."""
    for first, last in ((0, 1), (1, 7), (7, numbers.count)):
        part = np.ones(numbers.count)
        part[first:last] = 0.0
        yield part


@pytest.mark.parametrize("setting", [MERGE, EXIT, *later(ROUNDABOUT)])
@pytest.mark.parametrize("drivers", ["bold", "wild"])
def test_a_vehicle_that_comes_too_near_is_a_violator(setting, drivers):
    """The clearance of a verified plan to vehicles without a violation does not shrink from frame to frame."""
    numbers = RoadNumbers(drivers, decisions=6)
    for seed in range(2):
        found = drive_numbers(setting, numbers, drawn(numbers, seed))
        assert not found.hole
        assert found.shrunk == 0
        assert 0 < found.counted <= found.frames


def test_a_vehicle_that_drives_into_the_ego_is_named_before_the_crash():
    """It is named in the frame in which it enters the buffer and highway-env predicts the contact. The ego has
    executed its inputs so far, and is judged without the impact of the coming frame."""
    numbers = RoadNumbers("wild")
    found = drive_numbers(EXIT, numbers, np.random.default_rng(0).random((15, numbers.count))[14])
    assert found.crashed
    assert not found.hole
    assert "ways" in found.by_rule


@pytest.mark.slow
@pytest.mark.parametrize("name", ["roundabout", "merge", "exit", "two-way", "u-turn", "intersection"])
@pytest.mark.parametrize("drivers", ["bold", "wild"])
def test_a_search_finds_nothing_in_the_default(name, drivers):
    assert not search_roads(get_setting(name), drivers, episodes=90, seed=3).hole


def test_a_hole_is_found_and_driven_again(tmp_path):
    """With the settings of the road's own traffic it is none."""
    run, path, told = CliRunner(), tmp_path / "find.json", tmp_path / "told.toml"
    PLANTED.save(told)
    asked = ["falsify", str(path), "--setting", "exit", "--drivers", "bold", "--jobs", "1", "--seed", "10"]
    result = run.invoke(app, [*asked, "--config", str(told), "--episodes", "100"])
    assert result.exit_code == 1, result.output
    find = Find.load(path)
    assert drive_again(find) == find
    assert not drive_numbers(EXIT, RoadNumbers("bold", find.seed), np.array(find.shares)).hole
    result = run.invoke(app, ["replay", "--find", str(path)])
    assert result.exit_code == 0, result.output


@pytest.mark.slow
def test_a_vehicle_that_passes_on_a_ramp_is_predicted():
    assert not search_roads(MERGE, "bold", episodes=50, seed=3_500_000).hole


def drive_placed(config, ego, other, actions, obstacles=()):
    """The ego of merge-v0 and one bold driver that never slows down by itself, placed by hand as (lane, s, speed), and
    obstacles as (lane, s): the environment, the referee and the tier of the first decision."""
    env = ShieldedEnv(MERGE.make(), config)
    env.reset(seed=0)
    base = env.unwrapped
    road, body = base.road, base.vehicle
    road.vehicles, road.objects = [body], []
    at(body, *ego)
    road.vehicles.append(at(MDPVehicle(road, [0.0, 0.0]), *other))
    for lane, s in obstacles:
        road.objects.append(Obstacle(road, road.network.get_lane(lane).position(s, 0)))
    env.filter.reset()
    install_drivers(env, "bold", 1, 0, [(Script([0.99]), Script([0.0]))])
    referee, tiers = FaultOracle(base, env.filter), []
    for action in actions:
        *_, terminated, truncated, _ = env.step(action)
        tiers.append(env.last_decision.tier)
        if terminated or truncated or referee.over:
            break
    if not referee.over:
        env.filter.frame()
    return env, referee, tiers[0]


def at(vehicle, lane, s, speed):
    """The vehicle, at s [m] of a lane and with a speed [m/s] that it keeps to."""
    where = vehicle.road.network.get_lane(lane)
    vehicle.position, vehicle.heading, vehicle.speed = where.position(s, 0), where.heading_at(s), speed
    vehicle.lane, vehicle.lane_index, vehicle.target_lane_index = where, lane, lane
    vehicle.target_speed, vehicle.route = speed, None
    return vehicle


@pytest.mark.parametrize(("config", "crashes"), [(TOLD, False), (LOOKS_AHEAD, True)])
def test_a_wrong_assumption_leads_to_a_violation_before_the_crash(config, crashes):
    """Two obstacles stand where the next road begins. With the assumption that the follower looks beyond the end of
    its lane, the ego stops on that road, and the follower drives into it: the monitor names it by the distance rule,
    so this is no loophole. Without that assumption the ego stops before, where it is visible."""
    follower, lanes = (("a", "b", 0), 145.0, 20.0), (("b", "c", 0), ("b", "c", 1))
    ego = ("a", "b", 0), 170.0, 15.0
    env, referee, tier = drive_placed(config, ego, follower, [1] * 12, [(lane, 25.0) for lane in lanes])
    assert tier is Tier.PASSED
    assert env.unwrapped.vehicle.crashed is crashes
    assert ("distance" in env.filter.by_rule) is crashes
    assert "unforeseen" not in env.filter.by_rule
    assert referee.clearance >= 0


@pytest.mark.slow
def test_the_planted_hole_is_found_by_a_search_on_merges():
    """With the settings of the road's own traffic the same episode has none."""
    searched = search_roads(MERGE, "bold", PLANTED, episodes=170, seed=0)
    assert searched.hole
    assert not drive_numbers(MERGE, RoadNumbers("bold", searched.find.seed), np.array(searched.find.shares)).hole


def test_the_command_lists_valid_arguments(tmp_path):
    run, path = CliRunner(), tmp_path / "find.json"
    for asked, message in (
        (["--setting", "merge"], "settings that simulate it"),
        (["--setting", "merge", "--drivers", "tame"], "have idm, bold, wild, mixed"),
        (["--setting", "merge", "--drivers", "bold", "--policy", "faster"], "the policy is 'any'"),
        (["--setting", "highway-fast", "--drivers", "wild"], "have drivers idm or bold"),
    ):
        result = run.invoke(app, ["falsify", str(path), *asked])
        assert isinstance(result.exception, ConfigError)
        assert message in str(result.exception)


@pytest.mark.parametrize(
    ("setting", "config", "episodes", "message"),
    [
        (MERGE, ShieldConfig(), 500, "settings that simulate it"),
        (MERGE, EXACT, 100, "at least 500"),
    ],
)
def test_a_search_among_idm_traffic_refuses_unsupported_settings(setting, config, episodes, message):
    with pytest.raises(ConfigError, match=message):
        falsify(setting, ANY, config, episodes)


def test_a_search_among_drivers_refuses_unsupported_settings():
    with pytest.raises(ConfigError, match=f"at least {LEVEL}"):
        search_roads(MERGE, "bold", episodes=10)
    with pytest.raises(ConfigError, match="have wild, bold, mixed"):
        RoadNumbers("tame")
    with pytest.raises(ConfigError, match="numbers for an episode"):
        drive_numbers(MERGE, RoadNumbers("bold"), np.zeros(3))
    with pytest.raises(ConfigError, match="no road network"):
        drive_numbers(get_setting("highway-fast"), RoadNumbers("bold"), np.zeros(RoadNumbers("bold").count))
    with pytest.raises(ConfigError, match="are drawn from seeds"):
        crash_probability(MERGE, "faster", EXACT)
    assert has_network(MERGE)
    assert not has_network(get_setting("highway-fast"))


@pytest.mark.parametrize("setting", [EXIT, *later(ROUNDABOUT)])
def test_episodes_of_seeds_are_those_of_plain_runs(setting):
    """The chosen episodes are driven as by `run`."""
    seeds = [3, 900, 17]
    many = Many(setting, "faster", EXACT)
    rows, found = many.run(seeds), many.run_seeds(seeds)
    assert found.clearance.tolist() == rows["min_gap"].tolist()
    assert not found.lost.any()
    again = many.run_seeds(seeds, np.full((3, many.steps), 3))
    assert again.clearance.tolist() == found.clearance.tolist()


def test_an_episode_lost_at_the_reset_is_no_find():
    """A leader stands 2.5 m ahead, 7 m/s slower (see docs/lab/simulated-traffic.md)."""
    assert Many(get_setting("two-way"), "faster", EXACT).run_seeds([410026, 0]).lost.tolist() == [True, False]


@pytest.mark.parametrize(
    ("name", "policy"),
    [("exit", ANY), *later(*((name, ANY) for name in ("roundabout", "merge", "two-way", "u-turn", "intersection")))],
)
def test_a_find_on_a_network_is_replayed(name, policy, tmp_path):
    found = falsify(get_setting(name), policy, EXACT, episodes=60, samples=30)
    assert 0 < found.find.clearance < found.median
    found.find.save(tmp_path / "find.json")
    again = Find.load(tmp_path / "find.json")
    assert again == found.find
    assert drive_again(again).clearance == pytest.approx(found.find.clearance, abs=1e-9)


@pytest.mark.slow
def test_obligations_are_evaluated_again_for_another_manoeuvre():
    """On a ring the ego moves aside, clear of a follower, and back before it."""
    found = search_roads(Setting("roundabout-v1", "roundabout-v1"), "mixed", episodes=LEVEL, seed=5_700_000)
    assert not found.hole
