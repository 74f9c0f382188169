"""The shield's reports in the logs of a training run."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from shield.decision import Intervention
from shield.errors import ConfigError

__all__ = ["ShieldCallback"]


class ShieldCallback(BaseCallback):
    """Logs the reports of `ShieldedEnv` while an SB3 model learns, to TensorBoard if that is configured.

    Means over the decisions between two dumps of the logger: `shield/overridden`, `shield/held_back`,
    `shield/frames_overridden`, `shield/violations`, `shield/margin` [m] where it is finite, `shield/latency_ms`. The
    share of each reason that occurred is `shield/reason/...`.

    Raises
    ------
    ConfigError
        At the first step, if an environment has no shield.

    Examples
    --------
    >>> ShieldCallback().verbose
    0
    """

    def _on_step(self) -> bool:
        reports = [info["shield"] for info in self.locals["infos"] if "shield" in info]
        if len(reports) < len(self.locals["infos"]):
            raise ConfigError(
                f"{len(self.locals['infos']) - len(reports)} of {len(self.locals['infos'])} environments report no "
                "shield: the model learns unshielded there. Put each into one: PPO('MlpPolicy', ShieldedEnv(env)), or "
                "DummyVecEnv([lambda: ShieldedEnv(gym.make(...))])"
            )
        for report in reports:
            for name in ("overridden", "frames_overridden", "violations"):
                self.logger.record_mean(f"shield/{name}", float(report[name]))
            self.logger.record_mean("shield/held_back", float(report["intervention"] == Intervention.HELD_BACK))
            if np.isfinite(report["margin"]):
                self.logger.record_mean("shield/margin", report["margin"])
            self._seen.add(report["reason"])
            for reason in self._seen:
                self.logger.record_mean(f"shield/reason/{reason}", float(report["reason"] == reason))
        # A wrapper outside the shield may hide the attribute.
        with suppress(AttributeError):
            for latency in self.training_env.get_attr("latency"):
                self.logger.record_mean("shield/latency_ms", 1e3 * latency)
        return True

    def _init_callback(self) -> None:
        self._seen: set[str] = set()
