"""State, constants, buffers and results of many environments, as NamedTuples of arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynamics.state import FloatArray, IntArray

__all__ = [
    "Bodies",
    "LaneNeighbours",
    "Machine",
    "ObservationConfig",
    "Rules",
    "Simulation",
    "StepResults",
    "Work",
    "Worlds",
]


class Machine(NamedTuple):
    """How numpy computes on this machine: `sums_of_numpy`, and the `addresses` of its loops."""

    sums: int
    products: int
    loops: IntArray


class Worlds(NamedTuple):
    """The state of e environments of m bodies (see `layout`).

    Attributes
    ----------
    f, g, p : (e, F, m), (e, G, m) and (e, P, m).
    order : (e, m), bodies by x.
    rows : (e, 6), the random generators. clock : (e,), time since the reset [s].
    """

    f: FloatArray
    g: IntArray
    p: FloatArray
    order: IntArray
    rows: NDArray[np.uint64]
    clock: FloatArray


class Rules(NamedTuple):
    """The constants of all environments.

    Attributes
    ----------
    lanes : (n, LANE_COLUMNS).
    numbers : frames of a decision, vehicles, ego's first lane or -1, whether the traffic checks for collisions, kinds
        of ego and traffic.
    times : duration of a frame, of a decision and of an episode [s].
    spacings : of ego and traffic, and exp(-lanes / 8).
    constants : (1 + c, P), of the ego and of the c classes of the traffic, which alternate.
    ranges : (6, 2), of the parameters that are drawn for each vehicle.
    target_speeds : of the ego [m/s]. labels : of each action: 0 left, 1 none, 2 right, 3 faster, 4 slower.
    reward : weights of collision, right lane, high speed and being on the road; the speeds mapped to 0 and 1 [m/s];
        whether it is normalised; and whether leaving the road ends an episode.
    """

    lanes: FloatArray
    numbers: tuple[int, int, int, int, int, int]
    times: tuple[float, float, float]
    spacings: tuple[float, float, float]
    constants: FloatArray
    ranges: FloatArray
    target_speeds: FloatArray
    labels: IntArray
    reward: tuple[float, float, float, float, float, float, bool, bool]


class ObservationConfig(NamedTuple):
    """The configuration of an observation: see `grid.occupancy_grid`, and `observe.kinematics` if `grid` is empty, (0,
    3)."""

    features: IntArray
    ranges: FloatArray
    switches: tuple[bool, bool, bool, bool, bool, bool]
    places: FloatArray
    grid: FloatArray


class Work(NamedTuple):
    """Buffers of the kernels, overwritten."""

    numbers: FloatArray
    busy: IntArray
    front: IntArray
    rear: IntArray
    corners: FloatArray
    pairs: IntArray
    seen: FloatArray


class StepResults(NamedTuple):
    """Results of a step, one entry for each environment.

    Attributes
    ----------
    observations : (e, bodies, features). terminal : the same at the end of an episode, before a reset.
    reward, terminated, truncated : (e,).
    parts : (e, 4), terms of the reward: crashed, right lane, high speed, on the road.
    speed : (e,), of the ego [m/s].
    """

    observations: NDArray[np.float32]
    terminal: NDArray[np.float32]
    reward: FloatArray
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    parts: FloatArray
    speed: FloatArray


class Simulation(NamedTuple):
    """Everything that a step of many environments reads and writes."""

    machine: Machine
    worlds: Worlds
    rules: Rules
    view: ObservationConfig
    work: Work
    seen: StepResults


class Bodies(NamedTuple):
    """The m bodies of one environment, (F, m), (G, m) and (P, m) (see `layout`), and its lanes, (n, LANE_COLUMNS)."""

    f: FloatArray
    g: IntArray
    p: FloatArray
    lanes: FloatArray


class LaneNeighbours(NamedTuple):
    """The bodies ahead and behind in each lane, of `neighbours.find`."""

    front: IntArray
    rear: IntArray
