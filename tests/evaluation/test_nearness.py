"""Times to collision are those of the compiled tally; headways are times to the rear of who is ahead."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from evaluation import run_episode
from evaluation.measuring.nearness import headways, times_to_collision
from evaluation.measuring.tally import HORIZON, time_to_collision
from evaluation.running.records import variant_for
from shield import ShieldConfig

ROWS = arrays(
    float,
    (5, 6),
    elements=st.floats(-1.0, 1.0).map(lambda x: round(x, 3)),
)
SCALE = np.array([60.0, 8.0, 0.6, 35.0, 0.0, 0.0])
SIZE = np.array([0.0, 0.0, 0.0, 0.0, 5.0, 2.0])


@given(rows=ROWS)
def test_times_to_collision_are_those_of_the_compiled_tally(rows):
    rows = rows * SCALE + SIZE
    found = times_to_collision(rows[:1], rows[1:])
    for time, other in zip(found, rows[1:], strict=True):
        single = time_to_collision(np.append(rows[0], 0.0), np.append(other, 0.0))
        assert time == pytest.approx(single, abs=1e-9)


def test_a_headway_is_the_time_to_the_rear_of_who_is_ahead():
    ego = np.array([[0.0, 0.0, 0.0, 20.0, 5.0, 2.0]])
    others = np.array(
        [
            [45.0, 0.0, 0.0, 10.0, 5.0, 2.0],  # 40 m of room, 2 s at 20 m/s
            [25.0, 4.0, 0.0, 10.0, 5.0, 2.0],  # beside its way
            [-25.0, 0.0, 0.0, 10.0, 5.0, 2.0],  # behind
            [4.0, 1.0, 0.0, 10.0, 5.0, 2.0],  # overlapping
        ]
    )
    assert headways(ego, others).tolist() == [2.0, np.inf, np.inf, 0.0]
    assert np.isinf(headways(ego * [1, 1, 1, 0, 1, 1], others)).all()


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
