"""Finds of a search: one episode each, stored in a file and repeatable in highway-env itself."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from dynamics.highway_simulator.simulator import Simulator
from dynamics.road_networks.episodes.scenario import on_roads
from evaluation.falsification.compliant_traffic import drive_compliant
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
    """One repeatable episode.

    Attributes
    ----------
    env_id, config : the environment.
    shield : the shield's settings, TOML; "" for the defaults on a road network.
    shares : random numbers of the scene (see `Simulator.reset_to`), or all numbers of an episode among adversaries on a
        road network (`RoadNumbers`).
    policy : the policy that proposes; with `ANY` the proposals are `actions`.
    actions : the proposals, if the policy is `ANY`.
    clearance : least distance of the ego from another vehicle [m], 0 in a crash. Among other drivers than highway-env's
        own it includes the ego's buffer, and is negative in an intrusion; see `RoadEpisode` on road networks.
    drivers : one of `evaluation.falsification.falsify.TRAFFIC`. `"bold"` on a straight highway is determined by `seed`
        alone, without shares and actions.
    seed : seed of the scene on a road network with highway-env's own traffic; among other drivers there, the first of
        the seeds (`RoadNumbers`).
    made : identity of the environment and the policy, and versions (see `made_with`); empty in older files.
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
        """Read a file that `save` wrote.

        Raises
        ------
        ConfigError
            If the file has another format.
        """
        try:
            data = json.loads(Path(path).read_text(encoding="utf-8"))
            return cls(**{**data, "shares": tuple(data["shares"]), "actions": tuple(data["actions"])})
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise ConfigError(f"{path} is no find of `shield falsify`: {error}") from None


def made_with(setting: Setting, policy: str) -> dict[str, Any]:
    """Identity of the environment and the policy, and versions: see `evaluation.running.identity`."""
    return {"environment": of_environment(setting), "policy": of_policy(policy), "version of": versions()}


def changed(find: Find) -> list[str]:
    """Names of the libraries with other versions than at the time of the find."""
    return differences({"version of": find.made.get("version of", {})}, {"version of": versions()})


def replay(find: Find) -> Find:
    """Drive a find again in highway-env itself, and return it with the clearance measured there.

    Raises
    ------
    ConfigError
        If the environment or the files of the policy have changed since the find.
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
        return replace(find, clearance=drive_compliant(setting, find.seed, shield).clearance)
    env = setting.make()
    policy: Any = _ReplayedActions(find.actions) if find.policy == ANY else make_policy(find.policy, env)
    shielded: Any = env
    if find.policy != ANY:
        start_episode(policy, find.seed)
    if shield.simulates:
        policy = Shield(policy, env, shield, frames=False)
    elif shield.mode != "none":
        shielded = ShieldedEnv(env, shield, policy=None if find.policy == ANY else policy)
    shielded.reset(seed=find.seed)
    if not on_roads(find.env_id):
        simulator = Simulator(find.env_id, 1, setting.configured, replay_draws=True)
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


class _ReplayedActions:
    """Policy that proposes a given sequence of actions, and then repeats the last."""

    def __init__(self, actions: tuple[int, ...]) -> None:
        self._actions, self._step = actions, -1

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """The next action of the sequence; `observation` is ignored."""
        self._step += 1
        return np.asarray(self._actions[min(self._step, len(self._actions) - 1)]), state
