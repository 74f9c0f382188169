"""Search for the worst episode: over the scenes that a reset can make, and over the actions of a policy.

On a straight highway nothing is random after the reset. An episode is a function of the random numbers of its scene
and of the actions. Subset simulation searches both at once for the smallest true clearance. On a road network a scene
is determined by a seed, and similar seeds give unrelated scenes. There most moves keep the seed and change the actions.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from dynamics.road_networks.episodes.scenario import on_roads
from dynamics.state import FloatArray, IntArray
from evaluation.falsification.compliant_traffic import CompliantEpisode, drive_compliant_many
from evaluation.falsification.finds import Find, made_with
from evaluation.falsification.subset_simulation import MOST_SHARE, Subset, subset_simulation
from evaluation.names import ANY, TRAFFIC
from evaluation.running.batch_episodes import BatchResult, Many
from evaluation.settings import Setting
from shield.config import ShieldConfig
from shield.errors import ConfigError

__all__ = ["TRAFFIC", "CompliantSearchResult", "FalsificationResult", "crash_probability", "falsify", "falsify_among"]

_FREE = (ANY, "random")
_SCENES = 100_000
"""Number of consecutive seeds that are the scenes of a search on a road network."""
_ACTIONS = 40
"""Largest number of actions that are searched; the last one is repeated until the episode ends."""
_LOST = 1e3
"""Clearance of an episode without a verified first decision, for which nothing is guaranteed [m]."""
_AT_ONCE = 16
"""Episodes among compliant traffic that run in parallel before the results are checked for a find."""


@dataclass(frozen=True, slots=True)
class FalsificationResult:
    """Result of a search.

    Attributes
    ----------
    find : the worst episode.
    episodes : number of episodes driven.
    median : median clearance of the first level, which has the distribution of a reset [m].
    crashed : number of crashes in the last level.
    offended : share of the first level in which the traffic violated the assumptions.
    lost : on road networks, the share of the first level whose first decision is not verified. Nothing is guaranteed
        for these episodes, and they are no finds. None elsewhere.
    """

    find: Find
    episodes: int
    median: float
    crashed: int
    offended: float
    lost: float | None


@dataclass(frozen=True, slots=True)
class CompliantSearchResult:
    """Result of a search among worst-case compliant drivers.

    Attributes
    ----------
    find : the episode to inspect: the first hole, else the first with a violation by a compliant driver, else the one
        with the least clearance.
    episodes : number of episodes driven.
    began : number of episodes that began with a verified decision.
    named : number of episodes in which the monitor recorded a violation.
    by_rule : number of violations by rule.
    holes : seeds of the episodes with a crash or an intrusion into the buffer and no recorded violation.
    """

    find: Find
    episodes: int
    began: int
    named: int
    by_rule: dict[str, int]
    holes: tuple[int, ...]


class _Episodes:
    """Episodes as points of a standard normal distribution."""

    def __init__(self, setting: Setting, policy: str, config: ShieldConfig, seed: int = 0) -> None:
        self._free = policy in _FREE
        self.seeded = on_roads(setting.env_id)
        self._many = Many(setting, "idle" if self._free else policy, config, chosen=not self.seeded)
        self.scene, self.labels = 1 if self.seeded else self._many.draws, self._many.actions
        self.steps = min(self._many.steps, _ACTIONS) if self.seeded else self._many.steps
        self.dimensions = self.scene + (self.steps if self._free else 0)
        self._first = seed

    def of(self, points: FloatArray) -> tuple[FloatArray, IntArray | None]:
        """Random numbers of the scenes (n, draws), and the actions (n, steps) or None, from points (n, dimensions)."""
        uniforms = np.minimum(ndtr(points), MOST_SHARE)
        actions = (uniforms[:, self.scene :] * self.labels).astype(np.intp) if self._free else None
        return uniforms[:, : self.scene], actions

    def seeds(self, uniforms: FloatArray) -> IntArray:
        """Seeds of the scenes on a road network, (n,)."""
        return self._first + (uniforms[:, 0] * _SCENES).astype(np.intp)

    def drive(self, points: FloatArray) -> BatchResult:
        """Drive the episode of each point, and return the results of all."""
        uniforms, actions = self.of(points)
        if self.seeded:
            return self._many.run_seeds(self.seeds(uniforms), actions)
        return self._many.run_chosen(uniforms, actions)


def crash_probability(
    setting: Setting,
    policy: str,
    config: ShieldConfig,
    samples: int = 2_000,
    seed: int = 0,
    share: float = 0.1,
) -> Subset:
    """Estimate the probability that an episode ends in a crash.

    The levels are of the least time to a collision at constant velocities. A distance would not lead to crashes: two
    vehicles side by side are near and in no danger.

    Parameters
    ----------
    setting : the environment, a straight highway.
    policy : name of a policy, path of a zip file, or `ANY`.
    config : the shield's settings; mode "none" for no shield.
    samples, seed, share : see `subset_simulation`.

    Raises
    ------
    ConfigError
        If the setting is a road network, where seeds determine the scenes.
    """
    if on_roads(setting.env_id):
        raise ConfigError(
            f"the scenes of {setting.name} are drawn from seeds, with no direction to search in; have a straight"
            " highway, or count with `shield certify`"
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
) -> FalsificationResult:
    """Search for the episode with the smallest true clearance, and count violations of the assumptions by the traffic.

    Parameters
    ----------
    setting, config : as in `crash_probability`; or a road network, with settings that simulate the traffic.
    policy : as in `crash_probability`; on a road network also `ANY`.
    episodes : approximate number of episodes.
    seed : seed of the search; on a road network also the first of the `_SCENES` seeds of its scenes.
    samples : episodes of each level.

    Raises
    ------
    ConfigError
        If there are too few episodes for a level, or the batch simulator does not support the setting.
    """
    if episodes < samples:
        raise ConfigError(f"have at least {samples} episodes, a level's, not {episodes}")
    if on_roads(setting.env_id) and not config.simulates:
        raise ConfigError(
            f"highway-env's own traffic on {setting.name} is searched with settings that simulate it"
            " (`shield config --profile simulated`); with others have drivers bold, wild or mixed"
        )
    searched, first = _Episodes(setting, policy, config, seed), list[BatchResult]()

    def clearance(points: FloatArray) -> FloatArray:
        found = searched.drive(points)
        first.append(found)
        return np.where(found.lost, _LOST, found.clearance) if searched.seeded else found.clearance

    most, jumps = episodes - samples + 1, searched.scene if searched.seeded else 0
    result = subset_simulation(clearance, searched.dimensions, samples, 0.1, seed, most=most, jumps=jumps)
    uniforms, actions = searched.of(result.points[:1])
    find = Find(
        env_id=setting.env_id,
        config=dict(setting.config),
        shield=config.to_toml(),
        policy=policy if actions is None else ANY,
        shares=() if searched.seeded else tuple(uniforms[0].tolist()),
        actions=() if actions is None else tuple(actions[0].tolist()),
        clearance=float(result.performance[0]),
        seed=int(searched.seeds(uniforms)[0]) if searched.seeded else 0,
        made=made_with(setting, policy if actions is None else ANY),
    )
    drawn = first[0]
    return FalsificationResult(
        find,
        result.evaluations,
        float(np.median(drawn.clearance)),
        int((result.performance <= 0).sum()),
        float((drawn.offences > 0).mean()),
        float(drawn.lost.mean()) if searched.seeded else None,
    )


def falsify_among(
    setting: Setting, config: ShieldConfig, episodes: int = 5_000, seed: int = 0, lanes: int = 2, jobs: int = 1
) -> CompliantSearchResult:
    """Drive among worst-case compliant drivers in highway-env itself, until the first find or the limit of episodes.

    The drivers keep to `Assumptions.idm()`. A recorded violation shows that the shield has other assumptions. An
    intrusion into the buffer without a recorded violation is a hole in the certificate.

    Parameters
    ----------
    setting : a straight highway with meta-actions.
    config : the shield's settings.
    episodes : largest number of episodes.
    seed : seed of the first episode; the others follow.
    lanes : number of lanes of the road.
    jobs : processes, -1 for one per core.

    Raises
    ------
    ConfigError
        If `episodes` is less than 1, or no episode began with a verified decision.
    """
    if episodes < 1:
        raise ConfigError(f"have at least 1 episode, not {episodes}")
    road, driven = setting.override({"lanes_count": lanes}), list[CompliantEpisode]()
    while len(driven) < episodes and not any(x.is_find for x in driven):
        first = seed + len(driven)
        more = range(first, min(first + (1 if jobs == 1 else _AT_ONCE), seed + episodes))
        driven += drive_compliant_many(road, more, config, jobs=jobs)
    found = next((k for k, x in enumerate(driven) if x.is_find), len(driven) - 1)
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
    return CompliantSearchResult(find, len(driven), len(began), sum(bool(x.named) for x in began), dict(by_rule), holes)
