"""Where verification by simulation is refused, and where it is asked of what cannot do it."""

from __future__ import annotations

from typing import Any

from shield.config import ShieldConfig
from shield.errors import ConfigError

__all__ = ["check", "refuse_simulated", "require"]


def check(config: ShieldConfig) -> None:
    """Raise where settings are not for verification by simulation.

    Raises
    ------
    ConfigError
        If the traffic is not to be simulated, or the mode is another.
    """
    if not config.assumptions.simulated:
        raise ConfigError("verification by simulation needs Assumptions.exact(); ShieldConfig.exact() has them")
    require(config, "verification by simulation has", mode="full")


def require(config: ShieldConfig, has: str, instead: str = "", **wanted: Any) -> None:
    """Raise where settings are not as `wanted`.

    Parameters
    ----------
    has : who has them so, with its verb. instead : what takes others.

    Raises
    ------
    ConfigError
        That lists those which are not.
    """
    other = [name for name, value in wanted.items() if getattr(config, name) != value]
    if other:
        have = ", ".join(f"{name} = {wanted[name]!r}" for name in other)
        take = f"; take {instead} for another {', '.join(other)}" if instead else ""
        raise ConfigError(f"{has} {have} only{take}")


def refuse_simulated(config: ShieldConfig) -> None:
    """Raise where a door that does not simulate is asked to.

    Raises
    ------
    ConfigError
        If the settings have `Assumptions.exact()`.
    """
    if config.simulates:
        raise ConfigError(
            "Assumptions.exact() verifies by simulation, which Shield and ShieldedEnv do on roads whose traffic is "
            'known; here there are the profiles "idm", "moderate" and "rss"'
        )
