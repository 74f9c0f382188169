"""The scene at one instant: the input of a decision.

`SceneReader` reads the simulator's true state. A scene made from observations alone has the same type.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Any

import numpy as np

from dynamics.compiled import kernel_no_refcount
from dynamics.errors import ActionError, SceneError
from dynamics.roads.path_reader import read_network
from dynamics.roads.straight import Road, StraightRoad
from dynamics.state import LEAST, MOST, BoolArray, FloatArray, IntArray, State, Vehicle, readable
from dynamics.vehicle.bicycle import LENGTH
from dynamics.vehicle.controllers import speed_to_index

__all__ = ["LEAST_LAP", "EgoControl", "Scene", "SceneReader", "Target", "has_road_and_vehicles"]

LEAST_LAP = 300.0
"""Length of the shortest closed road that a scene is read on [m]. On shorter ones a vehicle ahead may come to be nearer
from behind within the horizon of a plan."""


@dataclass(frozen=True, slots=True)
class Target:
    """Target command of the ego's low-level controllers: a lane index and a speed [m/s]."""

    lane: int
    speed: float


@dataclass(frozen=True, slots=True)
class EgoControl:
    """The ego's meta-action interface.

    Attributes
    ----------
    target : the present target command.
    target_speeds : the speeds [m/s] that FASTER and SLOWER choose from.
    actions : label of each action index, e.g. ("LANE_LEFT", "IDLE", "LANE_RIGHT", "FASTER", "SLOWER").
    """

    target: Target
    target_speeds: tuple[float, ...] = (20.0, 25.0, 30.0)
    actions: tuple[str, ...] = ("LANE_LEFT", "IDLE", "LANE_RIGHT", "FASTER", "SLOWER")


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Ego, other vehicles, road and timing.

    Attributes
    ----------
    ego : vehicle row, shape (7,), columns `Vehicle`, world frame.
    others : other vehicles and obstacles, shape (n, 7).
    road : the static road map, a `Road`: a `StraightRoad`, or a `PathRoad` for a reader of curved roads.
    control : the ego's meta-action interface.
    dt : duration of a simulation frame [s].
    frames_per_decision : simulation frames in one decision period.
    frame : index of the simulation frame since the episode began, which identifies the instant. If None, each scene
        counts as the next instant.
    ids : identity of each of the others, (n,); -1 if it may change from scene to scene. None if all scenes have the
        same vehicles in the same order.
    observed : whether it was made from observations: the others' states are estimates, and some vehicles may be
        missing.
    blurred : whether the rows of the others are bounds: the greatest extent of each body, the least speed ahead of the
        ego and the greatest speed behind it.
    bodies : the simulator's objects of the others, row by row; None where there are none, or they are not visible.
    likely : the most likely states of the others, (n, 7), if their rows are bounds; None if only the bounds are known.
    """

    ego: FloatArray
    others: FloatArray
    road: Any
    control: EgoControl
    dt: float
    frames_per_decision: int
    frame: int | None = None
    ids: IntArray | None = None
    blurred: bool = False
    likely: FloatArray | None = None
    observed: bool = False
    bodies: Sequence[Any] | None = None
    ego_road: FloatArray = field(init=False, repr=False)
    others_road: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.ego.shape != (len(Vehicle),):
            raise SceneError(f"Scene.ego must have shape ({len(Vehicle)},), got {self.ego.shape}")
        if self.others.ndim != 2 or self.others.shape[1] != len(Vehicle):
            raise SceneError(f"Scene.others must have shape (n, {len(Vehicle)}), got {self.others.shape}")
        if self.ids is not None and self.ids.shape != (len(self.others),):
            raise SceneError(f"Scene.ids must have shape ({len(self.others)},), got {self.ids.shape}")
        if self.likely is not None and self.likely.shape != self.others.shape:
            raise SceneError(
                f"Scene.likely must have the shape of others, {self.others.shape}, got {self.likely.shape}"
            )
        if not self.dt > 0 or self.frames_per_decision < 1:
            raise SceneError(
                f"dt and frames_per_decision must be positive, got {self.dt} s and {self.frames_per_decision}"
            )
        if not 0 <= self.control.target.lane < self.road.centers.size:
            raise SceneError(
                f"target lane {self.control.target.lane} does not exist; the road has lanes "
                f"0 to {self.road.centers.size - 1}"
            )
        object.__setattr__(self, "ego_road", self.road.to_road(self.ego))
        object.__setattr__(self, "others_road", self.road.to_road(self.others, near=float(self.ego_road[0])))

    def with_shrunk_bounds(self, share: float) -> Scene:
        """The scene with bounds shrunk to a share of their distance from the most likely states."""
        if self.likely is None:
            return self
        return replace(self, others=self.likely + share * (self.others - self.likely))

    @property
    def finite(self) -> bool:
        """Whether every number in the scene is readable (see `dynamics.state.readable`)."""
        return math.isfinite(self.control.target.speed) and bool(_finite(self.ego, self.others))

    @property
    def unreadable(self) -> BoolArray:
        """Whether each of the others has a number that is not readable, (n,)."""
        return np.logical_not(readable(self.others).all(axis=1))

    def without(self, left_out: BoolArray) -> Scene:
        """The scene without the vehicles marked in `left_out`, (n,)."""
        kept = ~left_out
        ids = None if self.ids is None else self.ids[kept]
        likely = None if self.likely is None else self.likely[kept]
        bodies = None if self.bodies is None else [body for body, keep in zip(self.bodies, kept, strict=True) if keep]
        return replace(self, others=self.others[kept], ids=ids, likely=likely, bodies=bodies)

    @classmethod
    def from_env(cls, env: Any, curved: bool = False) -> Scene:
        """Read the true state of a highway-env environment once, without ids (see `SceneReader`)."""
        return replace(SceneReader(env, curved).read(), ids=None)

    def target_of(self, action: int) -> Target:
        """The target command after meta-action index `action`.

        Source: `ControlledVehicle.act` and `MDPVehicle.act` of highway-env 1.12.

        Raises
        ------
        ActionError
            If the index is not an action.
        """
        labels = self.control.actions
        if not 0 <= action < len(labels):
            raise ActionError(f"unknown action {action!r}; valid are 0 to {len(labels) - 1}: {labels}")
        label, now = labels[action], self.control.target
        if label in ("FASTER", "SLOWER"):
            speeds = self.control.target_speeds
            step = 1 if label == "FASTER" else -1
            index = speed_to_index(float(self.ego[State.SPEED]), speeds) + step
            return Target(now.lane, speeds[min(max(index, 0), len(speeds) - 1)])
        if label in ("LANE_LEFT", "LANE_RIGHT"):
            step = 1 if label == "LANE_RIGHT" else -1
            lane = min(max(now.lane + step, 0), self.road.centers.size - 1)
            reachable = self.road.reachable(float(self.ego_road[0]), float(self.ego_road[1]))
            return Target(lane if reachable[lane] else now.lane, now.speed)
        return now


@kernel_no_refcount
def _finite(ego: Any, others: Any) -> bool:
    """Whether all rows are within `LEAST` and `MOST`."""
    for c in range(len(ego)):
        if not LEAST[c] <= ego[c] <= MOST[c]:
            return False
    for i in range(others.shape[0]):
        for c in range(others.shape[1]):
            if not LEAST[c] <= others[i, c] <= MOST[c]:
                return False
    return True


def has_road_and_vehicles(base: Any) -> bool:
    """Whether an environment, unwrapped, has the attributes of highway-env's environments."""
    return hasattr(base, "road") and hasattr(base, "controlled_vehicles")


