"""What the shield drives: each environment that highway-env registers, and those of `evaluation`, with each kind of
action behind each wrapper, made, reset and driven for one decision.

    python benchmarks/what_it_drives.py > tables.md     # those of docs/lab/what-it-drives.md and docs/what-it-drives.md
    python benchmarks/what_it_drives.py --reasons parking-v0 merge-v0      # why not
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
from gymnasium.envs.registration import load_env_creator

import evaluation.scenarios
import evaluation.wrappers  # noqa: F401  (registers the -continuous ones)
from shield import Shield, ShieldedEnv
from shield.decision import Reason
from shield.errors import ShieldError

ACTIONS = ("DiscreteMetaAction", "ContinuousAction", "DiscreteAction")
WRAPPERS: Mapping[str, Callable[[Any, Any, str | None], Any]] = {
    "`ShieldedEnv`": lambda env, action, config: ShieldedEnv(env, config),
    "`Shield`": lambda env, action, config: Shield(lambda observation: action, env, config),
    "`Shield(frames=False)`": lambda env, action, config: Shield(lambda observation: action, env, config, frames=False),
}
CONFIGS: Mapping[str, Callable[[], str | None]] = {
    "default": lambda: None,
    "worst case": lambda: "worst-case",
    "simulated": lambda: "simulated",
}
"""None is what a wrapper takes by itself."""
FAILED = (Reason.BAD_SCENE, Reason.BAD_ACTION, Reason.STAGE_FAILED, Reason.POLICY_FAILED)


class Row(NamedTuple):
    """One environment with one kind of action: for each of the settings and each wrapper the refusal, "" if there is
    none."""

    env_id: str
    action: str
    why: tuple[str, ...]


def env_ids() -> list[str]:
    """What highway-env registers, in its order, then `evaluation`, by name: its own order depends on the imports."""
    homes: dict[str, list[str]] = {"highway_env.": [], "evaluation.": []}
    for name, spec in gym.registry.items():
        for home, names in homes.items():
            if str(spec.entry_point).startswith(home):
                names.append(name)
    return [*homes["highway_env."], *sorted(homes["evaluation."])]


def config_of(env_id: str, action: str) -> dict[str, Any] | None:
    """What gives an environment this kind of action: nothing where it has it by itself."""
    if "-continuous-" in env_id:
        return {} if action == "ContinuousAction" else None
    creator: Any = load_env_creator(str(gym.spec(env_id).entry_point))
    own = creator.default_config()["action"]
    if own.get("action_config", own)["type"] == action:
        return {}
    other = {"type": action}
    return {"action": {**own, "action_config": other} if "action_config" in own else other}


def made(env_id: str, config: dict[str, Any]) -> Any:
    """The environment; two of highway-env's take no configuration at all."""
    return gym.make(env_id, **({"config": config} if config else {}))


def idle(env: Any) -> Any:
    """An action of the space that asks for nothing."""

    def one(space: Any) -> Any:
        if isinstance(space, gym.spaces.Tuple):
            return tuple(map(one, space))
        if isinstance(space, gym.spaces.Box):
            return np.zeros(space.shape, space.dtype)
        # Of meta-actions IDLE, of a grid its middle.
        return 1 if space.n in (3, 5) else int(space.n) // 2

    return one(env.action_space)


def refusal(env_id: str, config: dict[str, Any], wrapper: str, settings: str | None) -> str:
    """Why a wrapper does not serve an environment, "" where it has decided in it."""
    env = made(env_id, config)
    try:
        observation, _ = env.reset(seed=0)
        action = idle(env)
        shielded = WRAPPERS[wrapper](env, action, settings)
        if isinstance(shielded, ShieldedEnv):
            shielded.reset(seed=0)
            shielded.step(action)
        else:
            env.step(shielded.predict(observation)[0])
        reasons = {decision.reason for decision in shielded.last_decisions or [shielded.last_decision]}
        return ", ".join(f"failed: {reason}" for reason in reasons & set(FAILED))
    except ShieldError as error:
        return str(error)
    finally:
        env.close()


def rows(env_id: str) -> Iterator[Row]:
    """One for each kind of action with which highway-env itself drives the environment."""
    for action in ACTIONS:
        config = config_of(env_id, action)
        if config is None:
            continue
        try:
            env = made(env_id, config)
            env.reset(seed=0)
            env.step(idle(env))
        except Exception as error:
            print(f"{env_id} with {action}: {type(error).__name__}: {error}", file=sys.stderr)
            continue
        why = (refusal(env_id, config, wrapper, settings()) for settings in CONFIGS.values() for wrapper in WRAPPERS)
        yield Row(env_id, action, tuple(why))


def table(found: Iterable[Row]) -> str:
    """Markdown; environments that are served alike share a row."""
    alike: dict[tuple[str, tuple[bool, ...]], list[str]] = {}
    for row in found:
        alike.setdefault((row.action, tuple(not why for why in row.why)), []).append(row.env_id)
    columns = [f"{settings}: {wrapper}" for settings in CONFIGS for wrapper in WRAPPERS]
    lines = [f"| environments | actions | {' | '.join(columns)} |", f"| :-- | :-- |{' :-: |' * len(columns)}"]
    for (action, served), names in sorted(alike.items(), key=lambda item: ACTIONS.index(item[0][0])):
        cells = " | ".join("yes" if there else "–" for there in served)
        lines.append(f"| {versions(names)} | `{action}` | {cells} |")
    return "\n".join(lines)


def short_table(found: Iterable[Row]) -> str:
    """Markdown: the wrappers that serve each environment with their default settings, a column for each kind of action.

    "yes" is all wrappers, a dash none. A cell is empty where highway-env does not drive the environment with this
    action.
    """
    cells: dict[str, dict[str, str]] = {}
    for row in found:
        served = [wrapper for wrapper, why in zip(WRAPPERS, row.why[: len(WRAPPERS)], strict=True) if not why]
        cell = "yes" if len(served) == len(WRAPPERS) else ", ".join(served) or "–"
        cells.setdefault(row.env_id, dict.fromkeys(ACTIONS, ""))[row.action] = cell
    alike: dict[tuple[str, ...], list[str]] = {}
    for env_id, of_actions in cells.items():
        alike.setdefault(tuple(of_actions.values()), []).append(env_id)
    lines = [f"| environments | {' | '.join(f'`{action}`' for action in ACTIONS)} |", "| :-- | :-- | :-- | :-- |"]
    lines += [f"| {versions(names)} | {' | '.join(served)} |" for served, names in alike.items()]
    return "\n".join(lines)


def versions(names: Sequence[str]) -> str:
    """Names of environments, those that differ by their version together.

    >>> versions(["merge-v0", "merge-v1", "exit-v0"])
    'merge-v0, v1; exit-v0'
    """
    found: dict[str, list[str]] = {}
    for name in names:
        road, version = name.rsplit("-", 1)
        found.setdefault(road, []).append(version)
    return "; ".join(f"{road}-{', '.join(each)}" for road, each in found.items())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("env_ids", nargs="*", help="all by default")
    parser.add_argument("--reasons", action="store_true", help="why each is not served, in place of the tables")
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    found = [row for env_id in asked.env_ids or env_ids() for row in rows(env_id)]
    if not asked.reasons:
        print(f"{table(found)}\n\n{short_table(found)}")
        return
    columns = [f"{settings}: {wrapper}" for settings in CONFIGS for wrapper in WRAPPERS]
    for row in found:
        for column, why in zip(columns, row.why, strict=True):
            print(f"{row.env_id}, {row.action}, {column}: {why or 'yes'}")


if __name__ == "__main__":
    main()
