"""Position and heading of the ego relative to its lane, with signs.

Both numbers are those of Dong et al. 2023: the distance of the ego from the centre line of its lane, and the difference
of its heading from the lane's. highway-env's y points down, so positions to the right are positive, and so are turns to
the right (clockwise on the screen). The lane is highway-env's lane of the ego: the nearest one in position and heading.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from dynamics.state import wrap_to_pi
from evaluation.wrappers.checks import check_highway_env
from shield.errors import ConfigError

__all__ = ["LaneOffset", "SignedLaneObservation", "extend_observation", "extended_space", "lane_offset"]


class LaneOffset(NamedTuple):
    """Position and heading of a vehicle relative to its lane.

    Attributes
    ----------
    distance : signed distance from the centre line of the lane, positive to the right [m].
    heading : heading of the vehicle minus that of the lane, in (-pi, pi], positive to the right [rad].
    """

    distance: float
    heading: float


_HIGH = np.array([np.inf, np.pi], np.float32)


def lane_offset(vehicle: Any) -> LaneOffset:
    """Position and heading of a vehicle of highway-env relative to its lane.

    Examples
    --------
    >>> from evaluation.settings import get_setting
    >>> env = get_setting("highway-fast").make()
    >>> _ = env.reset(seed=0)
    >>> lane_offset(env.unwrapped.vehicle)
    LaneOffset(distance=0.0, heading=0.0)
    """
    along, distance = vehicle.lane.local_coordinates(vehicle.position)
    # Negated twice, so that the half-open interval is closed at +pi.
    heading = -wrap_to_pi(vehicle.lane.heading_at(along) - vehicle.heading)
    return LaneOffset(float(distance), float(heading) + 0.0)


def extended_space(space: spaces.Space[Any]) -> spaces.Space[Any]:
    """The space of observations with the two numbers of `LaneOffset` added.

    A vector or a table becomes a vector that ends with the two numbers. A picture becomes a dictionary of "observation"
    and "signed_lane". A dictionary gets the key "signed_lane".

    Raises
    ------
    ConfigError
        If the space is neither a Box nor a Dict.
    """
    signed = spaces.Box(-_HIGH, _HIGH, dtype=np.float32)
    if isinstance(space, spaces.Dict):
        return spaces.Dict({**space.spaces, "signed_lane": signed})
    if not isinstance(space, spaces.Box):
        raise ConfigError(f"signed lane observations extend a Box or a Dict, not {type(space).__name__}")
    if len(space.shape) > 2:
        return spaces.Dict({"observation": space, "signed_lane": signed})
    low, high = (np.concatenate([end.ravel(), sign * _HIGH]) for end, sign in ((space.low, -1), (space.high, 1)))
    kind = np.float64 if space.dtype == np.float64 else np.float32
    return spaces.Box(low.astype(kind), high.astype(kind), dtype=kind)


def extend_observation(observation: Any, offset: LaneOffset, space: spaces.Space[Any]) -> Any:
    """An observation with a `LaneOffset` added, in the form of `extended_space`.

    Parameters
    ----------
    observation : the original observation.
    offset : the numbers to add.
    space : the extended space.
    """
    signed = np.array(offset, np.float32)
    if not isinstance(space, spaces.Dict):
        return np.concatenate([np.asarray(observation).ravel(), signed]).astype(space.dtype)
    inner = observation if isinstance(observation, dict) else {"observation": observation}
    return {**inner, "signed_lane": signed}


class SignedLaneObservation(gym.ObservationWrapper[Any, Any, Any]):
    """Adds the signed distance from the centre line of the lane [m] and the signed heading difference [rad].

    Parameters
    ----------
    env : an environment of highway-env; observations are a vector, a table, a picture or a dictionary.

    Raises
    ------
    ConfigError
        If its observations have another form, such as the tuple of several agents.

    Examples
    --------
    >>> from evaluation.settings import get_setting
    >>> env = SignedLaneObservation(get_setting("highway-fast").make())
    >>> observation, _ = env.reset(seed=0)
    >>> observation.shape, [float(x) for x in observation[-2:]]
    ((27,), [0.0, 0.0])
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        check_highway_env(env, "SignedLaneObservation")
        super().__init__(env)
        self.observation_space = extended_space(env.observation_space)

    def observation(self, observation: Any) -> Any:
        """The observation with the two numbers added."""
        vehicle = self.unwrapped.vehicle  # type: ignore[attr-defined]
        return extend_observation(observation, lane_offset(vehicle), self.observation_space)