class SceneReader:
    """Reads scenes from the simulator's true state; keeps the road map between reads.

    Parameters
    ----------
    env : a highway-env environment, wrapped or not, with one controlled vehicle.
    curved : whether a curved road may be read, as a `PathRoad`, by a reader with rollouts and bounds that use its
        curvature (`Rollouts(dt, scene.road)`). Otherwise such a road is refused.

    Raises
    ------
    SceneError
        If the environment has no road, several controlled vehicles, or an unsupported road.
    """

    def __init__(self, env: Any, curved: bool = False) -> None:
        base = getattr(env, "unwrapped", env)
        if not has_road_and_vehicles(base):
            raise SceneError(f"{type(base).__name__} is not a highway-env environment: it has no road and vehicles")
        if len(base.controlled_vehicles) != 1:
            raise SceneError(f"the shield supports one controlled vehicle, got {len(base.controlled_vehicles)}")
        self._env = base
        self._network: Any = None
        self._road: Road | None = None
        self._curved = curved
        self._bodies: list[Any] = []
        self._ids = np.zeros(0, np.intp)
        self._next_id = 0

    @property
    def road(self) -> Any:
        """The simulator's road; a new object in each episode."""
        return self._env.road

    @property
    def actions(self) -> tuple[str, ...]:
        """Labels of the meta-actions, by index."""
        return tuple(getattr(self._env.action_type, "actions", {}).values())

    @property
    def map(self) -> Any:
        """The static road map of the last read, a `Road`; None before the first."""
        return self._road

    @property
    def control(self) -> EgoControl:
        """The present target command of the ego, and its possible actions."""
        ego = self._env.vehicle
        return EgoControl(
            target=Target(
                int(getattr(ego, "target_lane_index", ego.lane_index)[2]),
                float(getattr(ego, "target_speed", ego.speed)),
            ),
            target_speeds=tuple(map(float, getattr(ego, "target_speeds", ()))),
            actions=self.actions,
        )

    def check(self) -> None:
        """Read the road map.

        Raises
        ------
        SceneError
            If the road is missing or unsupported, or the ego's length is not that of the rollouts.
        """
        env = self._env
        if env.road is None:
            raise SceneError("the environment has no road yet; call reset() first")
        if env.vehicle is not None and env.vehicle.LENGTH != LENGTH:
            raise SceneError(
                f"the ego is {env.vehicle.LENGTH:g} m long, and plans are rolled out for one of {LENGTH:g} m"
            )
        if env.road.network is not self._network or self._road is None:
            self._road = _road_of(env.road.network, self._curved)
            self._network = env.road.network

    def read(self) -> Scene:
        """The present scene.

        Raises
        ------
        SceneError
            If the road or the ego is missing, or the road is unsupported.
        """
        self.check()
        env = self._env
        ego = env.vehicle
        if ego is None:
            raise SceneError("the environment has no ego vehicle; call reset() first")
        rows, ids, bodies = getattr(env, "rows", None), None, None
        if rows is None:
            bodies = [v for v in env.road.vehicles if v is not ego]
            bodies += [o for o in env.road.objects if o.solid]
            flat = np.fromiter(chain.from_iterable(map(_row, (ego, *bodies))), float)
            rows, ids = flat.reshape(-1, len(Vehicle)), self._ids_of(bodies)
        config = env.config
        return Scene(
            ego=rows[0],
            others=rows[1:],
            road=self._road,
            control=self.control,
            dt=1 / config["simulation_frequency"],
            frames_per_decision=int(config["simulation_frequency"] // config["policy_frequency"]),
            frame=int(env.steps),
            ids=ids,
            bodies=bodies,
        )

    def _ids_of(self, bodies: list[Any]) -> IntArray:
        """A unique number for each object, (n,), which it keeps from scene to scene. The array is the same object if
        the bodies are the same."""
        if bodies != self._bodies:
            known = dict(zip(map(id, self._bodies), self._ids.tolist(), strict=True))
            fresh = range(self._next_id, self._next_id + len(bodies))
            self._next_id = fresh.stop
            # This keeps references to the objects of the last scene, so that no new object has the `id` of one of them.
            self._ids = np.array([known.get(id(b), new) for b, new in zip(bodies, fresh, strict=True)], np.intp)
            self._bodies = bodies
        return self._ids


def _road_of(network: Any, curved: bool) -> Road:
    """The road map of a network: straight, or a path if `curved` roads may be read.

    Raises
    ------
    SceneError
        If the network is no such road, or a closed one shorter than `LEAST_LAP`.
    """
    kinds = {type(lane).__name__ for lane in network.lanes_list()}
    straight = kinds == {"StraightLane"} and sum(map(len, network.graph.values())) == 1
    if straight or not curved:
        return StraightRoad.from_network(network)
    road = read_network(network)
    if road.closed and road.length < LEAST_LAP:
        raise SceneError(
            f"the lap of this closed road is {road.length:.0f} m long; at least {LEAST_LAP:.0f} m is needed, because "
            "each vehicle counts once: ahead of the ego or behind it, by the shorter way round"
        )
    return road


def _row(v: Any) -> tuple[float, ...]:
    """A body as a vehicle row, columns `Vehicle`."""
    x, y = v.position.tolist()
    return (x, y, v.heading, v.speed, v.LENGTH, v.WIDTH, v.crashed)
