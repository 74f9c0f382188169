"""How soon a monitor notices that noise has become three times as large, and how often it cries wolf: always FASTER
behind the shield.

At each decision a copy of what the shield perceives goes on through the same noise, three times as large, for the
frames of that one decision, while the traffic is that of the shield that sees as before. A decision without anybody in
sight counts for neither.

    python benchmarks/monitor.py [--episodes 12] [--seed 100000]
"""

from __future__ import annotations

import argparse
import copy
from typing import Any

import numpy as np
from bad_sensors import drive, shielded

from shield import PerceptionConfig
from shield.perception.perceiving import ObservationPerception

SENSORS = {"0.5 m, 0.5 m/s": [0.5] * 4, "2 m, 2 m/s": [2.0] * 4, "40 m, 2.4 m, 16 m/s": [40.0, 2.4, 16.0, 16.0]}
TIMES = 3.0


class Trial:
    """One sensor, and what its monitor says; `alarms` of `decisions`, and `noticed` of `changes`."""

    def __init__(self, sigma: list[float], kind: str) -> None:
        self.env, self.sensor = shielded(np.array(sigma), kind, PerceptionConfig(monitor=True))
        self.alarms = self.decisions = self.noticed = self.changes = 0

    def drive(self, seed: int) -> None:
        """An episode."""
        reader: Any = None
        shadow: ObservationPerception | None = None
        calm, loud, seen, see = False, False, 0, ObservationPerception.see

        def watched(own: ObservationPerception, observation: Any, frame: int, control: Any) -> Any:
            nonlocal shadow, calm, loud, seen
            frames = own._timing[1]
            if own is reader.perception and (not own._egos or own._egos[-1][0] != frame) and frame > 0:
                if frame % frames == 1:
                    shadow, calm, loud, seen = copy.deepcopy(own), False, False, 0
                if shadow is not None:
                    see(shadow, self.sensor.shown(TIMES), frame, control)
                    loud |= shadow.alarmed
                scene = see(own, observation, frame, control)
                calm |= own.alarmed
                seen += own.monitor.recent[-1][2] if own.monitor.recent else 0
                if frame % frames == 0 and seen and shadow is not None:
                    self.decisions, self.alarms = self.decisions + 1, self.alarms + calm
                    self.changes, self.noticed = self.changes + 1, self.noticed + loud
                return scene
            return see(own, observation, frame, control)

        self.env.reset(seed=seed)
        reader = self.env.filter.reader  # type: ignore[union-attr]
        ObservationPerception.see = watched  # type: ignore[method-assign]
        try:
            for _ in drive(self.env, seed):
                pass
        finally:
            ObservationPerception.see = see  # type: ignore[method-assign]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=12)
    parser.add_argument("--seed", type=int, default=100_000)
    asked = parser.parse_args()
    print("| sensor | noise | decisions | false alarms | three times as large, noticed within the decision |")
    print("| :-- | :-- | --: | --: | --: |")
    for name, sigma in SENSORS.items():
        for kind in ("gaussian", "tails"):
            trial = Trial(sigma, kind)
            for seed in range(asked.seed, asked.seed + asked.episodes):
                trial.drive(seed)
            wolf, noticed = trial.alarms / trial.decisions, trial.noticed / trial.changes
            print(
                f"| {name} | {kind} | {trial.decisions} | {trial.alarms} ({wolf:.2%}) | "
                f"{trial.noticed} of {trial.changes} ({noticed:.2%}) |",
                flush=True,
            )


if __name__ == "__main__":
    main()
