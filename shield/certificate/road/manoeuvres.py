"""Candidate manoeuvres, as commands that are not yet rolled out or judged.

A candidate commits to a target for some frames and then executes the fail-safe manoeuvre: brake to a stop in a lane.
With meta-actions only, the fail-safe is a sequence of meta-actions instead.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from dynamics.scenes.scene import Scene, Target
from dynamics.state import FloatArray, State
from dynamics.vehicle.controllers import KP_SPEED, speed_to_index
from dynamics.vehicle.rollout_kernels import StopTargets
from dynamics.vehicle.rollouts import NO_LIMIT, Rollouts

__all__ = ["Brakes", "Candidates", "Manoeuvres", "brake_candidates", "meta_candidates"]


class Manoeuvres(Protocol):
    """n manoeuvres, with the lanes that each commits to and stops in, (n,)."""

    @property
    def lanes(self) -> Any: ...
    @property
    def fails(self) -> Any: ...

    def paths(self, rollouts: Rollouts, state: FloatArray) -> FloatArray:
        """Road states after each frame, (n, frames, 4), from a road state (4,)."""
        ...


@dataclass(frozen=True, slots=True)
class Candidates:
    """n command sequences.

    Attributes
    ----------
    commands : (n, frames, 3), see `dynamics.vehicle.rollouts`.
    lanes : lane that each commits to first, (n,).
    fails : lane that each ends in, (n,).
    """

    commands: FloatArray
    lanes: Any
    fails: Any

    def paths(self, rollouts: Rollouts, state: FloatArray) -> FloatArray:
        """Road states after each frame, (n, frames, 4), from a road state (4,)."""
        return rollouts.run(state, self.commands)


@dataclass(frozen=True, slots=True)
class Brakes:
    """n targets that are tracked for some frames, followed by braking to a stop.

    Attributes
    ----------
    centers : of the road's lanes [m]. lanes, fails : lanes that each commits to and stops in, (n,).
    speeds : target speeds, (n,) [m/s]. commit, frames : number of frames of commitment, and in total.
    braking : deceleration afterwards [m/s^2].
    """

    centers: FloatArray
    lanes: Any
    fails: Any
    speeds: FloatArray
    commit: int
    frames: int
    braking: float

    def paths(self, rollouts: Rollouts, state: FloatArray) -> FloatArray:
        """Road states after each frame, (n, frames, 4), from a road state (4,)."""
        targets = StopTargets(self.lanes, self.fails, self.speeds, self.commit, self.braking)
        return rollouts.run_brakes(state, self.centers, targets, self.frames)


def brake_candidates(
    scene: Scene, target_lanes: Any, target_speeds: Any, fail_lanes: Any, commit: int, braking: float
) -> Brakes:
    """Commit to each target for `commit` frames, then brake to a stop in the fail-safe lane.

    Parameters
    ----------
    target_lanes, target_speeds, fail_lanes : one of each per candidate, (n,); speeds [m/s].
    braking : deceleration of the fail-safe [m/s^2].
    """
    lanes, fails = np.asarray(target_lanes, np.intp), np.asarray(fail_lanes, np.intp)
    speeds, v0 = np.asarray(target_speeds, dtype=float), float(scene.ego[State.SPEED])
    # After the commitment, the error of the speed has decayed geometrically under the controller; the speed increases
    # with the target speed.
    most = float(speeds.max())
    top = max(v0, most + (v0 - most) * (1 - KP_SPEED * scene.dt) ** commit, 0.0)
    frames = commit + math.ceil(top / (braking * scene.dt)) + 1
    return Brakes(scene.road.centers, lanes, fails, speeds, commit, frames, float(braking))


def meta_candidates(scene: Scene, actions: list[int], horizon: float) -> tuple[Candidates, list[tuple[int, ...]]]:
    """Sequences of meta-actions: each action, then SLOWER to the end.

    A lane change later in the sequence would be no fail-safe: until it has begun, no vehicle can react to it, and
    another vehicle may take the place first.

    Parameters
    ----------
    scene : the scene. actions : the first actions.
    horizon : duration of the sequences if the ego cannot stop [s]; otherwise they last until it stands.

    Returns
    -------
    The candidates, and the action indices of each sequence (one per decision period).
    """
    labels, speeds = scene.control.actions, scene.control.target_speeds
    period, dt = scene.frames_per_decision, scene.dt
    duration = period * dt
    slower = labels.index("SLOWER") if "SLOWER" in labels else labels.index("IDLE")
    if speeds and speeds[0] <= 0 and "SLOWER" in labels:
        step = (speeds[-1] - speeds[0]) / max(len(speeds) - 1, 1)
        periods = 2 + int(np.ceil((max(float(scene.ego[State.SPEED]), 0.0) / step) + 2))
    else:
        periods = max(2, int(np.ceil(horizon / duration)))
    sequences = [(a, *([slower] * (periods - 1))) for a in actions]
    commands = np.empty((len(sequences), periods * period, 3))
    commands[:, :, 2] = NO_LIMIT
    lanes = np.empty(len(sequences), dtype=int)
    fails = np.empty(len(sequences), dtype=int)
    decay = (1 - KP_SPEED * dt) ** period
    for i, sequence in enumerate(sequences):
        target, v = scene.target_of(sequence[0]), float(scene.ego[State.SPEED])
        lanes[i] = target.lane
        for j, action in enumerate(sequence):
            if j and labels[action] == "SLOWER":
                index = max(speed_to_index(v, speeds) - 1, 0)
                target = Target(target.lane, speeds[index])
            rows = slice(j * period, (j + 1) * period)
            commands[i, rows, 0] = scene.road.centers[target.lane]
            commands[i, rows, 1] = target.speed
            v = target.speed + (v - target.speed) * decay
        fails[i] = target.lane
    return Candidates(commands, lanes, fails), sequences
