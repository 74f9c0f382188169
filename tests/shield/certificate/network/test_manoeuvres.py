"""What is tried on a road network in place of a decision, and what is left of it a frame later."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from dynamics.road_networks.simulation.ego_alone import Course
from shield.certificate.network.manoeuvres import COMMITTED, Wish, courses_of, frames_of, gone_on_with, stopping
from shield.decision import Tier

BRAKING, HERTZ = 6.0, 15
LANES, SPEEDS = st.integers(0, 5), st.floats(0.0, 30.0)
GENTLE, FRAMES, ASIDE = st.sampled_from([COMMITTED, BRAKING]), st.integers(0, 60), st.sampled_from([-1, 0, 1])
STORED = st.none() | st.builds(Course, LANES, SPEEDS, GENTLE, FRAMES, ASIDE, st.just(BRAKING))
ASKED = st.tuples(
    st.builds(Wish, LANES, SPEEDS), STORED, SPEEDS, st.lists(LANES, min_size=1, max_size=3), st.booleans()
)


def tried(asked):
    return list(courses_of(*asked, HERTZ, BRAKING))


@given(ASKED)
def test_what_is_wished_comes_before_what_is_in_its_place(asked):
    tiers = [tier for _, tier in tried(asked)]
    assert tiers == sorted(tiers, key=[Tier.PASSED, Tier.GOVERNED].index)
    assert all(course[:3] == (*asked[0], COMMITTED) for course, tier in tried(asked) if tier is Tier.PASSED)


@given(ASKED)
def test_nothing_is_faster_than_the_wish_or_than_can_be_had(asked):
    wish, stored, speed, bound, _ = asked
    for course, tier in tried(asked):
        if tier is Tier.GOVERNED and course is not stored:
            assert course.speed <= min(wish.speed, speed + 5.0)
            assert course.lane in {wish.lane, *bound, *([] if stored is None else [stored.lane])}
        assert course.frames < frames_of(HERTZ)


@given(ASKED)
def test_what_was_verified_and_to_stand_still_are_always_tried(asked):
    wish, stored, *_ = asked
    courses = [course for course, _ in tried(asked)]
    assert stored is None or stored in courses
    assert any(course.lane == wish.lane and course.speed == 0.0 for course in courses)


@given(LANES, SPEEDS, st.integers(0, 20), st.sampled_from([-1, 0, 1]), LANES)
def test_a_course_that_is_gone_on_with_ends_in_braking(lane, speed, frames, aside, bound):
    course = Course(lane, speed, COMMITTED, frames, aside, BRAKING)
    for left in reversed(range(frames)):
        course = gone_on_with(course, bound)
        assert (course.lane, course.frames, course.aside) == (bound, left, aside)
    # It turns aside once: in the frame in which it begins to brake.
    course = gone_on_with(course, bound)
    assert (course.frames, course.aside) == (0, 0)
    assert gone_on_with(course, bound) == course


def test_stopping_is_to_brake_at_once():
    course = stopping(3, BRAKING)
    assert (course.lane, course.speed, course.frames, course.hard) == (3, 0.0, 0, BRAKING)
