"""Compilation of a filter's kernels before its first decision."""

from __future__ import annotations

from functools import cache

import gymnasium as gym
import numpy as np

from shield.compiling import announced, estimated_units
from shield.config import ShieldConfig
from shield.filters.network import NetworkFilter
from shield.filters.simulated.inputs import SimulatedInputFilter
from shield.filters.simulated.meta_actions import SimulatedMetaActionFilter
from shield.filters.simulated.multi_agent import MultiAgentFilter
from shield.pipelines.warm_up import warm_up
from shield.wrappers.filter_choice import Filter

__all__ = [
    "warm_up_explanations",
    "warm_up_filter",
    "warm_up_networks",
    "warm_up_simulated",
    "warm_up_simulated_inputs",
]

_EXPLANATIONS = {True: "simulated explanations on networks", False: "simulated explanations on highways"}
"""Parts, by whether the traffic is simulated as a road network."""


def warm_up_filter(action_filter: Filter | MultiAgentFilter) -> None:
    """Compile the kernels of a filter."""
    if isinstance(action_filter, MultiAgentFilter):
        warm_up_simulated(True)
    elif isinstance(action_filter, SimulatedMetaActionFilter):
        warm_up_simulated(action_filter.on_network)
    elif isinstance(action_filter, SimulatedInputFilter):
        warm_up_simulated_inputs()
    elif isinstance(action_filter, NetworkFilter):
        warm_up_networks()
    else:
        warm_up()


@cache
def warm_up_simulated(network: bool) -> None:
    """Compile the filter of meta-actions in simulated traffic, on a straight highway or on a road network."""
    with announced("simulated networks" if network else "simulated highways"):
        env = gym.make("u-turn-v1") if network else gym.make("highway-fast-v0", config={"vehicles_count": 3})
        env.reset(seed=0)
        SimulatedMetaActionFilter(env.unwrapped, ShieldConfig.simulated_traffic()).rehearse()
    _load_explanations(network)


@cache
def warm_up_simulated_inputs() -> None:
    """Compile the filter of throttle and steering in simulated traffic."""
    with announced("simulated throttle and steering"):
        env = gym.make("highway-fast-v0", config={"vehicles_count": 3, "action": {"type": "ContinuousAction"}})
        env.reset(seed=0)
        action_filter = SimulatedInputFilter(env.unwrapped, ShieldConfig.simulated_traffic())
        for action in ([0.0, 0.0], [1.0, 1.0], [np.nan, 0.0]):
            action_filter.decide(action)
    # Throttle and steering are simulated as on a network, even on a straight highway.
    _load_explanations(True)


@cache
def warm_up_explanations(network: bool) -> None:
    """Compile the kernels of `Decision.explain` in simulated traffic, or load them from the disk."""
    with announced(_EXPLANATIONS[network]):
        env = gym.make("u-turn-v1") if network else gym.make("highway-fast-v0", config={"vehicles_count": 3})
        env.reset(seed=0)
        SimulatedMetaActionFilter(env.unwrapped, ShieldConfig.simulated_traffic()).source(1).rehearse()


def _load_explanations(network: bool) -> None:
    """Load the kernels of explanations if they are compiled already. Otherwise the first explanation compiles them, so
    that no decision waits for that."""
    if not estimated_units(_EXPLANATIONS[network]):
        warm_up_explanations(network)


@cache
def warm_up_networks() -> None:
    """Compile the filter of meta-actions on road networks, in the worst case."""
    with announced("worst case on networks"):
        env = gym.make("roundabout-v1")
        env.reset(seed=0)
        action_filter = NetworkFilter(env.unwrapped, ShieldConfig.for_roads())
        action_filter.decide(1)
        action_filter.frame()
