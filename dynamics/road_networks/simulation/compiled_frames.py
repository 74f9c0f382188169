"""`CompiledFrames`: a live highway-env on a road network with compiled frames."""

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

__all__ = ["CompiledFrames", "FramesCallback"]

FramesCallback = Callable[[list[Any], FloatArray, BoolArray], None]
"""A function that is called after the frames of a decision, with three arguments: the bodies of the road; their rows
after each frame, (frames, m, 7) as of `NetworkSimulator.step`; and whether the ego is on the road after each frame,
(frames,)."""


class CompiledFrames(gym.Wrapper[Any, Any, Any, Any]):
    """Compiles the frames of each decision. Resets, observations, rewards and changes between two decisions remain the
    environment's own, except that Kinematics is observed without a data frame. The results are the same to the last bit
    (if `exact`). Vehicles of the linear model collect no `data` for a regression.

    It takes any actions, and several egos with meta-actions. A film shows only the frames in which a decision is made.
    If `act` of a vehicle is replaced on the instance, as a shield that supervises frames does, highway-env itself
    simulates the decision, without a speed-up.

    Parameters
    ----------
    env : one of highway-env's environments on a road network; racetracks too.

    Raises
    ------
    ConfigError
        If the traffic is not known to follow from its state, the environment stores trajectories, or it has manual
        control. At the reset, if its actions are not supported.
    SceneError
        At the reset, if its lanes or its vehicles are not supported.
    PlatformError
        At the reset, if numpy's own loops are not found.

    Attributes
    ----------
    exact : whether the way in which this machine's numpy computes sums of products is known.
    watchers : called after the frames of each decision; a reset clears them.

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
        self.watchers: list[FramesCallback] = []
        self.exact = Sums.OTHER not in sums_of_numpy()

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        """Reset the environment and clear the watchers."""
        self._simulators, self.watchers = {}, []
        result = self.env.reset(**kwargs)
        self._read()
        without_data_frames(self._base.observation_type)
        # An attribute of the instance hides the method of the class that simulates the frames.
        self._base._simulate = self._simulate
        return result

    def close(self) -> None:
        """Restore the environment's own method for frames, and close it."""
        vars(self._base).pop("_simulate", None)
        super().close()

    def _simulate(self, action: Any = None) -> None:
        """Replacement of highway-env's `AbstractEnv._simulate`."""
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
        """Simulate the frames with highway-env, so that a replaced `act` of a vehicle is called."""
        if self.watchers:
            raise ConfigError("frames that a shield supervises are not compiled, so there is nothing to be watched")
        base, drive = self._base, vars(self._base).pop("_simulate")
        try:
            base._simulate(action)
        finally:
            base._simulate = drive

    def _read(self) -> NetworkSimulator:
        """The present scene in a simulator with a fitting number of bodies."""
        base = self._base
        bodies = len(base.road.vehicles) + len(base.road.objects)
        simulator = self._simulators.get(bodies)
        if simulator is None or not simulator.fits(base):
            like = next(iter(self._simulators.values()), None)
            simulator = self._simulators[bodies] = NetworkSimulator(base, like=like)
        else:
            simulator.load(base)
        return simulator
