"""The overlay shows decisions in Gymnasium's own recordings, and does not change the drive."""

from __future__ import annotations

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import imageio.v3 as iio
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RecordVideo

from dynamics.roads.straight import StraightRoad
from evaluation.report.draw import GREEN, ORANGE, PROPOSAL, RED, draw
from evaluation.report.overlay import ShieldOverlay
from evaluation.report.proposal import ego_copy, proposed_path
from shield import Shield, ShieldConfig, ShieldedEnv
from shield.errors import ConfigError

RECORD = ShieldConfig(record=True)
FASTER = 3


def made(env_id="highway-fast-v0", render_mode="rgb_array", **config):
    return gym.make(env_id, render_mode=render_mode, config=config)


def holds(picture, color):
    return bool((np.abs(picture.astype(int) - color).max(axis=-1) < 12).any())


def test_an_overridden_decision_shows_the_proposal_and_the_executed_plan():
    env = ShieldOverlay(ShieldedEnv(made(), RECORD))
    env.reset(seed=5)
    before = env.render()
    assert not any(holds(before[-112:], color) for color in (GREEN, ORANGE, RED)), "nothing is decided yet"
    shown = {True: 0, False: 0}
    for _ in range(8):
        *_, info = env.step(FASTER)
        picture = env.render()
        assert picture.shape == before.shape
        replaced = env.get_wrapper_attr("last_decision").overridden
        if not info["shield"]["overridden"]:
            assert holds(picture[:, :10], GREEN)
        elif replaced:
            assert holds(picture[:, :10], ORANGE) or holds(picture[:, :10], RED)
        shown[replaced] += 1
    assert min(shown.values()) > 0, "this episode has decisions of one kind only"


def test_the_proposal_is_drawn_where_it_is_replaced():
    env = ShieldedEnv(made(), RECORD)
    overlay = ShieldOverlay(env)
    overlay.reset(seed=5)
    drawn = []
    base = overlay.unwrapped
    step = base.road.step

    def look(dt):
        step(dt)
        drawn.append((env.last_decision.overridden, holds(overlay.render()[:300], PROPOSAL)))

    base.road.step = look
    for _ in range(6):
        overlay.step(FASTER)
    begun = drawn[::5]  # frames later than that the proposal is behind
    assert {yellow for overridden, yellow in begun if overridden} == {True}
    assert {yellow for overridden, yellow in begun if not overridden} == {False}


def test_gymnasiums_recorder_has_every_frame(tmp_path):
    env = RecordVideo(ShieldOverlay(ShieldedEnv(made(duration=3, simulation_frequency=15), RECORD)), str(tmp_path))
    env.unwrapped.set_record_video_wrapper(env)
    env.reset(seed=5)
    for _ in range(3):
        env.step(FASTER)
    env.close()
    (film,) = tmp_path.glob("*.mp4")
    frames = iio.imread(film)
    assert len(frames) == pytest.approx(3 * 15 + 1, abs=1)
    assert frames.shape[2] == 1200


def test_an_overlay_around_a_policys_shield_changes_nothing():
    paths = []
    for overlaid in (False, True):
        bare = made()
        shield = Shield(lambda _: FASTER, env=bare, config=RECORD)
        env = ShieldOverlay(bare, shield) if overlaid else bare
        obs, _ = env.reset(seed=5)
        path = []
        for _ in range(6):
            action, _ = shield.predict(obs)
            obs, *_ = env.step(int(action))
            if overlaid:
                env.render()
            path.append([*env.unwrapped.vehicle.position, env.unwrapped.vehicle.speed])
        paths.append(path)
    assert paths[0] == paths[1]


@pytest.mark.parametrize(("env_id", "action"), [("highway-fast-v0", 0), ("racetrack-v0", np.array([0.3], np.float32))])
def test_the_copied_ego_drives_the_path_of_the_proposal(env_id, action):
    env = made(env_id)
    env.reset(seed=4)
    base = env.unwrapped
    road = StraightRoad.from_network(base.road.network) if env_id.startswith("highway") else None
    identity = type("World", (), {"to_road": staticmethod(lambda states: states)})
    ego = ego_copy(base)
    others = [vehicle.position.copy() for vehicle in base.road.vehicles]
    path = proposed_path(base, ego, action, road or identity)
    assert all(np.array_equal(a, v.position) for a, v in zip(others, base.road.vehicles, strict=True))
    env.step(action)
    state = np.array([*base.vehicle.position, base.vehicle.heading, base.vehicle.speed])
    expected = road.to_road(state) if road else state
    assert path[-1] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("env_id", ["roundabout-v1", "intersection-v2"])
def test_a_copied_ego_that_drives_on_to_other_roads_leaves_the_ego_its_route(env_id):
    """highway-env removes passed roads from the route itself."""
    env, driven = made(env_id, render_mode=None), 0
    env.reset(seed=4)
    ego, done = env.unwrapped.vehicle, False
    while not done:
        before, alone = list(ego.route), ego_copy(env.unwrapped)
        for _ in range(60):
            alone.act()
            alone.step(1 / 15)
        driven += alone.route != before
        assert ego.route == before
        *_, terminated, truncated, _ = env.step(1)
        done = terminated or truncated
    assert driven > 0


def test_a_proposal_that_is_none_is_not_driven():
    env = made()
    env.reset(seed=4)
    for action in (np.nan, 17, "left", None):
        assert proposed_path(env.unwrapped, ego_copy(env.unwrapped), action, None) is None


@pytest.mark.parametrize(
    ("env_id", "config", "settings"),
    [
        ("highway-fast-v0", {}, None),
        ("highway-fast-v0", {"action": {"type": "ContinuousAction"}}, None),
        ("roundabout-v1", {}, None),
        ("roundabout-v1", {}, "worst-case"),
    ],
)
@pytest.mark.parametrize("around", ["env", "policy"])
def test_the_overlay_draws_with_default_settings(env_id, config, settings, around):
    """Once `record=True` was required, and on networks nothing was drawn."""
    bare = made(env_id, **config)
    action = 1 if not config else np.zeros(2, np.float32)
    if around == "env":
        shield = ShieldedEnv(bare, settings)
        env = ShieldOverlay(shield)
    else:
        bare.reset(seed=5)
        shield = Shield(lambda _: action, bare, settings)
        env = ShieldOverlay(bare, shield)
    obs, _ = env.reset(seed=5)
    env.step(action if around == "env" else shield.predict(obs)[0])
    env.render()
    image = env.env.render()
    shot = env._shot(image, 1)
    assert shot.acting.plan is not None
    assert shot.decision.occupancy is not None or any(shot.areas)
    picture = np.asarray(draw(shot))[: image.shape[0]]
    assert np.any(picture != image)


def test_misuse_is_refused():
    with pytest.raises(ConfigError, match=r"no ShieldedEnv inside"):
        ShieldOverlay(made())
    with pytest.raises(ConfigError, match=r"render_mode='rgb_array'"):
        ShieldOverlay(ShieldedEnv(made(render_mode=None), RECORD))


def test_gymnasium_accepts_it():
    check_env(ShieldOverlay(ShieldedEnv(made(), RECORD)), skip_render_check=True)
