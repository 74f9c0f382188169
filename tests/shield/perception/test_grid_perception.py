"""Occupancy grids as scenes: every vehicle is inside the bounds of its cell, and vehicles that are not shown are
beyond the edges."""

from __future__ import annotations

from dataclasses import replace

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from highway_env.envs.highway_env import HighwayEnvFast
from hypothesis import Phase, assume, given, settings
from hypothesis import strategies as st
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack

from dynamics.roads.straight import StraightRoad
from dynamics.scenes.scene import EgoControl, SceneReader, Target
from dynamics.state import Vehicle
from shield import ConfigError, GridSpec, Known, PerceptionConfig, SceneError, Shield, ShieldedEnv, Unseen
from shield.decision import Guarantee, Reason
from shield.perception.grid_perception import GridPerception
from shield.perception.grid_sighting import covered_distance, decode_grid, lane_in_grid
from shield.perception.unwrapping import undo_vec_wrappers

FINE = {
    "type": "OccupancyGrid",
    "features": ["presence", "x", "y", "vx", "vy", "on_road"],
    "features_range": {"x": [-210, 210], "y": [-20, 20], "vx": [-80, 80], "vy": [-80, 80]},
    "grid_size": [[-205, 205], [-15, 15]],
    "grid_step": [5, 2],
}
COARSE = {"type": "OccupancyGrid", "grid_size": [[-102.5, 102.5], [-17.5, 17.5]]}
ROAD = StraightRoad.from_lanes(3)
CONTROL = EgoControl(Target(1, 25.0))
FRAMELESS = {"frames": False, "perception": "observation"}


def make(observation, **config):
    return gym.make("highway-fast-v0", config={"observation": observation, **config})


def row_of(base):
    ego = base.vehicle
    return np.array([*ego.position, ego.heading, ego.speed, 5.0, 2.0, 0.0])


def truth(base):
    """x, y, vx and vy of all other vehicles, relative to the ego."""
    ego = base.vehicle
    others = [[*(v.position - ego.position), *(v.velocity - ego.velocity)] for v in base.road.vehicles if v is not ego]
    return np.array(others).reshape(-1, 4)


grids = st.fixed_dictionaries(
    {
        "features": st.permutations(["presence", "vx", "vy", "on_road", "x", "y", "cos_h"]).flatmap(
            lambda names: st.sets(st.sampled_from(["on_road", "x", "y", "cos_h"])).map(
                lambda left_out: [name for name in names if name not in left_out]
            )
        ),
        "grid_size": st.tuples(st.floats(10, 150), st.floats(10, 150), st.floats(9, 20), st.floats(9, 20)).map(
            lambda g: [[-g[0], g[1]], [-g[2], g[3]]]
        ),
        "grid_step": st.tuples(st.floats(1.5, 8), st.floats(0.8, 5)).map(list),
        "features_range": st.sampled_from([None, FINE["features_range"], {"vx": [-15, 15], "vy": [-30, 30]}]),
        "clip": st.booleans(),
        "as_image": st.booleans(),
        "align_to_vehicle_axes": st.booleans(),
    }
)


