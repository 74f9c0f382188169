"""Candidate manoeuvres on a road network, and what remains of one a frame later."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from dynamics.road_networks.simulation.ego_manoeuvres import EgoManoeuvre
from shield.certificate.network.manoeuvres import (
    COMMITTED,
    TargetCommand,
    candidates_of,
    frames_of,
    remainder_after_frame,
    stopping,
)
from shield.decision import Tier

BRAKING, HERTZ = 6.0, 15
LANES, SPEEDS = st.integers(0, 5), st.floats(0.0, 30.0)
GENTLE, FRAMES, ASIDE = st.sampled_from([COMMITTED, BRAKING]), st.integers(0, 60), st.sampled_from([-1, 0, 1])
STORED = st.none() | st.builds(EgoManoeuvre, LANES, SPEEDS, GENTLE, FRAMES, ASIDE, st.just(BRAKING))
ASKED = st.tuples(
    st.builds(TargetCommand, LANES, SPEEDS), STORED, SPEEDS, st.lists(LANES, min_size=1, max_size=3), st.booleans()
)


def tried(asked):
    return list(candidates_of(*asked, HERTZ, BRAKING))


@given(ASKED)
def test_the_proposal_is_tried_before_its_replacements(asked):
    tiers = [tier for _, tier in tried(asked)]
    assert tiers == sorted(tiers, key=[Tier.PASSED, Tier.GOVERNED].index)
    assert all(manoeuvre[:3] == (*asked[0], COMMITTED) for manoeuvre, tier in tried(asked) if tier is Tier.PASSED)


@given(ASKED)
def test_no_candidate_is_faster_than_the_proposal_or_the_vehicle_can_be(asked):
    wish, stored, speed, bound, _ = asked
    for manoeuvre, tier in tried(asked):
        if tier is Tier.GOVERNED and manoeuvre is not stored:
            assert manoeuvre.speed <= min(wish.speed, speed + 5.0)
            assert manoeuvre.lane in {wish.lane, *bound, *([] if stored is None else [stored.lane])}
        assert manoeuvre.frames < frames_of(HERTZ, 9.8)


@given(ASKED)
def test_the_stored_plan_and_a_standstill_are_always_candidates(asked):
    wish, stored, *_ = asked
    courses = [manoeuvre for manoeuvre, _ in tried(asked)]
    assert stored is None or stored in courses
    assert any(manoeuvre.lane == wish.lane and manoeuvre.speed == 0.0 for manoeuvre in courses)


@given(LANES, SPEEDS, st.integers(0, 20), st.sampled_from([-1, 0, 1]), LANES)
def test_a_continued_manoeuvre_ends_in_braking(lane, speed, frames, aside, bound):
    manoeuvre = EgoManoeuvre(lane, speed, COMMITTED, frames, aside, BRAKING)
    for left in reversed(range(frames)):
        manoeuvre = remainder_after_frame(manoeuvre, bound)
        assert (manoeuvre.lane, manoeuvre.frames, manoeuvre.aside) == (bound, left, aside)
    # It turns aside once, in its first frame of braking.
    manoeuvre = remainder_after_frame(manoeuvre, bound)
    assert (manoeuvre.frames, manoeuvre.aside) == (0, 0)
    assert remainder_after_frame(manoeuvre, bound) == manoeuvre


def test_stopping_is_to_brake_at_once():
    manoeuvre = stopping(3, BRAKING)
    assert (manoeuvre.lane, manoeuvre.speed, manoeuvre.frames, manoeuvre.hard) == (3, 0.0, 0, BRAKING)
