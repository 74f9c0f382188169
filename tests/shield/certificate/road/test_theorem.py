"""Attacks on the theorem: other vehicles never come nearer than the buffer without a violation that the monitor
reports.

The attacks drive real highway-env environments (`attacks`, `driven_traffic`) and share no model with the shield. A
failure names a `Run`; `attacks.play(run)` repeats it. `python tests/support/attack_report.py` makes a table.
"""

from itertools import product

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import pytest
from attacks import ATTACKS, Run, play
from hypothesis import HealthCheck, Phase, assume, given, settings, target
from hypothesis import strategies as st
from worst_case import worst_case

from evaluation.policies import load_reference
from shield import ShieldedEnv

CASES = [(n, action, hz) for n, a in ATTACKS.items() for action, hz in product(a.actions, a.rates)]
QUICK = [c for c in CASES if c[2] in (5, 15)]
SEARCHED = [(n, action) for n, a in ATTACKS.items() for action in a.actions]
RUNS = 3
SLOW_RUNS = -(-10_000 // len(CASES))

# Seeds of runs that breached an earlier revision. They stand for other runs once an attack's numbers change.
ONCE_FOUND = {
    ("cut_in_and_brake", "meta", 5): (0, 31),
    ("cut_in_and_brake", "meta", 15): (38,),
    ("cut_in_and_brake", "continuous", 5): (0, 6),
    ("cut_in_and_brake", "continuous", 15): (2, 6),
    ("brake_and_push", "meta", 5): (6, 20),
    ("brake_and_push", "meta", 15): (2, 4),
    ("brake_and_push", "continuous", 5): (2, 17),
    ("brake_and_push", "continuous", 15): (1, 7),
    ("box_and_cut_in", "meta", 5): (7, 9),
    ("box_and_cut_in", "meta", 15): (1, 4),
    ("box_and_cut_in", "continuous", 5): (0, 7),
    ("box_and_cut_in", "continuous", 15): (5, 13),
    ("blind_merge", "meta", 5): (14, 18),
    ("blind_merge", "meta", 15): (5, 50),
    ("blind_merge", "continuous", 5): (5, 22),
    ("blind_merge", "continuous", 15): (9, 32),
    ("tailgater", "meta", 5): (15, 17),
    ("tailgater", "meta", 15): (2, 9),
    ("tailgater", "continuous", 5): (7, 15),
    ("tailgater", "continuous", 15): (35,),
    ("tailgater", "continuous", 30): (20_026,),
    ("random_inputs", "meta", 5): (2, 3),
    ("random_inputs", "meta", 15): (1, 5),
    ("random_inputs", "continuous", 5): (1, 3),
    ("random_inputs", "continuous", 15): (7, 17),
    ("mixed_traffic", "meta", 5): (15, 16),
    ("mixed_traffic", "meta", 15): (10, 30),
    ("mixed_traffic", "continuous", 5): (7, 9),
    ("mixed_traffic", "continuous", 15): (19, 30),
    ("coordinated", "meta", 5): (5, 18),
    ("coordinated", "meta", 15): (0, 5),
    ("coordinated", "continuous", 5): (0, 2),
    ("coordinated", "continuous", 15): (16, 25),
    ("abort_after_midline", "meta", 5): (10, 15),
    ("abort_after_midline", "meta", 15): (0, 5),
    ("abort_after_midline", "continuous", 5): (15, 16),
    ("abort_after_midline", "continuous", 15): (14, 20),
    ("idm_reverses", "meta", 5): (0, 1),
    ("idm_reverses", "meta", 15): (5, 8),
    ("idm_reverses", "continuous", 5): (9, 11),
    ("idm_reverses", "continuous", 15): (2, 7),
    ("beside_the_rear", "meta", 15): (49, 58),
    ("beside_the_rear", "continuous", 5): (18,),
    ("beside_the_rear", "continuous", 15): (43,),
    ("slip", "meta", 5): (6, 27),
    ("slip", "meta", 15): (8, 20),
    ("slip", "continuous", 5): (19, 20),
    ("slip", "continuous", 15): (2, 10),
    ("waver_beside", "meta", 5): (38, 50),
    ("waver_beside", "continuous", 5): (4, 7),
    ("waver_beside", "continuous", 15): (5, 10),
    ("coming_frame", "meta", 5): (7, 16),
    ("coming_frame", "continuous", 5): (9, 14),
    ("trucks", "meta", 5): (3, 9),
    ("trucks", "meta", 15): (12, 17),
    ("trucks", "continuous", 5): (7, 35),
    ("trucks", "continuous", 15): (3, 26),
    ("standing_and_reversing", "meta", 5): (2, 7),
    ("standing_and_reversing", "meta", 15): (1, 3),
    ("standing_and_reversing", "continuous", 5): (6, 11),
    ("standing_and_reversing", "continuous", 15): (6, 7),
}


def clean_breaches(runs: list[Run]) -> list[str]:
    """A line for each run that came nearer than the buffer without a reported violation."""
    found = [(run, play(run)) for run in runs]
    return [run.describe(out) for run, out in found if out.clean_breach]


@pytest.mark.parametrize(("name", "action", "hz"), [*QUICK, *(c for c in ONCE_FOUND if c not in QUICK)])
def test_no_attack_enters_the_buffer_without_a_reported_violation(name, action, hz):
    seeds = sorted({*range(RUNS), *ONCE_FOUND.get((name, action, hz), ())})
    found = clean_breaches([Run.sample(name, action, hz, seed) for seed in seeds])
    assert not found, "\n".join(found)


@st.composite
def runs(draw):
    """Any attack in any setting with any of its numbers."""
    name, action, hz = draw(st.sampled_from(QUICK))
    size = ATTACKS[name].size
    unit = draw(st.lists(st.floats(0, 1, allow_nan=False), min_size=size, max_size=size))
    return Run(name, action, hz, draw(st.integers(0, 99)), tuple(unit))


def no_numbers_breach_unflagged(run):
    out = play(run)
    assume(out.started)
    if not out.flagged:
        target(-min(out.clearance, 20.0), label="nearness to the buffer, unflagged")
    assert not out.clean_breach, run.describe(out)


# A shrunk attack says no more than the first that is found, and takes minutes.
PHASES = (Phase.explicit, Phase.reuse, Phase.generate, Phase.target)
CHECKS = (HealthCheck.filter_too_much, HealthCheck.too_slow, HealthCheck.data_too_large)


@settings(max_examples=100, phases=PHASES, suppress_health_check=CHECKS)
@given(run=runs())
def test_no_drawn_inputs_enter_the_buffer_without_a_reported_violation(run):
    no_numbers_breach_unflagged(run)


@pytest.mark.slow
@settings(max_examples=1500, phases=PHASES, suppress_health_check=CHECKS)
@given(run=runs())
def test_no_drawn_inputs_enter_the_buffer_without_a_reported_violation_at_length(run):
    no_numbers_breach_unflagged(run)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "action", "hz"), CASES)
