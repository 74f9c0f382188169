"""Former names of public functions, members and values work for one release, and warn with the present name."""

import pytest

from dynamics.traffic.assumptions import Assumptions
from shield import ShieldConfig
from shield.decision import Guarantee


@pytest.mark.parametrize("kind", [ShieldConfig, Assumptions])
def test_the_former_name_of_simulated_traffic_gives_the_same_settings(kind):
    with pytest.warns(DeprecationWarning, match=rf"write {kind.__name__}\.simulated_traffic\(\)"):
        assert kind.exact() == kind.simulated_traffic()
    with pytest.warns(DeprecationWarning, match='write "simulated"'):
        assert kind.profile("exact") == kind.profile("simulated")


def test_the_former_name_of_the_strongest_guarantee_is_the_same_member():
    for former in (lambda: Guarantee.FULL, lambda: Guarantee("full")):
        with pytest.warns(DeprecationWarning, match=r"write Guarantee\.ALL_SEEN"):
            assert former() is Guarantee.ALL_SEEN
    with pytest.warns(DeprecationWarning, match='write guarantee == "all vehicles seen"'):
        assert Guarantee.ALL_SEEN == "full"
    assert Guarantee.NONE != "full"
    assert Guarantee.ALL_SEEN == "all vehicles seen"


def test_an_unknown_member_is_an_attribute_error():
    with pytest.raises(AttributeError, match="COMPLETE"):
        Guarantee.COMPLETE  # noqa: B018
