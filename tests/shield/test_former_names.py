"""Former names of public functions, members and values work for one release, and warn with the present name."""

import pickle
from copy import deepcopy
from dataclasses import replace
from functools import partial

import gymnasium as gym
import pytest

from dynamics.traffic.assumptions import Assumptions
from evaluation.experiments import Experiment
from evaluation.running.records import ShieldVariant, make_variants
from shield import Shield, ShieldConfig, ShieldedEnv
from shield.certificate.road.clauses.all_clauses import CUT_IN_BINDS
from shield.certificate.road.verify import CLAUSES
from shield.decision import Decision, Guarantee, Intervention, Reason, Tier
from shield.perception.perception_settings import PerceptionConfig
from shield.perception.unseen import Unseen


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


FORMER = {
    "calm_braking": ("comfortable_braking", 1.0),
    "turning_burst": ("turning_action_in_one_second", 9.0),
    "lean": ("marking_tolerance", 0.3),
    "waver": ("lateral_deviation", 0.4),
    "blind_merge": ("simultaneous_merge", False),
    "slip_in": ("cut_in", False),
    "looks_ahead": ("considers_connected_lanes", True),
}


@pytest.mark.parametrize("former", FORMER)
def test_the_former_name_of_an_assumption_sets_and_reads_the_same_field(former):
    name, value = FORMER[former]
    present = Assumptions(**{name: value})
    assert present != Assumptions()
    with pytest.warns(DeprecationWarning, match=f"'{former}' of Assumptions is deprecated: write '{name}'") as warned:
        assert Assumptions(**{former: value}) == present
    assert warned[0].filename == __file__
    with pytest.warns(DeprecationWarning, match=f"write '{name}'"):
        assert replace(Assumptions(), **{former: value}) == present
    with pytest.warns(DeprecationWarning, match=rf"write Assumptions\.{name}"):
        assert getattr(present, former) == value
    document = ShieldConfig(assumptions=present).to_toml()
    assert former not in document
    with pytest.warns(DeprecationWarning, match=f"'{former}' of the table assumptions"):
        assert ShieldConfig.from_toml(document.replace(name, former)).assumptions == present


PERCEPTION = {
    "calm": ("lane_keeping", (1.0, 1.0)),
    "brisk": ("manoeuvring", (5.0, 5.0)),
    "cruise": ("usual_speed", (20.0, 2.0, 9.0)),
    "patience": ("missed_limit", 2),
}
UNSEEN = {"room": ("clear_behind", 9.0), "surge": ("speed_gain", 2.0), "strays": ("may_change_lanes", True)}
DECISION = {
    "sight": ("scene_guarantee", Guarantee.NONE),
    "weakest": ("weakest_guarantee", Guarantee.NONE),
    "done": ("step_intervention", Intervention.HELD_BACK),
    "held": ("first_overridden", None),
}


@pytest.mark.parametrize(
    ("kind", "former", "name", "value"),
    [
        (kind, former, *names)
        for kind, fields in (
            (ShieldConfig, {"patience": ("failure_limit", 7)}),
            (PerceptionConfig, PERCEPTION),
            (Unseen, UNSEEN),
            (partial(Decision, 1, 1, Reason.NONE, Tier.PASSED, 1.0, 0.0), DECISION),
        )
        for former, names in fields.items()
    ],
)
def test_the_former_name_of_a_field_sets_and_reads_the_same_field(kind, former, name, value):
    present = kind(**{name: value})
    with pytest.warns(DeprecationWarning, match=f"'{former}' of .* is deprecated: write '{name}'"):
        assert kind(**{former: value}) == present
    with pytest.warns(DeprecationWarning, match=rf"\.{former} is deprecated: write .*\.{name}"):
        assert getattr(present, former) is getattr(present, name)


def test_the_former_name_of_the_failure_limit_is_read_from_a_file():
    with pytest.warns(DeprecationWarning, match="'patience' of the table config is deprecated: write 'failure_limit'"):
        assert ShieldConfig.from_toml("patience = 7") == ShieldConfig(failure_limit=7)


def test_the_former_keyword_of_the_settings_on_road_networks():
    with pytest.warns(DeprecationWarning, match="write 'considers_connected_lanes'"):
        assert ShieldConfig.for_roads(looks_ahead=True) == ShieldConfig.for_roads(considers_connected_lanes=True)


def test_the_former_name_of_the_filter_of_both_wrappers():
    env = ShieldedEnv(gym.make("highway-fast-v0"), ShieldConfig(mode="distance"))
    with pytest.warns(DeprecationWarning, match=r"write ShieldedEnv\.filter"):
        assert env.door is env.filter
    shield = Shield(lambda _: 1, gym.make("highway-fast-v0"), ShieldConfig(mode="distance"))
    with pytest.warns(DeprecationWarning, match=r"write Shield\.filters"):
        assert shield.doors == shield.filters


def test_the_former_name_of_the_placement_of_a_shield(tmp_path):
    present = ShieldVariant(placement="env")
    with pytest.warns(DeprecationWarning, match="'door' of ShieldVariant is deprecated: write 'placement'"):
        assert ShieldVariant(door="env") == present
    with pytest.warns(DeprecationWarning, match=r"write ShieldVariant\.placement"):
        assert present.door == "env"
    with pytest.warns(DeprecationWarning, match="'doors' of make_variants is deprecated: write 'placements'"):
        assert make_variants(["full"], doors=["env"], config=ShieldConfig()) == [present]
    with pytest.warns(DeprecationWarning, match="'door' of Experiment"):
        experiment = Experiment(door="policy")
    assert experiment.placement == "policy"
    with pytest.warns(DeprecationWarning, match="'door' of Experiment"):
        assert experiment.with_options(door="env").placement == "env"
    file = tmp_path / "experiment.toml"
    file.write_text('door = "policy"\n', encoding="utf-8")
    with pytest.warns(DeprecationWarning, match="experiment.toml is deprecated: write 'placement'"):
        assert Experiment.from_toml(file) == experiment


def test_the_former_name_of_the_cut_in_clause_is_equal_and_warns():
    name = CLAUSES[CUT_IN_BINDS]
    assert name == "cut-in"
    assert name != "separation"
    assert hash(name) == hash("cut-in")
    with pytest.warns(DeprecationWarning, match="'slip-in' is deprecated: compare with 'cut-in'"):
        assert name == "slip-in"
    kept = pickle.loads(pickle.dumps(deepcopy(name)))
    with pytest.warns(DeprecationWarning, match="compare with 'cut-in'"):
        assert kept == "slip-in"


def test_an_unknown_keyword_is_still_refused():
    with pytest.raises(TypeError, match="calm"):
        Assumptions(calm=1.0)
