"""Pictures of decisions by simulation."""

from __future__ import annotations

import gymnasium as gym
import highway_env  # noqa: F401
import numpy as np
import pytest
from PIL import Image, ImageDraw

from evaluation.report.draw import AREA, ORANGE
from evaluation.report.gallery import draw_gallery, draw_override
from evaluation.report.overlay import ShieldOverlay
from evaluation.report.worst_case_view import draw_worst_cases
from shield import Shield, ShieldConfig
from shield.errors import ConfigError
from shield.filters.network import NetworkFilter


@pytest.fixture(autouse=True)
def one_episode(monkeypatch):
    monkeypatch.setattr("evaluation.report.gallery._SEARCH", 1)


def near(image, color):
    return int((np.abs(np.asarray(image.convert("RGB"), int) - color).sum(axis=-1) < 60).sum())


def test_an_override_shows_the_path_and_the_others():
    picture = draw_override("merge-v1")
    assert near(picture, ORANGE) > 500
    assert near(picture, np.array(AREA) // 2 + 50) > 100


def test_a_gallery_has_a_picture_for_each_road(tmp_path):
    path = draw_gallery(tmp_path / "new" / "roads.png", ["roundabout-v1", "merge-v1", "two-way-v0"])
    one = draw_gallery(tmp_path / "one.png", ["merge-v1"])
    (width, height), (single, low) = Image.open(path).size, Image.open(one).size
    assert width > 2 * single
    assert height > 2 * low


def test_each_road_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr("evaluation.report.gallery.draw_override", lambda *_: Image.new("RGB", (1200, 712), "red"))
    named = Image.open(draw_gallery(tmp_path / "two.png", ["merge-v1", "u-turn-v1"])).convert("L")
    strips = [np.asarray(named.crop((left, 0, left + 200, 30))) for left in (0, 810)]
    assert all((strip < 60).sum() > 100 for strip in strips)
    assert (strips[0] != strips[1]).any()


def test_a_picture_of_simulated_traffic_mentions_no_assumptions(monkeypatch):
    said = []
    text = ImageDraw.ImageDraw.text
    monkeypatch.setattr(
        ImageDraw.ImageDraw, "text", lambda pen, at, *a, **k: (said.append(a[0]), text(pen, at, *a, **k))
    )
    draw_override("merge-v1")
    why = [line for line in said if "refused" in line]
    assert why
    assert all("in the simulation" in line for line in why)
    assert not any("assumptions" in line for line in said)
    assert "others, foretold for 1 s" in said


def test_invalid_pictures_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="png"):
        draw_gallery(tmp_path / "roads.gif")
    with pytest.raises(ConfigError, match="not 10000"):
        draw_override("merge-v1", seed=10_000)
    for env_id in ("parking-v0", "racetrack-v0", "intersection-multi-agent-v0"):
        with pytest.raises(ConfigError, match=r"draws meta-actions.*have merge-v0"):
            draw_override(env_id, "random")
        with pytest.raises(ConfigError):
            draw_worst_cases(tmp_path / "worst.png", [env_id])
    with pytest.raises(ConfigError, match=r"on networks of roads.*have merge-v1"):
        draw_worst_cases(tmp_path / "worst.png", ["highway-fast-v0"])
    with pytest.raises(ConfigError, match="not overridden"):
        draw_override("exit-v1", "idle")


@pytest.mark.parametrize("env_id", ["roundabout-v1", "highway-fast-v0"])
def test_the_picture_follows_the_episode(env_id):
    """Rendered before and after the step: the plan begins at the ego."""
    raw = gym.make(env_id, render_mode="rgb_array")
    shield = Shield(lambda obs: 3, raw, ShieldConfig.simulated_traffic().replace(record=True), frames=False)
    env = ShieldOverlay(raw, shield)
    observation, _ = env.reset(seed=3)
    action, _ = shield.predict(observation)
    env.mark()
    before = env.render()
    env.step(int(action))
    after, ego, plan = env.render(), raw.unwrapped.vehicle, shield.last_decision.plan
    frames = raw.unwrapped.steps
    assert before.shape == after.shape
    assert (before != after).any()
    assert np.allclose(plan[frames], [*ego.position, ego.heading, ego.speed], atol=1e-9)


def test_the_worst_case_shows_where_others_may_be_and_where_ways_meet(tmp_path, monkeypatch):
    monkeypatch.setattr("evaluation.report.worst_case_view._EPISODES", 1)
    path = draw_worst_cases(tmp_path / "new" / "worst.png", ["roundabout-generic-v0"])
    picture = Image.open(path)
    assert near(picture, np.array([255, 127, 14])) > 20
    # A red or green zone over white is paler.
    red, green = (near(picture, np.array(color)) for color in ([221, 130, 135], [150, 205, 150]))
    assert red + green > 20


def test_the_prediction_begins_at_the_present_places():
    env = gym.make("roundabout-v1")
    env.reset(seed=1)
    network_filter = NetworkFilter(env.unwrapped, ShieldConfig.for_roads())
    network_filter.decide(1)
    seen, ego = network_filter.foreseen, env.unwrapped.vehicle
    assert np.hypot(*(seen.path[0, :2] - ego.position)) < 2.0
    assert abs(seen.path[-1, 3]) < 1e-6
    assert (seen.least <= seen.most).all()
    for j, (vehicle, lane) in enumerate(zip(seen.vehicles, seen.lanes, strict=True)):
        s, r = env.unwrapped.road.network.get_lane(lane).local_coordinates(seen.rows[vehicle, :2])
        if seen.least[j, 0] <= s <= seen.most[j, 0] and seen.least[j, 0] >= 0:
            assert seen.low[j] - 1e-6 <= r <= seen.high[j] + 1e-6


def test_worst_cases_that_cannot_be_drawn_are_refused(tmp_path):
    for path, roads, seed, message in (
        ("worst.svg", ["roundabout-v1"], 0, "png"),
        ("worst.png", [], 0, "at least one road"),
        ("worst.png", ["roundabout-v1"], 10_000, "not 10000"),
    ):
        with pytest.raises(ConfigError, match=message):
            draw_worst_cases(tmp_path / path, roads, seed=seed)
