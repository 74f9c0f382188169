"""Riders that deviate on networks of roads as far as the monitor lets them: nobody gets into the buffer unnamed."""

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
def test_whoever_gets_into_the_buffer_is_named(env_id, seed, rate):
    """Nor is a plan lost, or anybody unforeseen, while nobody has broken a rule; the first four were found so."""
    tally = ride_roads(env_id, seed, rate)
    assert tally.frames > 0
    assert (tally.clean, tally.crashed, tally.lost, tally.unforeseen) == (0, False, 0, 0)
