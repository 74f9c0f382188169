"""Verification by simulation: what it would let through if a line were missing."""

from __future__ import annotations

from mutants.kinds import EXACT, off

__all__ = ["SIMULATED"]

_TESTS, _NETWORKS = "tests/shield/test_exact.py", "tests/shield/test_exact_networks.py"
_TRAFFIC = "tests/dynamics/test_networks.py"

SIMULATED = (
    off("what is simulated passes", f"{EXACT}/deciding.py", "    if margin < 0:\n        return False\n", "", _TESTS),
    off(
        "no buffer in what is simulated",
        f"{EXACT}/search.py",
        "half_length + bounds.longitudinal, half_width + bounds.lateral",
        "half_length, half_width",
        _TESTS,
    ),
    off("one decision is enough", f"{EXACT}/search.py", "if level == bounds.depth:", "if level == 1:", _TESTS),
    off(
        "only the last decision's clearance",
        f"{EXACT}/search.py",
        "search.least[level + 1] = min(search.least[level], least)",
        "search.least[level + 1] = least",
        _TESTS,
    ),
    off(
        "a search that never turns back",
        f"{EXACT}/search.py",
        "            level -= 1\n",
        "            break\n",
        _TESTS,
    ),
    off(
        "a frame is looked at in each decision",
        f"{EXACT}/search.py",
        "        least = min(least, _clearance(futures, target, ego, bounds, search.row))\n",
        "        least = _clearance(futures, target, ego, bounds, search.row)\n",
        _TESTS,
    ),
    off(
        "an alternative is as good as its first decisions",
        f"{EXACT}/closest.py",
        "    if clear == bounds.depth:\n        return margin\n",
        "    return margin\n",
        _TESTS,
    ),
    off(
        "nothing is foretold",
        "shield/doors/exact_door.py",
        "if not other[columns[:, 0] == ego].any():",
        "if False:",
        _TESTS,
    ),
    off(
        "the ego is foretold too",
        "shield/doors/exact_door.py",
        "if not other[columns[:, 0] == ego].any():",
        "if True:",
        _TESTS,
    ),
    off(
        "the order is not asked for",
        f"{EXACT}/deciding.py",
        "ranked, now = order.shape[0] > 0 and order[0] >= 0, ",
        "ranked, now = False, ",
        _TESTS,
    ),
    off(
        "futures without routes",
        f"{EXACT}/traffic.py",
        "                routes[k, i, j, 0], routes[k, i, j, 1] = given[i, j, 0], given[i, j, 1]\n",
        "                routes[k, i, j, 0], routes[k, i, j, 1] = 0, 0\n",
        _NETWORKS,
    ),
    off(
        "every lane is where a road ends",
        "dynamics/networks/engine.py",
        "network.ids[lane, ENDS] != 0 and ",
        "",
        _NETWORKS,
    ),
    off("no road ends", "dynamics/networks/engine.py", "network.ids[lane, ENDS] != 0 and ", "False and ", _NETWORKS),
    off("nobody yields", "dynamics/networks/engine.py", "if rules.customs.period > 0 and ", "if False and ", _TRAFFIC),
    off(
        "who has left stays",
        "dynamics/networks/engine.py",
        "    if rules.customs.vehicles_leave:\n",
        "    if False:\n",
        _TRAFFIC,
    ),
    off(
        "the one of higher priority yields",
        "dynamics/networks/regulation.py",
        "return j if mine > theirs else i",
        "return i if mine > theirs else j",
        _TRAFFIC,
    ),
)
