"""Compiling what a door calls before its first decision."""

from __future__ import annotations

from functools import cache

import gymnasium as gym
import numpy as np

from shield.compiling import announced
from shield.config import ShieldConfig
from shield.doors.road_door import RoadDoor
from shield.doors.simulated.exact_door import ExactDoor
from shield.doors.simulated.exact_input_door import ExactInputDoor
from shield.doors.simulated.team_door import TeamDoor
from shield.doors.which import Door
from shield.procedures.warm_up import warm_up

__all__ = ["warm_up_door", "warm_up_exact", "warm_up_exact_inputs", "warm_up_roads"]


def warm_up_door(door: Door | TeamDoor) -> None:
    """Let no decision of a door wait for a compiler."""
    if isinstance(door, TeamDoor):
        warm_up_exact(True)
    elif isinstance(door, ExactDoor):
        warm_up_exact(door.on_network)
    elif isinstance(door, ExactInputDoor):
        warm_up_exact_inputs()
    elif isinstance(door, RoadDoor):
        warm_up_roads()
    else:
        warm_up()


@cache
def warm_up_exact(network: bool) -> None:
    """What `warm_up` does for the other doors, on a straight highway or on a network of roads."""
    with announced("simulated networks" if network else "simulated highways"):
        env = gym.make("u-turn-v1") if network else gym.make("highway-fast-v0", config={"vehicles_count": 3})
        env.reset(seed=0)
        ExactDoor(env.unwrapped, ShieldConfig.exact()).rehearse()


@cache
def warm_up_exact_inputs() -> None:
    """What `warm_up` does for the other doors."""
    with announced("simulated throttle and steering"):
        env = gym.make("highway-fast-v0", config={"vehicles_count": 3, "action": {"type": "ContinuousAction"}})
        env.reset(seed=0)
        door = ExactInputDoor(env.unwrapped, ShieldConfig.exact())
        for action in ([0.0, 0.0], [1.0, 1.0], [np.nan, 0.0]):
            door.decide(action)


@cache
def warm_up_roads() -> None:
    """What `warm_up` does for the other doors."""
    with announced("worst case on networks"):
        env = gym.make("roundabout-v1")
        env.reset(seed=0)
        door = RoadDoor(env.unwrapped, ShieldConfig.for_roads())
        door.decide(1)
        door.frame()
