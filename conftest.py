"""Hypothesis profiles (the default suite repeats itself exactly; `make test-slow` explores new examples), and traffic
that no test, and no example in a docstring, leaves changed behind.
"""

import os
from collections.abc import Iterator

import pytest
from highway_env.vehicle.behavior import IDMVehicle
from hypothesis import settings

settings.register_profile("repeatable", derandomize=True, database=None, deadline=None)
settings.register_profile("explore", derandomize=False, print_blob=True, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))

_TRAFFIC = {name: getattr(IDMVehicle, name) for name in ("DISTANCE_WANTED", "COMFORT_ACC_MAX", "COMFORT_ACC_MIN")}


@pytest.fixture(autouse=True)
def traffic_as_it_comes() -> Iterator[None]:
    """highway-env's intersection sets these on the class: every later environment of the process would feel it."""
    yield
    for name, value in _TRAFFIC.items():
        setattr(IDMVehicle, name, value)