@given(grid=grids, seed=st.integers(0, 500), turns=st.integers(0, 3))
@settings(max_examples=25, deadline=None, phases=[Phase.generate])
def test_every_vehicle_in_the_grid_is_inside_its_bounds(grid, seed, turns):
    """A vehicle that is not shown is beyond the edges, hidden by another in the same cell, or too fast for the
    range."""
    observation = {"type": "OccupancyGrid", **grid}
    env = make(observation)
    obs, _ = env.reset(seed=seed)
    for _ in range(turns):
        env.step(0 if seed % 2 else 2)
    base = env.unwrapped
    if turns:  # in the middle of a lane change
        base.action_type.act(2 if seed % 2 else 0)
        for _ in range(2):
            base.road.act()
            base.road.step(0.2)
        obs = base.observation_type.observe()
    spec = GridSpec.of(env)
    assert spec == GridSpec.from_config(observation)
    heading = float(base.vehicle.heading)
    sighting, there = decode_grid(spec, obs, heading), truth(base)
    slack = 1e-5 + np.array([2e-5, 2e-5, 1e-5, 1e-5])  # 32 bits of 210 m and 80 m/s
    inside = (there[:, None] >= sighting.low - slack) & (there[:, None] <= sighting.high + slack)
    if len(sighting.low):
        assert inside.all(axis=2).any(axis=0).all()
    far, back = covered_distance(spec, *(ROAD.centers[[0, -1]] - base.vehicle.position[1]), heading)
    low, high = sighting.cells[:, [0, 2]], sighting.cells[:, [1, 3]]
    for each, held in zip(there, inside, strict=True):
        if held.all(axis=1).any() or not -back <= each[0] <= far:
            continue
        in_a_cell = ((each[:2] >= low) & (each[:2] <= high)).all(axis=1).any()
        assert in_a_cell or sighting.cut
    wide = sighting.high - sighting.low
    if spec.legible("x") and not spec.image and len(wide):
        assert wide[:, 0].max() < 1e-3


@given(
    lanes=st.integers(2, 5),
    lane=st.integers(0, 4),
    across=st.floats(0.5, 5.5),
    low=st.floats(18, 30),
    image=st.booleans(),
)
@settings(max_examples=10, deadline=None, phases=[Phase.generate])
def test_the_lane_that_the_ego_begins_in_is_found_or_said_not_to_be(lanes, lane, across, low, image):
    observation = {**COARSE, "grid_size": [[-20, 20], [-low, 20]], "grid_step": [5, across], "as_image": image}
    env = make(observation, lanes_count=lanes, initial_lane_id=lane % lanes, vehicles_count=2)
    obs, _ = env.reset(seed=0)
    try:
        found = lane_in_grid(GridSpec.of(env), obs, StraightRoad.from_lanes(lanes).centers)
    except SceneError as error:
        assert across > 2.0 and "make its cells narrower" in str(error)  # noqa: PT017, PT018
    else:
        assert found == lane % lanes


def seen(observation, seed, config=None, actions=(), **kwargs):
    """A perception that has followed an episode so far, with its scene and the environment."""
    env = make(observation, **kwargs)
    obs, _ = env.reset(seed=seed)
    base = env.unwrapped
    perception = GridPerception(GridSpec.of(env), ROAD, (0.2, 5), config)
    scene = perception.see(obs, base.steps, CONTROL, row_of(base))
    for action in actions:
        obs, _, over, _, _ = env.step(action)
        scene = perception.see(obs, base.steps, CONTROL, row_of(base))
        if over:
            break
    return perception, scene, base


@pytest.mark.parametrize("observation", [FINE, COARSE, {**COARSE, "as_image": True}, {**FINE, "as_image": True}])
@given(seed=st.integers(0, 1_000), actions=st.lists(st.integers(0, 4), max_size=4))
@settings(max_examples=4, deadline=None, phases=[Phase.generate])
def test_true_bodies_are_inside_those_of_the_scene(observation, seed, actions):
    """Each body is covered by one in the scene, which ahead is no faster and behind no slower; or it is beyond the
    edges."""
    perception, scene, base = seen(observation, seed, actions=actions)
    (far, back), ego, shown = perception.edges, base.vehicle, scene.others
    assume(not ego.crashed)  # bodies that overlap share a cell
    for v in base.road.vehicles:
        gap = v.position[0] - ego.position[0]
        if v is ego or not -back <= gap <= far:
            continue
        apart = np.abs(shown[:, :2] - v.position)
        room = (shown[:, [Vehicle.LENGTH, Vehicle.WIDTH]] - [5.0, 2.0]) / 2 + [1e-3, 0.6]
        covers = (apart <= room).all(axis=1)
        slower = shown[:, 3] * np.cos(shown[:, 2]) - v.velocity[0]
        fits = (slower <= 1e-3) if gap > 0 else (slower >= -1e-3)
        assert (covers & fits).any()


