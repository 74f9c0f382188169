"""One episode on a network of roads in which every choice is a number that is handed in: a search can move in it.

The numbers say which scene it is, what the ego proposes, and what each driver of
`evaluation.falsification.network_adversaries` does and where it turns. What counts is what
`evaluation.falsification.fault_oracle` says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtri

from dynamics.state import FloatArray
from evaluation.falsification.fault_oracle import Referee
from evaluation.falsification.network_adversaries import DRIVERS, man
from evaluation.settings import Setting
from evaluation.threads import one_thread
from shield import ShieldConfig, ShieldedEnv
from shield.certificate.network.monitor import Breach
from shield.config import WORST_CASE
from shield.errors import ConfigError
from shield.filters.network import RoadDoor

__all__ = ["SCENES", "RoadEpisode", "RoadNumbers", "Script", "drive_numbers"]

SCENES = 100_000
"""So many seeds, from one on, are the scenes of a search."""
_HOLDS, _TURNS = {"bold": 60, "wild": 120, "mixed": 120}, 12
"""So many numbers say what a driver holds and for how long, and where it turns; after the last they begin again."""


class Script:
    """Numbers in the place of a generator's, shares from 0 to 1; after the last they begin again.

    Examples
    --------
    >>> told = Script([0.0, 0.5, 0.99])
    >>> told.integers(2, 20), told.choice([-6.0, 0.0, 3.0, 3.0]), told.integers(3)
    (2, 3.0, 2)
    >>> told.uniform(-3.0, 3.0), told.normal(0.0, 0.3)
    (-3.0, 0.0)
    """

    def __init__(self, shares: Sequence[float] | FloatArray) -> None:
        self._shares, self._next = shares, 0

    def random(self) -> float:
        """The next share."""
        share = float(self._shares[self._next % len(self._shares)])
        self._next += 1
        return share

    def integers(self, low: int, high: int | None = None) -> int:
        """Of those from `low` up to `high`, or from 0 up to `low`; without the last."""
        first, last = (0, low) if high is None else (low, high)
        return first + int(self.random() * (last - first))

    def choice(self, values: Sequence[float]) -> float:
        """One of these."""
        return values[self.integers(len(values))]

    def uniform(self, low: float, high: float) -> float:
        """Between these."""
        return low + (high - low) * self.random()

    def normal(self, mean: float, deviation: float) -> float:
        """Of that distribution, no further out than 4 deviations."""
        return mean + deviation * float(np.clip(ndtri(self.random()), -4.0, 4.0))


@dataclass(frozen=True, slots=True)
class RoadNumbers:
    """What the numbers of an episode stand for.

    Attributes
    ----------
    drivers : of `evaluation.falsification.network_adversaries.DRIVERS`. first : the first of the `SCENES` seeds.
    vehicles : how many of the others are driven. decisions : of the ego, at most.

    Raises
    ------
    ConfigError
        If there are no drivers of that name.
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
        """How many numbers there are: one for the scene, those of the ego, and those of each driver."""
        return 1 + self.decisions + self.vehicles * self.each

    @property
    def each(self) -> int:
        """How many numbers a driver has."""
        return _HOLDS[self.drivers] + _TURNS

    def seed(self, shares: FloatArray) -> int:
        """Of the scene."""
        return self.first + int(shares[0] * SCENES)

    def scripts(self, shares: FloatArray) -> list[tuple[Script, Script]]:
        """What each driver holds, and where it turns."""
        rows = shares[1 + self.decisions :].reshape(self.vehicles, self.each)
        return [(Script(row[:-_TURNS]), Script(row[-_TURNS:])) for row in rows]


@dataclass(frozen=True, slots=True)
class RoadEpisode:
    """What came of one episode.

    Attributes
    ----------
    seed : of its scene. frames : how many there were. counted : in how many the clearance counts.
    clearance : the least separation of the ego with its `BUFFER` from what stands and from whoever is no wreck and has
        not been named; of those who owe it their distance, of the bodies [m]. Infinite where nothing counts.
    near : the same, but of those who owe the ego their distance what is left of it once both have braked [m].
    shrunk : in how many frames the margin of what was verified became less because of one who has broken no rule then,
        and has not been named.
    margin : the least that it became so [m]; infinite where it never did.
    crashed : whether the ego was. by_rule : how often each rule was broken.
    who, when : from whom the clearance is, a place in the road's list, -1 for what stands or nobody; and the frame.
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
    who: int
    when: int

    @property
    def hole(self) -> bool:
        """Whether one whom nobody has named came nearer than it may, or made the fail-safe suffer."""
        return self.clearance < 0 or Breach.UNFORESEEN in self.by_rule

    @property
    def performance(self) -> float:
        """What a search makes small: not positive where there is a hole.

        What is verified holds because from one frame to the next its margin from nobody becomes less who keeps to what
        is assumed. Where it does, that is half a hole, and how little is left says how far it is to a whole one. The
        clearance says less: whoever stands at the edge of the buffer is near, and in no danger. It decides where no
        margin has shrunk, with what those have left who owe the ego their distance.
        """
        if self.hole:
            return -1.0
        return 1.0 + max(self.margin, 0.0) if self.shrunk else 1e3 + min(self.near, 500.0)


def drive_numbers(
    setting: Setting, numbers: RoadNumbers, shares: FloatArray, config: ShieldConfig | None = None
) -> RoadEpisode:
    """One episode of a shielded ego among such drivers, as far as the first hole.

    Parameters
    ----------
    shares : numbers from 0 to 1, (`numbers.count`,).
    config : settings; the worst case of the road's traffic by default.

    Raises
    ------
    ConfigError
        If there are not as many numbers, or the environment is none of a road network with meta-actions.
    """
    if shares.shape != (numbers.count,):
        raise ConfigError(f"have {numbers.count} numbers for an episode, not shape {shares.shape}")
    with one_thread():
        env = ShieldedEnv(setting.make(), config or WORST_CASE)
        try:
            return _drive(env, setting, numbers, shares)
        finally:
            env.close()


def _drive(env: ShieldedEnv, setting: Setting, numbers: RoadNumbers, shares: FloatArray) -> RoadEpisode:
    base: Any = env.unwrapped
    door, seed = env.door, numbers.seed(shares)
    if not isinstance(door, RoadDoor):
        raise ConfigError(f"{setting.name} is no road network with meta-actions, which this attacks")
    env.reset(seed=seed)
    man(env, numbers.drivers, numbers.vehicles, seed, numbers.scripts(shares))
    referee, ended = Referee(base, door), False
    for share in shares[1 : 1 + numbers.decisions]:
        *_, terminated, truncated, _ = env.step(int(share * env.action_space.n))  # type: ignore[attr-defined]
        ended = bool(terminated or truncated)
        if ended or referee.over:
            break
    if not referee.over:
        # The last frame has not been looked at.
        door.frame()
    return RoadEpisode(
        seed=seed,
        frames=referee.frames,
        counted=referee.counted,
        clearance=float(referee.clearance),
        near=float(referee.near),
        shrunk=referee.shrunk,
        margin=float(referee.margin),
        crashed=bool(base.vehicle.crashed),
        by_rule=door.by_rule,
        who=referee.who,
        when=referee.when,
    )
