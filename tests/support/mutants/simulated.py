"""Verification by simulation: what it would let through if a line were missing."""

from __future__ import annotations

from mutants.kinds import EXACT, off

__all__ = ["SIMULATED"]

_TESTS, _NETWORKS = "tests/shield/test_exact.py", "tests/shield/test_exact_networks.py"
_TRAFFIC = "tests/dynamics/test_networks.py"
_TEAM = "tests/shield/test_team.py"
_INPUTS, _HELD = "tests/shield/test_exact_inputs.py", "tests/dynamics/test_network_inputs.py"

SIMULATED = (
    off("what is simulated passes", f"{EXACT}/deciding.py", "    if margin < 0:\n        return False\n", "", _TESTS),
    off(
        "no buffer in what is simulated",
        f"{EXACT}/search.py",
        "half_length + bounds.longitudinal, half_width + bounds.lateral",
        "half_length, half_width",
        _TESTS,
    ),
    off(
        "one decision is enough",
        f"{EXACT}/search.py",
        "(margin if lasts == search.bounds.depth else -np.inf)",
        "margin",
        _TESTS,
    ),
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
        "        least = min(least, clearance(futures, target, ego, bounds, search.row))\n",
        "        least = clearance(futures, target, ego, bounds, search.row)\n",
        _TESTS,
    ),
    off(
        "an alternative is as good as its first decisions",
        f"{EXACT}/closest.py",
        "    margin, _ = survives(search, search.hint[0], search.hint, bounds.outlook)\n",
        "    margin = 0.0\n",
        _TESTS,
    ),
    off(
        "the first way to a lane and speed is kept, not the best",
        f"{EXACT}/closest.py",
        "        if not cost < (np.inf if slot == NOBODY else nodes.cost[slot]):\n",
        "        if slot != NOBODY:\n",
        "tests/shield/test_exact_closest.py",
    ),
    off(
        "a search that ends early is a plan",
        f"{EXACT}/closest.py",
        "    return margin if lasts == search.bounds.depth else -np.inf\n",
        "    return margin\n",
        _TESTS,
    ),
    off(
        "who is boxed in looks for one future of each lane and speed",
        f"{EXACT}/deciding.py",
        "        if further > lasts:\n",
        "        if False:\n",
        "tests/shield/test_exact_roads.py",
    ),
    off(
        "a search in depth forgets what went on longest",
        f"{EXACT}/search.py",
        "        if level > lasts:\n",
        "        if lasts == 0 or level == bounds.depth:\n",
        "tests/shield/test_exact_roads.py",
    ),
    off(
        "the mask asks more than a decision",
        "shield/doors/exact_door.py",
        "twice, stored, length = not boxed_in(plans, 0), ",
        "twice, stored, length = True, ",
        _TESTS,
    ),
    off(
        "the mask forgets what was planned",
        "shield/doors/exact_door.py",
        "plans.actions[0], plans.length[0]\n        mask",
        "plans.actions[0], 0\n        mask",
        _TESTS,
    ),
    off(
        "nothing is foretold",
        "shield/doors/exact_scene.py",
        "if not other[columns[:, 0] == ego].any():",
        "if False:",
        _TESTS,
    ),
    off(
        "the ego is foretold too",
        "shield/doors/exact_scene.py",
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
        "    clear(traffic, rules.customs, vehicles)\n",
        "",
        _TRAFFIC,
    ),
    off(
        "the one of higher priority yields",
        "dynamics/networks/regulation.py",
        "return j if mine > theirs else i",
        "return i if mine > theirs else j",
        _TRAFFIC,
    ),
    off(
        "a frame of an input may be inside the buffer",
        f"{EXACT}/inputs.py",
        "least = clearance(futures, 0, ego, search.bounds, search.row)",
        "least = 1.0",
        _INPUTS,
    ),
    off(
        "an input may leave the road",
        f"{EXACT}/inputs.py",
        "if futures.g[0, CRASHED, ego] != 0 or not on:",
        "if futures.g[0, CRASHED, ego] != 0:",
        _INPUTS,
    ),
    off(
        "whether the law can go on does not matter",
        f"{EXACT}/inputs.py",
        "        if margin >= 0:\n            return margin\n    return -np.inf\n",
        "        return abs(margin)\n    return -np.inf\n",
        _INPUTS,
    ),
    off(
        "the law is forgotten between decisions",
        "shield/doors/exact_input_door.py",
        "            elif law is not None:\n",
        "            elif False:\n",
        _INPUTS,
    ),
    off(
        "a plan for another scene is kept",
        "shield/doors/exact_input_door.py",
        "                self._tail.counts[:] = 0\n            elif",
        "                pass\n            elif",
        _INPUTS,
    ),
    off(
        "nobody looks between two decisions",
        "shield/doors/exact_scene.py",
        "return bool((np.abs(now - self._foretold) <= _SAME).all())",
        "return True",
        _INPUTS,
    ),
    off(
        "the wheel is straight in what others foresee",
        "dynamics/networks/regulation.py",
        "        if g[KIND, i] == CONTINUOUS:\n",
        "        if False:\n",
        _HELD,
    ),
    off(
        "an ally's buffer is its own business",
        f"{EXACT}/search.py",
        "            least = min(least, clearance(futures, target, allies[i], bounds, search.row))\n",
        "",
        _TEAM,
    ),
    off(
        "allies stay as they are",
        f"{EXACT}/traffic.py",
        "        _command(search.machine, search.futures, rules, k, team.columns[i], team.plans[i, now])\n",
        "        pass\n",
        _TEAM,
    ),
    off(
        "nobody is told what the one before was given",
        "shield/doors/team_door.py",
        "            wanted[k, 0] = decisions[-1].executed\n",
        "",
        _TEAM,
    ),
)
