"""Who owes the ego its distance, and who may come in."""

from __future__ import annotations

from mutants.kinds import DUTIES, ENTERING, MOBIL, SEPARATION, SETTINGS, TESTS_OF_MOBIL, TOGETHER, off

__all__ = ["OWED"]

OWED = (
    off(
        "blind merge off",
        TOGETHER,
        "x.blind > 0 and hold == 0",
        "False",
        "blind",
    ),
    off(
        "nobody enters but who is on the way",
        ENTERING,
        "may = turning or gains[j, 1 if above else 0]",
        "may = turning",
        "blind",
    ),
    off(
        "nobody enters but who gains by it",
        ENTERING,
        "may = turning or gains[j, 1 if above else 0]",
        "may = gains[j, 1 if above else 0]",
        "loses",
    ),
    off(
        "seen at once by one that is turning in", ENTERING, "if visible[k] >= settled:", "if visible[k] > 0:", "turning"
    ),
    off("who turns in gives way", ENTERING, "may = last and turning", "may = False", "turning"),
    off(
        "begun before it could see the ego",
        ENTERING,
        "elif visible[k] > sight:",
        "elif visible[k] > 0:",
        "tests/shield/test_kernels.py",
    ),
    off(
        "nobody comes where the ego is out of sight",
        ENTERING,
        "leaves and beside",
        "False and beside",
        "joins",
    ),
    off(
        "everybody behind owes",
        DUTIES,
        "owes = behind[j] and held[j]",
        "owes = behind[j]",
        "owes",
    ),
    off(
        "owed even where the path enters the lane",
        DUTIES,
        "owes = owes and not (touches or others.comes[entered, j])",
        "pass",
        "owes",
    ),
    off(
        "those ahead owe",
        DUTIES,
        "owes = behind[j] and held[j]",
        "owes = held[j]",
        "owes",
    ),
    off(
        "owed what was left and is come back to",
        DUTIES,
        "        if inside and left:",
        "        if inside and False:",
        "left",
    ),
    off(
        "duty ends where the lane is owned no more",
        DUTIES,
        "held or (followed and low",
        "held or (False and low",
        "lasts",
    ),
    off(
        "duty ends where a corner comes beside a corner",
        DUTIES,
        "behind = gap_between(ego.seen, ego.seen.along, ego.seen.across, rows, j, 0.0) >= 0",
        "pass",
        "corner",
    ),
    off(
        "duty lasts where the buffer is touched",
        DUTIES,
        "behind = gap_between(ego.seen, ego.seen.along, ego.seen.across, rows, j, 0.0) >= 0",
        "behind = True",
        "corner",
    ),
    off(
        "nobody joins where the ego has got out of sight",
        DUTIES,
        "                coming[j, i] = True",
        "                pass",
        "anybody",
    ),
    off("who enters need not gain by it", MOBIL, "gain >= LEAST_GAIN - slack and imposed", "imposed", TESTS_OF_MOBIL),
    off("who leaves a lane leads there", MOBIL, " and abs(r + _LEAVES * across - center) <= sight", "", TESTS_OF_MOBIL),
    off(
        "the ego holds nobody up",
        MOBIL,
        "    if ahead >= 0 and (abs(ego[1]",
        "    if False and (abs(ego[1]",
        TESTS_OF_MOBIL,
    ),
    off(
        "who may enter too owes",
        DUTIES,
        "touches or others.comes[entered, j]",
        "touches",
        "tests/shield/test_found.py",
    ),
    off("who enters may impose anything", MOBIL, " and imposed <= IMPOSED + slack", "", TESTS_OF_MOBIL),
    off("lane owned without a plan", DUTIES, "(had or j == stored) and offset < touch", "offset < touch", "owned"),
    off("lane owned for ever", DUTIES, "(had or j == stored) and offset < touch", "had or j == stored", "owned"),
    off(
        "reaction time off",
        SEPARATION,
        "else first + reaction",
        "else first",
        "follower[idm-15-20-0.0]",
        "follower[rss-25-20-0.0]",
    ),
    off(
        "visible from the first frame on",
        SEPARATION,
        "            first = k + 2\n",
        "            first = 1\n",
        "follower[idm-15-20-0.0]",
    ),
    off(
        "seen for long already",
        TOGETHER,
        "already = centers[home[j]], -1, visible",
        "already = centers[home[j]], 0, visible",
        "follower[idm-15-20-1.5]",
        "follower[rss-25-20-1.5]",
    ),
    off(
        "follower that still brakes when the ego stands off",
        SEPARATION,
        "    if path[frames - 1, 3] < 0.5:",
        "    if path[frames - 1, 3] < -0.5:",
        "follower[rss-25-20-0.0]",
        "follower[idm-15-20-0.0]",
    ),
    off(
        "follower accelerates half as hard",
        SEPARATION,
        "min(gain, power / max(speed, 1e-3)) * dt, top)",
        "0.5 * min(gain, power / max(speed, 1e-3)) * dt, top)",
        "follower[idm-15-20-0.0]",
    ),
    off(
        "follower brakes harder than it owes",
        SETTINGS,
        "            a.follower_braking,",
        "            1.25 * a.follower_braking,",
        "follower[idm-15-20-0.0]",
    ),
)
