"""Finds of a search: one episode each, in a file, to be driven again in highway-env itself."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from dynamics.highway_simulator.simulator import Simulator
from dynamics.road_networks.episodes.scenario import on_roads
from evaluation.falsification.compliant_traffic import drive_bold
from evaluation.falsification.road_episode import RoadNumbers, drive_numbers
from evaluation.measuring.recorder import Recorder
from evaluation.names import ANY
from evaluation.running.identity import differences, of_environment, of_policy, versions
from evaluation.running.named_policies import make_policy, start_episode
from evaluation.settings import Setting
from shield import Shield, ShieldedEnv
from shield.config import ShieldConfig
from shield.errors import ConfigError

__all__ = ["ANY", "Find", "changed", "made_with", "replay"]


@dataclass(frozen=True, slots=True)
class Find:
    """One episode, to be driven again.

    Attributes
    ----------
    env_id, config : the environment. shield : the shield's settings, TOML; "" for those of the road's own traffic.
    shares : the numbers that its scene is made from (see `Simulator.reset_to`).
    policy : that proposes; of `ANY`, `actions` are what it proposes.
    clearance : the smallest to anybody [m], 0 in a crash; among other drivers than highway-env's own that of the ego
        with its buffer, negative where somebody was in it; see `RoadEpisode` on networks of roads.
    drivers : of `evaluation.falsification.falsify.TRAFFIC`. Among bold ones on straight highways `seed` says
        everything, and there are no shares and actions. On networks of roads it says the scene, where highway-env's
        own traffic drives; among other drivers `shares` say everything, and it is the first of the seeds
        (`RoadNumbers`).
    made : of the environment, of the policy, and versions (see `made_with`); nothing in older files.
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
    made: dict[str, Any] = field(default_factory=dict)

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


def made_with(setting: Setting, policy: str) -> dict[str, Any]:
    """What determines an episode beside the find's own numbers: see `evaluation.running.identity`."""
    return {"environment": of_environment(setting), "policy": of_policy(policy), "version of": versions()}


def changed(find: Find) -> list[str]:
    """Which versions of the libraries are others than those that a find was made with."""
    return differences({"version of": find.made.get("version of", {})}, {"version of": versions()})


def replay(find: Find) -> Find:
    """Drive a find again in highway-env itself; its clearance is what is found there.

    Raises
    ------
    ConfigError
        If the environment or the files of the policy are others than those that it was found with.
    """
    setting, shield = Setting("find", find.env_id, find.config), ShieldConfig.from_toml(find.shield)
    if find.made:
        now, kept = made_with(setting, find.policy), ("environment", "policy")
        differ = differences(*({key: made.get(key) for key in kept} for made in (find.made, now)))
        if differ:
            raise ConfigError(f"this is not what the episode was found with: {', '.join(differ)} differ; search again")
    if find.drivers != "idm" and find.shares:
        numbers, given = RoadNumbers(find.drivers, find.seed), shield if find.shield else None
        return replace(find, clearance=drive_numbers(setting, numbers, np.array(find.shares), given).clearance)
    if find.drivers == "bold":
        return replace(find, clearance=drive_bold(setting, find.seed, shield).clearance)
    env = setting.make()
    policy: Any = _Told(find.actions) if find.policy == ANY else make_policy(find.policy, env)
    shielded: Any = env
    if find.policy != ANY:
        start_episode(policy, find.seed)
    if shield.simulates:
        policy = Shield(policy, env, shield, frames=False)
    elif shield.mode != "none":
        shielded = ShieldedEnv(env, shield, policy=None if find.policy == ANY else policy)
    shielded.reset(seed=find.seed)
    if not on_roads(find.env_id):
        simulator = Simulator(find.env_id, 1, setting.configured, tape=True)
        simulator.reset_to(np.array(find.shares)[None], [0])
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
