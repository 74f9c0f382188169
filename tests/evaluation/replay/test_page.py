"""The replay page in a browser: mouse and keys show the values of the records, bit for bit."""

from __future__ import annotations

import json
import time

import numpy as np
import pytest
from replayed import asked_for, records_of

pytest.importorskip("selenium", reason="selenium is not installed: the replay page is not driven")

from chromium import open_browser, resized
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import Select, WebDriverWait

from evaluation.replay.collect import collect
from evaluation.replay.html import write_page

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """The page of an episode of always FASTER, its data, and the records of the episode, driven apart."""
    asked = asked_for("highway-fast", "faster", 5)
    replay, _ = collect(asked)
    return write_page(replay, tmp_path_factory.mktemp("page") / "page.html"), replay, records_of(asked)


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """One browser for all tests."""
    found = open_browser(tmp_path_factory.mktemp("profile"))
    yield found
    found.quit()


@pytest.fixture
def page(browser, driven):
    """The page, just opened from its file, on a desktop."""
    resized(browser, 1280, 900)
    browser.get(driven[0].as_uri())
    return browser


def shown(page):
    """Number of the frame that is shown."""
    return int(page.execute_script("return document.documentElement.dataset.frame"))


def recorded(page, name):
    """The value beside the text of an element, as a float."""
    return float(page.find_element(By.ID, name).get_attribute("data-value").replace("Infinity", "inf"))


def press(page, *keys):
    """Press keys, wherever the focus is."""
    ActionChains(page).send_keys(*keys).perform()


def same_bits(a, b):
    """Whether two numbers are the same float; any NaN is NaN."""
    return np.float64(a).tobytes() == np.float64(b).tobytes() or (np.isnan(a) and np.isnan(b))


def test_every_frame_shows_the_bits_of_the_records(page, driven):
    """The scrubber is moved through the whole episode: time, speed and margin are the records' floats."""
    _, replay, records = driven
    decisions = [each for frames in records.frames for each in frames]
    assert len(decisions) == len(replay.frames) - 1
    scrub = (
        "const s = document.getElementById('scrubber'); s.value = arguments[0];"
        "s.dispatchEvent(new Event('input'));"
        "return ['speed', 'margin', 'time', 'tier', 'reason'].map((n) => document.getElementById(n).dataset.value)"
    )
    for k, decision in enumerate(decisions):
        speed, margin, at, tier, reason = page.execute_script(scrub, k)
        assert same_bits(float(speed), records.world[k, 0, 3])
        assert same_bits(float(margin), decision.margin)
        assert same_bits(float(at), k * replay.dt)
        assert (tier, reason) == (decision.tier.value, decision.reason.value)
    assert shown(page) == len(decisions) - 1


def test_next_override_steps_through_the_overrides_with_their_explanations(page, driven):
    """The button and the key `o` stop at each override in turn, with the sentence of `Decision.explain`."""
    _, replay, records = driven
    button = page.find_element(By.ID, "next")
    for number, override in enumerate(replay.overrides):
        if number % 2:
            press(page, "o")
        else:
            button.click()
        record = records.steps[override.step]
        assert shown(page) == override.frame
        assert page.find_element(By.ID, "explanation").text == record.explain().text
        assert page.find_element(By.ID, "proposed").text == "FASTER"
        current = page.find_elements(By.CSS_SELECTOR, "#overrides [aria-current=true]")
        assert [each.get_attribute("data-step") for each in current] == [str(override.step)]
        assert page.find_element(By.ID, "status").text in ("HELD BACK", "OVERRIDE", "FALLBACK")
    assert not button.is_enabled()
    press(page, "p")
    assert shown(page) == replay.overrides[-2].frame


def test_the_outcome_of_a_refused_proposal_is_shown_and_played(page, driven):
    """The simulated outcome of the proposal is shown beside its override; playing it moves no frame."""
    _, replay, _ = driven
    override = next(each for each in replay.overrides if each.what_if.crashed)
    while shown(page) != override.frame:
        press(page, "o")
    text = page.find_element(By.ID, "what-if")
    assert override.what_if.text in text.text
    assert same_bits(recorded(page, "what-if"), override.what_if.gap)
    Select(page.find_element(By.ID, "rate")).select_by_value("4")
    before = page.execute_script("return document.getElementById('scene').toDataURL()")
    page.find_element(By.ID, "follow").click()
    last = len(override.what_if.path) // 3 - 1
    WebDriverWait(page, 10).until(lambda page: page.execute_script("return state.ghost") == last)
    assert shown(page) == replay.steps[override.step].first
    assert page.execute_script("return document.getElementById('scene').toDataURL()") != before
    press(page, Keys.END)
    assert not text.is_displayed()