@pytest.mark.parametrize(
    "observation", [FINE, pytest.param({**FINE, "align_to_vehicle_axes": True}, marks=pytest.mark.slow)]
)
def test_a_fine_grid_decides_as_the_simulator_s_state(observation):
    """Also in another process, where the ego's own state is that of its commands."""
    known = Known.from_config({**HighwayEnvFast.default_config(), "observation": observation})
    found = []
    for kwargs in ({"perception": "simulator", "config": "worst-case"}, {}, {"env": None, "known": known}):
        env = make(observation)
        obs, _ = env.reset(seed=0)
        shielded = Shield(lambda obs: 3, **{"env": env, **FRAMELESS, **kwargs})
        found.append([])
        for _ in range(12):
            action, _ = shielded.predict(obs)
            found[-1].append(int(action))
            obs, _, terminated, truncated, _ = env.step(int(action))
            if terminated or truncated:
                break
    assert found[0] == found[1] == found[2]
    assert len(set(found[0])) > 1


def test_vehicles_keep_their_identity_from_one_grid_to_the_next():
    for observation, share in ((FINE, 0.9), (COARSE, 0.3)):
        env = make(observation)
        obs, _ = env.reset(seed=0)
        base, known, again = env.unwrapped, {}, 0
        perception = GridPerception(GridSpec.of(env), ROAD, (0.2, 5))
        total = 0
        for _ in range(15):
            scene = perception.see(obs, base.steps, CONTROL, row_of(base))
            for row, who in zip(scene.others, scene.ids.tolist(), strict=True):
                if who < 0:
                    continue
                room = (row[[Vehicle.LENGTH, Vehicle.WIDTH]] - [5.0, 2.0]) / 2 + 1e-3
                inside = [v for v in base.road.vehicles if (np.abs(row[:2] - v.position) <= room).all()]
                assert known.setdefault(who, inside[0]) in inside
                total, again = total + 1, again + (known[who] is inside[0])
            base.action_type.act(1)
            base.road.act()
            base.road.step(0.2)
            base.steps += 1
            obs = base.observation_type.observe()
        assert len(known) < (1 - share) * total


def test_ambiguous_vehicles_get_new_identities():
    """Two vehicles in one lane, each of which may be in either cell a decision later: bounds are not narrowed by a
    guess."""
    spec = GridSpec(size=((-50.0, 50.0), (-15.0, 15.0)), step=(5.0, 5.0))
    perception, ego = GridPerception(spec, ROAD, (0.2, 5)), np.array([0.0, 4.0, 0.0, 25.0, 5.0, 2.0, 0.0])

    def grid(*cells):
        obs = np.zeros(spec.shape)
        for cell in ((10, 3), *cells):
            obs[0, cell[0], cell[1]] = 1
        return obs

    first = perception.see(grid((13, 3), (14, 3), (19, 3)), 0, CONTROL, ego)
    later = perception.see(grid((13, 3), (14, 3), (19, 3)), 5, CONTROL, np.array([25.0, 4.0, 0.0, 25.0, 5.0, 2.0, 0.0]))
    assert first.ids[first.ids >= 0].tolist() == [1, 2, 3]
    assert later.ids[later.ids >= 0].tolist() == [4, 5, 3]
    last = perception.see(grid((13, 3), (19, 3)), 10, CONTROL, ego + np.array([50.0, 0, 0, 0, 0, 0, 0]))
    assert last.ids[last.ids >= 0].tolist() == [6, 3]
    assert later.blurred


