"""Keys of an environment's configuration that highway-env ignores: at the top level, in observations and in actions."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any

from highway_env.envs.common.action import action_factory
from highway_env.envs.common.observation import observation_factory

from dynamics.errors import nearest_name_hint
from evaluation.settings import Setting

__all__ = ["unknown_keys"]

_FORWARDS = re.compile(r"super\(\)\.__init__\([^)]*\*\*kwargs")
_WITHIN = ("observation_config", "observation_configs", "action_config")
"""Keys of the configurations of several egos, or of several observations."""
_NAMES = {
    "KinematicObservation": "Kinematics",
    "KinematicsGoalObservation": "KinematicsGoal",
    "OccupancyGridObservation": "OccupancyGrid",
    "TimeToCollisionObservation": "TimeToCollision",
}
"""Names in a configuration of classes that have another name there."""
_FACTORIES: Mapping[str, Callable[[Any, Any], Any]] = {"observation": observation_factory, "action": action_factory}


def unknown_keys(setting: Setting) -> list[str]:
    """A line for each key of a setting's own configuration that its environment does not read.

    Valid keys at the top level are those of the class's default configuration and of the registered one. Valid keys of
    observations and actions are the arguments of their types.
    """
    env = setting.make()
    try:
        base: Any = env.unwrapped
        default: dict[str, Any] = getattr(type(base), "default_config", dict)()
        registered = Setting(setting.name, setting.env_id).configured
        messages: list[str] = []
        if default:
            messages += _unknown_key_messages(
                setting.env_id, "its configuration", setting.config, [*default, *registered]
            )
        for name, factory in _FACTORIES.items():
            given = setting.config.get(name)
            if isinstance(given, Mapping):
                # highway-env's own defaults contain ignored keys; copies of them are no mistake.
                usual = default.get(name, {})
                given = {key: value for key, value in given.items() if key not in usual or usual[key] != value}
                of = _Reader(setting.env_id, base, factory)
                messages += of.unknown(f"[{name}]", given, getattr(base, f"{name}_type"))
        return messages
    finally:
        env.close()


class _Reader:
    """Finds ignored keys in the configuration of observations or actions; `factory` makes their types."""

    def __init__(self, env_id: str, base: Any, factory: Callable[[Any, Any], Any]) -> None:
        self._env_id, self._base, self._factory = env_id, base, factory

    def unknown(self, where: str, given: Mapping[str, Any], made: Any) -> Iterator[str]:
        """A line for each key of `given` that the observation or action `made` from it does not read.

        `where` names the section in the message.
        """
        kind = type(made)
        label = f"{where} of type {_NAMES.get(kind.__name__, kind.__name__)}"
        yield from _unknown_key_messages(self._env_id, label, given, arguments_of(kind))
        ranges, features = given.get("features_range"), given.get("features") or getattr(kind, "FEATURES", None)
        if isinstance(ranges, Mapping) and features:
            yield from _unknown_key_messages(self._env_id, f"the features of {label}", ranges, features)
        for key in _WITHIN:
            inner = given.get(key, [])
            for each in [inner] if isinstance(inner, Mapping) else inner:
                yield from self.unknown(f"{where[:-1]}.{key}]", each, self._factory(self._base, each))


def arguments_of(kind: type) -> list[str]:
    """The keys that a type of observation or action reads: the arguments of its constructor, and those of base classes
    to which it passes its other arguments."""
    found = ["type"]
    for each in kind.__mro__:
        own = each.__dict__.get("__init__")
        if own is None or each is object:
            continue
        arguments = inspect.signature(own).parameters.values()
        named = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
        found += [argument.name for argument in arguments if argument.kind in named]
        if not _FORWARDS.search(inspect.getsource(own)):
            break
    return [name for name in found if name not in ("self", "env")]


def _unknown_key_messages(env_id: str, where: str, given: Collection[str], known: Collection[str]) -> Iterator[str]:
    for key in given:
        if key not in known:
            yield f"{env_id} has no {key!r} in {where}, and ignores it{nearest_name_hint(key, known)}"
