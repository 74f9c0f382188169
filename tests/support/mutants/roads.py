"""The certificate on road networks: what it would let through if a line were missing."""

from __future__ import annotations

from mutants.kinds import off

__all__ = ["ROADS"]

_TESTS, _CLAUSES = "tests/shield/test_roads.py", "tests/shield/test_roads_clauses.py"
_JUDGING, _PREDICTION = "shield/roads/judging.py", "dynamics/networks/prediction.py"

ROADS = (
    off(
        "nobody goes on where lanes end",
        _PREDICTION,
        "                    if after >= 0 and not waits",
        "                    if False and not waits",
        _CLAUSES,
    ),
    off(
        "nobody comes over from a lane that ends",
        _PREDICTION,
        "if ways.over[lane] >= 0 and row[3] > _STANDS:",
        "if False:",
        _CLAUSES,
    ),
    off(
        "nobody accelerates",
        _PREDICTION,
        "            fast = min(fast + conduct.acceleration * dt, cap)\n",
        "",
        _CLAUSES,
    ),
    off(
        "nobody brakes",
        _PREDICTION,
        "            slow = max(slow - conduct.braking * dt, 0.0) if",
        "            slow = slow if",
        _CLAUSES,
    ),
    off(
        "where the ego rests nobody comes later",
        _JUDGING,
        "            if rests and k == count - 1:\n                ahead = ALWAYS\n",
        "",
        _CLAUSES,
    ),
    off(
        "those behind see the ego before they are in its lane",
        _JUDGING,
        "if k >= since and there else 0",
        "if k >= since else 0",
        _CLAUSES,
    ),
    off(
        "no buffer on the lanes",
        "shield/roads/survey.py",
        "(j // 3 - 1) * body.along, (j % 3 - 1) * body.across",
        "(j // 3 - 1) * body.length, (j % 3 - 1) * body.width",
        _CLAUSES,
    ),
    off(
        "what stands is not there",
        _JUDGING,
        "            if gap < worst:\n                worst, who = gap, -1\n",
        "",
        _CLAUSES,
    ),
    off("the ego leaves the road", "shield/roads/choosing.py", "    if found < 0:\n", "    if False:\n", _CLAUSES),
)
