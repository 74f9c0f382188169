"""Compiling what a door calls before its first decision."""

from __future__ import annotations

from shield.doors.exact_door import ExactDoor, warm_up_exact
from shield.doors.exact_input_door import ExactInputDoor, warm_up_exact_inputs
from shield.doors.input_door import InputDoor
from shield.doors.meta_door import MetaDoor
from shield.doors.road_door import RoadDoor, warm_up_roads
from shield.doors.team_door import TeamDoor
from shield.procedures.warm_up import warm_up

__all__ = ["warm_up_door"]


def warm_up_door(door: MetaDoor | InputDoor | ExactDoor | ExactInputDoor | TeamDoor | RoadDoor) -> None:
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
