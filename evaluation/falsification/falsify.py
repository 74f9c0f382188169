"""The search for the worst episode: over the scenes that a reset can make, and over what a policy can propose.

On a straight highway nothing is drawn after the reset, so an episode is a function of the numbers that its scene is
made from, and of the actions. Both are searched at once by subset simulation, for the smallest true clearance. On a
network of roads a scene is that of a seed, which has no neighbours: most moves keep it and change the actions.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from dynamics.road_networks.episodes.scenario import on_roads
from dynamics.state import FloatArray, IntArray
from evaluation.falsification.compliant_traffic import BoldEpisode, drive_bold_many
from evaluation.falsification.finds import Find, made_with
from evaluation.falsification.subset import MOST_SHARE, Subset, subset_simulation
from evaluation.names import ANY, TRAFFIC
from evaluation.running.batch_episodes import Chosen, Many
from evaluation.settings import Setting
from shield.config import ShieldConfig
from shield.errors import ConfigError

__all__ = ["TRAFFIC", "Met", "Searched", "crash_probability", "falsify", "falsify_among"]

_FREE = (ANY, "random")
_SCENES = 100_000
"""So many seeds, from one on, are the scenes of a search on a network of roads."""
_ACTIONS = 40
"""So many actions of an episode are searched at most; what follows is the last of them."""
_LOST = 1e3
"""The clearance of an episode whose first decision finds nothing that verifies [m]: nothing was promised of it."""
_AT_ONCE = 16
"""Episodes among bold drivers, in several processes, before it is asked whether anything was found."""


@dataclass(frozen=True, slots=True)
class Searched:
    """What a search has found.

    Attributes
    ----------
    find : the worst episode. episodes : how many were driven. median : of the clearances in the first of them, which
        were drawn as a reset draws them [m]. crashed : how many of the last level crashed.
    offended : the share of the first in which the traffic broke the assumptions.
    lost : on networks of roads, the share of the first whose first decision found nothing that verifies; of them
        nothing is promised, and they are no finds. None elsewhere.
    """

    find: Find
    episodes: int
    median: float
    crashed: int
    offended: float
    lost: float | None


@dataclass(frozen=True, slots=True)
class Met:
    """What a search among bold drivers has met.

    Attributes
    ----------
    find : the episode that is to be looked at: the first hole, or else the first with somebody named who has done no
        wrong, or else the one with the least clearance. episodes : how many were driven, and how many of them `began`
        with a decision that was verified. named : in how many the monitor named somebody, and by_rule for what.
    holes : seeds of those with a crash or a breach of the buffer and nobody named.
    """

    find: Find
    episodes: int
    began: int
    named: int
    by_rule: dict[str, int]
    holes: tuple[int, ...]


class _Episodes:
    """Points of a standard normal as episodes."""

    def __init__(self, setting: Setting, policy: str, config: ShieldConfig, seed: int = 0) -> None:
        self._free = policy in _FREE
        self.seeded = on_roads(setting.env_id)
        self._many = Many(setting, "idle" if self._free else policy, config, chosen=not self.seeded)
        self.scene, self.labels = 1 if self.seeded else self._many.draws, self._many.actions
        self.steps = min(self._many.steps, _ACTIONS) if self.seeded else self._many.steps
        self.dimensions = self.scene + (self.steps if self._free else 0)
        self._first = seed

    def of(self, points: FloatArray) -> tuple[FloatArray, IntArray | None]:
        """The numbers that the scenes are made from (n, draws), and the actions (n, steps)."""
        shares = np.minimum(ndtr(points), MOST_SHARE)
        actions = (shares[:, self.scene :] * self.labels).astype(np.intp) if self._free else None
        return shares[:, : self.scene], actions

    def seeds(self, shares: FloatArray) -> IntArray:
        """Of scenes on a network of roads, (n,)."""
        return self._first + (shares[:, 0] * _SCENES).astype(np.intp)

    def drive(self, points: FloatArray) -> Chosen:
        """What happens in each."""
        shares, actions = self.of(points)
        if self.seeded:
            return self._many.run_seeds(self.seeds(shares), actions)
        return self._many.run_chosen(shares, actions)


def crash_probability(
    setting: Setting,
    policy: str,
    config: ShieldConfig,
    samples: int = 2_000,
    seed: int = 0,
    share: float = 0.1,
) -> Subset:
    """The probability that an episode ends in a crash.

    What leads there is the least time to a collision at constant velocities: two that pass one another side by side are
    near, and in no danger.

    Parameters
    ----------
    setting, policy : the environment, and the policy by name or as the path of a zip file; or `ANY`.
    config : the shield's settings; of mode "none" without a shield.
    samples, seed, share : see `subset_simulation`.

    Raises
    ------
    ConfigError
        If it is a network of roads, whose scenes are those of seeds.
    """
    if on_roads(setting.env_id):
        raise ConfigError(
            f"the scenes of {setting.name} go by seeds, which lead nowhere; have a straight highway, or count"
            " with `shield certify`"
        )
    episodes = _Episodes(setting, policy, config)
    return subset_simulation(
        lambda points: episodes.drive(points).time_to_collision, episodes.dimensions, samples, share, seed
    )


def falsify(
    setting: Setting,
    policy: str,
    config: ShieldConfig,
    episodes: int = 5_000,
    seed: int = 0,
    samples: int = 500,
) -> Searched:
    """Search for the episode with the smallest true clearance, and see whether the traffic keeps to what is assumed of
    it.

    Parameters
    ----------
    setting, config : as in `crash_probability`; or a network of roads, and settings that simulate. policy : likewise,
        or `ANY`.
    episodes : to drive, about. samples : of each level.
    seed : of the search; on a network of roads the scenes are those of the `_SCENES` seeds from here on.

    Raises
    ------
    ConfigError
        If there are too few episodes for a level, or what drives side by side cannot drive these.
    """
    if episodes < samples:
        raise ConfigError(f"have at least {samples} episodes, a level's, not {episodes}")
    if on_roads(setting.env_id) and not config.simulates:
        raise ConfigError(
            f"highway-env's own traffic on {setting.name} is searched with settings that simulate it"
            " (`shield config --profile exact`); with others have drivers bold, wild or mixed"
        )
    searched, first = _Episodes(setting, policy, config, seed), list[Chosen]()

    def clearance(points: FloatArray) -> FloatArray:
        found = searched.drive(points)
        first.append(found)
        return np.where(found.lost, _LOST, found.clearance) if searched.seeded else found.clearance

    most, jumps = episodes - samples + 1, searched.scene if searched.seeded else 0
    result = subset_simulation(clearance, searched.dimensions, samples, 0.1, seed, most=most, jumps=jumps)
    shares, actions = searched.of(result.points[:1])
    find = Find(
        env_id=setting.env_id,
        config=dict(setting.config),
        shield=config.to_toml(),
        policy=policy if actions is None else ANY,
        shares=() if searched.seeded else tuple(shares[0].tolist()),
        actions=() if actions is None else tuple(actions[0].tolist()),
        clearance=float(result.performance[0]),
        seed=int(searched.seeds(shares)[0]) if searched.seeded else 0,
        made=made_with(setting, policy if actions is None else ANY),
    )
    drawn = first[0]
    return Searched(
        find,
        result.evaluations,
        float(np.median(drawn.clearance)),
        int((result.performance <= 0).sum()),
        float((drawn.offences > 0).mean()),
        float(drawn.lost.mean()) if searched.seeded else None,
    )


def falsify_among(
    setting: Setting, config: ShieldConfig, episodes: int = 5_000, seed: int = 0, lanes: int = 2, jobs: int = 1
) -> Met:
    """Drive among bold drivers in highway-env itself until they have found something out, or for so many episodes.

    They keep to `Assumptions.idm()`. So whoever is named shows that the shield was told something else, and a breach
    with nobody named is a hole in what it makes of it.

    Parameters
    ----------
    setting : a straight highway with meta-actions. config : the shield's settings. episodes : at most.
    seed : of the first; the others follow. lanes : of the road. jobs : processes, -1 for one per core.
    """
    if episodes < 1:
        raise ConfigError(f"have at least 1 episode, not {episodes}")
    road, driven = setting.override({"lanes_count": lanes}), list[BoldEpisode]()
    while len(driven) < episodes and not any(x.told for x in driven):
        first = seed + len(driven)
        more = range(first, min(first + (1 if jobs == 1 else _AT_ONCE), seed + episodes))
        driven += drive_bold_many(road, more, config, jobs=jobs)
    found = next((k for k, x in enumerate(driven) if x.told), len(driven) - 1)
    driven = driven[: found + 1]
    began = [x for x in driven if x.started]
    if not began:
        raise ConfigError(f"none of {len(driven)} episodes began with a decision that was verified")
    worst = min(began, key=lambda x: (not x.unnamed, not x.named, x.clearance))
    by_rule: Counter[str] = sum((Counter(x.named) for x in began), Counter())
    find = Find(
        env_id=road.env_id,
        config=dict(road.config),
        shield=config.to_toml(),
        policy=ANY,
        shares=(),
        actions=(),
        clearance=worst.clearance,
        drivers="bold",
        seed=worst.seed,
        made=made_with(road, ANY),
    )
    holes = tuple(x.seed for x in began if x.unnamed)
    return Met(find, len(driven), len(began), sum(bool(x.named) for x in began), dict(by_rule), holes)