def test_ten_thousand_attacks(name, action, hz):
    found = clean_breaches([Run.sample(name, action, hz, 10_000 + i) for i in range(SLOW_RUNS)])
    assert not found, f"{len(found)} of {SLOW_RUNS}\n" + "\n".join(found[:5])


@pytest.mark.slow
@pytest.mark.parametrize(("name", "action"), SEARCHED)
def test_no_search_finds_an_unreported_intrusion_into_the_buffer(name, action):
    for hz in (5, 15):
        worst = worst_case(name, action, hz, evaluations=300, seed=1)
        assert not worst.outcome.clean_breach, worst.describe()


@pytest.mark.slow
@pytest.mark.parametrize("name", ATTACKS)
def test_attacks_change_the_traffic(name):
    """Enough starts are verified: otherwise the tests above would hold of nothing."""
    outs = [play(Run.sample(name, action, 5, seed)) for action in ATTACKS[name].actions for seed in range(20)]
    assert sum(o.started for o in outs) >= 0.25 * len(outs)
    assert sum(o.started and not o.violations_before for o in outs) >= 0.1 * len(outs)


def test_ppo_does_not_crash_where_it_once_did():
    """A neighbour left the ego's lane and came back."""
    env = ShieldedEnv(gym.make("highway-fast-v0"))
    policy = load_reference("ppo-highway-fast")
    obs, _ = env.reset(seed=4001110)
    done = False
    while not done:
        obs, _, terminated, truncated, _ = env.step(int(policy.predict(obs, deterministic=True)[0]))
        done = terminated or truncated
    crashed = env.unwrapped.vehicle.crashed
    env.close()
    assert not crashed
