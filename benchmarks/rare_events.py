"""What subset simulation is worth, and what is found out of assumptions that are too weak.

    python benchmarks/rare_events.py [known | count | bare | strata | weak | bold]

`known`: a half-space of probability 1e-4, a hundred times. `count`: plain counting of what the next two estimate.
`bare`: the crashes of a policy that always slows down, without a shield, against plain counting. `strata`: the same by
how many share the ego's lane. `weak`: the smallest clearance that is found in some 5,000 episodes where the shield is
told too little of the others. `bold`: what drivers find out of that who use all that the rules permit.
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy.stats import norm

from dynamics.traffic.assumptions import Assumptions
from evaluation.falsification.falsify import crash_probability, falsify, falsify_among
from evaluation.falsification.finds import ANY
from evaluation.falsification.strata import Strata, stratified
from evaluation.falsification.subset_simulation import subset_simulation
from evaluation.measuring.statistics import clopper_pearson
from evaluation.running.batch_episodes import Many
from evaluation.settings import Setting, get_setting
from shield import ShieldConfig
from shield.config import Buffer

BETA = 3.719
FRESH = 100_000
"""Seeds from here on are reported; nothing was chosen on them."""
BARE = ShieldConfig(mode="none")
SHORT = Setting(
    "short", "highway-fast-v0", {"vehicles_count": 6, "duration": 6, "lanes_count": 3, "vehicles_density": 0.85}
)
REPEATS = 50
COUNTED = range(300_000_000, 301_600_000)
PARTS = ("known", "count", "bare", "strata", "weak", "bold")
WEAK = {
    "the default": ShieldConfig(),
    "nobody drives below 20 m/s": ShieldConfig(assumptions=Assumptions(min_speed=20.0)),
    "seen from 6 m off": ShieldConfig(assumptions=Assumptions(visible_distance=6.0)),
    "nobody enters blindly": ShieldConfig(assumptions=Assumptions(simultaneous_merge=False)),
    "nobody settles or reacts late": ShieldConfig(assumptions=Assumptions(settle_time=0.0, reaction_time=0.0)),
    "nobody slips in": ShieldConfig(assumptions=Assumptions(cut_in=False)),
    "braking 2": ShieldConfig(assumptions=Assumptions(braking=2.0, comfortable_braking=2.0)),
    "no buffer": ShieldConfig(buffer=Buffer(0.0, 0.0)),
    "turning costs nothing": ShieldConfig(
        assumptions=Assumptions(turning_loss=0.0, turning_action=0.0, turning_action_in_one_second=0.0)
    ),
    "calm braking 0.5": ShieldConfig(assumptions=Assumptions(comfortable_braking=0.5)),
    "acceleration 1": ShieldConfig(assumptions=Assumptions(acceleration=1.0)),
    "lean 1": ShieldConfig(assumptions=Assumptions(marking_tolerance=1.0)),
    "followers brake at 20": ShieldConfig(assumptions=Assumptions(follower_braking=20.0, reaction_time=0.0)),
}

WHERE = {"highway-fast": tuple(WEAK), "abz-idm": ("the default", "nobody slips in")}
"""On which roads each is tried: who slips in does so on the faster one."""
BY_BOLD = (
    "braking 2", "turning costs nothing", "acceleration 1", "no buffer", "calm braking 0.5", "lean 1",
    "nobody drives below 20 m/s", "followers brake at 20",
)  # fmt: skip
"""What drivers on two lanes can find out; who enters a lane that the ego enters too comes from a third."""


def spread(estimates: list[float], truth: float, evaluations: float) -> None:
    found = np.array(estimates)
    error = found.std() / truth
    counting = (1 - truth) / (truth * error**2)
    print(
        f"truth {truth:.3g}: mean of {len(found)} {found.mean():.3g}, relative error of one {error:.0%} from "
        f"{evaluations:,.0f} evaluations; counting takes {counting:,.0f}, {counting / evaluations:.1f} times as many"
    )


def known() -> None:
    runs = [subset_simulation(lambda x: BETA - x.sum(axis=1) / 10, 100, 2400, seed=FRESH + k) for k in range(100)]
    spread([x.probability for x in runs], float(norm.sf(BETA)), float(np.mean([x.evaluations for x in runs])))


def bare() -> None:
    counted = Many(SHORT, "slower", BARE).run(range(400_000))["crashed"]
    print(f"{counted.sum()} of {len(counted)} crash")
    runs = [crash_probability(SHORT, "slower", BARE, 4000, seed) for seed in range(16)]
    evaluations = float(np.mean([x.evaluations for x in runs]))
    spread([x.probability for x in runs], float(counted.mean()), evaluations)


def count() -> None:
    many, crashes = Many(SHORT, "slower", BARE), 0
    for first in range(COUNTED.start, COUNTED.stop, 50_000):
        crashes += int(many.run(range(first, first + 50_000))["crashed"].sum())
    print(f"{crashes} of {len(COUNTED):,} crash: {clopper_pearson(crashes, len(COUNTED))}")


def strata() -> None:
    many = Many(SHORT, "slower", BARE, chosen=True)
    sorts = Strata(SHORT.config["vehicles_count"], SHORT.config["lanes_count"])
    runs = [
        stratified(lambda x: many.run_chosen(x).clearance == 0, sorts, 2500, 22_000, FRESH + k) for k in range(REPEATS)
    ]
    found = np.array([x.probability for x in runs])
    spread(list(found), float(found.mean()), float(np.mean([x.evaluations for x in runs])))
    print("of the others", sum(x.met for x in runs), "events in", sum(x.counted for x in runs), "episodes, by stratum")


def weak() -> None:
    for setting, name in [(setting, name) for setting, names in WHERE.items() for name in names]:
        found = falsify(get_setting(setting), ANY, WEAK[name], 5000, seed=1)
        print(
            f"{setting:12s} {name:32s} {found.find.clearance:.3f} m, as drawn {found.median:.2f} m, "
            f"{found.episodes} episodes, {found.crashed} crashes, an assumption broken in "
            f"{100 * found.offended:.0f} % as drawn",
            flush=True,
        )


def bold() -> None:
    for name in (*BY_BOLD, "the default"):
        most = 300 if name == "the default" else 5000
        met = falsify_among(get_setting("highway-fast"), WEAK[name], most, FRESH)
        print(
            f"{name:32s} {met.episodes} episodes ({met.began} from a verified start), holes {list(met.holes)}, named "
            f"{met.by_rule}, clearance of the buffer {met.find.clearance:.2f} m at seed {met.find.seed}",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", nargs="?", choices=PARTS)
    part = parser.parse_args().part
    for name, run in zip(PARTS, (known, count, bare, strata, weak, bold), strict=True):
        if part in (None, name):
            run()


if __name__ == "__main__":
    main()
