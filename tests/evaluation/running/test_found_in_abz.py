"""Episodes of the ABZ case study in which the ego was hit, or nearly so: found among 100,000, driven again here."""

import pytest

from evaluation.running.episodes import run_episode
from evaluation.running.records import variant_for
from shield.config import ShieldConfig


@pytest.mark.parametrize(
    "seed",
    [
        # The only crash: the ego arrived earlier beside the vehicle that cut in than the speed of that vehicle
        # suggested.
        63022052,
        # The vehicle had not settled in its lane yet, and was not considered for a further lane change.
        63010836,
        63055590,
        # The vehicle that blocked it had just entered the lane.
        63050333,
        63076334,
        # It had lost speed by then, or its leader had.
        63063621,
        63087395,
    ],
)
def test_a_cut_in_is_predicted_in_time(seed: int) -> None:
    record = run_episode("abz-idm", "dqn-abz-adversarial", variant_for(ShieldConfig()), seed, simulator="compiled")
    assert not record.crashed
    assert record.violations == 0
    assert record.min_gap > 1.5


@pytest.mark.parametrize("seed", [74011368, 74034550])
def test_the_ego_brakes_for_a_leader_that_violates_the_braking_rule(seed: int) -> None:
    """Two of 100,000 episodes ran into their leader. It brakes at 6 m/s² and then breaks a rule; a violator is
    predicted to keep its speed. By that prediction nothing was urgent, and the ego sped up, or braked ever less.
    Among inputs that stay clear equally long the worst case now decides: the ego brakes."""
    variant = variant_for(ShieldConfig())
    record = run_episode("abz-aggressive", "dqn-abz-adversarial", variant, seed, simulator="compiled")
    assert not record.crashed
    assert record.violations == 1
    assert record.min_gap > 1.6
