"""A log of how the ego drives: a row for each decision, and a row for each episode.

All numbers are in SI units, see `UNITS`. The ego is on its lane by highway-env's definition, and always on a parking
lot. A decision counts by the state at its end.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd
from highway_env.envs.common.action import ContinuousAction
from highway_env.vehicle.kinematics import Vehicle

from evaluation.measuring.jerk import jerk, normalised_jerk
from evaluation.measuring.recorder import is_off_road
from evaluation.wrappers.checks import check_highway_env, check_number
from evaluation.wrappers.signed_lane import lane_offset
from shield.errors import ConfigError

__all__ = ["MEASURES", "UNITS", "PerformanceLogger"]

MEASURES = ("reward", "speed", "speed_normalised", "jerk", "jerk_normalised", "distance", "collisions", "on_lane_time")
"""Measures with a mean, a peak and a total for each episode."""

_STEP_UNITS = {
    "time": "s",
    "speed": "m/s",
    "acceleration": "m/s^2",
    "steering": "rad",
    "lane_distance": "m",
    "lane_heading": "rad",
    "jerk": "m/s^3",
    "distance": "m",
    "on_lane_time": "s",
}
UNITS: Mapping[str, str] = MappingProxyType(
    {
        **_STEP_UNITS,
        **{
            f"{kind}_{name}": unit
            for kind in ("mean", "peak", "total")
            for name, unit in _STEP_UNITS.items()
            if name in MEASURES
        },
        "duration": "s",
    }
)
"""Units of the columns; a column that is not named has none."""


class PerformanceLogger(gym.Wrapper[Any, Any, Any, Any]):
    """Records every decision of every episode.

    `steps()` has a row for each decision: `episode`, `step`, `time` since reset, `reward`, `speed`, `speed_normalised`
    in [0, 1], the last command (`acceleration`, `steering`), `lane_distance` and `lane_heading` (see `LaneOffset`),
    `jerk` (the physical one) and `jerk_normalised` (that of Dong et al. 2023), `distance` driven in the decision,
    `collisions` (1 if the ego crashes), `on_lane_time`. Both jerks are magnitudes, and NaN before there are enough
    decisions.

    `episodes()` has a row for each episode that has ended, or was stopped by a reset: `episode`, `seed`, `steps`,
    `duration`, `finished`, `success` (None if the environment does not report it), `on_lane_rate`, and for all
    `MEASURES` the mean, the peak and the total over its decisions (without NaN).

    Parameters
    ----------
    env : an environment of highway-env; put wrappers that change its reward inside.
    speed_range : speeds that are normalised to 0 and to 1 [m/s].
    acceleration_range : difference of full throttle and full braking [m/s^2]; by default that of the environment's
        actions, 10 for meta-actions.

    Raises
    ------
    ConfigError
        If a range is empty or not finite.

    Examples
    --------
    >>> from evaluation.settings import get_setting
    >>> env = PerformanceLogger(get_setting("highway-fast").make())
    >>> _ = env.reset(seed=3)
    >>> for _ in range(4):
    ...     _ = env.step(1)
    >>> env.steps()["distance"].round(1).tolist()
    [25.0, 25.0, 25.0, 25.0]
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        speed_range: tuple[float, float] = (0.0, Vehicle.MAX_SPEED),
        acceleration_range: float | None = None,
    ) -> None:
        check_highway_env(env, "PerformanceLogger")
        if np.shape(speed_range) != (2,):
            raise ConfigError(f"speed_range is two speeds, the lower one first, not {speed_range!r}")
        check_number("the lower end of speed_range", speed_range[0])
        check_number("the upper end of speed_range", speed_range[1], above=float(speed_range[0]))
        if acceleration_range is not None:
            check_number("acceleration_range", acceleration_range, above=0.0)
        super().__init__(env)
        self._speeds, self._range = speed_range, acceleration_range
        self._finished: list[tuple[pd.DataFrame, dict[str, Any]]] = []
        self._rows: list[dict[str, Any]] = []
        self._begin = 0.0
        self._seed: int | None = None
        self._done: dict[str, Any] | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment; an unfinished episode is closed."""
        self._close_episode()
        result = self.env.reset(seed=seed, options=options)
        base: Any = self.unwrapped
        self._seed, self._begin = seed, float(base.vehicle.speed)
        return result

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Step the environment, and record the decision."""
        base: Any = self.unwrapped
        crashed, place = bool(base.vehicle.crashed), base.vehicle.position.copy()
        observation, reward, terminated, truncated, info = self.env.step(action)
        ego, offset, dt = base.vehicle, lane_offset(base.vehicle), 1.0 / base.config["policy_frequency"]
        low, high = self._speeds
        self._rows.append(
            {
                "step": len(self._rows),
                "time": dt * (len(self._rows) + 1),
                "reward": float(reward),
                "speed": float(ego.speed),
                "speed_normalised": float(np.clip((ego.speed - low) / (high - low), 0.0, 1.0)),
                "acceleration": float(ego.action["acceleration"]),
                "steering": float(ego.action["steering"]),
                "lane_distance": offset.distance,
                "lane_heading": offset.heading,
                "distance": float(np.hypot(*(ego.position - place))),
                "collisions": int(ego.crashed and not crashed),
                "on_lane_time": dt * (not is_off_road(base)),
            }
        )
        if terminated or truncated:
            self._done = dict(info)
        return observation, float(reward), terminated, truncated, info

    def steps(self) -> pd.DataFrame:
        """A row for each decision so far, of all episodes."""
        tables = [table for table, _ in self._finished] + ([self._table()] if self._rows else [])
        return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame({"episode": [], "step": []})

    def episodes(self) -> pd.DataFrame:
        """A row for each episode that has ended."""
        rows = [row for _, row in self._finished]
        if self._done is not None:
            rows.append(self._episode(self._table()))
        return pd.DataFrame(rows)

    def to_csv(self, path: str | Path) -> tuple[Path, Path]:
        """Write NAME-steps.csv and NAME-episodes.csv, and return their paths.

        Parameters
        ----------
        path : NAME.csv; folders are created.

        Raises
        ------
        ConfigError
            If it does not end in .csv.
        """
        return self._write(Path(path), ".csv")

    def to_parquet(self, path: str | Path) -> tuple[Path, Path]:
        """Write NAME-steps.parquet and NAME-episodes.parquet, like `to_csv`."""
        return self._write(Path(path), ".parquet")

    def _write(self, path: Path, ending: str) -> tuple[Path, Path]:
        if path.suffix != ending:
            raise ConfigError(f"{path.name!r} must end in {ending}")
        path.parent.mkdir(parents=True, exist_ok=True)
        paths = path.with_stem(f"{path.stem}-steps"), path.with_stem(f"{path.stem}-episodes")
        for table, file in zip((self.steps(), self.episodes()), paths, strict=True):
            table.to_csv(file, index=False) if ending == ".csv" else table.to_parquet(file, index=False)
        return paths

    def _close_episode(self) -> None:
        if self._rows:
            table = self._table()
            self._finished.append((table, self._episode(table)))
        self._rows, self._done = [], None

    def _table(self) -> pd.DataFrame:
        """The decisions of the present episode."""
        base: Any = self.unwrapped
        table = pd.DataFrame(self._rows)
        table.insert(0, "episode", len(self._finished))
        dt = 1.0 / base.config["policy_frequency"]
        # The speed at reset comes first, so the jerk needs one earlier decision; commands have no value at reset.
        speeds = [self._begin, *table["speed"]]
        commands = table["acceleration"], table["steering"], self._acceleration_range()
        table["jerk"] = np.concatenate([[np.nan], jerk(speeds, dt)])
        table["jerk_normalised"] = np.concatenate([[np.nan], normalised_jerk(*commands)])
        return table

    def _acceleration_range(self) -> float:
        if self._range is not None:
            return self._range
        kind = self.unwrapped.action_type  # type: ignore[attr-defined]
        low, high = (
            kind.acceleration_range if isinstance(kind, ContinuousAction) else ContinuousAction.ACCELERATION_RANGE
        )
        return float(high - low)

    def _episode(self, table: pd.DataFrame) -> dict[str, Any]:
        base: Any = self.unwrapped
        duration = len(table) / base.config["policy_frequency"]
        row: dict[str, Any] = {
            "episode": len(self._finished),
            "seed": self._seed,
            "steps": len(table),
            "duration": duration,
            "finished": self._done is not None,
            "success": None if self._done is None else self._done.get("is_success", self._done.get("success")),
            "on_lane_rate": float(table["on_lane_time"].sum() / duration),
        }
        for kind in ("mean", "max", "sum"):
            values = table[list(MEASURES)].agg(kind)
            name = {"max": "peak", "sum": "total"}.get(kind, kind)
            row |= {f"{name}_{measure}": float(values[measure]) for measure in MEASURES}
        return row
