"""With the buffer lost, the worst-case filter of road networks does not continue the proposal."""

import pytest
from placed import Body, placed

ENTRY, NEXT = ("ser", "ses", 0), ("ses", "se", 0)


@pytest.mark.parametrize(("ahead", "second", "first"), [(5.0, 122.0, 112.0), (8.0, 118.0, 100.0)])
def test_the_ego_does_not_drive_into_a_queue_that_rolls_back(ahead, second, first):
    """A vehicle of highway-env that wants to stand rolls back slowly into the buffer; the ego stands then."""
    queue = [Body(NEXT, ahead, 0.0, "nxs"), Body(ENTRY, second, 0.0, "nxs"), Body(ENTRY, first, 0.0, "nxs")]
    env, lost = placed("roundabout-v1", "worst case", Body(ENTRY, 80.0, 8.0, "nxs"), queue), 0
    while lost < 4:
        *_, info = env.step(3)
        lost += info["shield"]["tier"] == "largest_margin"
        assert not env.unwrapped.vehicle.crashed
    assert abs(env.unwrapped.vehicle.speed) < 0.1
