"""Vehicles that deviate on road networks as far as the monitor permits: none comes into the buffer unnamed."""

import pytest
from road_riders import ride_roads
from slowly import later


@pytest.mark.parametrize(
    ("env_id", "seed", "rate"),
    [
        ("roundabout-v0", 3030, 5),
        ("roundabout-v0", 3036, 5),
        ("roundabout-v0", 3042, 5),
        ("roundabout-v0", 3035, 30),
        *later(
            *(("roundabout-v0", seed, 10) for seed in range(3100, 3106)),
            *(("u-turn-v0", seed, 15) for seed in range(3100, 3106)),
            *(("merge-v0", seed, 15) for seed in range(3100, 3103)),
        ),
    ],
)
def test_a_vehicle_that_comes_into_the_buffer_is_a_violator(env_id, seed, rate):
    """Without a violation, no plan is lost and no prediction mismatch is reported. The first four cases were once
    failures."""
    tally = ride_roads(env_id, seed, rate)
    assert tally.frames > 0
    assert (tally.clean, tally.crashed, tally.lost, tally.unforeseen) == (0, False, 0, 0)
