"""Clauses that say how near a path comes."""

from __future__ import annotations

from mutants.kinds import EDGE, GAPS, ROOM, RULE_KERNELS, SEPARATION, SLIPS, TOGETHER, VERIFY, off

__all__ = ["CLEARANCE"]

CLEARANCE = (
    off(
        "separation off",
        ROOM,
        "        least = min(least, separations[j])",
        "        least = min(least, np.inf)",
        "leader",
    ),
    off("room in the lane off", ROOM, "    if room < 0:", "    if room < -1e9:", "room"),
    off(
        "road edge off",
        EDGE,
        "margin[i] if room >= 0 else min(margin[i], room)",
        "margin[i] if room >= -1e9 else min(margin[i], room)",
        "road",
        "verdict",
    ),
    off("one new lane at most, and none again, off", EDGE, "if not allowed[i] or paths", "if paths", "verdict"),
    off("rolling backwards off", EDGE, "paths[i, held - 1, 3] < -1e-9", "paths[i, held - 1, 3] < -1e9", "road"),
    off(
        "both sides at once off",
        EDGE,
        "        if count > 1:",
        "        if count > 9:",
        "tests/shield/test_kernels.py",
    ),
    off(
        "no way back to a lane left off",
        EDGE,
        " or (inside and not within[j]):",
        ":",
        "tests/shield/test_kernels.py",
    ),
    off("gaps of the map off", VERIFY, "        if gaps is not None:", "        if gaps is None and gaps:", "gap"),
    off(
        "gap beginning within a stretch off",
        GAPS,
        "        low = np.minimum(low, np.minimum(low[before], low[after]))",
        "        low = low + 0.05",
        "tests/dynamics/test_gaps.py",
    ),
    off(
        "slip-in off",
        TOGETHER,
        "    c = slipping.shape[0] if hold == 0 else 0\n    _slips",
        "    c = slipping.shape[0] if hold < 0 else 0\n    _slips",
        "slip",
    ),
    off(
        "slip-in counts for nothing",
        ROOM,
        "        least = min(least, slipping[j])",
        "        least = min(least, np.inf)",
        "slip",
    ),
    off(
        "one that slips in keeps its speed meanwhile",
        SLIPS,
        "slows = min(COMFORT * slips.ratios[1, j] ** 2, slips.braking)",
        "slows = 0.0",
        "tests/shield/test_alongside.py",
    ),
    off(
        "one that slips in is held up as it is now",
        SLIPS,
        "_HARDLY + _CHANGES * t",
        "_HARDLY",
        "tests/evaluation/test_found_in_abz.py",
    ),
    off(
        "who is still settling does not slip in",
        SLIPS,
        "        if first[j] > last[j] or",
        "        if first[j] != last[j] or",
        "tests/evaluation/test_found_in_abz.py",
    ),
    off(
        "who comes into a lane holds nobody up there yet",
        SLIPS,
        "elif abs(off) <= sight + _COMING",
        "elif abs(off) <= sight",
        "tests/evaluation/test_found_in_abz.py",
    ),
    off(
        "coming frame off",
        SEPARATION,
        "    return apart if apart < 0 else np.inf",
        "    return np.inf",
        "coming[0]",
    ),
    off(
        "later coming frames off",
        SEPARATION,
        "if ego.turned and k < frames - 1",
        "if ego.turned and k < 1",
        "coming[1]",
    ),
    off(
        "buffer rule off",
        RULE_KERNELS,
        "        if beside and _gap",
        "        if False and _gap",
        "tests/shield/test_rules.py",
    ),
    off("buffer along off", VERIFY, "0.5 * length + buffer.longitudinal,", "0.5 * length,", "buffer"),
    off(
        "buffer across off",
        VERIFY,
        "0.5 * width + buffer.lateral\n    size",
        "0.5 * width\n    size",
        "buffer",
    ),
)
