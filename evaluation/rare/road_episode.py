"""One episode on a network of roads in which every choice is a number that is handed in: a search can move in it.

The numbers say which scene it is, what the ego proposes, and what each driver of `evaluation.rare.attack` does and
where it turns. What is tested is the claim of `shield.roads`: whatever the others do is named by the monitor in the
frame in which it breaks a rule, or brings nobody nearer to the ego than its buffer. So what counts is how near those
come whom the monitor has not named, from when something is verified, and as long as nobody named has been in the way
of it, nor a wreck that was none before. Whoever owes the ego its distance may come into its buffer; of it the bodies
count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtri

from dynamics.state import FloatArray
from dynamics.traffic.assumptions import Assumptions
from dynamics.traffic.permits import footprint, gap_between
from evaluation.rare.attack import DRIVERS, man
from evaluation.settings import Setting
from evaluation.threads import one_thread
from shield import ShieldConfig, ShieldedEnv
from shield.config import Buffer
from shield.decision import Decision
from shield.doors.road_door import RoadDoor
from shield.errors import ConfigError
from shield.roads.watch import Breach

__all__ = ["SCENES", "RoadEpisode", "RoadNumbers", "Script", "drive_numbers"]

SCENES = 100_000
"""So many seeds, from one on, are the scenes of a search."""
BUFFER = Buffer()
"""Whoever comes nearer to the ego has breached it, whatever the shield is told."""
_RULES = Assumptions.roads()
_FAIL_SAFE = 9.8
"""How hard the ego may brake at any time [m/s^2]."""
_HOLDS, _TURNS = {"bold": 60, "wild": 120, "mixed": 120}, 12
"""So many numbers say what a driver holds and for how long, and where it turns; after the last they begin again."""
_SHRINKS = 1e-6
"""By so much a margin has become less, and not by rounding [m]."""


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
    drivers : of `evaluation.rare.attack.DRIVERS`. first : the first of the `SCENES` seeds.
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


class _Referee:
    """Sees every frame: how near whom comes, and whom the monitor has named of them, a frame later."""

    def __init__(self, base: Any, door: RoadDoor) -> None:
        self._base, self._door, self._step, self._ask = base, door, base.road.step, door.frame
        self._near: list[tuple[Any, int, float, float]] = []
        self._promised, self._crashes, self.frames, self.counted = False, door.by_rule.get(Breach.CRASH, 0), 0, 0
        self.clearance, self.near, self.who, self.when = np.inf, np.inf, -1, -1
        self.margin, self.shrunk = np.inf, 0
        base.road.step = self._watched
        door.frame = self._asked  # type: ignore[method-assign]

    @property
    def over(self) -> bool:
        """Whether there is nothing more to be seen."""
        return bool(self._base.vehicle.crashed) or self.clearance < 0 or Breach.UNFORESEEN in self._door.watch.by_rule

    def settle(self, named: set[Any]) -> None:
        """Count those who were near when last seen and have not been named."""
        for body, place, gap, left in self._near:
            if body in named:
                continue
            self.near = min(self.near, left)
            if gap < self.clearance:
                self.clearance, self.who, self.when = gap, place, self.frames
        self._near = []

    def _asked(self) -> tuple[Any, Decision]:
        before = self._door.watch.last
        command, decision = self._ask()
        named = self._door.watch.culprits
        self.settle(named)
        less = {body: now for body, (then, now) in self._door.kept.items() if now < then - _SHRINKS}
        if less and before is not None and self._promised:
            innocent = less.keys() - named - self._door.have_broken(less, before)
            self.shrunk += bool(innocent)
            self.margin = min(self.margin, *(less[body] for body in innocent), np.inf)
        crashes = self._door.by_rule.get(Breach.CRASH, 0)
        # Two that have crashed into one another slide: they are no longer among those who offend.
        disturbed = self._door.disturbed or crashes > self._crashes
        if decision.tier.verified or disturbed:
            self._promised = decision.tier.verified
        self._crashes = crashes
        return command, decision

    def _watched(self, dt: float) -> None:
        base, ego = self._base, self._base.vehicle
        was_over = self.over
        sound = [(k, b) for k, b in enumerate(base.road.vehicles) if b is not ego and not b.crashed]
        owing = {body for _, body in sound if self._door.is_owed_by(body)}
        self._step(dt)
        self.frames += 1
        if was_over or not self._promised:
            return
        self.counted += 1
        bodies = [*sound, *((-1, thing) for thing in base.road.objects)]
        rows = np.array([_row(ego), *(_row(body) for _, body in bodies)])
        for i, (place, body) in enumerate(bodies, start=1):
            gap = _gap(rows, i, body in owing)
            self._near.append((body, place, gap, _left(gap, *rows[[i, 0], 3]) if body in owing else gap))
        if ego.crashed:
            hit = {body for _, body in sound if body.crashed}
            self.settle(self._door.culprits(hit) | self._door.watch.culprits)


def _row(body: Any) -> list[float]:
    speed = float(getattr(body, "speed", 0.0))
    return [*body.position, body.heading, speed, body.LENGTH, body.WIDTH, 0.0]


def _gap(rows: FloatArray, i: int, owing: bool) -> float:
    """Of the ego, the first of the rows, with its buffer or without, from vehicle i [m]."""
    buffer = Buffer(0.0, 0.0) if owing else BUFFER
    mine = footprint(rows[0], buffer.longitudinal, buffer.lateral)
    return float(gap_between(mine, mine.along, mine.across, rows, i, 0.0))


def _left(gap: float, speed: float, ego: float) -> float:
    """What is left of a gap when one that follows the ego brakes as it owes it, and the ego as hard as it can [m]."""
    v = max(speed, 0.0)
    return gap - v * _RULES.reaction_time - v**2 / (2 * _RULES.follower_braking) + ego**2 / (2 * _FAIL_SAFE)


def drive_numbers(
    setting: Setting, numbers: RoadNumbers, shares: FloatArray, config: ShieldConfig | None = None
) -> RoadEpisode:
    """One episode of a shielded ego among such drivers, as far as the first hole.

    Parameters
    ----------
    shares : numbers from 0 to 1, (`numbers.count`,). config : settings; those for the road's traffic by default.

    Raises
    ------
    ConfigError
        If there are not as many numbers, or the environment is none of a road network with meta-actions.
    """
    if shares.shape != (numbers.count,):
        raise ConfigError(f"have {numbers.count} numbers for an episode, not shape {shares.shape}")
    with one_thread():
        env = ShieldedEnv(setting.make(), config)
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
    referee, ended = _Referee(base, door), False
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
