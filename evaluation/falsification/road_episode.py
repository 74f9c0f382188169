"""One episode on a road network as a function of numbers, so that a search can vary every choice in it.

The numbers determine the scene, the ego's proposals, and the inputs and turns of each driver of
`evaluation.falsification.network_adversaries`. `evaluation.falsification.fault_oracle` evaluates the episode.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtri

from dynamics.state import FloatArray
from evaluation.falsification.fault_oracle import FaultOracle
from evaluation.falsification.network_adversaries import DRIVERS, install_drivers
from evaluation.settings import Setting
from evaluation.threads import one_thread
from shield import ShieldConfig, ShieldedEnv
from shield.certificate.network.monitor import NetworkRule
from shield.config import WORST_CASE
from shield.errors import ConfigError
from shield.filters.network import NetworkFilter

__all__ = ["SCENES", "RoadEpisode", "RoadNumbers", "Script", "drive_numbers"]

SCENES = 100_000
"""Number of consecutive seeds that are the scenes of a search."""
_HOLDS, _TURNS = {"bold": 60, "wild": 120, "mixed": 120}, 12
"""Numbers of a driver for its inputs and their durations, and for its turns; they repeat after the last."""


class Script:
    """Replays given numbers with the methods of a random generator; they repeat after the last.

    Parameters
    ----------
    uniforms : numbers from 0 to 1.

    Examples
    --------
    >>> script = Script([0.0, 0.5, 0.99])
    >>> script.integers(2, 20), script.choice([-6.0, 0.0, 3.0, 3.0]), script.integers(3)
    (2, 3.0, 2)
    >>> script.uniform(-3.0, 3.0), script.normal(0.0, 0.3)
    (-3.0, 0.0)
    """

    def __init__(self, uniforms: Sequence[float] | FloatArray) -> None:
        self._uniforms, self._next = uniforms, 0

    def random(self) -> float:
        """The next number, from 0 to 1."""
        share = float(self._uniforms[self._next % len(self._uniforms)])
        self._next += 1
        return share

    def integers(self, low: int, high: int | None = None) -> int:
        """An integer from `low` to `high`, or from 0 to `low`; the upper end is exclusive."""
        first, last = (0, low) if high is None else (low, high)
        return first + int(self.random() * (last - first))

    def choice(self, values: Sequence[float]) -> float:
        """One of the values."""
        return values[self.integers(len(values))]

    def uniform(self, low: float, high: float) -> float:
        """A number between `low` and `high`."""
        return low + (high - low) * self.random()

    def normal(self, mean: float, deviation: float) -> float:
        """A normally distributed number, at most 4 deviations from the mean."""
        return mean + deviation * float(np.clip(ndtri(self.random()), -4.0, 4.0))


@dataclass(frozen=True, slots=True)
class RoadNumbers:
    """Meaning of the numbers of an episode.

    Attributes
    ----------
    drivers : one of `evaluation.falsification.network_adversaries.DRIVERS`.
    first : first of the `SCENES` seeds.
    vehicles : number of vehicles that are replaced by adversaries.
    decisions : largest number of decisions of the ego.

    Raises
    ------
    ConfigError
        If `drivers` is unknown.
    """

    drivers: str
    first: int = 0
    vehicles: int = 8
    decisions: int = 20

    def __post_init__(self) -> None:
        if self.drivers not in DRIVERS:
            raise ConfigError(f"unknown drivers {self.drivers!r}; have {', '.join(DRIVERS)}")

    @property
    def count(self) -> int:
        """Total of numbers: one for the scene, one for each decision of the ego, and those of each driver."""
        return 1 + self.decisions + self.vehicles * self.each

    @property
    def each(self) -> int:
        """Numbers of a driver."""
        return _HOLDS[self.drivers] + _TURNS

    def seed(self, uniforms: FloatArray) -> int:
        """Seed of the scene."""
        return self.first + int(uniforms[0] * SCENES)

    def scripts(self, uniforms: FloatArray) -> list[tuple[Script, Script]]:
        """For each driver, the numbers of its inputs and of its turns."""
        rows = uniforms[1 + self.decisions :].reshape(self.vehicles, self.each)
        return [(Script(row[:-_TURNS]), Script(row[-_TURNS:])) for row in rows]


@dataclass(frozen=True, slots=True)
class RoadEpisode:
    """Result of one episode.

    Attributes
    ----------
    seed : seed of its scene.
    frames : number of frames.
    counted : number of frames in which the clearance counts.
    clearance : least distance from the ego with its `BUFFER` to an obstacle, or to a vehicle that is no wreck and has
        no recorded violation [m]. For vehicles that must keep their distance from the ego, the distance of the
        bodies. Infinite where nothing counts.
    near : like `clearance`, but for vehicles that must keep their distance from the ego the gap that is left after
        both have braked [m].
    shrunk : number of frames in which a vehicle without a violation reduced the margin of the verified plan.
    margin : least margin after such a reduction [m]; infinite without one.
    crashed : whether the ego crashed.
    by_rule : number of violations by rule.
    nearest_vehicle : index in the road's list of the vehicle with the clearance; -1 for an obstacle or none.
    when : frame of the clearance.
    """

    seed: int
    frames: int
    counted: int
    clearance: float
    near: float
    shrunk: int
    margin: float
    crashed: bool
    by_rule: dict[str, int]
    nearest_vehicle: int
    when: int

    @property
    def hole(self) -> bool:
        """Whether a vehicle without a recorded violation came too near, or took the margin of the fail-safe."""
        return self.clearance < 0 or NetworkRule.UNFORESEEN in self.by_rule

    @property
    def performance(self) -> float:
        """Objective of the search, to be minimised; not positive for a hole.

        A verified plan stays verified because no vehicle that keeps to the assumptions can reduce its margin from one
        frame to the next. A reduction is a partial hole, and the remaining margin measures the distance to a hole. The
        clearance is a weaker measure, since a vehicle at rest beside the buffer is near and in no danger. It decides
        only where no margin has shrunk, in the form of `near`.
        """
        if self.hole:
            return -1.0
        return 1.0 + max(self.margin, 0.0) if self.shrunk else 1e3 + min(self.near, 500.0)


def drive_numbers(
    setting: Setting, numbers: RoadNumbers, uniforms: FloatArray, config: ShieldConfig | None = None
) -> RoadEpisode:
    """Drive one episode of a shielded ego among adversaries, up to the first hole.

    Parameters
    ----------
    setting : a road network with meta-actions.
    numbers : meaning of the numbers.
    uniforms : numbers from 0 to 1, (`numbers.count`,).
    config : the shield's settings; the worst case of the road's traffic by default.

    Raises
    ------
    ConfigError
        If the shape is wrong, or the environment is no road network with meta-actions.
    """
    if uniforms.shape != (numbers.count,):
        raise ConfigError(f"have {numbers.count} numbers for an episode, not shape {uniforms.shape}")
    with one_thread():
        env = ShieldedEnv(setting.make(), config or WORST_CASE)
        try:
            return _drive(env, setting, numbers, uniforms)
        finally:
            env.close()


def _drive(env: ShieldedEnv, setting: Setting, numbers: RoadNumbers, uniforms: FloatArray) -> RoadEpisode:
    base: Any = env.unwrapped
    network_filter, seed = env.filter, numbers.seed(uniforms)
    if not isinstance(network_filter, NetworkFilter):
        raise ConfigError(f"{setting.name} is no road network with meta-actions, which this attacks")
    env.reset(seed=seed)
    install_drivers(env, numbers.drivers, numbers.vehicles, seed, numbers.scripts(uniforms))
    oracle, ended = FaultOracle(base, network_filter), False
    for share in uniforms[1 : 1 + numbers.decisions]:
        *_, terminated, truncated, _ = env.step(int(share * env.action_space.n))  # type: ignore[attr-defined]
        ended = bool(terminated or truncated)
        if ended or oracle.over:
            break
    if not oracle.over:
        # The monitor has not checked the last frame yet.
        network_filter.frame()
    return RoadEpisode(
        seed=seed,
        frames=oracle.frames,
        counted=oracle.counted,
        clearance=float(oracle.clearance),
        near=float(oracle.near),
        shrunk=oracle.shrunk,
        margin=float(oracle.margin),
        crashed=bool(base.vehicle.crashed),
        by_rule=network_filter.by_rule,
        nearest_vehicle=oracle.nearest_vehicle,
        when=oracle.when,
    )
