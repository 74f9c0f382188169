"""Search for the worst case of the certificate on road networks, over scenes, adversaries and proposals.

An episode in highway-env itself takes about a second, so a search has some hundred of them. A level has 50 episodes, a
fifth of which goes on to the next. The search ends with the first hole.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed
from scipy.special import ndtr

from dynamics.state import FloatArray
from evaluation.falsification.finds import ANY, Find, made_with
from evaluation.falsification.road_episode import RoadEpisode, RoadNumbers, drive_numbers
from evaluation.falsification.subset_simulation import MOST_SHARE, subset_simulation
from evaluation.settings import Setting
from shield.certificate.network.others import has_crossings
from shield.config import ShieldConfig
from shield.errors import ConfigError

__all__ = ["LEVEL", "NetworkSearchResult", "has_network", "search_roads"]

LEVEL = 50
"""Episodes of a level."""
_SHARE = 0.2
"""Share of a level that goes on to the next."""


@dataclass(frozen=True, slots=True)
class NetworkSearchResult:
    """Result of a search.

    Attributes
    ----------
    find : the first hole, or else the episode that came nearest to one (`RoadEpisode.performance`).
    episodes : number of episodes driven.
    hole : whether the find is a hole.
    median : median clearance of the first level, which was drawn at random [m].
    crashed : number of episodes in which the ego crashed.
    by_rule : number of violations by rule.
    frames : number of frames in which the clearance counted.
    shrunk : number of them in which a vehicle without a violation reduced the margin of the verified plan.
    """

    find: Find
    episodes: int
    hole: bool
    median: float
    crashed: int
    by_rule: dict[str, int]
    frames: int
    shrunk: int


def has_network(setting: Setting) -> bool:
    """Whether the scenes of a setting are on a network of several roads, with any kind of action."""
    env = setting.make()
    try:
        env.reset(seed=0)
        return has_crossings(env.unwrapped)
    finally:
        env.close()


class _HoleFound(Exception):
    """Signals the end of the search."""


def search_roads(
    setting: Setting,
    drivers: str,
    config: ShieldConfig | None = None,
    episodes: int = 500,
    seed: int = 0,
    jobs: int = 1,
    drawn: bool = False,
) -> NetworkSearchResult:
    """Search by subset simulation for a vehicle that comes too near to the ego without a recorded violation.

    The search varies scenes, drivers and proposals. It ends with the first hole, or at the limit of episodes.

    Parameters
    ----------
    setting : a road network with meta-actions.
    drivers : one of `evaluation.falsification.network_adversaries.DRIVERS`.
    config : the shield's settings; the worst case of the road's traffic by default.
    episodes : largest number of episodes, at least `LEVEL`.
    seed : seed of the search, and the first of the seeds of its scenes.
    jobs : processes, -1 for one per core.
    drawn : whether all episodes are drawn at random instead, for comparison.

    Raises
    ------
    ConfigError
        If there are too few episodes for a level, `drivers` is unknown, or the environment is no such network.
    """
    if episodes < LEVEL:
        raise ConfigError(f"have at least {LEVEL} episodes, a level's, not {episodes}")
    numbers, driven, points_of = RoadNumbers(drivers, seed), list[RoadEpisode](), list[FloatArray]()
    with Parallel(n_jobs=jobs, return_as="list") as pool:

        def drive(rows: Sequence[FloatArray]) -> list[RoadEpisode]:
            return list(pool(delayed(drive_numbers)(setting, numbers, row, config) for row in rows))

        def performance(points: FloatArray) -> FloatArray:
            shares, at_once = np.minimum(ndtr(points), MOST_SHARE), 1 if jobs == 1 else len(points)
            first = len(driven)
            for k in range(0, len(points), at_once):
                rows = shares[k : k + at_once][: episodes - len(driven)]
                driven.extend(drive(rows))
                points_of.extend(rows)
                if any(each.hole for each in driven[-len(rows) :]) or len(driven) == episodes:
                    raise _HoleFound
            return np.array([each.performance for each in driven[first:]])

        try:
            if drawn:
                performance(np.random.default_rng(seed).standard_normal((episodes, numbers.count)))
            subset_simulation(performance, numbers.count, LEVEL, _SHARE, seed, jumps=1)
        except _HoleFound:
            pass
    return _result(setting, config, numbers, driven, points_of)


def _result(
    setting: Setting,
    config: ShieldConfig | None,
    numbers: RoadNumbers,
    driven: Sequence[RoadEpisode],
    points_of: Sequence[FloatArray],
) -> NetworkSearchResult:
    """Result of a search from its episodes and their points, up to the first hole."""
    last = next((k for k, each in enumerate(driven) if each.hole), len(driven) - 1)
    driven = driven[: last + 1]
    worst = min(range(len(driven)), key=lambda k: driven[k].performance)
    find = Find(
        env_id=setting.env_id,
        config=dict(setting.config),
        shield="" if config is None else config.to_toml(),
        policy=ANY,
        shares=tuple(points_of[worst].tolist()),
        actions=(),
        clearance=driven[worst].clearance,
        drivers=numbers.drivers,
        seed=numbers.first,
        made=made_with(setting, ANY),
    )
    return NetworkSearchResult(
        find=find,
        episodes=len(driven),
        hole=driven[worst].hole,
        median=float(np.median([each.clearance for each in driven[:LEVEL]])),
        crashed=sum(each.crashed for each in driven),
        by_rule=dict(sum((Counter(each.by_rule) for each in driven), Counter())),
        frames=sum(each.counted for each in driven),
        shrunk=sum(each.shrunk for each in driven),
    )
