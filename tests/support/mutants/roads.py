"""The certificate on road networks: what it would let through if a line were missing."""

from __future__ import annotations

from mutants.kinds import off

__all__ = ["ROADS"]

_TESTS, _CLAUSES = "tests/shield/test_roads.py", "tests/shield/test_roads_clauses.py"
_JUDGING, _PREDICTION = "shield/roads/judging.py", "dynamics/networks/reachable/prediction.py"

ROADS = (
    off(
        "nobody goes on where lanes end",
        _PREDICTION,
        "            if after >= 0 and not (known",
        "            if False and not (known",
        _CLAUSES,
    ),
    off(
        "nobody comes over from a lane that ends",
        _PREDICTION,
        "    if ways.over[lane] >= 0:\n        drive[3]",
        "    if False:\n        drive[3]",
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
        "who comes from the lane before is no faster for how the frames fall",
        _JUDGING,
        "            v = max(v, min(_arrival(v0, row[NEAR], others.drive[i], conduct.acceleration, dt), top))\n",
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
        "                ahead = ALWAYS\n",
        "",
        _CLAUSES,
    ),
    off(
        "one behind owes its distance before it has come over from a lane that ends",
        "shield/roads/dues.py",
        " & ~_comes_over(others, road.ways)",
        "",
        _CLAUSES,
    ),
    off(
        "who is ahead on a ring is behind",
        _JUDGING,
        "came <= rear < FAR_OFF",
        "rear < FAR_OFF",
        _CLAUSES,
    ),
    off(
        "who creeps gets as far along its lane as others",
        _JUDGING,
        "    v = max(v, drive[3] + step)\n",
        "",
        _CLAUSES,
    ),
    off(
        "who is behind need not brake",
        "shield/roads/watch.py",
        "            if late:\n                broken.add(Breach.DISTANCE)\n",
        "",
        _CLAUSES,
    ),
    off(
        "who owes its distance keeps it on whatever course",
        "shield/roads/choosing.py",
        "        if owed:",
        "        if False:",
        _CLAUSES,
    ),
    off(
        "who can keep its distance no longer is counted on to",
        "shield/roads/late.py",
        "np.where(at_once < CLEAR, at_once, believed)",
        "believed",
        _CLAUSES,
    ),
    off(
        "who owes its distance has the time to react again",
        _JUDGING,
        "0 if asked else road.duty.reaction",
        "road.duty.reaction",
        _CLAUSES,
    ),
    off(
        "who stands astride waits too",
        _PREDICTION,
        "strips.marks[j, 2] == -1 and max(numbers[HIGH], -numbers[LOW]) <= numbers[KEEP]",
        "strips.marks[j, 2] == -1",
        _CLAUSES,
    ),
    off(
        "who is coming over keeps to its lane",
        _PREDICTION,
        "    numbers[LOW], numbers[HIGH] = min(numbers[LOW], -r - keep), max(numbers[HIGH], keep - r)\n",
        "",
        _CLAUSES,
    ),
    off(
        "where the ego rests nobody rolls back later",
        _JUDGING,
        "                back = min(back, others.least[i, others.least.shape[1] - 1] - row[FAR])\n",
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
        "ds, dr = abs(along) * body.along + abs(aside) * body.across,",
        "ds, dr = abs(along) * body.length + abs(aside) * body.width,",
        _CLAUSES,
    ),
    off(
        "what stands is not there",
        _JUDGING,
        "            if gap < worst:\n                worst, who = gap, -1\n",
        "",
        _CLAUSES,
    ),
    off(
        "everybody waits, whatever the right of way",
        _JUDGING,
        "while since > 0 and road.rights[trial.own[since - 1]] > others.ranks[j]:",
        "while since > 0:",
        _CLAUSES,
    ),
    off(
        "who waits needs no time to react",
        _JUDGING,
        "    delay, given = road.duty.reaction, others.gives[i, lane]\n",
        "    delay, given = 0, others.gives[i, lane]\n",
        _CLAUSES,
    ),
    off(
        "who has to wait may do as it likes",
        "shield/roads/watch.py",
        "            broken.add(Breach.RIGHT_OF_WAY)\n",
        "            pass\n",
        _TESTS,
    ),
    off(
        "who creeps gains as much as others",
        _PREDICTION,
        "(drive[i, 4] if 0.0 < slow < drive[i, 3] else 1.0)",
        "1.0",
        _CLAUSES,
    ),
    off(
        "who is about to leave its lane has left it",
        _PREDICTION,
        "                    marks[j, 2] = k\n",
        "                    pass\n",
        _CLAUSES,
    ),
    off(
        "who is beside its lane may stay there",
        "shield/roads/watch.py",
        "        if not (along & across & settles &",
        "        if not (along & across &",
        _CLAUSES,
    ),
    off(
        "the last resort does as it was told",
        "shield/roads/choosing.py",
        "        return a.speed < b.speed\n",
        "        return False\n",
        _CLAUSES,
    ),
    off(
        "it turns aside into a lane that ends",
        "dynamics/networks/alone.py",
        " and over[beside] < 0:",
        ":",
        _CLAUSES,
    ),
    off("the ego leaves the road", "shield/roads/choosing.py", "    if found < 0:\n", "    if False:\n", _CLAUSES),
)
