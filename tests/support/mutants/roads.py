"""Mutants of the certificate on road networks: its paths, their separation and the choice among them."""

from __future__ import annotations

from mutants.kinds import off

__all__ = ["ROADS"]

_CLAUSES = "tests/shield/certificate/network/test_clearance.py"
_FOUND = "tests/shield/certificate/network/test_found.py"
_AROUND = "tests/shield/wrappers/test_around_and_inside.py"
_BANDS = "tests/shield/certificate/network/test_footprint_bands.py"
_JOINTS = "tests/shield/certificate/network/test_followers_at_joints.py"
_LOOPHOLES = "tests/shield/certificate/network/test_loopholes.py"
_TRANSITIONS = "tests/shield/certificate/network/test_transitions.py"
_OWN = "tests/shield/certificate/network/test_own_road_networks.py"
_JUDGING = "shield.certificate.network.clearance"
_FOLLOWING = "shield.certificate.network.followers"

ROADS = (
    off(
        "rounding of arrival frames from the previous lane off",
        _FOLLOWING,
        "separation_behind",
        "_ = max(_, min(_(_, _[_], _[_], _, _), _))",
        "pass",
        _CLAUSES,
    ),
    off(
        "later arrivals at the ego's stop off",
        _JUDGING,
        "_conflict",
        "_ = _",
        "pass",
        _CLAUSES,
    ),
    off(
        "driving on past a dead end off",
        "shield.certificate.network.projection",
        "project_path",
        "_(_, _)",
        "False",
        _OWN,
        which=3,
    ),
    off(
        "distinction of ahead and behind on a ring off",
        _FOLLOWING,
        "has_obligation",
        "_ + _ <= _[_, 0] < _",
        "{3}[{4}, 0] < {5}",
        _CLAUSES,
    ),
    off(
        "bound of slow vehicles on arrival off",
        _FOLLOWING,
        "_arrival",
        "_ = max(_, _[3] + _)",
        "pass",
        _CLAUSES,
    ),
    off(
        "check that obliged vehicles can brake off",
        "shield.certificate.network.choice",
        "choose",
        "if _:",
        "if False:",
        _CLAUSES,
    ),
    off(
        "immediate braking of obliged followers off",
        _JUDGING,
        "_separation_if_it_follows",
        "_(0, 0, True, _[_])",
        "{1}(0, road.response.reaction, True, {2}[{3}])",
        _CLAUSES,
    ),
    off(
        "later rolling back at the ego's stop off",
        _JUDGING,
        "_conflict",
        "_ = min(_, _[_, _[1] - 1] - _[_])",
        "pass",
        _CLAUSES,
    ),
    off(
        "later frame of a vehicle that rolls back off",
        _JUDGING,
        "_conflict",
        "min(_[_, max(_ - 1, 0)], _[_, _ + 1])",
        "{1}[{2}, max({3} - 1, 0)]",
        _TRANSITIONS,
    ),
    off(
        "front gap of a follower that brakes off",
        _JUDGING,
        "_separation_if_it_follows",
        "_(_, _, _, _[_])",
        "{1}({2}, {3}, {4}, {5}[FRONT])",
        _TRANSITIONS,
    ),
    off(
        "lane centre condition for blocking a lane off",
        _JUDGING,
        "_shuts",
        "_ and _[_, 1] <= _ and (_[_, _, 2] < 0.0 < _[_, _, 3])",
        "{1} and {2}[{3}, 1] <= {4}",
        _TRANSITIONS,
    ),
    off(
        "followers wait until they are in the ego's lane off",
        _FOLLOWING,
        "separation_behind",
        "_ >= _ and _",
        "{1} >= {2}",
        _CLAUSES,
    ),
    off(
        "buffer on road networks off",
        "shield.certificate.network.projection",
        "_box",
        "_(0.0, _, _, _, _)",
        "{1}(0.0, {2}, {3}, body.length, body.width)",
        _CLAUSES,
    ),
    off(
        "standing bodies off",
        _JUDGING,
        "_separation_from_standing",
        "if _ < _:",
        "pass",
        _CLAUSES,
    ),
    off(
        "right of way off",
        _JUDGING,
        "_separation_if_it_waits",
        "_ > 0 and _[_[_ - 1]] > _[_]",
        "{1} > 0",
        _CLAUSES,
    ),
    off(
        "reaction time of vehicles that wait off",
        _JUDGING,
        "_separation_if_it_waits",
        "(_, _[_, _])",
        "(0, {2}[{3}, {4}])",
        _CLAUSES,
    ),
    off(
        "preference for the slower unverified candidate off",
        "shield.certificate.network.choice",
        "_better",
        "_ < _",
        "False",
        _CLAUSES,
    ),
    off(
        "refusal of paths that leave the road off",
        "shield.certificate.network.choice",
        "_weigh",
        "_ < 0",
        "False",
        _CLAUSES,
    ),
    off(
        "blocking limited to a rear within the lane off",
        _JUDGING,
        "_shuts",
        "_ and _[_, 1] <= _ and (_[_, _, 2] < 0.0 < _[_, _, 3])",
        "{1} and {5}[{3}, {7}, 2] < 0.0 < {5}[{3}, {7}, 3]",
        _FOUND,
    ),
    off(
        "candidates in other lanes off",
        "shield.filters.network",
        "NetworkFilter._choose",
        "_()",
        "[self._bound]",
        _FOUND,
    ),
    off(
        "blocking of a lane that several strips lead to off",
        _JUDGING,
        "_is_blocked",
        "_ != _",
        "True",
        _LOOPHOLES,
    ),
    off(
        "unrolled position past half a circle off",
        "shield.certificate.network.projection",
        "project_path",
        "_(_, _, _)",
        "{4}",
        _BANDS,
    ),
    off(
        "projection of a body far from its lane off",
        "shield.certificate.network.projection",
        "project_path",
        "max(_[_], _)",
        "{3}",
        _BANDS,
    ),
    off(
        "rear of an inclined body without its buffer off",
        _FOLLOWING,
        "has_obligation",
        "_[_, 0]",
        "rollout.boxes[{2}, 0, 0] + road.body.along - road.body.length",
        _JOINTS,
        which=2,
    ),
    off(
        "check of actions that a wrapper has changed off",
        "shield.environments",
        "check_step",
        "not _(_, _)",
        "False",
        _AROUND,
    ),
    off(
        "longer horizon for weak braking off",
        "shield.certificate.network.manoeuvres",
        "frames_of",
        "max(_, _ / _)",
        "{1}",
        "tests/shield/certificate/network/test_own_road_networks.py",
    ),
)
