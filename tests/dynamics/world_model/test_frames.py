"""Frames: each pixel against footprints and lanes of highway-env, and the compiled copies against highway-env."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynamics.errors import ConfigError, SceneError
from dynamics.highway_simulator.simulator import Simulator
from dynamics.road_networks.episodes.simulator import RoadSimulator
from dynamics.traffic.crossing import make
from dynamics.world_model import CHANNELS, BirdsEye, FrameView, composite
from dynamics.world_model.draw_kernels import DrawWork, draw
from dynamics.world_model.road_pictures import CELL, RoadPicture
from dynamics.world_model.view import DRIVABLE, EGO, MARKINGS, OTHERS, RELATIVE_SPEED

VIEW = FrameView()
_, SIZE, _ = VIEW.shape
NO_ROAD = RoadPicture(0, 0.0, 0.0, 0.0, 0.0, 1, 1, np.zeros(1, np.uint16))
ROADS = (
    "highway-v0",
    "merge-v0",
    "roundabout-v1",
    "intersection-v0",
    "exit-v0",
    "two-way-v0",
    "u-turn-v0",
    "racetrack-v0",
)


def pixel_centres(view: FrameView = VIEW) -> np.ndarray:
    """Places of the pixels in the frame of the ego: ahead, to the right, (size, size, 2) [m]."""
    length, width = (view.ahead + view.behind) / view.size, 2 * view.side / view.size
    ahead, right = (np.arange(view.size) + 0.5) * length - view.behind, (np.arange(view.size) + 0.5) * width - view.side
    return np.stack(np.meshgrid(ahead, right), axis=-1)


def drawn(bodies: Any, view: FrameView = VIEW, road: RoadPicture = NO_ROAD) -> np.ndarray:
    frame = np.empty(view.shape, np.uint8)
    rows = [(x, y, np.cos(h), np.sin(h), v, length, width) for x, y, h, v, length, width in bodies]
    draw(np.array(rows, float), 0, road, view.numbers, DrawWork.of(view.size), frame)
    return frame


def corners_of_pixels(view: FrameView) -> np.ndarray:
    """(size, size, 4, 2) [m]."""
    half = np.array([(view.ahead + view.behind) / view.size, 2 * view.side / view.size]) / 2
    signs = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    return pixel_centres(view)[:, :, None] + signs * half


@given(
    x=st.floats(-40, 110),
    y=st.floats(-20, 20),
    heading=st.floats(-np.pi, np.pi),
    ego_heading=st.floats(-np.pi, np.pi),
    size=st.tuples(st.floats(0.5, 18), st.floats(0.5, 3)),
)
def test_a_pixel_inside_a_footprint_is_full_and_one_outside_is_empty(
    x: float, y: float, heading: float, ego_heading: float, size: tuple[float, float]
) -> None:
    cos, sin = np.cos(ego_heading), np.sin(ego_heading)
    place = 100 + cos * x - sin * y, 50 + sin * x + cos * y
    body = (*place, ego_heading + heading, 20.0, *size)
    frame = drawn([(100, 50, ego_heading, 20.0, 5.0, 2.0), body])[OTHERS]
    # Corners of the pixels in the axes of the body, and corners of the body in those of the frame.
    offset = corners_of_pixels(VIEW) - (x, y)
    along = offset @ (np.cos(heading), np.sin(heading))
    across = offset @ (-np.sin(heading), np.cos(heading))
    slack = 1e-6
    inside = (np.abs(along) <= size[0] / 2 - slack).all(-1) & (np.abs(across) <= size[1] / 2 - slack).all(-1)
    beyond = [
        (part.min(-1) >= half + slack) | (part.max(-1) <= -half - slack)
        for part, half in ((along, size[0] / 2), (across, size[1] / 2))
    ]
    assert (frame[inside] == 255).all()
    assert (frame[beyond[0] | beyond[1]] == 0).all()


@given(
    x=st.floats(0, 80),
    y=st.floats(-8, 8),
    heading=st.floats(-np.pi, np.pi),
    length=st.floats(3, 15),
    width=st.floats(1, 3),
)
def test_the_pixels_of_a_body_have_its_area(x: float, y: float, heading: float, length: float, width: float) -> None:
    """Square pixels, where soft edges on all sides are alike; the sum of shares is the area within a tenth or so."""
    view = FrameView(ahead=100, behind=28, side=64, size=256)
    frame = drawn([(0, 0, 0.0, 20.0, 5.0, 2.0), (x, y, heading, 20.0, length, width)], view)[OTHERS]
    assert frame.sum() / 255 * 0.25 == pytest.approx(length * width, rel=0.12)


def test_the_shade_of_a_body_is_its_speed() -> None:
    speeds = {0.0: 1, 10.0: 65, 20.0: 128, 30.0: 192, 60.0: 255}
    for speed, shade in speeds.items():
        frame = drawn([(0, 0, 0.0, 20.0, 5.0, 2.0), (30, 0, 0.0, speed, 5.0, 2.0)])
        assert set(np.unique(frame[RELATIVE_SPEED])) == {0, shade}
        assert ((frame[RELATIVE_SPEED] > 0) == (frame[OTHERS] > 0)).all()
    for speed, bright in {0.0: 64, 20.0: 159, 40.0: 255, 90.0: 255}.items():
        assert drawn([(0, 0, 1.0, speed, 5.0, 2.0)])[EGO].max() == pytest.approx(bright, abs=1)


def test_a_body_at_an_unknown_place_is_not_drawn() -> None:
    assert not drawn([(0, 0, 0.0, 20.0, 5.0, 2.0), (np.nan, 0.0, 0.0, 20.0, 5.0, 2.0)])[OTHERS].any()


@pytest.mark.parametrize("env_id", ROADS)
def test_the_road_is_drivable_where_highway_env_has_a_lane(env_id: str) -> None:
    env = make(env_id, {})
    env.reset(seed=3)
    base: Any = env.unwrapped
    ego, lanes = base.vehicle, base.road.network.lanes_list()
    rng = np.random.default_rng(0)
    for _ in range(3):
        ego.position, ego.heading = ego.position + rng.normal(0, 3, 2), ego.heading + rng.normal(0, 0.3)
        frame = BirdsEye().frame(env)
        cos, sin = np.cos(ego.heading), np.sin(ego.heading)
        places = pixel_centres() @ np.array([[cos, sin], [-sin, cos]]) + ego.position
        # A pixel covers this much along and across; the map is drawn from the cell under its centre.
        reach = CELL + np.hypot((VIEW.ahead + VIEW.behind) / SIZE, 2 * VIEW.side / SIZE) / 2
        for j, i in zip(*rng.integers(0, SIZE, (2, 300)), strict=True):
            depth = max(_depth(lane, places[j, i]) for lane in lanes)
            if depth >= reach:
                assert frame[DRIVABLE, j, i] == 255, (j, i, depth)
            if depth <= -reach:
                assert frame[DRIVABLE, j, i] == 0, (j, i, depth)
                assert frame[MARKINGS, j, i] == 0, (j, i, depth)


def _depth(lane: Any, place: Any) -> float:
    """How far inside a lane a place is, negative outside of it [m]."""
    s, r = lane.local_coordinates(place)
    return float(min(lane.width_at(s) / 2 - abs(r), s, lane.length - s))


def test_continuous_lines_are_brighter_than_dashed_ones() -> None:
    env = gym.make("highway-v0", config={"lanes_count": 3})
    env.reset(seed=0)
    base: Any = env.unwrapped
    base.vehicle.position[1] = 4.0
    marks = BirdsEye(FrameView(side=8.0)).frame(env)[MARKINGS]
    assert (marks == marks[:, :1]).all()
    bright = {y: marks[round((y + 8) / 0.25) - 1, 0] for y in (-6.0, -2.0, 2.0, 6.0)}
    assert bright[-6.0] == bright[6.0] == 2 * bright[-2.0] - bright[6.0] % 2
    assert bright[-2.0] == bright[2.0] > 0


def test_frames_of_the_compiled_highway_are_those_of_highway_env() -> None:
    env = gym.make("highway-fast-v0")
    env.reset(seed=5)
    simulator, eye = Simulator("highway-fast-v0", 2), BirdsEye()
    simulator.reset([5, 6])
    frames = np.zeros((2, *VIEW.shape), np.uint8)
    network = env.unwrapped.road.network  # type: ignore[attr-defined]
    for action in (3, 0, 2, 1, 4, 2):
        env.step(action)
        simulator.step([action, 1])
        eye.frames(simulator, network, frames)
        assert (frames[0] == eye.frame(env)).all()
        assert (frames[0] != frames[1]).any()
    before = frames.copy()
    simulator.step([1, 1])
    eye.frames(simulator, network, frames, [1])
    assert (frames[0] == before[0]).all()
    assert (frames[1] != before[1]).any()


@pytest.mark.parametrize("env_id", ["merge-v0", "roundabout-v0", "intersection-v0"])
def test_frames_of_compiled_networks_are_those_of_highway_env(env_id: str) -> None:
    env = make(env_id, {})
    env.reset(seed=5)
    simulator, eye = RoadSimulator(env_id, 1), BirdsEye()
    simulator.reset([5])
    frames, network = np.zeros((1, *VIEW.shape), np.uint8), env.unwrapped.road.network  # type: ignore[attr-defined]
    for _ in range(4):
        env.step(1)
        simulator.step([1])
        assert (eye.frames(simulator, network, frames)[0] == eye.frame(env)).all()


def test_frames_follow_a_road_that_a_reset_replaces() -> None:
    env, eye = gym.make("highway-v0", config={"lanes_count": 2}), BirdsEye()
    env.reset(seed=0)
    narrow = eye.frame(env)[DRIVABLE].astype(int).sum()
    env.unwrapped.configure({"lanes_count": 5})  # type: ignore[attr-defined]
    env.reset(seed=0)
    assert eye.frame(env)[DRIVABLE].astype(int).sum() > 1.5 * narrow


def test_views_and_scenes_that_cannot_be_drawn() -> None:
    for wrong in ({"ahead": 0.0}, {"side": -1.0}, {"behind": float("nan")}, {"size": 8}, {"size": 64.0}):
        with pytest.raises(ConfigError, match=next(iter(wrong))):
            FrameView(**wrong)  # type: ignore[arg-type]
    with pytest.raises(SceneError, match="reset"):
        BirdsEye().frame(gym.make("CartPole-v1"))


def test_the_composite_shows_road_ego_and_others() -> None:
    env = gym.make("highway-fast-v0")
    env.reset(seed=0)
    frame = BirdsEye().frame(env)
    picture = composite(frame)
    assert picture.shape == (SIZE, SIZE, 3)
    assert len(CHANNELS) == len(frame)
    ego = frame[EGO] == frame[EGO].max()
    assert (picture[ego][:, 1] > picture[ego][:, 0]).all()
    assert not picture[(frame == 0).all(0)].any()
    assert (composite(np.stack([frame, frame])) == picture).all()
