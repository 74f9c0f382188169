"""The last word on the ego's low-level action at every simulation frame: a hook on its `act`."""

from __future__ import annotations

from collections.abc import Callable
from types import MethodType
from typing import Any

from shield.pipelines.frames import FrameCommand

__all__ = ["Command", "Supervision", "limited_braking"]

Command = FrameCommand | dict[str, float] | None
"""What the actuators get for one frame: a lane and an acceleration, or both inputs as highway-env names them; None
where the environment's own low-level action stands."""


def limited_braking(acceleration: float, speed: float, frequency: float) -> float:
    """An acceleration, limited so that braking ends in a standstill: it never makes the ego drive backwards, and an
    ego that drives backwards is braked too [m/s^2].

    Parameters
    ----------
    acceleration : asked for [m/s^2]; below zero it is braking. speed : of the ego [m/s], below zero backwards.
    frequency : frames per second.

    Examples
    --------
    >>> limited_braking(-9.8, 20.0, 5), limited_braking(-9.8, 1.0, 5), limited_braking(-9.8, -8.0, 5)
    (-9.8, -5.0, 9.8)
    """
    stopping = -speed * frequency
    if speed < 0:
        return max(acceleration, min(-acceleration, stopping))
    return max(acceleration, stopping)


class Supervision:
    """Lets `frame` have the last word on what one vehicle does, from `install` to `remove`.

    highway-env calls `vehicle.act(action)` with the decision's action, and `vehicle.act()` at each frame. A copy of the
    vehicle is not supervised: it lives in another road than the one that `frame` reads.

    Parameters
    ----------
    env : the environment, unwrapped. frame : asked once a frame, after the vehicle's own controllers.
    """

    def __init__(self, env: Any, frame: Callable[[], Command]) -> None:
        self._env, self._frame, self._ego = env, frame, env.vehicle

    def install(self) -> Supervision:
        """Stand in the place of the vehicle's `act`."""
        self._ego.act = self
        return self

    def remove(self) -> None:
        """Give the vehicle its own `act` back."""
        if self._ego.__dict__.get("act") is self:
            del self._ego.act

    def supervises(self, ego: Any) -> bool:
        """Whether this stands in the place of that vehicle's `act`."""
        return ego is self._ego and ego.__dict__.get("act") is self

    def __enter__(self) -> Supervision:
        return self.install()

    def __exit__(self, *_: Any) -> None:
        self.remove()

    def __deepcopy__(self, memo: dict[int, Any]) -> Any:
        copied = memo.get(id(self._ego))
        return MethodType(type(self._ego).act, self._ego if copied is None else copied)

    def __call__(self, action: Any = None) -> None:
        ego = self._ego
        type(ego).act(ego, action)
        if action is not None:
            return
        command = self._frame()
        if isinstance(command, dict):
            ego.action = command
        elif command is not None:
            lane = (*ego.target_lane_index[:2], command.lane)
            if command.lane != ego.target_lane_index[2]:
                ego.target_lane_index = lane
            wheel, frequency = command.steering, self._env.config["simulation_frequency"]
            ego.action = {
                "steering": ego.steering_control(lane) if wheel is None else wheel,
                "acceleration": limited_braking(command.acceleration, float(ego.speed), frequency),
            }
