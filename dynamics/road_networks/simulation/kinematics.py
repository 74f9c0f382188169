"""highway-env's Kinematics observation without a data frame: the same numbers, in a tenth of the time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from highway_env import utils
from highway_env.envs.common.observation import KinematicObservation, MultiAgentObservation

__all__ = ["without_data_frames"]

_RELATIVE = ("x", "y", "vx", "vy")


def without_data_frames(observation_type: Any) -> None:
    """Replace `observe` of a live observation type, and of the types that it contains, by the fast version.

    Only Kinematics types are changed, unless `observe` is already replaced on the instance. A type that wraps another
    has it as `_inner`.
    """
    for kind in _kinematics_in(observation_type):
        if "observe" not in vars(kind):
            kind.observe = _observer(kind)


def _kinematics_in(kind: Any) -> Iterator[Any]:
    """The Kinematics observation types in an observation type."""
    if type(kind) is KinematicObservation:
        yield kind
    for part in kind.agents_observation_types if type(kind) is MultiAgentObservation else ():
        yield from _kinematics_in(part)
    if hasattr(kind, "_inner"):
        yield from _kinematics_in(kind._inner)


def _observer(kind: Any) -> Callable[[], Any]:
    """The replacement of `KinematicObservation.observe`."""
    features, count, dtype = list(kind.features), kind.vehicles_count, kind.space().dtype
    columns = {feature: [k for k, each in enumerate(features) if each == feature] for feature in features}

    def observe() -> Any:
        env, ego = kind.env, kind.observer_vehicle
        if not env.road:
            return np.zeros(kind.space().shape)
        own = ego.to_dict()
        close = env.road.close_objects_to(
            ego,
            env.PERCEPTION_DISTANCE,
            count=count - 1,
            see_behind=kind.see_behind,
            sort=kind.order == "sorted",
            vehicles_only=not kind.include_obstacles,
        )
        rows = [[own[feature] for feature in features]]
        for body in close[-count + 1 :]:
            seen = body.to_dict(None, observe_intentions=kind.observe_intentions)
            if not kind.absolute:
                seen.update((key, seen[key] - own[key]) for key in _RELATIVE)
            rows.append([seen.get(feature, np.nan) for feature in features])
        observed = np.array(rows, float)
        if kind.normalize:
            kind.normalize_obs({})  # sets `features_range`; nothing is normalised
            for feature, (least, most) in kind.features_range.items():
                for k in columns.get(feature, ()):
                    column = utils.lmap(observed[:, k], [least, most], [-1, 1])
                    observed[:, k] = np.clip(column, -1, 1) if kind.clip else column
        filled = np.zeros((max(count, len(observed)), len(features)))
        filled[: len(observed)] = observed
        if kind.order == "shuffled":
            env.np_random.shuffle(filled[1:])
        return filled.astype(dtype)

    return observe
