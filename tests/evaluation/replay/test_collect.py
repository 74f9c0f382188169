"""The data of a replay equal the records, bit for bit, and rollouts change nothing."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from replayed import asked_for, records_of

from evaluation.replay.collect import collect
from evaluation.replay.html import page_path, to_html, write_page
from evaluation.replay.record import STEP
from evaluation.replay.what_if import copy_without_recorder, follow
from evaluation.running.driver import Driver, DriverSpec
from shield.errors import ConfigError


@pytest.fixture(scope="module")
def driven():
    """An episode of always FASTER with overrides by other actions and by frames held back; and its records, driven
    apart."""
    asked = asked_for("highway-fast", "faster", 5)
    return *collect(asked), records_of(asked)


def data_of(page):
    """The data of the page, read as the page reads them."""
    return json.loads(re.search(r'<script id="data" type="application/json">(.*?)</script>', page, re.S).group(1))


def bits(value):
    """A number of the data as the 8 bytes of a float."""
    return np.float64(value).tobytes()


def test_the_page_has_the_bits_of_the_records(driven):
    """Each margin, speed and place of the ego in the page is the record's float; words are the record's words."""
    replay, _, records = driven
    data = data_of(to_html(replay))
    assert len(data["steps"]) == len(records.steps)
    assert len(data["frames"]) == len(records.world)
    for step, record, text in zip(data["steps"], records.steps, records.texts, strict=True):
        assert bits(step["margin"]) == bits(record.margin)
        assert (step["tier"], step["reason"]) == (record.tier.value, record.reason.value)
        assert (step["overridden"], step["text"]) == (record.overridden, text)
    decided = [each for frames in records.frames for each in frames]
    for frame, decision in zip(data["frames"], decided, strict=False):
        assert bits(frame["margin"]) == bits(decision.margin)
        assert (frame["tier"], frame["reason"], frame["clause"]) == (
            *(decision.tier.value, decision.reason.value),
            decision.clause,
        )
    for frame, rows in zip(data["frames"], records.world, strict=True):
        assert [bits(frame[name]) for name in ("x", "y", "heading", "speed")] == [bits(x) for x in rows[0, :4]]


def test_the_others_are_drawn_where_they_are_to_a_centimetre(driven):
    """Drawn bodies are the recorded ones, rounded; those in view are all there."""
    replay, _, records = driven
    for frame, rows in zip(replay.frames, records.world, strict=True):
        drawn = np.array(frame.others).reshape(-1, 5)
        near = np.hypot(*(rows[1:, :2] - rows[0, :2]).T) < 100
        assert set(np.flatnonzero(near) + 1) <= set(drawn[:, 0])
        assert np.abs(drawn[:, 1:3] * STEP - rows[drawn[:, 0], :2]).max(initial=0) <= 0.5001 * STEP


def test_overrides_are_explained_in_the_words_of_the_record(driven):
    """Each overridden step has one entry, with the text and the time of `Decision.explain`, and the binding vehicle."""
    replay, _, records = driven
    overridden = [k for k, record in enumerate(records.steps) if record.overridden]
    assert [each.step for each in replay.overrides] == overridden
    assert len(overridden) > 5
    for override in replay.overrides:
        why = records.steps[override.step].explain()
        assert (override.text, override.why, override.done, override.proof) == (why.text, why.why, why.done, why.proof)
        assert bits(override.binding) == bits(why.after)
        assert override.frame == replay.steps[override.step].first + why.frame
        assert replay.bodies[override.cause].kind == why.cause.kind
        (area,) = [area for area in override.areas if area.body == override.cause]
        assert len(area.outline) == 8


def test_following_proposals_changes_nothing_of_the_episode(driven):
    """The episode with rollouts, and all that the shield has decided in it, is the one without."""
    _, record, records = driven
    one, other = (
        {key: value for key, value in each.row().items() if not key.startswith("latenc")}
        for each in (record, records.episode)
    )
    np.testing.assert_equal(one, other)


def test_a_copy_that_is_followed_is_the_simulator_itself():
    """The action that the shield let pass, in a copy without a shield, leads to the recorded states, bit for bit."""
    asked = asked_for("highway-fast", "faster", 5)
    driver = Driver(DriverSpec(asked.setting, asked.policy, asked.variant, simulator="highway-env"))
    copies, compared = [], 0
    shielded = driver.env

    def after(time, record):
        first = round(time * 5)
        if not record.overridden and not any(frame.overridden for frame in shielded.frame_decisions):
            seen, _ = follow(copies[-1], record.executed, "faster", 5)
            kept.append((first, [frame[copies[-1].unwrapped.vehicle][:4] for frame in seen.frames[:6]]))

    kept = []
    driver.run(5, after, lambda _: copies.append(copy_without_recorder(driver.env.env)))
    world = driver.recorder.world()
    for first, states in kept:
        assert np.array(states).tobytes() == world[first : first + len(states), 0, :4].tobytes()
        compared += len(states)
    assert compared > 50


def test_the_outcome_of_a_refused_proposal_is_in_the_data(driven):
    """Always FASTER, let through, crashes into the binding vehicle of the refusal; the path ends there."""
    replay, _, _ = driven
    crashes = [each for each in replay.overrides if each.what_if is not None and each.what_if.crashed]
    assert len(crashes) > 3
    for each in crashes:
        found = each.what_if
        assert found.gap == 0.0
        assert found.within
        assert len(found.path) == 3 * (round(found.time / replay.dt) + 1)
        assert "crashes" in found.text
    assert sum(each.what_if.body == each.cause for each in crashes) > len(crashes) // 2


def test_numbers_that_are_not_finite_are_texts(driven):
    """JSON has no NaN and no infinity: the page reads texts in their place."""
    replay, _, _ = driven
    frame = replace(replay.frames[0], margin=math.nan, speed=math.inf, x=-math.inf)
    data = json.loads(replace(replay, frames=[frame]).to_json())
    assert [data["frames"][0][name] for name in ("margin", "speed", "x")] == ["NaN", "Infinity", "-Infinity"]


def test_the_page_refers_to_nothing_outside_it(driven, tmp_path):
    """No address, no file beside it, and a policy for the browser that allows no request."""
    replay, _, _ = driven
    page = write_page(replay, tmp_path / "new" / "page.html").read_text(encoding="utf-8")
    assert "://" not in page
    assert not re.search(r"@import|fetch\(|XMLHttpRequest|WebSocket|import\(", page)
    assert re.findall(r'(?:src|href)\s*=\s*"([^"]*)"', page) == ["data:,"]
    assert "default-src 'none'" in page
    assert not re.search(r"@[A-Z]+@", page)


def test_user_text_is_escaped(driven):
    """A setting whose name contains markup neither ends the data nor becomes an element."""
    replay, _, _ = driven
    about = {**replay.about, "setting": "</script><b>@SCRIPT@"}
    page = to_html(replace(replay, about=about))
    assert page.count("<b>") == 0
    assert data_of(page)["about"]["setting"] == about["setting"]


@pytest.mark.parametrize("seconds", [8, pytest.param(40, marks=pytest.mark.slow)])
def test_forty_seconds_at_15_hz_among_fifty_vehicles_are_small(seconds):
    """The page of the standard highway's longest episode stays below 1.5 MB: so many seconds have their share."""
    changes = {"duration": seconds, "simulation_frequency": 15, "vehicles_count": 50}
    replay, _ = collect(asked_for("highway-fast", "faster", 7, **changes))
    assert len(replay.frames) == 15 * seconds + 1
    assert len(replay.overrides) > seconds // 4
    assert len(to_html(replay).encode()) <= 1.5e6 * seconds / 40


def test_a_page_is_html(tmp_path):
    """Another ending is refused before anything is driven."""
    with pytest.raises(ConfigError, match=r"\.html"):
        page_path(tmp_path / "page.pdf")
