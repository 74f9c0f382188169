"""Grades of a safety monitor by the exact simulator: drivers bare and behind the monitor, on the same seeds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from dynamics.state import IntArray
from dynamics.world_model.monitor import SafetyMonitor
from evaluation.measuring.statistics import wilson
from evaluation.training.monitor import filtered_driver, grade, named_driver
from evaluation.training.safety_labels import EpisodeOutcomes, LabelledHighways, LabelledStates, gather_episodes

__all__ = ["grade_drivers"]

_SIDE_BY_SIDE = 250
"""Number of episodes that are driven side by side."""


def grade_drivers(
    monitor: SafetyMonitor,
    drivers: Sequence[str],
    seeds: range,
    env_id: str = "highway-fast-v0",
    config: Mapping[str, Any] | None = None,
    progress: Callable[[str], None] = lambda line: None,
) -> pd.DataFrame:
    """A row for each driver, bare and behind the monitor.

    Parameters
    ----------
    drivers : names, see `evaluation.training.monitor.named_driver`. seeds : of the episodes.
    env_id, config : the highway. progress : called with a line after each driver.

    Returns
    -------
    Columns: driver, monitor, episodes, crashed, crash_low, crash_high (95 % Wilson interval), return, speed [m/s],
    overridden (share of the decisions), executed_unsafe (share of the decisions in which an action without a verified
    continuation was executed while another had one), and the fields of `MonitorGrade`.
    """
    rows = []
    for name in drivers:
        for behind in (False, True):
            states, outcomes, overridden = _driven(monitor if behind else None, name, seeds, (env_id, config, monitor))
            crashed, n = int(outcomes.crashed.sum()), len(outcomes.crashed)
            rate = wilson(crashed, n)
            each = np.arange(len(states.executed))
            avoidable = states.unsafe[each, states.executed] & ~states.unsafe.all(axis=1)
            rows.append(
                {
                    "driver": name,
                    "monitor": behind,
                    "episodes": n,
                    "crashed": crashed / n,
                    "crash_low": rate.low,
                    "crash_high": rate.high,
                    "return": float(outcomes.returns.mean()),
                    "speed": float(outcomes.speeds.mean()),
                    "overridden": overridden,
                    "executed_unsafe": float(avoidable.mean()),
                    **grade(monitor, states, outcomes)._asdict(),
                }
            )
            progress(f"{name}{' behind the monitor' if behind else ''}: {crashed} of {n} crashed")
    return pd.DataFrame(rows)


def _driven(
    filtering: SafetyMonitor | None, name: str, seeds: range, place: tuple[str, Any, SafetyMonitor]
) -> tuple[LabelledStates, EpisodeOutcomes, float]:
    """States and outcomes of one episode for each seed, and the share of the decisions that were overridden."""
    env_id, config, monitor = place
    parts, outcomes, overridden = [], [], []
    for k in range(0, len(seeds), _SIDE_BY_SIDE):
        some = seeds[k : k + _SIDE_BY_SIDE]
        world = LabelledHighways(len(some), env_id, config, monitor.config.view)
        inner = named_driver(name, monitor.config.actions)
        proposals: list[IntArray] = []
        drive = inner if filtering is None else filtered_driver(filtering, _kept(inner, proposals))
        states, found = gather_episodes(world, drive, some[0])
        parts.append(states)
        outcomes.append(found)
        if filtering is not None:
            proposed = np.stack(proposals)[states.steps, states.episodes]
            overridden.append(proposed != states.executed)
    share = float(np.concatenate(overridden).mean()) if overridden else 0.0
    joined = EpisodeOutcomes(*(np.concatenate(columns) for columns in zip(*outcomes, strict=True)))
    return _joined(parts, [len(found.crashed) for found in outcomes]), joined, share


def _kept(drive: Any, proposals: list[IntArray]) -> Any:
    """A driver whose actions are appended to a list."""

    def driven(frames: Any, rng: np.random.Generator) -> IntArray:
        proposals.append(drive(frames, rng))
        return proposals[-1]

    return driven


def _joined(parts: list[LabelledStates], counts: list[int]) -> LabelledStates:
    """States of several batches of episodes, with the episodes numbered throughout."""
    first = np.cumsum([0, *counts[:-1]])
    numbered = [part._replace(episodes=part.episodes + k) for part, k in zip(parts, first, strict=True)]
    return LabelledStates(*(np.concatenate(columns) for columns in zip(*numbered, strict=True)))
