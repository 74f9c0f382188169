"""The search over lanes and speeds against a plain search, decision by decision."""

from __future__ import annotations

import numpy as np
import pytest

from dynamics.highway_simulator.layout import SPEED, TARGET, TARGET_SPEED
from dynamics.highway_simulator.simulator import Simulator
from shield import ShieldConfig
from shield.certificate.simulated.closest import best_plan
from shield.certificate.simulated.search import begin_action, finish_action, set_root_scene
from shield.certificate.simulated.workspace import ANY, LaneSpeedTarget, new_search
from shield.config import Buffer

DENSE = {"vehicles_density": 1.6}
DEPTH = 5


def moving(search):
    """The moving bodies, as arrays by future."""
    return search.futures.f, search.futures.g, search.futures.order, search.futures.clock


def lost_at_least(search, k, decisions, wish):
    """The least loss on an empty road, with the actions that reach the speed soonest."""
    f, rules = search.futures.f[k], search.rules
    speeds, dt = [float(each) for each in rules.target_speeds], rules.times[0]
    speed, target, lost = float(f[SPEED, 0]), float(f[TARGET_SPEED, 0]), 0.0
    side = 1 if speed < wish else -1
    for _ in range(decisions):
        share = (speed - speeds[0]) / (speeds[-1] - speeds[0]) * (len(speeds) - 1)
        following = speeds[min(max(min(max(round(share), 0), len(speeds) - 1) + side, 0), len(speeds) - 1)]
        target = side * max(side * target, side * following)
        for _ in range(rules.numbers[0]):
            speed += (target - speed) / 0.6 * dt
            if side * (wish - speed) <= 0:
                return lost
            lost += abs(wish - speed) * dt
    return lost


def plainly(search, only, never, wish, floor):
    """For each lane and speed, after each number of decisions: the best way there, with the least loss from there
    on. All of them are continued."""
    spare, zero = search.bounds.spare, [array[0].copy() for array in moving(search)]
    # A lane and a speed: cost, clearance, the actions, and the moving bodies.
    best, lasts = {None: (0.0, np.inf, (), zero, 0.0)}, ()
    for level in range(DEPTH):
        then = {}
        for key in sorted(best, key=str) if level == 0 else sorted(best):
            cost, clear, actions, state, _ = best[key]
            seen = set()
            for action in range(len(search.order)):
                if level == 0 and (action == never or only not in (ANY, action)):
                    continue
                for array, saved in zip(moving(search), state, strict=True):
                    array[0] = saved
                bound = begin_action(search, 0, spare, action)
                if bound in seen:
                    continue
                seen.add(bound)
                least, lost = finish_action(search, spare, wish, floor)
                if least < floor:
                    continue
                kind = int(search.futures.g[spare, TARGET, 0]), float(search.futures.f[spare, TARGET_SPEED, 0])
                all_clear = min(clear, least)
                paid = -all_clear if floor < 0 else cost + lost
                bound = paid if floor < 0 else paid + lost_at_least(search, spare, DEPTH - level - 1, wish.speed)
                if kind not in then or bound < then[kind][4]:
                    state_then = [array[spare].copy() for array in moving(search)]
                    then[kind] = paid, all_clear, (*actions, action), state_then, bound
        for array, saved in zip(moving(search), zero, strict=True):
            array[0] = saved
        if not then:
            break
        best = then
        lasts = min((paid, kind, clear, actions) for kind, (paid, clear, actions, *_) in then.items())
    return (lasts[3], lasts[2]) if lasts else ((), -np.inf)


@pytest.mark.parametrize("floor", [0.0, -1e9])
@pytest.mark.parametrize("seed", range(12))
def test_the_search_finds_the_result_of_a_plain_search(seed, floor):
    config = ShieldConfig.simulated_traffic().replace(
        horizon=float(DEPTH), buffer=Buffer(4.0, 0.5) if seed % 2 else Buffer(0.5, 0.3)
    )
    simulator = Simulator("highway-fast-v0", 1, DENSE)
    simulator.reset([800 + seed])
    search = new_search(simulator, config)
    for k in range(4):
        simulator.step([3])
        set_root_scene(search, simulator.worlds, 0)
        for only, never, speed in ((ANY, ANY, 30.0), (ANY, 3, 30.0), (k, ANY, 20.0), (ANY, 1, 25.0)):
            wish = LaneSpeedTarget(speed, 2.0, 0.0) if speed == 25.0 else LaneSpeedTarget(speed, 0.0, 0.8)
            plan, margin = plainly(search, only, never, wish, floor)
            lasts, found = best_plan(search, only, never, DEPTH, wish, floor)
            assert lasts == len(plan)
            assert found == margin
            # Several plans are equally clear; any of them may be found.
            assert floor < 0 or tuple(search.plan[:lasts]) == plan
