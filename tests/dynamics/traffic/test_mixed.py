"""Traffic of several classes that take turns is the same in the compiled highway, or refused."""

from __future__ import annotations

import pytest
from highway_env.vehicle.behavior import AggressiveVehicle, IDMVehicle, LinearVehicle
from simulator_pair import drive

from dynamics.errors import ConfigError
from dynamics.highway_simulator.simulator import Simulator
from dynamics.traffic.mixed import WithTrucks


class LongAndShort(WithTrucks):
    """A mix of the user's own."""

    MIX = (AggressiveVehicle, type("Coach", (AggressiveVehicle,), {"LENGTH": 15.0}), AggressiveVehicle)


class Strange(WithTrucks):
    """One with more than a mix of its own."""

    def act(self, action=None):
        """As ever."""


class TwoWays(WithTrucks):
    """Classes that drive in different ways."""

    MIX = (IDMVehicle, LinearVehicle)


class TwoDraws(WithTrucks):
    """Classes for which other numbers are drawn."""

    MIX = (IDMVehicle, type("Calm", (IDMVehicle,), {"DELTA_RANGE": (4.0, 4.0)}))


class Nested(WithTrucks):
    """A mix of mixes."""

    MIX = (IDMVehicle, WithTrucks)


class Empty(WithTrucks):
    """Nothing."""

    MIX = ()


def test_a_mix_is_the_same():
    drive({"other_vehicles_type": f"{__name__}.LongAndShort", "vehicles_density": 3.0, "vehicles_count": 9})


@pytest.mark.parametrize(
    ("mix", "message"),
    [
        (Strange, "act"),
        (TwoWays, "in different ways"),
        (TwoDraws, "drawn"),
        (Nested, "WithTrucks; name"),
        (Empty, "nothing; name"),
    ],
)
def test_a_mix_that_is_not_known_is_refused(mix, message):
    with pytest.raises(ConfigError, match=message):
        Simulator("highway-v0", 1, {"other_vehicles_type": f"{__name__}.{mix.__name__}"})
