"""Episodes that went wrong once: found among hundreds of thousands, explained, and driven again here."""

from __future__ import annotations

import numpy as np
import pytest

from shield.batch.highways import ShieldedHighways


def episode(seed, actions):
    """What becomes of an episode of highway-fast: whether it crashed, and how many offences there were."""
    highways, step = ShieldedHighways("highway-fast-v0", 1), 0
    highways.reset([seed])
    while True:
        _, _, terminated, truncated = highways.step(actions[step : step + 1])
        step += 1
        if terminated[0] or truncated[0]:
            return bool(terminated[0]), int(highways.shields.offences[0])


@pytest.mark.parametrize(
    "seed",
    [
        # Two lanes over, one gained by the lane that the ego went to as soon as a slow one had left that: it was
        # counted as the leader there still. The only crash in 276,000 episodes under random actions.
        3216884,
        # A follower that the ego itself held up went for the same lane in the same frame.
        3001550,
        3010435,
    ],
)
def test_nobody_is_overlooked_any_more(seed):
    crashed, offences = episode(seed, np.random.default_rng(seed).integers(5, size=30))
    assert not crashed
    assert offences == 0


@pytest.mark.parametrize("seed", [7255195, 7518249, 7742728])
def test_from_an_offender_it_gets_away(seed):
    """The leader goes for the same lane in the frame after the ego, which it has begun to gain by. It had broken a rule
    by then, and in the worst case nothing helped: the ego did not even brake. Three of 860,000 episodes of always
    FASTER; what is expected of the offender tells that braking does."""
    crashed, offences = episode(seed, np.full(30, 3))
    assert not crashed
    assert offences > 0
