"""Where verification by simulation is refused, and where it is asked of what cannot do it."""

from __future__ import annotations

from shield.config import ShieldConfig
from shield.errors import ConfigError

__all__ = ["check", "refuse_simulated"]


def check(config: ShieldConfig) -> None:
    """Raise where settings are not for verification by simulation.

    Raises
    ------
    ConfigError
        If the traffic is not to be simulated, or the mode is another.
    """
    if not config.assumptions.simulated:
        raise ConfigError("verification by simulation needs Assumptions.exact(); ShieldConfig.exact() has them")
    wanted = {"mode": "full", "record": False}
    other = [name for name, value in wanted.items() if getattr(config, name) != value]
    if other:
        have = ", ".join(f"{name} = {wanted[name]!r}" for name in other)
        raise ConfigError(f"verification by simulation has {have} only")


def refuse_simulated(config: ShieldConfig) -> None:
    """Raise where a door that does not simulate is asked to.

    Raises
    ------
    ConfigError
        If the settings have `Assumptions.exact()`.
    """
    if config.assumptions.simulated and config.mode != "none":
        raise ConfigError(
            "Assumptions.exact() verifies meta-actions alone: Shield(policy, env, config, frames=False). ShieldedEnv, "
            'Shield with frames, and throttle and steering take the profiles "idm", "moderate" and "rss"'
        )
