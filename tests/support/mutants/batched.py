"""Many shields at once: what they would overlook if a line were missing."""

from __future__ import annotations

from mutants.kinds import BATCH, off

__all__ = ["BATCHED"]

_TESTS = "tests/shield/test_batch.py"

BATCHED = (
    off(
        "a suspect from another scene",
        f"{BATCH}/observing.py",
        "room.desk.swept[0], room.suspect[0] = 0, NOBODY",
        "room.desk.swept[0] = 0",
        _TESTS,
    ),
    off(
        "whoever is near is in the way",
        f"{BATCH}/verifying.py",
        "return beside and rear - (s + along_of(foot, sin, cos)) < 0",
        "return beside",
        _TESTS,
    ),
    off(
        "bounds from another scene",
        f"{BATCH}/observing.py",
        "room.desk.done[0, j] = room.desk.done[1, j] = 0",
        "pass",
        _TESTS,
    ),
    off(
        "offenders are never forgiven",
        f"{BATCH}/supervising.py",
        "        shields.offenders[e, i] = False",
        "        pass",
        _TESTS,
    ),
)
