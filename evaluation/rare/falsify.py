"""The search for the worst episode: over the scenes that a reset can make, and over what a policy can propose.

On a straight highway nothing is drawn after the reset, so an episode is a function of the numbers that its scene is
made from, and of the actions. Both are searched at once by subset simulation, for the smallest true clearance.
"""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtr

from dynamics.simulator.simulator import Simulator
from dynamics.state import FloatArray, IntArray
from evaluation.measuring.recorder import Recorder
from evaluation.rare.bold import BoldEpisode, drive_bold, drive_bold_many
from evaluation.rare.subset import Subset, subset_simulation
from evaluation.running.many import Chosen, Many
from evaluation.running.named_policies import make_policy, start_episode
from evaluation.settings import Setting
from shield import Shield, ShieldedEnv
from shield.config import ShieldConfig
from shield.errors import ConfigError

__all__ = ["ANY", "TRAFFIC", "Find", "Met", "Searched", "crash_probability", "falsify", "falsify_among", "replay"]

ANY = "any"
"""The policy that may propose anything: its actions are searched too. Drawn evenly, they are those of `random`."""
_FREE = (ANY, "random")
TRAFFIC = ("idm", "bold")
"""Who drives the others: highway-env's own, or as recklessly as the rules permit (`evaluation.rare.bold`)."""
_AT_ONCE = 16
"""Episodes among bold drivers, in several processes, before it is asked whether anything was found."""
_MOST = float(np.nextafter(1.0, 0.0))


@dataclass(frozen=True, slots=True)
class Find:
    """One episode, to be driven again.

    Attributes
    ----------
    env_id, config : the environment. shield : the shield's settings, TOML.
    shares : the numbers that its scene is made from (see `Simulator.reset_to`).
    policy : that proposes; of `ANY`, `actions` are what it proposes.
    clearance : the smallest to anybody [m], 0 in a crash; among bold drivers that of the ego with its buffer, negative
        where somebody was in it.
    drivers : of `TRAFFIC`. Among bold ones `seed` says everything, and there are no shares and actions.
    """

    env_id: str
    config: dict[str, Any]
    shield: str
    policy: str
    shares: tuple[float, ...]
    actions: tuple[int, ...]
    clearance: float
    drivers: str = "idm"
    seed: int = 0

    def save(self, path: str | Path) -> None:
        """Write a JSON file."""
        Path(path).write_text(json.dumps(asdict(self), indent=1) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, path: str | Path) -> Find:
        """Read what `save` wrote.

        Raises
        ------
        ConfigError
            If it is not such a file.
        """
        try:
            data = json.loads(Path(path).read_text(encoding="utf-8"))
            return cls(**{**data, "shares": tuple(data["shares"]), "actions": tuple(data["actions"])})
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise ConfigError(f"{path} is no find of `shield falsify`: {error}") from None


@dataclass(frozen=True, slots=True)
class Searched:
    """What a search has found.

    Attributes
    ----------
    find : the worst episode. episodes : how many were driven. median : of the clearances in the first of them, which
        were drawn as a reset draws them [m]. crashed : how many of the last level crashed.
    offended : the share of the first in which the traffic broke the assumptions.
    """

    find: Find
    episodes: int
    median: float
    crashed: int
    offended: float


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

    def __init__(self, setting: Setting, policy: str, config: ShieldConfig) -> None:
        self._free = policy in _FREE
        self._many = Many(setting, "idle" if self._free else policy, config, chosen=True)
        self.scene, self.steps, self.labels = self._many.draws, self._many.steps, self._many.actions
        self.dimensions = self.scene + (self.steps if self._free else 0)

    def of(self, points: FloatArray) -> tuple[FloatArray, IntArray | None]:
        """The numbers that the scenes are made from (n, draws), and the actions (n, steps)."""
        shares = np.minimum(ndtr(points), _MOST)
        actions = (shares[:, self.scene :] * self.labels).astype(np.intp) if self._free else None
        return shares[:, : self.scene], actions

    def drive(self, points: FloatArray) -> Chosen:
        """What happens in each."""
        return self._many.run_chosen(*self.of(points))


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
    """
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
    setting, config : as in `crash_probability`. policy : likewise, or `ANY`.
    episodes : to drive, about. samples : of each level.
    """
    if episodes < samples:
        raise ConfigError(f"have at least {samples} episodes, a level's, not {episodes}")
    searched, first = _Episodes(setting, policy, config), list[Chosen]()

    def clearance(points: FloatArray) -> FloatArray:
        found = searched.drive(points)
        first.append(found)
        return found.clearance

    most = episodes - samples + 1
    result = subset_simulation(clearance, searched.dimensions, samples, 0.1, seed, most=most)
    shares, actions = searched.of(result.points[:1])
    find = Find(
        env_id=setting.env_id,
        config=dict(setting.config),
        shield=config.to_toml(),
        policy=policy if actions is None else ANY,
        shares=tuple(shares[0].tolist()),
        actions=() if actions is None else tuple(actions[0].tolist()),
        clearance=float(result.performance[0]),
    )
    drawn = first[0]
    return Searched(
        find,
        result.evaluations,
        float(np.median(drawn.clearance)),
        int((result.performance <= 0).sum()),
        float((drawn.offences > 0).mean()),
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
    )
    holes = tuple(x.seed for x in began if x.unnamed)
    return Met(find, len(driven), len(began), sum(bool(x.named) for x in began), dict(by_rule), holes)


def replay(find: Find) -> Find:
    """Drive a find again in highway-env itself; its clearance is what is found there."""
    setting, shield = Setting("find", find.env_id, find.config), ShieldConfig.from_toml(find.shield)
    if find.drivers == "bold":
        return replace(find, clearance=drive_bold(setting, find.seed, shield).clearance)
    simulator = Simulator(find.env_id, 1, find.config, tape=True)
    simulator.reset_to(np.array(find.shares)[None], [0])
    env = setting.make()
    policy: Any = _Told(find.actions) if find.policy == ANY else make_policy(find.policy, env)
    shielded: Any = env
    if find.policy != ANY:
        start_episode(policy, 0)
    if shield.simulates:
        policy = Shield(policy, env, shield, frames=False)
    elif shield.mode != "none":
        shielded = ShieldedEnv(env, shield, policy=None if find.policy == ANY else policy)
    shielded.reset(seed=0)
    simulator.store(env)
    base: Any = env.unwrapped
    obs, recorder, done = base.observation_type.observe(), Recorder(env), False
    while not done:
        action = int(np.asarray(policy.predict(obs, deterministic=True)[0]).item())
        obs, _, terminated, truncated, _ = shielded.step(action)
        done = bool(terminated or truncated)
    env.close()
    return replace(find, clearance=recorder.history().min_gap())


class _Told:
    """Proposes what it is told to, and then the last of it."""

    def __init__(self, actions: tuple[int, ...]) -> None:
        self._actions, self._step = actions, -1

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """The next."""
        self._step += 1
        return np.asarray(self._actions[min(self._step, len(self._actions) - 1)]), state
