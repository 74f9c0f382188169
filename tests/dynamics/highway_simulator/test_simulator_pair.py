"""The comparison of the compiled highway with highway-env's detects differences."""

import numpy as np
import pytest
from highway_env.vehicle.behavior import IDMVehicle
from simulator_pair import SMALL, Pair

from dynamics.highway_simulator.layout import SPEED, X


def test_a_difference_of_one_bit_of_a_position_is_detected_and_named():
    pair = Pair("highway-fast-v0", SMALL)
    pair.reset([4])
    worlds = pair.simulator.worlds
    if not pair.simulator.exact:
        pytest.skip("states are compared to 1e-9 here")
    kept = worlds.f[0, X, 3]
    worlds.f[0, X, 3] = np.nextafter(kept, np.inf)
    with pytest.raises(AssertionError, match=r"seed 4, copy 0, decision 0, vehicle 3, x: .*0x1.*0x1"):
        pair.compare_states()
    worlds.f[0, X, 3] = kept
    pair.compare_states()
    worlds.rows[0, 5] += np.uint64(1)
    with pytest.raises(AssertionError, match="generator"):
        pair.compare_states()


def test_a_changed_constant_of_the_world_is_detected(monkeypatch):
    pair = Pair("highway-fast-v0", SMALL)
    pair.reset([0])
    pair.step([1])
    monkeypatch.setattr(IDMVehicle, "TIME_WANTED", 1.5 + 1e-6)
    with pytest.raises(AssertionError, match=r"decision \d+, vehicle \d+, "):
        pair.drive(10, np.random.default_rng(0))


@pytest.mark.parametrize("name", ["reward", "terminated", "truncated", "observations"])
def test_the_results_of_a_step_are_compared(name, monkeypatch):
    pair = Pair("highway-fast-v0", SMALL)
    pair.reset([0])
    right = pair.simulator.step

    def wrong(actions, again=False):
        right(actions, again)
        seen = pair.simulator.seen
        changed = {"reward": seen.reward + 1e-6, "observations": seen.observations + np.float32(1e-6)}
        changed |= {"terminated": ~seen.terminated, "truncated": ~seen.truncated}
        shown = {key: changed[key] if key == name else getattr(seen, key) for key in changed}
        return shown["observations"], shown["reward"], shown["terminated"], shown["truncated"]

    monkeypatch.setattr(pair.simulator, "step", wrong)
    with pytest.raises(AssertionError, match=name.removesuffix("s")):
        pair.step([1])


def test_a_simulator_that_stands_still_is_detected():
    pair = Pair("highway-fast-v0", SMALL)
    pair.reset([0])
    pair.simulator.worlds.f[0, SPEED, 0] = 0.0
    with pytest.raises(AssertionError, match="vehicle 0, x"):
        pair.step([1])
