"""The induction: a plan that verified is good a frame later against every vehicle that has broken no rule.

`tests/support/induction.py` judges what is left of the stored plan in each new frame; `induction_report.py` makes a
table.
"""

from functools import partial

import numpy as np
import pytest
from edge_riders import EdgeRider, Skidder, ride
from induction import drive, make
from induction_report import POLICIES, policy_for
from spoiling_followers import spoil

from shield import ShieldedEnv
from shield.certificate.road.clauses.entering import leaves_sight
from shield.decision import Reason, Tier

FREQUENCIES = (5, 8, 10, 15, 30, 60)
SHORT = [
    ("meta", 5, "changing", "native"),
    ("meta", 15, "random", "riders"),
    ("inputs", 5, "throttle", "native"),
    ("inputs", 5, "swerving", "native"),
    ("inputs", 15, "random", "riders"),
    ("inputs", 30, "random", "riders"),
    ("inputs", 30, "swerving", "skidders"),
    ("inputs", 15, "swerving", "skidders"),
    ("meta", 15, "changing", "skidders"),
]


def tally_of(action, hz, policy, traffic, seed, frames):
    kind = {"riders": EdgeRider, "skidders": Skidder}.get(traffic)
    prepare = None if kind is None else partial(ride, seed=seed, kind=kind)
    return drive(make(action, hz), policy_for(action, policy), seed, frames, prepare)


@pytest.mark.parametrize(("action", "hz", "policy", "traffic"), SHORT)
def test_a_verified_plan_verifies_a_frame_later(action, hz, policy, traffic):
    """Sides, owned lanes, followers counted on and the coming frame: the assumptions of the plan still hold."""
    found = tally_of(action, hz, policy, traffic, 0, 110)
    assert found.judged > 60
    assert not found.lost, "\n".join(map(str, found.lost))


@pytest.mark.parametrize(("seed", "hz"), [(9, 5), (14, 15), (2, 15)])
def test_no_follower_takes_a_plan_away_by_taking_less_room(seed, hz):
    """A follower does what leaves the stored plan the smallest margin, among all that the monitor lets pass."""
    env = make("inputs", hz, lanes_count=3, policy_frequency=hz)
    found = drive(env, policy_for("inputs", "wild"), seed, 8 * hz, partial(spoil, seed=seed))
    assert found.judged > hz
    assert not found.lost, "\n".join(map(str, found.lost))


@pytest.mark.slow
@pytest.mark.parametrize("traffic", ["native", "riders", "skidders"])
@pytest.mark.parametrize("hz", FREQUENCIES)
@pytest.mark.parametrize("action", ["meta", "inputs"])
def test_verified_plans_verify_a_frame_later_at_length(action, hz, traffic):
    """10^5 frames over all cells; no exception."""
    frames, seed, lost, want = 0, 0, [], 2800
    while frames < want:
        for policy in POLICIES[action]:
            found = tally_of(action, hz, policy, traffic, 10_000 + seed, 600)
            frames += found.frames
            lost += [(policy, 10_000 + seed, str(each)) for each in found.lost]
        seed += 1
    assert not lost, f"{len(lost)} of {frames}\n" + "\n".join(map(str, lost[:10]))


@pytest.mark.parametrize(("r", "way", "frame"), [
    (0.0, [0.5, 0.2, 0.0, 0.0], 4),  # never in sight
    (0.0, [1.2, 1.5, 0.8, 0.2], 2),  # comes into sight on its way, and leaves it
    (1.5, [1.2, 0.9, 0.5, 0.0], 1),  # in sight now
    (0.0, [1.2, 2.5, 3.5, 4.0], 4),  # stays
])  # fmt: skip
def test_a_lane_whose_view_the_plan_will_leave_counts_as_left(r, way, frame):
    path = np.zeros((4, 4))
    path[:, 1] = way
    assert leaves_sight(r, path, 4.0, 3.0) == frame


def test_a_precaution_that_refuses_every_plan_differs_from_a_lost_guarantee():
    """A vehicle that may cut in refuses plans; the stored plan, which verifies without that clause, is continued.
    About a quarter of the episodes have one; which of them depends on how the processor rounds."""
    env = ShieldedEnv(make("inputs", 5))
    for seed in range(30):
        env.reset(seed=seed)
        rng, over = np.random.default_rng(seed), False
        propose = policy_for("inputs", "swerving")
        while not over:
            _, _, terminated, truncated, _ = env.step(propose(env, rng, None))
            over = terminated or truncated
            for decision in env.frame_decisions:
                kept = decision.tier is Tier.STORED_PLAN
                assert (decision.reason is Reason.PRECAUTION) <= kept
                if decision.reason is Reason.PRECAUTION:
                    assert decision.margin >= -1e-6
                    assert decision.guarantee == "all vehicles seen"
                    env.close()
                    return
    env.close()
    pytest.fail("no precaution refused every plan in these episodes")
