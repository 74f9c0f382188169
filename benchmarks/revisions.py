"""How much faster one revision's shielded highways are than another's: both in the same run, in turns of half a second.

    git worktree add /tmp/before REVISION
    python benchmarks/revisions.py /tmp/before . [--env highway-fast-v0] [--rounds 15]

Decisions a second of processor time, 64 environments, always FASTER: the median of each, and of the ratios.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

WORKER = """
import sys, time
import numpy as np
from shield.batch.highways import ShieldedHighways

highways, actions = ShieldedHighways(sys.argv[1], 64), np.full(64, 3)
highways.reset(range(64))
highways.step(actions, again=True)
print("ready", flush=True)
for _ in sys.stdin:
    start, n = time.process_time(), 0
    while time.process_time() - start < 0.5:
        highways.step(actions, again=True)
        n += 64
    print(n / (time.process_time() - start), flush=True)
"""


def worker(checkout: Path, env_id: str) -> subprocess.Popen[str]:
    """A process that measures once for each line that it is sent."""
    environment = {**os.environ, "PYTHONPATH": str(checkout.resolve()), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-c", WORKER, env_id]
    made = subprocess.Popen(
        command, cwd=checkout, env=environment, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert made.stdout is not None
    while (line := made.stdout.readline()) != "ready\n":  # it may have to compile first
        if not line:
            raise SystemExit(f"{checkout}: it ended with {made.wait()} before it was ready")
    return made


def measured(one: subprocess.Popen[str]) -> float:
    """Decisions a second, once."""
    assert one.stdin is not None
    assert one.stdout is not None
    one.stdin.write("\n")
    one.stdin.flush()
    return float(one.stdout.readline())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("--env", default="highway-fast-v0")
    parser.add_argument("--rounds", type=int, default=15)
    arguments = parser.parse_args()
    both = [worker(checkout, arguments.env) for checkout in (arguments.before, arguments.after)]
    rates = np.array([[measured(one) for one in both] for _ in range(arguments.rounds)])
    for one in both:
        one.communicate()
    before, after = np.median(rates, axis=0)
    ratio, least = np.median(rates[:, 1] / rates[:, 0]), 1e6 / rates.max(axis=0)
    print(f"{arguments.env}: {before:.0f} /s before, {after:.0f} /s after; {ratio:.2f} x")
    print(f"at best {least[0]:.0f} and {least[1]:.0f} us a decision")


if __name__ == "__main__":
    main()
