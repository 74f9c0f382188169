"""Pictures show the scene with the right colours, and drawings match the places of highway-env's vehicles."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from PIL import Image

from dynamics.state import RoadState
from evaluation.report import video
from evaluation.report.camera import Camera
from evaluation.report.draw import GREEN, ORANGE, RED, Shot, _executed, _label, _pixels, draw
from evaluation.report.video import _best_clip, _decisions, _filmed, _overridden, film_override, find_override, record
from evaluation.settings import get_setting
from shield import ShieldConfig, ShieldedEnv
from shield.decision import Decision, Reason, Tier
from shield.errors import ConfigError


@pytest.fixture(scope="module")
def shots() -> list[Shot]:
    return record("highway-fast", "faster", 0, first=1, last=3)


def test_each_simulation_frame_has_a_picture(shots):
    assert len(shots) == 30
    assert [shot.age for shot in shots] == [*range(15)] * 2
    np.testing.assert_allclose(np.diff([shot.time for shot in shots]), 1 / 15)
    assert shots[0].time == pytest.approx(1.0)


def test_the_background_is_drawn_without_a_display(shots):
    assert all(np.unique(shot.image.reshape(-1, 3), axis=0).shape[0] > 5 for shot in shots[::7])


def test_the_plan_begins_where_the_ego_is_drawn(shots):
    shot = shots[0]
    plan = shot.decision.plan
    world = shot.road.to_world(plan[:1])[0, :2]
    x, y = np.round((world - shot.origin) * shot.scaling).astype(int)
    red, green, blue = shot.image[y, x].astype(int)
    assert green > red + 50, "the ego is green in highway-env's picture"
    assert green > blue + 50
    assert plan[0, RoadState.SPEED] == pytest.approx(shot.speed)


WHEEL = get_setting("highway-continuous").override({"vehicles_count": 10}, name="wheel")


def test_a_film_of_throttle_and_steering_shows_the_replacements():
    shots = record(WHEEL, "throttle", 0, first=30, last=60)
    assert len(shots) == 60
    np.testing.assert_allclose(np.diff([shot.time for shot in shots]), 1 / 20)
    assert shots[0].actions == ()
    held = [shot for shot in shots if shot.color != GREEN]
    assert held, "full throttle for six seconds is not let through"
    assert _executed(held[0]).endswith("°")
    assert _label(shots[0], shots[0].decision.proposed) == "+1.00, +0.00 of ±1"
    assert _label(shots[0], np.int64(4)) == "number 4"
    for shot in (shots[0], held[0]):
        assert draw(shot).getpixel((5, shot.image.shape[0] + 82)) == shot.color


def test_decisions_of_a_tenth_of_a_second_are_counted_in_seconds():
    assert _decisions(WHEEL) == 90
    assert _decisions("highway-fast") == 9
    assert _best_clip([False] * 30 + [True] * 60 + [False] * 100, rate=10) == (20, 60)


def test_a_curved_road_is_filmed_around_the_ego():
    setting = get_setting("racetrack")
    bare = _filmed(setting).make(render_mode="rgb_array")
    try:
        env = ShieldedEnv(bare)
        env.reset(seed=0)
        ego = env.unwrapped.vehicle
        camera = Camera(env)
        camera._take()
        (taken,) = camera._taken
        height, width, _ = taken["image"].shape
        assert (width, height) == (1000, 500)
        x, y = np.round((ego.position - taken["origin"]) * taken["scaling"]).astype(int)
        assert (x, y) == pytest.approx((500, 250), abs=2)
        red, green, blue = taken["image"][y, x].astype(int)
        assert min(red, green) > blue + 50, "a car with a wheel is yellow in highway-env's picture"
    finally:
        bare.close()


def test_a_network_of_roads_has_overrides_to_be_filmed():
    flags, rate = _overridden(get_setting("roundabout"), "faster", 0)
    assert rate == 1
    assert any(flags)
    assert not all(flags)


@pytest.mark.parametrize("config", [ShieldConfig.simulated_traffic(), "worst-case", None])
def test_a_network_of_roads_is_filmed_around_the_ego(config):
    shots = record("roundabout", "faster", 3, last=2, config=config, smooth=False)
    assert len(shots) == 30
    for shot in shots[::15]:
        height, width, _ = shot.image.shape
        assert (width, height) == (1000, 500)
        red, green, blue = shot.image[250, 500].astype(int)
        assert green > max(red, blue) + 30, "an ego with meta-actions is green in highway-env's picture"
        assert draw(shot).size[0] == width
    # The plan begins at the ego.
    assert _pixels(shots[0], shots[0].decision.plan[:1, :2])[0] == pytest.approx((1000, 500), abs=4)


def test_recording_does_not_change_the_drive():
    drawn = [shot.speed for shot in record("highway-fast", "faster", 3, last=3)]
    skipped = [shot.speed for shot in record("highway-fast", "faster", 3, first=2, last=3)]
    assert drawn[30:] == skipped


@pytest.mark.parametrize(
    ("tier", "color"),
    [
        (Tier.PASSED, GREEN),
        (Tier.ALTERNATIVE, ORANGE),
        (Tier.STORED_PLAN, RED),
        (Tier.LARGEST_MARGIN, RED),
    ],
)
def test_the_colour_says_which_stage_acted(shots, tier, color):
    shot = shots[0]
    decision = Decision(3, 4, Reason.RSS, tier, 0.5, 0.0, plan=shot.decision.plan)
    values = {name: getattr(shot, name) for name in Shot.__slots__}
    picture = draw(Shot(**{**values, "decision": decision, "frame": None}))
    assert picture.size == (shot.image.shape[1], shot.image.shape[0] + 112)
    assert picture.getpixel((5, picture.size[1] - 10)) == color


def test_a_clip_begins_with_a_decision_that_passed():
    flags = [False] * 5 + [True] * 3 + [False] * 20
    assert _best_clip(flags) == (4, 3)
    assert _best_clip([False] * 10) == (0, 0)


def test_seeds_of_the_evaluation_are_not_chosen_from():
    with pytest.raises(ConfigError, match="below 10000"):
        find_override(seed=100_000)
    with pytest.raises(ConfigError, match="gif"):
        film_override("x.mp4")


def test_a_film_is_written(tmp_path):
    setting = get_setting("highway-fast").override({"duration": 12, "vehicles_count": 10}, name="short")
    film = film_override(tmp_path / "deep" / "x.gif", setting, "faster")
    with Image.open(film.path) as picture:
        assert picture.n_frames > film.frames / 2  # frames that are the same are merged
    assert film.overrides >= 1


def test_a_film_is_written_of_an_episode_without_an_override(tmp_path, monkeypatch):
    """Once it was refused after 30 episodes; the search is announced before each of them."""
    monkeypatch.setattr(video, "_SEARCH", 3)
    setting = get_setting("highway-fast").override({"duration": 3, "vehicles_count": 1}, name="empty")
    tried = []
    film = film_override(tmp_path / "x.gif", setting, "idle", 7, lambda *seen: tried.append(seen))
    assert (film.seed, film.overrides) == (7, 0)
    assert tried == [(0, 3), (1, 3), (2, 3)]
    with Image.open(film.path) as picture:
        assert picture.n_frames >= 1
    with pytest.raises(ConfigError, match="was not overridden in 3 episodes of empty"):
        find_override(setting, "idle", 7)


@pytest.mark.parametrize("settings", [None, "worst-case"])
def test_films_on_networks_show_the_plan_and_the_others(settings):
    """By default settings nothing was drawn there, under a legend that lists all of it."""
    shots = record("roundabout", "faster", 0, last=2, config=settings)
    assert shots
    for shot in shots:
        assert shot.acting.plan is not None
        assert shot.decision.occupancy is not None or any(shot.areas)
    bare = replace(shots[-1].decision, plan=None, occupancy=None)
    values = {name: getattr(shots[-1], name) for name in Shot.__slots__}
    nothing = draw(Shot(**{**values, "decision": bare, "frame": None, "areas": ()}))
    assert np.any(np.asarray(draw(shots[-1])) != np.asarray(nothing))


def test_the_shaded_areas_are_the_reachable_places_of_the_other_vehicles():
    """The outlines of the first time contain the present centre of each vehicle."""
    shot = record("roundabout", "faster", 0, last=1, config="worst-case")[0]
    env = get_setting("roundabout").make()
    env.reset(seed=0)
    others = [v.position for v in env.unwrapped.road.vehicles if v is not env.unwrapped.vehicle]
    near = [at for at in others if np.hypot(*(at - env.unwrapped.vehicle.position)) < 150]
    shapes = [shapely.Polygon(outline).buffer(0.1) for outline in shot.areas[-1]]
    assert near
    for at in near:
        assert any(shape.contains(shapely.Point(at)) for shape in shapes)
