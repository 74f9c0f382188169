"""Episodes of the ABZ case study in which the ego was hit, or nearly so: found among 100,000, driven again here."""

import pytest

from evaluation.running.episodes import run_episode
from evaluation.running.records import variant_for
from shield.config import ShieldConfig


@pytest.mark.parametrize(
    "seed",
    [
        # The only crash: it came a little earlier beside the one that slipped in than that one's speed had told.
        63022052,
        # It had not quite settled in its lane yet: so long it was not asked whether it might go on to the next one.
        63010836,
        63055590,
        # The one that held it up had just come before it.
        63050333,
        63076334,
        # It had lost speed by then, or its leader had.
        63063621,
        63087395,
    ],
)
def test_one_that_slips_in_is_foreseen_in_time(seed: int) -> None:
    record = run_episode("abz-idm", "dqn-abz-adversarial", variant_for(ShieldConfig()), seed, simulator="compiled")
    assert not record.crashed
    assert record.violations == 0
    assert record.min_gap > 1.5


@pytest.mark.parametrize("seed", [74011368, 74034550])
def test_who_brakes_before_it_is_braked_for(seed: int) -> None:
    """Two of 100,000, both ran into their leader. It brakes at 6 m/s^2, and then breaks a rule; whoever does is
    expected to keep its speed. By that speed nothing was urgent, so that the ego sped up, or braked ever less, until
    nothing helped. Of what is expected to stay clear as long it is now the worst case that chooses: it brakes."""
    variant = variant_for(ShieldConfig())
    record = run_episode("abz-aggressive", "dqn-abz-adversarial", variant, seed, simulator="compiled")
    assert not record.crashed
    assert record.violations == 1
    assert record.min_gap > 1.6
