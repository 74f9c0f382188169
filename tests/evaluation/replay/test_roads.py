"""Replays on every kind of road, with meta-actions, with throttle and steering, and of the user's environments."""

from __future__ import annotations

import numpy as np
import pytest
from replayed import asked_for

from evaluation.replay.collect import ReplayRequest, collect
from evaluation.replay.html import to_html
from evaluation.replay.record import STEP
from evaluation.running.records import config_on, variant_for
from evaluation.settings import get_setting, setting_of
from shield.config import ShieldConfig


def replayed(setting, policy, seed, config=None, **changes):
    """The replay of one episode."""
    where = get_setting(setting).override(changes) if changes else get_setting(setting)
    return collect(ReplayRequest(where, policy, variant_for(config_on(where, config), where), seed))[0]


def outline_of(area):
    """The corners of an area in the world [m], (n, 2)."""
    return STEP * np.array(area.outline).reshape(-1, 2)


def test_simulated_traffic_is_shown_where_it_would_be():
    """At the intersection the areas are bodies, and that of the binding vehicle is among them."""
    replay = replayed("intersection", "faster", 3)
    assert not replay.straight
    assert len(replay.lanes) > 10
    caused = [each for each in replay.overrides if each.cause >= 0]
    assert len(caused) >= 2
    for override in caused:
        (area,) = [area for area in override.areas if area.body == override.cause]
        sides = np.hypot(*(np.roll(outline_of(area), 1, axis=0) - outline_of(area)).T)
        body = replay.bodies[override.cause]
        assert sorted(sides) == pytest.approx([body.width, body.width, body.length, body.length], abs=2 * STEP)


def test_the_worst_case_on_a_network_is_shown_as_strips_of_lanes():
    """At the roundabout the areas of the binding vehicle reach farther than its body."""
    replay = replayed("roundabout", "faster", 5, "worst-case")
    assert replay.about["verification"] == "worst_case"
    caused = [each for each in replay.overrides if each.cause >= 0]
    assert len(caused) >= 3
    shown = [[area for area in each.areas if area.body == each.cause] for each in caused]
    assert sum(bool(areas) for areas in shown) >= len(caused) - 1
    lengths = [np.ptp(outline_of(area), axis=0).max() for areas in shown for area in areas]
    assert max(lengths) > 5.0
    assert all(area.body >= 0 for each in replay.overrides for area in each.areas)


def test_a_replay_of_throttle_and_steering_has_the_executed_inputs():
    """On a racetrack each frame has its inputs; a rollout continues with the policy, unshielded, at most one a
    second."""
    replay = replayed("racetrack", "idle", 3, duration=12)
    decided = [frame for frame in replay.frames if frame.step >= 0]
    assert replay.about["actions"] == "inputs"
    assert all(np.isfinite([frame.acceleration, frame.wheel]).all() for frame in decided)
    changed = [frame for frame in decided if frame.status != "PASSED"]
    assert len(changed) > 10
    assert any(frame.wheel != 0 for frame in changed)
    assert all(frame.wheel == 0 for frame in decided if frame.status == "PASSED")
    followed = [each for each in replay.overrides if each.what_if is not None]
    assert followed
    assert all(each.what_if.then == "idle, unshielded" for each in followed)
    starts = np.array([replay.steps[each.step].first for each in followed]) * replay.dt
    assert (np.diff(starts) >= 1 - 1e-9).all()
    assert any(each.what_if.off_road for each in followed)


def test_an_environment_of_the_users_is_replayed(tmp_path):
    """Throttle and steering on the highway, configured by a file."""
    (tmp_path / "mine.toml").write_text('duration = 4\nvehicles_count = 10\naction = { type = "ContinuousAction" }\n')
    where = setting_of("highway-v0", tmp_path / "mine.toml")
    replay, record = collect(ReplayRequest(where, "throttle", variant_for(config_on(where), where), 3))
    assert replay.straight
    assert record.steps == len(replay.steps) == 4
    assert "highway-v0+mine" in to_html(replay)


def test_a_rule_alone_and_no_area():
    """Modes that verify nothing are replayed, too: overrides have their reason."""
    replay = replayed("highway-fast", "faster", 5, ShieldConfig(mode="rss"))
    assert {replay.steps[each.step].reason for each in replay.overrides} == {"rss"}


@pytest.mark.parametrize("setting", ["merge", "exit", "two-way", "u-turn", "parking-parked"])
def test_every_road_has_a_page(setting):
    """The page has lanes, the ego in each frame, and the records of all steps."""
    replay, record = collect(asked_for(setting, "random", 4, duration=10))
    assert replay.lanes
    assert len(replay.steps) == record.steps
    assert len(replay.frames) == record.frames + 1
    assert to_html(replay).startswith("<!doctype html>")
