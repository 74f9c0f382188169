"""Least clearances are those of polygons, least times to collision those of each pair, and headways times to the
rear of a vehicle ahead."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from evaluation import run_episode
from evaluation.measuring.nearest import least_clearance, least_headway, least_time_to_collision
from evaluation.measuring.rectangles import separation
from evaluation.measuring.tally import HORIZON, time_to_collision
from evaluation.running.records import variant_for
from shield import ShieldConfig

FRAMES = arrays(float, (3, 5, 6), elements=st.floats(-1.0, 1.0).map(lambda x: round(x, 3)))
"""Frames, bodies and columns, body 0 the ego."""
SCALE = np.array([60.0, 8.0, 0.6, 35.0, 0.0, 0.0])
SIZE = np.array([0.0, 0.0, 0.0, 0.0, 5.0, 2.0])


@given(frames=FRAMES)
def test_the_least_of_an_episode_is_the_least_over_pairs_and_frames(frames):
    """Pairs left out as too far away do not have the least value."""
    frames = frames * SCALE + SIZE
    pairs = [(frame[0], other) for frame in frames for other in frame[1:]]
    gaps = [float(separation(ego, other)) for ego, other in pairs]
    assert least_clearance(frames) == pytest.approx(min(gaps), abs=1e-9)
    assert least_time_to_collision(frames) == min(time_to_collision(ego, other) for ego, other in pairs)
    assert least_headway(frames) == min(least_headway(np.stack([ego, other])[None]) for ego, other in pairs)


def test_an_ego_alone_has_infinite_clearance():
    alone = np.array([[[0.0, 0.0, 0.0, 20.0, 5.0, 2.0]]])
    assert (least_clearance(alone), least_headway(alone)) == (np.inf, np.inf)
    assert least_time_to_collision(alone) == HORIZON


@pytest.mark.parametrize(
    ("other", "headway"),
    [
        ([45.0, 0.0, 0.0, 10.0, 5.0, 2.0], 2.0),  # 40 m of room, 2 s at 20 m/s
        ([25.0, 4.0, 0.0, 10.0, 5.0, 2.0], np.inf),  # beside its way
        ([-25.0, 0.0, 0.0, 10.0, 5.0, 2.0], np.inf),  # behind
        ([4.0, 1.0, 0.0, 10.0, 5.0, 2.0], 0.0),  # overlapping
        ([25.0, 0.0, 0.0, 0.0, 0.0, 0.0], np.inf),  # not there: it has no size
    ],
)
def test_a_headway_is_the_time_to_the_rear_of_a_vehicle_ahead(other, headway):
    ego = [0.0, 0.0, 0.0, 20.0, 5.0, 2.0]
    assert least_headway(np.array([[ego, other]])) == headway
    ego[3] = 0.0
    assert least_headway(np.array([[ego, other]])) == np.inf


def test_an_episode_has_both_in_its_row():
    config = ShieldConfig()
    one = run_episode("highway-fast", "faster", variant_for(config), seed=100_000)
    assert 0 < one.min_headway < 10
    assert 0 < one.min_time_to_collision <= HORIZON
    bare = run_episode("highway-fast", "faster", seed=100_000)
    assert bare.crashed
    assert bare.min_time_to_collision == 0
    assert np.isnan(run_episode("roundabout", "slower", seed=100_000).min_headway)
    assert {"min_headway", "min_time_to_collision"} <= one.row().keys()