def test_a_cell_of_two_lanes_may_hide_a_vehicle():
    """The lanes at 4 m and 8 m share a cell: the shown vehicle may be in either, and another vehicle in the other."""
    spec = GridSpec(size=((-50.0, 50.0), (-22.0, 22.0)), step=(5.0, 8.0))
    road, ego = StraightRoad.from_lanes(4), np.array([0.0, 0.0, 0.0, 25.0, 5.0, 2.0, 0.0])
    obs = np.zeros(spec.shape)
    obs[0, 10, 2] = obs[0, 14, 3] = 1
    scene = GridPerception(spec, road, (0.2, 5)).see(obs, 0, CONTROL, ego)
    hidden = scene.others[(scene.ids < 0) & (np.abs(scene.others[:, 0] - 22.5) < 1e-9)]
    assert hidden[:, 1].tolist() == [4.0, 8.0]
    assert (hidden[:, [3, 4, 5]] == [18.0, 10.0, 2.0]).all()
    narrow = replace(spec, step=(5.0, 2.0), size=((-50.0, 50.0), (-22.0, 22.0)))
    assert narrow.hides is False
    assert spec.hides


def test_a_slow_vehicle_is_assumed_beyond_the_grid():
    perception, scene, _ = seen({**COARSE, "grid_size": [[-32.5, 52.5], [-17.5, 17.5]]}, 3)
    assert perception.edges == (pytest.approx(52.5), pytest.approx(32.5))
    far = scene.others[(scene.ids < 0) & (scene.others[:, 0] - scene.ego[0] >= 52.5 - 1e-6)]
    assert sorted(far[:, 1].tolist()) == ROAD.centers.tolist()
    assert far[:, 3].max() <= 18.0
    worst = seen({**COARSE, "grid_size": [[-32.5, 52.5], [-17.5, 17.5]]}, 3, PerceptionConfig(Unseen.worst()))[1]
    assert (worst.others[:, 0] - worst.ego[0] == -32.5).sum() == 3
    assert perception.rating == (Guarantee.ASSUMED, 1.0)
    assert seen(FINE, 3)[0].rating == (Guarantee.ALL_SEEN, 1.0)


def test_the_grid_turns_with_the_ego():
    """The further the ego is turned, the nearer is the edge at which the road leaves a grid along it."""
    spec, reach = GridSpec(size=((-100.0, 100.0), (-15.0, 15.0)), step=(5.0, 2.0), aligned=True), []
    assert covered_distance(spec, -4.0, 4.0, 0.0) == (100.0, 100.0)
    for heading in (0.1, 0.2, 0.3):
        reach.append(covered_distance(spec, -4.0, 4.0, heading))
        assert covered_distance(spec, -4.0, 4.0, heading) == pytest.approx(
            covered_distance(spec, -4.0, 4.0, -heading), abs=2.0
        )
    assert reach[0][0] > reach[1][0] > reach[2][0]
    assert reach[-1][0] == pytest.approx((15.0 - 4.0 * np.cos(0.3)) / np.sin(0.3))
    assert covered_distance(replace(spec, size=((-100.0, 100.0), (-15.0, 3.0))), -4.0, 4.0, 0.0) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"features": ["presence", "on_road"]}, "lacks vx, vy: add them to config"),
        ({"features": ["vx", "vy"]}, "lacks presence: add them"),
        ({"absolute": True}, "set 'absolute' to False"),
        ({"features_range": {"x": [-50, 50]}}, "vx, vy of the grid are cut off at 1: add them"),
        ({"features_range": {"x": [-50, 50]}, "clip": False, "as_image": True}, "cut off at 1"),
        ({"grid_size": [[5, 50], [-20, 20]]}, "has to hold the ego"),
        ({"grid_step": [0, 5]}, "cells, bodies and distance are above 0"),
        ({"features_range": {"vx": [1, 0], "vy": [0, 1]}}, "has to ascend"),
        ({"features": ["presence", "vx", "vx", "vy"]}, "each feature may be there once"),
    ],
)
def test_an_unusable_grid_is_refused_with_the_setting_to_change(options, match):
    with pytest.raises(ConfigError, match=match):
        GridSpec.from_config({**COARSE, **options})


def test_a_grid_has_to_reach_across_the_road():
    with pytest.raises(ConfigError, match=r"grid_size.* to at least -8 to 8 across"):
        GridPerception(GridSpec(size=((-50.0, 50.0), (-5.0, 5.0)), step=(5.0, 1.0)), ROAD, (0.2, 5))
    with pytest.raises(ConfigError, match="noise and delay are of Kinematics"):
        GridPerception(GridSpec(), ROAD, (0.2, 5), PerceptionConfig(noise=(1.0,) * 4))


