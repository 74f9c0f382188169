"""Episodes of variants without a compiled batch, one at a time: shields that read only observations, and the planner
with learned dynamics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from dynamics.highway_simulator.env import CompiledHighwayEnv
from evaluation.reproduction.batch import NOISE_STREAM, setting_for
from evaluation.reproduction.driving import COLUMNS
from evaluation.reproduction.presets import Preset
from evaluation.reproduction.script import confidence_across_features, counts_as_lane_change, noise_on_all_rows
from evaluation.reproduction.text import ConfidenceOverTime
from evaluation.reproduction.variants import ReportVariant
from evaluation.running.episodes import run_paired
from evaluation.running.records import ShieldVariant as Driven
from evaluation.threads import one_thread
from evaluation.wrappers.sensor_noise import SensorNoise, get_sensor
from evaluation.wrappers.skills import Skills, overridden
from shield import Shield, ShieldedEnv

__all__ = ["drive_one_by_one"]

_SLOWER = 4


class _NoisyModel:
    """A model with the observations of `evaluation.reproduction.batch.ObservationChannels`, for a sensor with noise on
    others alone.

    The noise of the ego's row and of absent rows, and the confidence, are added for the model. The shield reads the
    sensor's observations, because the ego measures its own state.
    """

    def __init__(self, preset: Preset, model: Any) -> None:
        self._preset, self._model = preset, model
        self.begin(0)

    def begin(self, seed: int) -> None:
        """Prepare for a new episode."""
        self._generator = np.random.default_rng([seed, NOISE_STREAM])
        self._over_time: ConfidenceOverTime | None = None
        self.actions: list[int] = []
        self.seen: list[Any] = []

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Any, Any]:
        """The model's action."""
        rows = np.asarray(observation, np.float32)
        draws = self._generator.standard_normal((len(rows), 4))
        if self._preset.noise == "all rows":
            draws[1:][rows[1:, 0] > 0] = 0.0
            rows = noise_on_all_rows(rows, draws, self._preset.sigma)
        if self._preset.confidence == "time":
            if self._over_time is None:
                self._over_time = ConfidenceOverTime(1, len(rows))
            column = self._over_time.add(rows[None], np.zeros(1, np.intp))[0]
        else:
            column = confidence_across_features(rows)
        shown = np.column_stack([rows, column]).astype(np.float32)
        action = self._model.predict(shown, deterministic=True)[0]
        self.actions.append(int(action))
        self.seen.append(shown[0])
        return action, state


def drive_one_by_one(preset: Preset, variant: ReportVariant, model: Any, seeds: Sequence[int]) -> pd.DataFrame:
    """Drive an episode for each seed, one at a time.

    Parameters
    ----------
    preset, variant : the variant, one of those that are `pooled`.
    model : an SB3 model; None for the planner.
    seeds : seeds of the episodes.

    Returns
    -------
    A row for each seed, in order (see `evaluation.reproduction.driving.COLUMNS`).
    """
    with one_thread():
        frame = _planned(preset, seeds) if model is None else _observed(preset, variant, model, seeds)
    return frame[list(COLUMNS)]


def _planned(preset: Preset, seeds: Sequence[int]) -> pd.DataFrame:
    """Episodes of the planner with learned dynamics."""
    found = run_paired(preset.setting, "cem", [Driven()], seeds)
    unknown = ["slow", "replaced", "fallbacks", "script_lane_changes", "confidence", "violations"]
    return found.assign(decisions=found["steps"], **dict.fromkeys(unknown, np.nan))


def _observed(preset: Preset, variant: ReportVariant, model: Any, seeds: Sequence[int]) -> pd.DataFrame:
    setting, policy = setting_for(preset, variant), _NoisyModel(preset, model)
    base = CompiledHighwayEnv(setting.env_id, setting.configured)
    env: Any = SensorNoise(base, get_sensor(f"normalised-{preset.sigma:g}"))
    shield, driver = None, policy
    if variant.shield == "env":
        env = ShieldedEnv(env, perception="observation")
    else:
        shield = Shield(policy, env, frames=False, perception="observation")
        driver = shield  # type: ignore[assignment]
    if variant.skills:
        env = Skills(env, preset.skills, interrupt=overridden)
    slow = list(preset.skills).index("SLOW_DOWN") if variant.skills else _SLOWER
    rows = []
    for seed in seeds:
        observation, _ = env.reset(seed=int(seed))
        policy.begin(int(seed))
        total, speeds, overrides, fallbacks, frames, over = 0.0, [], 0, 0, 0, False
        steps = decisions = 0
        while not over:
            start = np.array([decisions == 0])
            action, _ = driver.predict(observation, episode_start=start, deterministic=True)
            observation, reward, terminated, truncated, info = env.step(int(action))
            reported = shield.report() if shield is not None else info["shield"]
            skill = info.get("skill", {"steps": 1, "overridden": reported["overridden"]})
            total += float(reward)
            decisions, steps = decisions + 1, steps + skill["steps"]
            overrides += int(skill["overridden"])
            frames += int(reported["frames_overridden"])
            fallbacks += reported["guarantee"] == "none"
            speeds.append(float(info["speed"]))
            over = bool(terminated or truncated)
        seen = np.array(policy.seen)
        rows.append(
            {
                "seed": int(seed),
                "crashed": bool(info["crashed"]),
                "off_road": any(base.off_road),
                "return": total,
                "steps": steps,
                "decisions": decisions,
                "mean_speed": float(np.mean(speeds)),
                "min_gap": float("nan"),
                "slow": sum(each == slow for each in policy.actions),
                "replaced": 0,
                "overridden": overrides,
                "frames": len(base.frames) - 1,
                "frames_overridden": frames,
                "fallbacks": fallbacks,
                "violations": float("nan"),
                "confidence": float(seen[:, -1].mean()),
                "script_lane_changes": int(counts_as_lane_change(seen[:, None, :]).sum()),
                "simulator": "compiled",
            }
        )
    return pd.DataFrame(rows)
