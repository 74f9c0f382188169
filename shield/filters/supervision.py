"""Override of the ego's low-level action at every simulation frame: a hook on its `act`."""

from __future__ import annotations

from collections.abc import Callable
from types import MethodType
from typing import Any

from shield.pipelines.frames import FrameCommand

__all__ = ["Command", "Supervision", "limited_braking"]

Command = FrameCommand | dict[str, float] | None
"""Command for one frame: a lane and an acceleration, or both inputs with highway-env's names. None keeps the
environment's own low-level action."""


def limited_braking(acceleration: float, speed: float, frequency: float) -> float:
    """Acceleration [m/s^2], limited so that braking ends in a standstill. It never makes the ego drive backwards, and
    brakes an ego that drives backwards.

    Parameters
    ----------
    acceleration : requested [m/s^2]; below zero it is braking. speed : of the ego [m/s], below zero backwards.
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
    """Replaces the low-level action of one vehicle by that of `frame`, from `install` to `remove`.

    highway-env calls `vehicle.act(action)` with the decision's action, and `vehicle.act()` at each frame. A copy of the
    vehicle is not supervised, because `frame` reads another road.

    Parameters
    ----------
    env : the environment, unwrapped. frame : called once a frame, after the vehicle's own controllers.
    """

    def __init__(self, env: Any, frame: Callable[[], Command]) -> None:
        self._env, self._frame, self._ego = env, frame, env.vehicle

    def install(self) -> Supervision:
        """Replace the vehicle's `act`."""
        self._ego.act = self
        return self

    def remove(self) -> None:
        """Restore the vehicle's own `act`."""
        if self._ego.__dict__.get("act") is self:
            del self._ego.act

    def supervises(self, ego: Any) -> bool:
        """Whether this object replaces the `act` of the given vehicle."""
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