SHAPE = GridSpec.from_config(COARSE).shape
BAD = {
    "nan": np.full(SHAPE, np.nan),
    "infinity": np.full(SHAPE, np.inf),
    "all zero": np.zeros(SHAPE),
    "another shape": np.zeros((4, 5, 5)),
    "turned": np.ones((*SHAPE[1:], SHAPE[0])),
    "booleans": np.ones(SHAPE, bool),
    "words": np.full(SHAPE, "a"),
    "two": np.ones((2, *SHAPE)),
    "nothing": None,
}


@pytest.mark.parametrize("bad", BAD.values(), ids=BAD)
def test_a_grid_that_cannot_be_read_is_answered_with_the_labelled_fallback(bad):
    with pytest.raises(SceneError):
        decode_grid(GridSpec.from_config(COARSE), bad)
    known = Known.from_config({**HighwayEnvFast.default_config(), "observation": COARSE})
    shielded, env = Shield(lambda obs: 3, known=known, **FRAMELESS), make(COARSE)
    obs, _ = env.reset(seed=1)
    for shown, fails in ((obs, False), (bad, True), (obs, False)):
        shielded.policy.function = lambda obs: 3
        shielded.predict(shown)
        assert (shielded.last_decision.reason is Reason.BAD_SCENE) is fails
    shielded.reset()
    shielded.predict(bad)
    shielded.predict(obs)  # the ego's position is unknown now
    assert shielded.last_decision.reason is Reason.BAD_SCENE


def test_a_vehicle_too_fast_for_the_range_may_be_anywhere():
    spec = GridSpec(
        size=((-50.0, 50.0), (-15.0, 15.0)), step=(5.0, 5.0), ranges={"vx": (-10.0, 10.0), "vy": (-10.0, 10.0)}
    )
    obs = np.zeros(spec.shape)
    obs[0, 10, 3] = obs[0, 15, 3] = 1
    ego = np.array([0.0, 4.0, 0.0, 25.0, 5.0, 2.0, 0.0])
    perception = GridPerception(spec, ROAD, (0.2, 5))
    perception.see(obs, 0, CONTROL, ego)
    assert min(perception.edges) == 50.0
    obs[1, 15, 3] = -1.0
    perception.see(obs, 1, CONTROL, ego)
    assert perception.edges == (5.0, 5.0)
    assert not decode_grid(spec, obs).low.size


@pytest.mark.parametrize("order", ["first", "last"])
def test_stacked_grids_are_unstacked(order):
    """Of a VecFrameStack on either axis, bytes as well."""
    for observation in (COARSE, {**COARSE, "as_image": True}):
        inner = DummyVecEnv([lambda observation=observation: make(observation)])
        world = VecFrameStack(inner, 3, channels_order=order)
        inner.seed(3)
        shown = world.reset()
        shielded = Shield(lambda obs: np.array([1]), env=world, **FRAMELESS)
        for _ in range(3):
            np.testing.assert_array_equal(
                undo_vec_wrappers(world, shown)[0], inner.envs[0].unwrapped.observation_type.observe()
            )
            action, _ = shielded.predict(shown)
            assert shielded.last_decision.reason is not Reason.BAD_SCENE
            shown, *_ = world.step(action)


def test_traffic_is_read_from_grids_alone_and_the_ego_does_not_crash(monkeypatch):
    def forbidden(self):
        raise AssertionError("the simulator's state was read")

    monkeypatch.setattr(SceneReader, "read", forbidden)
    env = ShieldedEnv(make(COARSE, duration=15), perception="observation")
    env.reset(seed=301)
    over = False
    while not over:
        _, _, terminated, truncated, info = env.step(3)
        over = terminated or truncated
    assert not info["crashed"]
    assert info["shield"]["guarantee"] in ("assumed", "none")
