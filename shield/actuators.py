"""Throttle and steering (see `dynamics.actuators`)."""

from dynamics.actuators import Actuators

__all__ = ["Actuators"]
