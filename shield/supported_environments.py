"""Checks of settings and configurations that the shield does not support."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from shield.config import ShieldConfig
from shield.errors import ConfigError

__all__ = [
    "LOWEST",
    "LOWEST_SIMULATED",
    "check",
    "check_frequency",
    "check_perception",
    "check_target_speeds",
    "refuse_manual_control",
    "refuse_simulated",
    "require",
]

LOWEST = 5
"""Least simulation frequency for the worst case [Hz]."""
LOWEST_SIMULATED = 3
"""Least simulation frequency for simulated traffic [Hz]."""


def check(config: ShieldConfig) -> None:
    """Check that settings are for verification by simulation.

    Raises
    ------
    ConfigError
        If the traffic is not to be simulated, or the mode is another.
    """
    if not config.assumptions.simulated:
        raise ConfigError(
            "verification by simulation needs Assumptions.simulated_traffic(); "
            "ShieldConfig.simulated_traffic() has them"
        )
    require(config, "verification by simulation has", mode="full")


def require(config: ShieldConfig, has: str, instead: str = "", **wanted: Any) -> None:
    """Check that settings have the values in `wanted`.

    Parameters
    ----------
    has : subject and verb of the message. instead : alternative for other values.

    Raises
    ------
    ConfigError
        If some differ; the message lists these.
    """
    other = [name for name, value in wanted.items() if getattr(config, name) != value]
    if other:
        have = ", ".join(f"{name} = {wanted[name]!r}" for name in other)
        take = f"; take {instead} for another {', '.join(other)}" if instead else ""
        raise ConfigError(f"{has} {have} only{take}")


def refuse_simulated(config: ShieldConfig) -> None:
    """Check that settings are not for simulated traffic, where the filter does not simulate.

    Raises
    ------
    ConfigError
        If the settings have `Assumptions.simulated_traffic()`.
    """
    if config.simulates:
        raise ConfigError(
            "Assumptions.simulated_traffic() verifies by simulation, which Shield and ShieldedEnv do on roads "
            'whose traffic is known; here there are the profiles "idm", "moderate" and "rss"'
        )


def check_target_speeds(speeds: Any) -> None:
    """Check that meta-actions cannot make the ego drive backwards, and that SLOWER is slower.

    Parameters
    ----------
    speeds : target speeds of `DiscreteMetaAction` [m/s], (n,).

    Raises
    ------
    ConfigError
        If there are fewer than two, or one is not finite or below zero, or one is below the one before it.
    """
    each = np.asarray(speeds, dtype=float).reshape(-1)
    shown = ", ".join(f"{speed:g}" for speed in each)
    if (each < 0).any():
        raise ConfigError(
            f"target_speeds [{shown}] m/s: the shield does not verify an ego that drives backwards with meta-actions; "
            "leave out the speeds below 0"
        )
    if not np.isfinite(each).all() or each.size < 2 or (np.diff(each) < 0).any() or each[0] == each[-1]:
        raise ConfigError(f"target_speeds [{shown}] m/s: have two or more speeds in ascending order, from 0 on")


def check_perception(speeds: Any, config: ShieldConfig) -> None:
    """Check that the ego can brake from its greatest target speed within the perception range.

    Parameters
    ----------
    speeds : target speeds of `DiscreteMetaAction` [m/s], (n,). config : with the braking and the perception range.

    Raises
    ------
    ConfigError
        If the stopping distance from the greatest of them is longer than the range. Vehicles beyond it do not count.
    """
    fastest = float(np.max(np.asarray(speeds, dtype=float)))
    way = fastest**2 / (2 * config.braking)
    if config.mode == "full" and not config.simulates and way > config.perception_range:
        raise ConfigError(
            f"from the target speed {fastest:g} m/s the ego takes {way:.0f} m to stop at {config.braking:g} m/s^2, and "
            f"vehicles further away than {config.perception_range:g} m do not count: have target_speeds up to "
            f"{np.sqrt(2 * config.braking * config.perception_range):.0f} m/s, or set perception_range to {way:.0f}"
        )


def check_frequency(frequency: float, simulated: bool) -> None:
    """Check that the simulation frequency is at least the lowest that verification has been tested with.

    Parameters
    ----------
    frequency : `simulation_frequency` of highway-env's configuration [Hz].
    simulated : whether the traffic is simulated, instead of the worst case.

    Raises
    ------
    ConfigError
        If it is below `LOWEST_SIMULATED`, or `LOWEST`.
    """
    lowest = LOWEST_SIMULATED if simulated else LOWEST
    if frequency < lowest:
        raise ConfigError(
            f"simulation_frequency {frequency:g} Hz: {'simulated traffic' if simulated else 'the worst case'} is "
            f"verified from {lowest} Hz on. With fewer frames highway-env's own controllers overshoot and its traffic "
            f"breaks the assumptions; set simulation_frequency to {lowest} or more"
        )


def refuse_manual_control(config: Mapping[str, Any]) -> None:
    """Check that highway-env's configuration does not let the keyboard drive the ego, which drops all actions.

    Raises
    ------
    ConfigError
        If `manual_control` is set.
    """
    if config.get("manual_control"):
        raise ConfigError(
            "with manual_control the ego ignores all actions, so nothing that the shield verifies is executed; "
            "set manual_control to False"
        )
