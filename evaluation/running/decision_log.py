"""Log of the decisions of an episode: the episode's columns that come from it, and the rows of `--steps`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from highway_env.envs.common.action import ContinuousAction
from highway_env.vehicle.kinematics import Vehicle

from dynamics.state import FloatArray, wrap_to_pi
from dynamics.vehicle.actuators import Actuators
from evaluation.measuring.jerk import normalised_jerk
from evaluation.measuring.recorder import History, Track
from evaluation.measuring.statistics import quantiles
from shield.decision import Decision

__all__ = ["MEASURED", "DecisionLog", "action_steps"]

MEASURED = (
    *("frame_override_share", "input_distance", "acceleration_distance", "steering_distance", "on_lane_share"),
    *("mean_confidence", "latency_p50_ms", "latency_p99_ms", "latency_max_ms", "mean_reward", "peak_reward"),
    *("peak_speed", "mean_normalised_speed", "peak_jerk", "mean_normalised_jerk", "peak_normalised_jerk"),
)
"""Columns of an episode from `DecisionLog.columns`; see `evaluation.running.records.EpisodeRecord`."""
_STEPS = {
    "LANE_LEFT": (-1, 0),
    "LANE_RIGHT": (1, 0),
    "IDLE": (0, 0),
    "FASTER": (0, 1),
    "SLOWER": (0, -1),
}
"""For each meta-action, the change of the target lane in lanes and of the target speed in steps."""
_SLOW = 0.1
"""Below this speed the steering angle cannot be inferred from the yaw rate [m/s]."""


def action_steps(labels: Mapping[int, str]) -> FloatArray:
    """Change of the target lane and of the target speed by each meta-action, in steps, (actions, 2).

    Parameters
    ----------
    labels : the meta-actions by number, as of highway-env's `DiscreteMetaAction.actions`.

    Examples
    --------
    >>> action_steps({0: "SLOWER", 1: "IDLE"}).tolist()
    [[0.0, -1.0], [0.0, 0.0]]
    """
    return np.array([_STEPS[labels[number]] for number in range(len(labels))], float)


class DecisionLog:
    """Log of the decisions of one episode.

    Parameters
    ----------
    env : the environment that is driven, with its wrappers, after `reset`.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        base: Any = env.unwrapped
        kind = base.action_type
        self._actuators = Actuators.of(kind) if isinstance(kind, ContinuousAction) else None
        labels = getattr(kind, "actions", None)
        self._meta = (
            action_steps(labels) if isinstance(labels, Mapping) and set(labels.values()) <= set(_STEPS) else None
        )
        own = kind.acceleration_range if self._actuators else ContinuousAction.ACCELERATION_RANGE
        self._range = float(own[1] - own[0])
        self._period = 1.0 / base.config["policy_frequency"]
        self._frames = int(base.config["simulation_frequency"] // base.config["policy_frequency"])
        self._confidence = _confidence_column(env)
        self._rows: list[tuple[float, Any, Any, Mapping[str, Any], float]] = []

    def add(
        self, observation: Any, action: Any, reward: float, shield: Mapping[str, Any], decision: Decision | None
    ) -> None:
        """Add a decision.

        Parameters
        ----------
        observation : observation of the decision.
        action : action that the environment, or the shield around it, received.
        reward : reward of the step.
        shield : `info["shield"]` and `latency_ms`.
        decision : the shield's decision about the action; None without a shield.
        """
        proposed, executed = (action, action) if decision is None else (decision.proposed, decision.executed)
        # Derived values are computed at the end of the episode.
        self._rows.append((reward, proposed, executed, shield, self._believed(observation)))

    def columns(self, history: History, latencies: bool) -> dict[str, Any]:
        """The columns `MEASURED` of an episode that has ended.

        Parameters
        ----------
        history : frames of the episode.
        latencies : whether there is a shield, so that latencies exist.
        """
        rewards, _, _, shields, believed = zip(*self._rows, strict=True)
        times = np.array([each["latency_ms"] for each in shields if latencies], float)
        p50, p99 = quantiles(times)
        driven = history.ego if history.crash_frame is None else history.ego[: history.crash_frame + 1]
        sizes, changes = history.jerks(), self._command_changes(history)
        ends = self._ends(history)
        found = {
            "frame_override_share": sum(each["frames_overridden"] for each in shields) / (len(history.states) - 1),
            **dict(zip(_DISTANCES, self.distances().mean(axis=0).tolist(), strict=True)),
            "on_lane_share": float(1.0 - ends[:, Track.OFF_ROAD].mean()),
            "mean_confidence": _mean(np.array(believed)),
            "latency_p50_ms": p50,
            "latency_p99_ms": p99,
            "latency_max_ms": float(times.max()) if times.size else math.nan,
            "mean_reward": float(np.mean(rewards)),
            "peak_reward": max(rewards),
            "peak_speed": float(driven[:, Track.SPEED].max()),
            "mean_normalised_speed": float(np.clip(ends[:, Track.SPEED] / Vehicle.MAX_SPEED, 0.0, 1.0).mean()),
            "peak_jerk": float(sizes.max()) if sizes.size else float("nan"),
            "mean_normalised_jerk": _mean(changes),
            "peak_normalised_jerk": float(np.nanmax(changes)) if np.isfinite(changes).any() else float("nan"),
        }
        # The same NaN object, so that records of the same episode are equal.
        return {key: math.nan if math.isnan(value) else value for key, value in found.items()}

    def steps(self, history: History) -> dict[str, list[Any]]:
        """Columns of the decisions of an episode that has ended: the log, and the ego's state after each decision."""
        ends, inputs = self._ends(history), self._inputs(history)
        rewards, proposed, executed, shields, believed = zip(*self._rows, strict=True)
        return {
            "step": list(range(len(self._rows))),
            "time": [self._period * number for number in range(len(self._rows))],
            "reward": list(rewards),
            "proposed": [_listed(each) for each in proposed],
            "executed": [_listed(each) for each in executed],
            **dict(zip(_DISTANCES, self.distances().T.tolist(), strict=True)),
            **{key: [each[key] for each in shields] for key in _OF_SHIELD},
            "confidence": list(believed),
            "speed": ends[:, Track.SPEED].tolist(),
            "acceleration": inputs[:, 0].tolist(),
            "steering": inputs[:, 1].tolist(),
            "on_lane": (ends[:, Track.OFF_ROAD] == 0).tolist(),
            "crashed": (ends[:, Track.CRASHED] > 0).tolist(),
        }

    def distances(self) -> FloatArray:
        """Distance between proposal and executed action: normalised, [m/s^2] and [rad], (decisions, 3)."""
        return np.array([self._distances(proposed, executed) for _, proposed, executed, _, _ in self._rows])

    def _ends(self, history: History) -> FloatArray:
        """The ego in the last frame of each decision, (decisions, 8)."""
        return history.ego[self._frames :: self._frames]

    def _distances(self, proposed: Any, executed: Any) -> tuple[float, float, float]:
        """Distance between two actions: normalised, [m/s^2] and [rad]; NaN if they are no inputs of one ego."""
        nothing = math.nan
        if proposed is executed and self._actuators is None:
            return (nothing if self._meta is None else 0.0), nothing, nothing
        if self._actuators is None:
            if self._meta is None or np.size(proposed) != 1 or np.size(executed) != 1:
                return nothing, nothing, nothing
            one, other = (self._meta_steps(each) for each in (proposed, executed))
            return nothing if one is None or other is None else float(np.abs(one - other).sum()), nothing, nothing
        one, other = self._actuators.read(proposed), self._actuators.read(executed)
        if one is None or other is None:
            return nothing, nothing, nothing
        push, turn = np.abs(self._actuators.physical(one) - self._actuators.physical(other)).tolist()
        return float(np.linalg.norm(0.5 * (one - other))), push, turn

    def _meta_steps(self, action: Any) -> FloatArray | None:
        assert self._meta is not None
        number = float(np.asarray(action, float).item())
        return self._meta[int(number)] if number == int(number) and 0 <= number < len(self._meta) else None

    def _believed(self, observation: Any) -> float:
        """Mean confidence of the observation's rows that are not empty; NaN without that column."""
        if self._confidence is None:
            return float("nan")
        rows = np.asarray(observation, float)
        there = np.abs(np.delete(rows, self._confidence, axis=1)).max(axis=1) > 0
        return float(rows[there, self._confidence].mean()) if there.any() else float("nan")

    def _inputs(self, history: History) -> FloatArray:
        """Inputs in the last frame of each decision, inferred from the ego's motion by highway-env's bicycle model.

        Returns
        -------
        Acceleration [m/s^2] and front wheel angle [rad], (decisions, 2). NaN from a crash on; the angle is NaN at a
        standstill.
        """
        last = np.arange(self._frames, len(history.states), self._frames)
        before, after = history.moved[last - 1], history.moved[last]
        speed, dt = before[:, Track.SPEED], history.dt
        with np.errstate(invalid="ignore", divide="ignore"):
            turned = wrap_to_pi(after[:, Track.HEADING] - before[:, Track.HEADING])
            slip = np.arcsin(turned * (0.5 * before[:, Track.LENGTH]) / (speed * dt))
            wheel = np.where(np.abs(speed) < _SLOW, np.nan, np.arctan(2.0 * np.tan(slip)))
        inputs = np.column_stack([(after[:, Track.SPEED] - speed) / dt, wheel])
        if history.crash_frame is not None:
            inputs[last >= history.crash_frame] = np.nan
        return inputs

    def _command_changes(self, history: History) -> FloatArray:
        """The normalised jerk from one decision to the next (see `evaluation.measuring.jerk`), (decisions - 1,)."""
        inputs = self._inputs(history)
        return normalised_jerk(inputs[:, 0], inputs[:, 1], self._range)


_DISTANCES = ("input_distance", "acceleration_distance", "steering_distance")
_OF_SHIELD = (
    *("overridden", "intervention", "reason", "tier", "margin", "frames_overridden", "violations", "latency_ms"),
)


def _confidence_column(env: gym.Env[Any, Any]) -> int | None:
    """Index of the confidence column in an observation, counted from the end; None without one."""
    after = 0
    while isinstance(env, gym.Wrapper):
        added = getattr(env, "added_features", ())
        if "confidence" in added:
            return -1 - after - (len(added) - 1 - added.index("confidence"))
        after += len(added)
        env = env.env
    return None


def _listed(action: Any) -> list[float]:
    """An action as numbers; empty if it is no action."""
    try:
        return [float(each) for each in np.ravel(np.asarray(action, float))]
    except (TypeError, ValueError, OverflowError):
        return []


def _mean(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else float("nan")
