"""Mutants of the compiled batch of shields."""

from __future__ import annotations

from mutants.kinds import BATCH, off

__all__ = ["BATCHED"]

_TESTS = "tests/shield/batch/test_decisions.py"

BATCHED = (
    off(
        "batch: the suspect is not reset between scenes",
        f"{BATCH}.observing",
        "_prepare",
        "_[0], _[0] = (0, _)",
        "{1}[0] = 0",
        _TESTS,
    ),
    off(
        "batch: any vehicle near counts as touching",
        f"{BATCH}.verifying",
        "_touches",
        "_ and _ - (_ + _(_, _, _)) < 0",
        "{1}",
        _TESTS,
    ),
    off(
        "batch: rear bounds are not reset between scenes",
        f"{BATCH}.observing",
        "_prepare",
        "_[0, _] = _[1, _] = 0",
        "pass",
        _TESTS,
    ),
    off(
        "batch: violators are never cleared",
        f"{BATCH}.supervising",
        "clear_violators",
        "_[_, _] = False",
        "pass",
        _TESTS,
    ),
)
