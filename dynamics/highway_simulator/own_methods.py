"""Check that an environment moves its traffic by highway-env's own methods, by the class that defines each method."""

from __future__ import annotations

from typing import Any

from dynamics.errors import ConfigError

__all__ = ["check_own_methods"]

_STEPS = ("_simulate", "step")
"""The method that moves the traffic between two decisions, and the one that calls it."""
_OF_ROADS = (
    "act",
    "step",
    "neighbour_vehicles",
    "close_objects_to",
    "close_vehicles_to",
    "enforce_road_rules",
    "respect_priorities",
    "is_conflict_possible",
)
"""The methods by which a road moves its vehicles."""
_KNOWN = ("highway_env", "dynamics")
"""The compiled copies reproduce the methods of these packages."""


def check_own_methods(base: Any, others: tuple[str, ...] = ()) -> None:
    """Check that an environment, unwrapped, and its road move traffic by highway-env's own methods.

    Rewards, observations, ends of episodes and resets may be overridden, because the scene is read as it is. A class
    with `changes_between_decisions_only = True` declares that its `step` changes the road only between two decisions,
    apart from highway-env's `_simulate`.

    Parameters
    ----------
    others : names of further methods that have to be highway-env's own.

    Raises
    ------
    ConfigError
        If one is not. The message names the first such method and the class that defines it.
    """
    declared = getattr(base, "changes_between_decisions_only", False)
    for name in (*_STEPS, *others):
        if name == "step" and declared:
            continue
        own = _owner(base, name)
        if own:
            remedy = (
                "; if its step changes nothing on the road but between two decisions, set "
                "changes_between_decisions_only = True in the class"
                if name == "step"
                else ""
            )
            raise ConfigError(
                f"{type(base).__name__} steps in a way of its own: {own}.{name} is not highway-env's, so its traffic "
                f"may move otherwise than it is simulated{remedy}"
            )
    road = base.road
    for name in _OF_ROADS if road is not None else ():
        # Attributes of the instance are not checked: frames are recorded by such an attribute.
        own = _defined_in(type(road), name)
        if own:
            raise ConfigError(
                f"the road, a {type(road).__name__}, moves its vehicles in a way of its own: {own}.{name} is not "
                "highway-env's"
            )


def _owner(thing: Any, name: str) -> str:
    """The name of the class that defines a method, or of the object with such an attribute. "" if the method is
    highway-env's or this project's, or does not exist."""
    method = vars(thing).get(name)
    if method is not None:
        return "" if _is_known(getattr(method, "__module__", None)) else f"this {type(thing).__name__}"
    return _defined_in(type(thing), name)


def _defined_in(kind: type[Any], name: str) -> str:
    """As `_owner`, for classes only."""
    defines = next((each for each in kind.__mro__ if name in vars(each)), None)
    return "" if defines is None or _is_known(defines.__module__) else defines.__name__


def _is_known(module: str | None) -> bool:
    """Whether a module belongs to highway-env or to this package."""
    return module is not None and module.partition(".")[0] in _KNOWN
