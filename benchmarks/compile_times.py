"""How long numba takes to make the machine code of each part of the shield, with nothing on the disk.

python benchmarks/compile_times.py [--write] [PART ...]

Each part is compiled in a process and with a cache of its own. Times are CPU seconds of the process: wall-clock times
depend on what else the machine does. "estimated" is what `shield.compiling` says, in CPU seconds too: the stored units
times what the reference kernel takes here. With --write the units are stored anew in `shield/compile_units.json`.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from importlib.resources import files
from pathlib import Path

from shield.compiling import UNITS_FILE
from shield.wrappers.warm_parts import PARTS

MEASURE = """
import json, logging, sys, time
import gymnasium as gym, highway_env
from numba.core.event import Listener, install_listener
import shield.compiling as compiling
from shield.wrappers.warm_parts import PARTS

class Times(Listener):
    def __init__(self): self.depth, self.begun, self.each = 0, 0.0, {}
    def on_start(self, event):
        if self.depth == 0: self.begun = time.process_time()
        self.depth += 1
    def on_end(self, event):
        self.depth -= 1
        if self.depth == 0:
            name = event.data["dispatcher"].py_func
            name = f"{name.__module__}.{name.__qualname__}:{compiling.types_digest(event.data['args'])}"
            self.each[name] = self.each.get(name, 0.0) + time.process_time() - self.begun

part = sys.argv[1]
logging.getLogger("shield").setLevel(logging.ERROR)
before = compiling.reference_seconds(time.process_time)
units = compiling.estimated_units(part) if part in compiling.compile_units() else 0.0
compiling._only_speaker = lambda: None
compiling.estimated_units = lambda part: 0.0
times, start = Times(), time.process_time()
with install_listener("numba:compile", times):
    PARTS[part]()
whole = time.process_time() - start
after = compiling.reference_seconds(time.process_time)
print(json.dumps({"reference": (before + after) / 2, "estimated": units * before, "whole": whole, "each": times.each}))
"""


def measured(part: str) -> dict[str, object]:
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
        done = subprocess.run(
            [sys.executable, "-c", MEASURE, part], env=environment, capture_output=True, text=True, check=True
        )
    return dict(json.loads(done.stdout.splitlines()[-1]))


def main() -> None:
    write, path = "--write" in sys.argv, Path(str(files("shield") / UNITS_FILE))
    stored = json.loads(path.read_text(encoding="utf-8"))
    for part in [each for each in sys.argv[1:] if each != "--write"] or PARTS:
        found = measured(part)
        whole, reference, each = found["whole"], found["reference"], dict(found["each"])
        print(
            f"{part}: {whole:.1f} s of CPU, estimated {found['estimated']:.1f} s; of it {sum(each.values()):.1f} s "
            f"compiling, reference {reference:.3f} s",
            flush=True,
        )
        # The rest is shared out: making arrays, writing the machine code to the disk, calling it.
        share = whole / max(sum(each.values()), 1e-9)
        slowest = sorted(each.items(), key=lambda item: -item[1])
        stored[part] = {name: round(share * taken / reference, 1) for name, taken in slowest if taken > 0.05}
        if write:
            kept = {name: stored[name] for name in PARTS if name in stored}
            path.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
