"""`CompiledFrames`: a live highway-env on a network of roads, of which only the frames are compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import gymnasium as gym

from dynamics.errors import ConfigError
from dynamics.highway_simulator.arithmetic import Sums, sums_of_numpy
from dynamics.road_networks.simulation.kinematics import without_data_frames
from dynamics.road_networks.simulation.simulator import NetworkSimulator
from dynamics.road_networks.simulation.supported_traffic import check_network
from dynamics.state import BoolArray, FloatArray

__all__ = ["CompiledFrames", "Watcher"]

Watcher = Callable[[list[Any], FloatArray, BoolArray], None]
"""Gets the bodies of the road, where they are after each frame of a decision, (frames, m, 7) as of
`NetworkSimulator.step`, and whether the ego is on the road, (frames,)."""


class CompiledFrames(gym.Wrapper[Any, Any, Any, Any]):
    """The frames of each decision compiled, the rest as it is: resets, observations, rewards and what an environment
    changes between two decisions are its own (but that Kinematics is observed without a data frame). The same to the
    last bit (where `exact`), but that vehicles of the linear model collect no `data` for a regression.

    Any actions, and several egos with meta-actions. What looks at single frames (a film) finds only those in which a
    decision is made. Where somebody has a hand in the frames of a vehicle, as a shield that supervises them has, the
    decision is driven by highway-env itself, no faster than without.

    Parameters
    ----------
    env : one of highway-env's environments on a network of roads; racetracks too.

    Raises
    ------
    ConfigError
        If its traffic is not known to follow from its state, it keeps the trajectories of its vehicles, or it is driven
        by hand; at the reset, if its actions are not known.
    SceneError
        At the reset, if its lanes or its vehicles are not known.
    PlatformError
        At the reset, if numpy's own loops cannot be had here.

    Attributes
    ----------
    exact : whether this machine's numpy computes in a way that is known here.
    watchers : called after each decision's frames; a reset forgets them.

    Examples
    --------
    >>> env = CompiledFrames(gym.make("roundabout-v0"))
    >>> obs, info = env.reset(seed=0)
    >>> obs, reward, terminated, truncated, info = env.step(1)
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        base = cast(Any, env.unwrapped)
        check_network(base)
        if base.config.get("show_trajectories") or base.config.get("manual_control"):
            raise ConfigError("frames are not compiled with show_trajectories, nor with manual_control")
        super().__init__(env)
        self._base = base
        self._simulators: dict[int, NetworkSimulator] = {}
        self.watchers: list[Watcher] = []
        self.exact = Sums.OTHER not in sums_of_numpy()

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        """As of the environment."""
        self._simulators, self.watchers = {}, []
        result = self.env.reset(**kwargs)
        self._read()
        without_data_frames(self._base.observation_type)
        # An attribute of the instance hides the method that drives the frames.
        self._base._simulate = self._simulate
        return result

    def close(self) -> None:
        """Give the environment its own frames back, and close it."""
        vars(self._base).pop("_simulate", None)
        super().close()

    def _simulate(self, action: Any = None) -> None:
        """What stands in for highway-env's `AbstractEnv._simulate`."""
        base, config = self._base, self._base.config
        if any("act" in vars(vehicle) for vehicle in base.road.vehicles):
            self._by_itself(action)
            return
        frames = int(config["simulation_frequency"] // config["policy_frequency"])
        if action is not None:
            base.action_type.act(action)
        simulator = self._read()
        rows, on_road = simulator.go_on(frames)
        simulator.store(base)
        base.steps += frames
        base.enable_auto_render = False
        for watch in self.watchers:
            watch([*base.road.vehicles, *base.road.objects], rows, on_road)

    def _by_itself(self, action: Any) -> None:
        """The frames as highway-env drives them, with whoever has a hand in them."""
        if self.watchers:
            raise ConfigError("frames that a shield supervises are not compiled, so there is nothing to be watched")
        base, drive = self._base, vars(self._base).pop("_simulate")
        try:
            base._simulate(action)
        finally:
            base._simulate = drive

    def _read(self) -> NetworkSimulator:
        """The scene as it is, in a simulator that has room for it."""
        base = self._base
        bodies = len(base.road.vehicles) + len(base.road.objects)
        simulator = self._simulators.get(bodies)
        if simulator is None or not simulator.fits(base):
            like = next(iter(self._simulators.values()), None)
            simulator = self._simulators[bodies] = NetworkSimulator(base, like=like)
        else:
            simulator.load(base)
        return simulator
