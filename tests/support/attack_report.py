"""Table of the results of attacks: `PYTHONPATH=tests/support python tests/support/attack_report.py slip trucks
--runs 40`."""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from itertools import product

from attacks import ATTACKS, Run, play
from driven_traffic import Outcome

import shield

HEAD = f"{'attack':24}{'action':12}{'Hz':>3}{'runs':>6}{'flagged':>8}{'late':>6}{'lost':>6}{'clean':>6}{'worst':>8}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("attacks", nargs="*", default=list(ATTACKS), help="which attacks; all by default")
    parser.add_argument("--runs", type=int, default=20, help="of each attack, action type and frequency")
    parser.add_argument("--seed", type=int, default=0, help="the first of them")
    parser.add_argument("--actions", nargs="*", default=["meta", "continuous"])
    parser.add_argument("--hz", nargs="*", type=int, default=None, help="frequencies; each attack's own by default")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--verbose", action="store_true", help="print every clean breach")
    options = parser.parse_args()
    print(shield.__file__)
    print(HEAD)
    with ProcessPoolExecutor(options.jobs) as pool:
        for name, action in product(options.attacks, options.actions):
            attack = ATTACKS[name]
            if action not in attack.actions:
                continue
            for hz in options.hz or attack.rates:
                runs = [Run.sample(name, action, hz, options.seed + i) for i in range(options.runs)]
                found = list(pool.map(play, runs)) if options.jobs > 1 else [play(run) for run in runs]
                print(line(name, action, hz, found), flush=True)
                if options.verbose:
                    for run, out in zip(runs, found, strict=True):
                        if out.clean_breach:
                            print("   ", run.describe(out))


def line(name: str, action: str, hz: int, found: list[Outcome]) -> str:
    """One row: of the runs whose start was verified, how many were flagged, and how many of these only at the breach;
    how many lost their certificate or breached with nobody flagged; and the least clearance of the unflagged [m].
    """
    runs = [o for o in found if o.started]
    worst = min((o.clearance for o in runs if not o.flagged), default=float("nan"))
    late = [o for o in runs if o.flagged and not o.violations_before]
    clean = [o for o in runs if o.clean_breach]
    counts = [len(runs), sum(o.flagged for o in runs), len(late), sum(o.clean_loss for o in runs), len(clean)]
    row = "".join(f"{n:>{w}}" for n, w in zip(counts, (6, 8, 6, 6, 6), strict=True))
    return f"{name:24}{action:12}{hz:>3}{row}{worst:>8.2f}"


if __name__ == "__main__":
    main()
