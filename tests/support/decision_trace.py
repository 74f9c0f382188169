"""Whether two revisions decide the same: a digest of whole shielded episodes, to the bit.

    python tests/support/decision_trace.py --record trace.json    # at the revision before
    python tests/support/decision_trace.py --compare trace.json   # at the one after: names what differs, and fails

In each setting, under several policies, many environments are driven side by side behind their shields, episode after
episode. What goes into a digest, one of each environment: all records of decisions and frames (actions, reasons, tiers,
margins, clauses, vehicles, lanes, accelerations, violations), the bodies after each frame, observations, rewards, ends,
the stored plans, the lanes owned and visible, who owes, breaks and has broken a rule, and the offences by rule.
"""

from __future__ import annotations

import argparse
import json
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from dynamics.traffic.assumptions import Assumptions
from shield import ShieldConfig
from shield.batch.codes import TIERS
from shield.batch.highways import ShieldedHighways
from shield.config import Buffer

TRAFFIC = "highway_env.vehicle.behavior."
TRUCKS = {"other_vehicles_type": "dynamics.traffic.mixed.WithTrucks"}
AGGRESSIVE = {"vehicles_count": 30, "other_vehicles_type": TRAFFIC + "AggressiveVehicle"}
LINEAR = {"lanes_count": 2, "vehicles_count": 12, "other_vehicles_type": TRAFFIC + "LinearVehicle"}
SPEEDS = {"action": {"type": "DiscreteMetaAction", "target_speeds": [0, 5, 10, 15, 20, 25, 30]}}
WEAK = Assumptions(braking=2.0, comfortable_braking=1.0, cut_in=False, turning_action=1.0)
WEAKER = Assumptions(
    braking=1.0, comfortable_braking=0.3, acceleration=0.5, simultaneous_merge=False, cut_in=False, reversing_speed=0.0
)
SETTINGS: dict[str, tuple[str, dict[str, Any], ShieldConfig, int]] = {
    "fast": ("highway-fast-v0", {}, ShieldConfig(), 64),
    "15 Hz": ("highway-v0", {}, ShieldConfig(), 8),
    "trucks": ("highway-fast-v0", TRUCKS, ShieldConfig(), 32),
    "trucks, 15 Hz": ("highway-v0", {**TRUCKS, "vehicles_count": 25}, ShieldConfig(), 4),
    "aggressive, 15 Hz": ("highway-v0", AGGRESSIVE, ShieldConfig(), 4),
    "linear": ("highway-fast-v0", LINEAR, ShieldConfig(), 16),
    "speeds": ("highway-fast-v0", SPEEDS, ShieldConfig(), 16),
    "one lane": ("highway-fast-v0", {"lanes_count": 1, "vehicles_count": 6}, ShieldConfig(), 16),
    "five lanes": ("highway-fast-v0", {"lanes_count": 5, "vehicles_count": 40}, ShieldConfig(), 16),
    "nobody": ("highway-fast-v0", {"vehicles_count": 0}, ShieldConfig(), 4),
    "dense, 10 Hz": ("highway-fast-v0", {"vehicles_density": 2.5, "simulation_frequency": 10}, ShieldConfig(), 16),
    "rss": ("highway-fast-v0", {}, ShieldConfig(assumptions=Assumptions.rss()), 16),
    "weak": ("highway-fast-v0", {"vehicles_density": 1.5}, ShieldConfig(assumptions=WEAK), 32),
    "weaker": ("highway-fast-v0", {"vehicles_density": 1.5}, ShieldConfig(assumptions=WEAKER), 32),
    "weaker, dense": ("highway-fast-v0", {"vehicles_density": 5.0}, ShieldConfig(assumptions=WEAKER), 32),
    "near": ("highway-fast-v0", {}, ShieldConfig(buffer=Buffer(0.5, 0.0), braking=6.0, perception_range=80.0), 16),
}
POLICIES = ("faster", "random", "weaving", "ranked")


def chosen(policy: str, rng: np.random.Generator, k: int, e: int, actions: int) -> tuple[Any, Any]:
    """What is proposed in each of `e` environments at decision `k`, and the order of the others."""
    if policy == "faster":
        return np.full(e, min(3, actions - 1)), None
    if policy == "weaving":
        return np.full(e, (0, 3, 2, 3)[k % 4]), None
    action = rng.integers(actions, size=e)
    if policy == "random":
        return action, None
    orders = rng.permuted(np.tile(np.arange(actions), (e, 1)), axis=1)
    rest = np.array([row[row != a] for row, a in zip(orders, action, strict=True)])
    return action, np.hstack([rest, np.full((e, 1), -1)])


def put(digests: list[Any], array: Any) -> None:
    """An array of the environments into their digests; every NaN is the same one."""
    array = np.asarray(array)
    if array.dtype.kind == "f":
        array = np.where(np.isnan(array), np.array(np.nan, array.dtype), array)
    for digest, row in zip(digests, array, strict=True):
        digest.update(np.ascontiguousarray(row).tobytes())


def trace(name: str, policy: str, seed: int, decisions: int) -> tuple[list[str], dict[str, int]]:
    """The digest of each environment, and how often each tier was met."""
    env_id, config, shield, e = SETTINGS[name]
    highways = ShieldedHighways(env_id, e, config, shield)
    digests, rng = [sha256() for _ in range(e)], np.random.default_rng(seed)
    put(digests, highways.reset(range(seed, seed + e)))
    actions, met = len(highways.parameters.labels), np.zeros(len(TIERS), dtype=int)
    for k in range(decisions):
        for array in highways.step(*chosen(policy, rng, k, e, actions), again=True):
            put(digests, array)
        for array in highways.records:
            put(digests, array)
        put(digests, highways.rows)
        put(digests, highways.off_road)
        s = highways.shields
        for array in (s.stored, s.visible, s.owned, s.obliged, s.breaking, s.offenders, s.offences, s.by_rule):
            put(digests, array)
        for tiers in (highways.records.tier, highways.records.tiers):
            met += np.bincount(tiers.ravel(), minlength=len(TIERS))
    return [digest.hexdigest() for digest in digests], {str(TIERS[t]): int(met[t]) for t in np.flatnonzero(met)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--record", type=Path)
    parser.add_argument("--compare", type=Path)
    parser.add_argument("--seed", type=int, default=4_000)
    parser.add_argument("--decisions", type=int, default=35)
    parser.add_argument("--only", nargs="*", default=list(SETTINGS), help="settings")
    arguments = parser.parse_args()
    before = json.loads(arguments.compare.read_text()) if arguments.compare else {}
    found, differ = {}, 0
    for name in arguments.only:
        for policy in POLICIES:
            key = f"{name}; {policy}; {arguments.seed}; {arguments.decisions}"
            found[key], tiers = trace(name, policy, arguments.seed, arguments.decisions)
            told = ""
            if arguments.compare:
                if key not in before:
                    raise SystemExit(f"{arguments.compare} has no {key!r}; have {', '.join(before)}")
                other = [e for e, (a, b) in enumerate(zip(found[key], before[key], strict=True)) if a != b]
                differ += len(other)
                told = f"DIFFERENT in environments {other}" if other else "the same"
            print(f"{key:32s} {told:10s} {tiers}", flush=True)
    if arguments.record:
        arguments.record.write_text(json.dumps(found, indent=1))
    if differ:
        raise SystemExit(f"{differ} environments differ")


if __name__ == "__main__":
    main()
