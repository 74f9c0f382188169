"""Observations whose clipping hides part of a scene are refused; beyond the range of x no vehicle is seen."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from policies import Always

from shield import Shield, ShieldedEnv
from shield.errors import ConfigError
from shield.perception.known import Known
from shield.perception.sighting import decode
from shield.perception.spec import ObservationSpec
from shield.perception.unseen import edges

WIDE = {"x": [-200, 200], "y": [-12, 12], "vx": [-80, 80], "vy": [-80, 80]}
ROWS = {"type": "Kinematics", "vehicles_count": 15, "see_behind": True, "features": ["presence", "x", "y", "vx", "vy"]}
GRID = {
    "type": "OccupancyGrid",
    "features": ["presence", "x", "y", "vx", "vy", "on_road"],
    "grid_size": [[-60, 120], [-14, 14]],
    "grid_step": [3, 2],
}


def made(observation, **ranges):
    observation = {**observation, "features_range": {**WIDE, **ranges}}
    return gym.make("highway-fast-v0", config={"observation": observation, "duration": 10})


ENTRIES = {
    "env": lambda env: ShieldedEnv(env, perception="observation"),
    "policy": lambda env: Shield(Always(3), env=env, perception="observation"),
    "actions only": lambda env: Shield(Always(3), env=env, perception="observation", frames=False),
    "known": lambda env: Known.from_config(env.unwrapped.config),
}


@pytest.mark.parametrize("entry", ENTRIES)
@pytest.mark.parametrize(
    ("observation", "ranges", "message"),
    [
        (ROWS, {"vx": [-20, 20]}, r"vx .* beyond \[-12, 30\]"),
        (ROWS, {"vx": [-30, 30]}, r"vx .* beyond \[-12, 30\]"),
        (ROWS, {"vx": [0, 40]}, r"vx .* beyond \[-12, 30\]"),
        (ROWS, {"y": [-8, 8]}, r"y .* beyond \[-8, 10\]"),
        (ROWS, {"vy": [-1, 1]}, r"vy .* beyond \[-9, 9\]"),
        ({**ROWS, "features": [*ROWS["features"], "heading"]}, {"heading": [-0.1, 0.1]}, "heading .* beyond"),
        (ROWS, {"presence": [0, 2]}, "presence of 1 has to be shown"),
        (GRID, {"vx": [-5, 5]}, r"vx .* beyond \[-12, 12\]"),
        (GRID, {"vy": [-1, 1]}, r"vy .* beyond \[-9, 9\]"),
    ],
)
def test_ranges_that_hide_a_speed_or_a_place_are_refused(entry, observation, ranges, message):
    """With vx of +-20 m/s the ego's own speed was at the edge: it stopped on the highway, in `bad_scene`."""
    with pytest.raises(ConfigError, match=message):
        ENTRIES[entry](made(observation, **ranges))


def test_a_reset_to_such_ranges_is_refused_too():
    """And the remedies that the message names work."""
    env = ShieldedEnv(made(ROWS), perception="observation")
    narrow = {**ROWS, "features_range": {**WIDE, "vx": [-20, 20]}}
    with pytest.raises(ConfigError, match=r"widen .*or set 'clip' to False"):
        env.reset(seed=0, options={"config": {"observation": narrow}})
    env.reset(seed=0, options={"config": {"observation": {**narrow, "clip": False}}})
    *_, info = env.step(3)
    assert info["shield"]["reason"] != "bad_scene"


@pytest.mark.parametrize("reach", [50.0, 100.0])
def test_a_range_of_x_shorter_than_sight_is_supported(reach):
    """A vehicle beyond the range was once assumed 5 m away, and the ego stopped. Such a vehicle is out of sight."""
    env = ShieldedEnv(made(ROWS, x=[-reach, reach]), perception="observation")
    speeds = []
    for seed in range(2):
        env.reset(seed=seed)
        over = False
        while not over:
            *_, terminated, truncated, info = env.step(3)
            over = terminated or truncated
            assert not terminated
            assert info["shield"]["guarantee"] in ("assumed", "none")
            speeds.append(env.unwrapped.vehicle.speed)
    assert np.mean(speeds) > 24.0


def test_a_vehicle_beyond_the_range_of_x_is_out_of_sight_and_one_too_fast_is_not():
    """Sight ends at the range; a row whose speed is at the limit of its own range may be anywhere."""
    spec = ObservationSpec(
        see_behind=True, ranges={name: tuple(ends) for name, ends in {**WIDE, "x": [-50, 100]}.items()}
    )
    rows = np.zeros((5, 5))
    rows[:3, 0] = 1.0
    rows[0, 3] = 25 / 80
    rows[1, 1], rows[2, 1] = 1.0, -1.0
    sighting = decode(spec, rows)
    assert len(sighting.others) == 0
    assert not sighting.cut
    assert edges(spec, sighting) == (100.0, 50.0)
    rows[3, [0, 1, 3]] = 1.0, 0.2, -1.0
    sighting = decode(spec, rows)
    assert sighting.cut
    assert edges(spec, sighting) == (5.0, 5.0)
