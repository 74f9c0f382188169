"""The highway-env environments on road networks with traffic that follows from its present state alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.exit_env import ExitEnv
from highway_env.envs.highway_env import HighwayEnv
from highway_env.envs.intersection_env import IntersectionEnv
from highway_env.envs.lane_keeping_env import LaneKeepingEnv
from highway_env.envs.merge_env import MergeEnv
from highway_env.envs.parking_env import ParkingEnv
from highway_env.envs.racetrack_env import RacetrackEnv
from highway_env.envs.roundabout_env import RoundaboutEnv
from highway_env.envs.two_way_env import TwoWayEnv
from highway_env.envs.u_turn_env import UTurnEnv
from highway_env.road.regulation import RegulatedRoad
from highway_env.utils import class_from_path

from dynamics.errors import ConfigError
from dynamics.highway_simulator.kinds import kind_of
from dynamics.highway_simulator.own_methods import check_own_methods
from dynamics.road_networks.traffic.priority_road import PriorityRoad
from dynamics.road_networks.traffic.regulation import TrafficRegulation

__all__ = ["check_network", "exits_of", "may_have_spawned", "on_network", "traffic_regulation_of"]

_KNOWN = (ExitEnv, IntersectionEnv, LaneKeepingEnv, MergeEnv, RacetrackEnv, RoundaboutEnv, TwoWayEnv, UTurnEnv)
"""After the reset, no random draws affect the traffic of these environments, except for new vehicles at an
intersection."""
_AT_CROSSINGS = ("_clear_vehicles", "_spawn_vehicle")
"""Methods by which `IntersectionEnv` changes the traffic between two decisions: vehicles leave near their exits, and
new ones enter."""
_SPAWNED_WITHIN = 15.0
"""Greatest distance along its entrance at which `IntersectionEnv` spawns a vehicle [m]: 5 m, plus a normal deviation of
1 m."""


def on_network(base: Any) -> bool:
    """Whether an environment, unwrapped, has a road other than a straight highway."""
    return isinstance(base, ExitEnv) or not isinstance(base, HighwayEnv)


def check_network(base: Any) -> None:
    """Check that the motion of the traffic of an environment, unwrapped, is known.

    The environment may be of any class. The methods that move its traffic have to be highway-env's own
    (`check_own_methods`). The objects on its road are checked when the scene is read.

    Raises
    ------
    ConfigError
        If a method is not highway-env's own; the message names it. If a vehicle class has an unknown driving model. If
        the environment is a parking lot, or none of highway-env's.
    """
    if not isinstance(base, AbstractEnv) or isinstance(base, ParkingEnv):
        raise ConfigError(
            f"the traffic of {type(base).__name__} does not follow from its state; it does on straight highways "
            f"(highway-v0, highway-fast-v0), in {_names(_KNOWN)}, and in environments made as these are"
        )
    check_own_methods(base, _AT_CROSSINGS if isinstance(base, IntersectionEnv) else ())
    traffic = base.config.get("other_vehicles_type")
    if traffic is not None:
        kind_of(class_from_path(traffic))


def exits_of(base: Any) -> Callable[[tuple[str, str, int]], bool] | None:
    """A function that tells near the ends of which lanes vehicles vanish, by highway-env's index of a lane; None if
    they vanish nowhere."""
    if not isinstance(base, IntersectionEnv):
        return None
    return lambda key: "il" in key[0] and "o" in key[1]


def may_have_spawned(base: Any, body: Any) -> bool:
    """Whether highway-env itself may have placed a body at its present position between two decisions: at an entrance
    of an intersection."""
    if not isinstance(base, IntersectionEnv) or body not in base.road.vehicles or body.lane_index is None:
        return False
    start, end, _ = body.lane_index
    along = float(body.lane.local_coordinates(body.position)[0])
    return start.startswith("o") and end.startswith("ir") and along < _SPAWNED_WITHIN


def traffic_regulation_of(base: Any) -> TrafficRegulation:
    """The rules of an environment's road that act on vehicles beside their driving.

    Raises
    ------
    ConfigError
        If the class of the road is unknown, or vehicles yield for longer than until the next update.
    """
    road, frames = base.road, int(base.config["simulation_frequency"] // base.config["policy_frequency"])
    stay = frames if isinstance(base, IntersectionEnv) else 0
    if not isinstance(road, RegulatedRoad):
        return TrafficRegulation(0, False, stay, 0)
    known = (RegulatedRoad, PriorityRoad)
    if type(road) not in known:
        raise ConfigError(f"the right of way on a {type(road).__name__} is not known; known are {_names(known)}")
    if road.YIELD_DURATION != 0:
        raise ConfigError(f"vehicles yield for {road.YIELD_DURATION} s; only a YIELD_DURATION of 0 is supported")
    period = int(1 / (1 / base.config["simulation_frequency"]) / road.REGULATION_FREQUENCY)
    return TrafficRegulation(period, isinstance(road, PriorityRoad), stay, road.steps - base.steps)


def _names(kinds: tuple[type, ...]) -> str:
    return ", ".join(kind.__name__ for kind in kinds)
