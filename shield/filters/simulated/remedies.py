"""Advice in the message of a refusal: other settings that filter the same actions in the same environment, each
tried."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from highway_env.envs.common.action import ContinuousAction

from shield.certificate.network.others import default_on, has_crossings
from shield.config import ShieldConfig
from shield.filters.network import NetworkFilter
from shield.filters.simulated.inputs import SimulatedInputFilter
from shield.filters.simulated.meta_actions import SimulatedMetaActionFilter
from shield.filters.simulated.multi_agent import MultiAgentFilter, is_multi_agent

__all__ = ["default_advice", "multi_agent_advice", "simulation_advice"]


def simulation_advice(base: Any) -> str:
    """Advice to have the actions of one ego filtered by `ShieldConfig.simulated_traffic()`; "" where that refuses them
    too.

    Parameters
    ----------
    base : highway-env's environment, unwrapped. The check leaves it unchanged.
    """
    filters = SimulatedInputFilter if isinstance(base.action_type, ContinuousAction) else SimulatedMetaActionFilter
    if not _accepted(filters, base, ShieldConfig.simulated_traffic()):
        return ""
    return (
        "pass ShieldConfig.simulated_traffic(), which simulates the traffic here: "
        "ShieldedEnv(env, ShieldConfig.simulated_traffic()), "
        "Shield(policy, env, ShieldConfig.simulated_traffic()), "
        "or as TOML what `shield config --profile simulated` prints"
    )


def multi_agent_advice(base: Any) -> str:
    """Advice to have the meta-actions of several egos filtered; "" where they are refused.

    Parameters
    ----------
    base : highway-env's environment, unwrapped, with `MultiAgentAction`. The check leaves it unchanged.
    """
    accepted = is_multi_agent(base) and _accepted(MultiAgentFilter, base, ShieldConfig.simulated_traffic())
    return "ShieldedEnv(env, ShieldConfig.simulated_traffic()) filters those of several" if accepted else ""


def default_advice(base: Any) -> str:
    """Advice that the default settings filter meta-actions on a road network; "" where they do not.

    Parameters
    ----------
    base : highway-env's environment, unwrapped, with `DiscreteMetaAction`. The check leaves it unchanged.
    """
    if not has_crossings(base) or not _accepted(NetworkFilter, base, default_on(base)):
        return ""
    return (
        "by default ShieldedEnv(env) and Shield(policy, env=env) filter meta-actions here: without a rule or a mode, "
        "without frames=False, and with the simulator's perception"
    )


def _accepted(filters: Callable[[Any, ShieldConfig], Any], base: Any, config: ShieldConfig) -> bool:
    """Whether a filter can be constructed for an environment."""
    try:
        filters(base, config)
    except Exception:
        # The user did not choose these settings: an error of the check must not hide the message that it is for.
        return False
    return True