def test_keys_move_through_the_episode(page, driven):
    """Arrows go a frame, with shift a second; Home and End to its ends, and no further."""
    _, replay, _ = driven
    last, second = len(replay.frames) - 1, round(1 / replay.dt)
    press(page, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_LEFT)
    assert shown(page) == 2
    ActionChains(page).key_down(Keys.SHIFT).send_keys(Keys.ARROW_RIGHT).key_up(Keys.SHIFT).perform()
    assert shown(page) == 2 + second
    press(page, Keys.END, Keys.ARROW_RIGHT)
    assert shown(page) == last
    press(page, Keys.HOME, Keys.ARROW_LEFT)
    assert shown(page) == 0


def test_the_page_plays_and_pauses_at_the_chosen_speed(page, driven):
    """Space plays and pauses; four times as fast is about four times as far."""
    _, replay, _ = driven
    press(page, " ")
    WebDriverWait(page, 10).until(lambda page: shown(page) > 2)
    press(page, " ")
    stopped = shown(page)
    time.sleep(0.5)
    assert shown(page) == stopped
    press(page, Keys.HOME)
    Select(page.find_element(By.ID, "rate")).select_by_value("4")
    page.find_element(By.ID, "play").click()
    begun = time.monotonic()
    WebDriverWait(page, 20).until(lambda page: shown(page) >= 40)
    assert 40 * replay.dt / 4 * 0.7 < time.monotonic() - begun < 40 * replay.dt / 4 + 5
    assert page.find_element(By.ID, "play").text == "Pause"


def test_the_timeline_and_the_list_are_clicked(page, driven):
    """A click into the timeline goes to that time; one on an override of the list to its frame."""
    _, replay, _ = driven
    chart = page.find_element(By.ID, "timeline")
    ActionChains(page).move_to_element(chart).click().perform()
    assert abs(shown(page) - len(replay.frames) / 2) < 0.05 * len(replay.frames)
    page.find_elements(By.CSS_SELECTOR, "#overrides button")[3].click()
    assert shown(page) == replay.overrides[3].frame


def test_the_page_opens_within_a_second_without_a_request(browser, driven):
    """From its file to the first picture; only the file is loaded, and the browser reports no error."""
    resized(browser, 1280, 900)
    browser.get("about:blank")
    browser.get_log("performance")
    browser.get(driven[0].as_uri())
    assert browser.execute_script("return document.documentElement.dataset.ready") == "true"
    took = browser.execute_script("return performance.getEntriesByType('navigation')[0].loadEventEnd")
    assert 0 < took < 1000
    events = [json.loads(each["message"])["message"] for each in browser.get_log("performance")]
    sent = [each["params"]["request"]["url"] for each in events if each["method"] == "Network.requestWillBeSent"]
    assert {url for url in sent if not url.startswith("data:")} <= {driven[0].as_uri()}
    assert [each for each in browser.get_log("browser") if each["level"] in ("SEVERE", "WARNING")] == []


@pytest.mark.parametrize("width", [360, 390, 768, 1280])
def test_nothing_is_cut_off_at_any_width(browser, driven, width):
    """Phones and desktops: the page is no wider than the window, and the buttons are large enough for a finger."""
    resized(browser, width, 800)
    browser.get(driven[0].as_uri())
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    for name in ("play", "next", "previous", "zoom-in"):
        assert browser.find_element(By.ID, name).size["height"] >= 32


def test_light_and_dark(browser, driven):
    """The colours of the page and of its canvas follow the scheme that the reader prefers."""
    found = []
    for dark in (False, True):
        resized(browser, 1280, 900, dark)
        browser.get(driven[0].as_uri())
        corner = (
            "return [...document.getElementById('scene').getContext('2d').getImageData(5, 250, 1, 1).data].slice(0, 3)"
        )
        paper = "return getComputedStyle(document.body).backgroundColor.match(/\\d+/g).slice(0, 3).map(Number)"
        found.append((sum(browser.execute_script(corner)), sum(browser.execute_script(paper))))
    (light_grass, light_paper), (dark_grass, dark_paper) = found
    assert light_grass > 500 > 300 > dark_grass
    assert light_paper > 500 > 300 > dark_paper
