"""Decisions on every road equal the recorded ones.

A change that means to alter decisions records them anew with `make decisions RECORD=--record`, and its commit message
gives the reason. Here the cells of `ShieldedEnv` with default settings and in the worst case are compared; `make
decisions` compares all.
"""

import pytest
import recorded_decisions
from recorded_decisions import Cell, decided, differences, recorded, rounds_as_recorded

BEFORE = recorded()
BEFORE = BEFORE[BEFORE.cell.str.contains("; (?:default|worst case); ShieldedEnv$")]
BY_ENV = {env_id: group for env_id, group in BEFORE.groupby(BEFORE.cell.str.partition(";")[0])}


@pytest.mark.parametrize("env_id", BY_ENV)
def test_decisions_are_those_recorded(env_id):
    """The executed action, its reason, tier, margin and clause, and the ego's state afterwards."""
    before = BY_ENV[env_id]
    now = decided([Cell(*cell.split("; ")) for cell in before.cell.unique()])
    assert not list(differences(before, now, rounds_as_recorded()))


def test_rounding_of_another_processor_is_no_difference_and_a_changed_text_is():
    """From the first decision that rounding has changed, a cell is not compared on another processor."""
    before = BEFORE[BEFORE.cell == BEFORE.cell.iloc[0]].reset_index(drop=True)
    now = before.copy()
    now.loc[2:, "speed"] += 1e-4
    assert not list(differences(before, now, exactly=False))
    assert list(differences(before, now))
    now.loc[2, "tier"] = "x"
    assert list(differences(before, now, exactly=False))


@pytest.mark.parametrize("column", [*recorded_decisions.TEXTS, *recorded_decisions.COUNTS, "margin", "speed"])
def test_each_column_is_compared(column):
    """A change of any column, a missing decision and a missing cell are reported."""
    before = BEFORE[BEFORE.cell == BEFORE.cell.iloc[0]]
    now = before.copy()
    now[column] = now[column] + ("x" if column in recorded_decisions.TEXTS else 1)
    told = list(differences(before, now))
    assert len(told) == 1
    assert column in told[0]
    assert list(differences(before, before.iloc[:-1]))
    assert list(differences(before, before.iloc[:0]))
    assert not list(differences(before, before.copy()))


def test_the_recorded_episodes_have_overrides_of_many_kinds():
    """Episodes in which everything passes would compare little."""
    every = recorded()
    overridden = every[~every.tier.isin(["passed", "off"])]
    assert len(overridden) > 2000
    assert min(every.tier.nunique(), every.reason.nunique()) >= 6
    assert {"", "separation", "cut-in"} <= set(every.clause)
