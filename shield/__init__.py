"""A runtime safety shield around learned driving policies on highway-env.

Modules are imported on first use, so `import shield` is fast.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import lazy_loader

try:
    from dynamics import __version__ as __version__
    from dynamics.packages import refuse_hidden, warn_of_hidden
except ImportError as error:
    import dynamics

    raise ImportError(
        f"{dynamics.__file__} hides the package 'dynamics' of highway-shield: rename or move that file"
    ) from error

refuse_hidden("dynamics", "mpc")
warn_of_hidden("evaluation")

if TYPE_CHECKING:
    from dynamics.traffic.assumptions import Assumptions
    from shield.callback import ShieldCallback
    from shield.config import Buffer, ShieldConfig
    from shield.decision import Decision, Reason, Tier
    from shield.errors import ActionError, ConfigError, PolicyError, SceneError, ShieldError
    from shield.perception.grid_spec import GridSpec
    from shield.perception.known import Known
    from shield.perception.perceiving import PerceptionConfig
    from shield.perception.spec import ObservationSpec
    from shield.perception.unseen import Unseen
    from shield.wrappers.shielded_env import ShieldedEnv
    from shield.wrappers.shielded_policy import Shield

__all__ = [
    "ActionError",
    "Assumptions",
    "Buffer",
    "ConfigError",
    "Decision",
    "GridSpec",
    "Known",
    "ObservationSpec",
    "PerceptionConfig",
    "PolicyError",
    "Reason",
    "SceneError",
    "Shield",
    "ShieldCallback",
    "ShieldConfig",
    "ShieldError",
    "ShieldedEnv",
    "Tier",
    "Unseen",
]

__getattr__, _, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "callback": ["ShieldCallback"],
        "config": ["Assumptions", "Buffer", "ShieldConfig"],
        "decision": ["Decision", "Reason", "Tier"],
        "errors": ["ActionError", "ConfigError", "PolicyError", "SceneError", "ShieldError"],
        "perception.grid_spec": ["GridSpec"],
        "perception.known": ["Known"],
        "perception.perceiving": ["PerceptionConfig"],
        "perception.spec": ["ObservationSpec"],
        "perception.unseen": ["Unseen"],
        "wrappers.shielded_env": ["ShieldedEnv"],
        "wrappers.shielded_policy": ["Shield"],
    },
)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
