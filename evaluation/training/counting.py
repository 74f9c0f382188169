"""Counts of a training."""

from __future__ import annotations

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

__all__ = ["CountSteps"]


class CountSteps(BaseCallback):
    """Counts episodes, crashes and overridden steps of a training.

    Attributes
    ----------
    counts : "episodes" that ended, "crashes", and "overridden", the number of steps that the shield overrode.
    """

    def __init__(self) -> None:
        super().__init__()
        self.counts = {"episodes": 0, "crashes": 0, "overridden": 0}

    def _on_step(self) -> bool:
        infos = self.locals["infos"]
        self.counts["episodes"] += int(np.sum(self.locals["dones"]))
        self.counts["crashes"] += sum(
            bool(info.get("crashed")) for info, done in zip(infos, self.locals["dones"], strict=True) if done
        )
        self.counts["overridden"] += sum(bool(info.get("shield", {}).get("overridden")) for info in infos)
        return True
