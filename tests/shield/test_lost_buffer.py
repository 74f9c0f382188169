"""Where the buffer is gone, the worst-case door of road networks does not go faster for the sake of the proposal."""

import numpy as np
import pytest
from placed import Body, placed

DECISION = 1.0
"""Duration of a decision [s]."""
ENTRY, NEXT = ("ser", "ses", 0), ("ses", "se", 0)


@pytest.mark.parametrize(("ahead", "second", "first"), [(5.0, 122.0, 112.0), (8.0, 118.0, 103.0), (8.0, 118.0, 100.0)])
def test_nobody_drives_into_a_queue_that_rolls_back(ahead, second, first):
    """A vehicle of highway-env that wants to stand rolls back, however slowly, into the buffer and beyond."""
    queue = [Body(NEXT, ahead, 0.0, "nxs"), Body(ENTRY, second, 0.0, "nxs"), Body(ENTRY, first, 0.0, "nxs")]
    env, lost, over = placed("roundabout-v1", "worst case", Body(ENTRY, 80.0, 8.0, "nxs"), queue), 0, False
    while not over and lost < 8:
        vehicle = env.unwrapped.vehicle
        speed, place = vehicle.speed, vehicle.position.copy()
        *_, terminated, truncated, info = env.step(3)
        over = terminated or truncated
        if info["shield"]["tier"] == "largest_margin":
            lost += 1
            assert np.linalg.norm(vehicle.position - place) <= max(speed, 0.0) * DECISION + 1e-6
    assert lost > 0
