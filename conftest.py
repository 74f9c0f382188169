"""Hypothesis profiles (the default suite repeats itself exactly; `make test-slow` explores new examples), and state of
the process that no test, and no example in a docstring, leaves changed behind.
"""

import logging
import os
from collections.abc import Iterator

import pytest
from highway_env.vehicle.behavior import AggressiveVehicle, DefensiveVehicle, IDMVehicle, LinearVehicle
from hypothesis import settings

settings.register_profile("repeatable", derandomize=True, database=None, deadline=None)
settings.register_profile("explore", derandomize=False, print_blob=True, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))

_CHANGED = ("DISTANCE_WANTED", "COMFORT_ACC_MAX", "COMFORT_ACC_MIN")
_TRAFFIC = {
    kind: {name: vars(kind)[name] for name in _CHANGED if name in vars(kind)}
    for kind in (IDMVehicle, LinearVehicle, AggressiveVehicle, DefensiveVehicle)
}


@pytest.fixture(autouse=True)
def traffic_as_it_comes() -> Iterator[None]:
    """highway-env's intersection sets these on the class of its traffic: every later environment of the process would
    feel it."""
    yield
    for kind, own in _TRAFFIC.items():
        for name in _CHANGED:
            if name in own:
                setattr(kind, name, own[name])
            elif name in vars(kind):
                delattr(kind, name)


@pytest.fixture(autouse=True)
def logging_stays_enabled() -> Iterator[None]:
    """A test that disables logging for the process makes later tests of log lines fail, depending on their order."""
    before = logging.root.manager.disable
    yield
    after = logging.root.manager.disable
    logging.disable(before)
    assert after == before, "the test left logging disabled: restore it"
