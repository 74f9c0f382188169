"""What a refusal of throttle and steering adds where they are verified by simulation."""

from __future__ import annotations

from typing import Any

from shield.config import ShieldConfig
from shield.doors.simulated.exact_input_door import ExactInputDoor

__all__ = ["by_simulation"]


def by_simulation(base: Any) -> str:
    """How to have throttle and steering filtered by `ShieldConfig.exact()`, in words; "" where that refuses them too.

    Parameters
    ----------
    base : highway-env's environment, unwrapped, with `ContinuousAction`. It is tried, and left as it is.
    """
    try:
        ExactInputDoor(base, ShieldConfig.exact())
    except Exception:
        # Whatever it is, it is not what the user has asked for, and must not hide what is told.
        return ""
    return (
        "pass ShieldConfig.exact(), which simulates the traffic here: ShieldedEnv(env, ShieldConfig.exact()), "
        "Shield(policy, env, ShieldConfig.exact()), or as TOML what `shield config --profile exact` prints"
    )
