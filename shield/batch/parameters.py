"""Settings of the shield as numbers and arrays, which all environments share."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dynamics.highway_simulator.scenario import Scenario
from dynamics.roads.straight import StraightRoad
from dynamics.state import FloatArray, IntArray
from dynamics.traffic.motion_limits import limits_of
from dynamics.traffic.occupancy import motion_settings
from dynamics.vehicle.controllers import KP_SPEED
from dynamics.vehicle.rollout_kernels import table_of
from shield.certificate.road.clauses.parameters import settings_of
from shield.certificate.road.verify import footprint_of
from shield.config import ShieldConfig

__all__ = ["NO_INDEX", "BatchParameters", "ScalarParameters", "batch_parameters_of"]

NO_INDEX = -1
"""Stands for no vehicle, no lane, no frame, no action."""


class ScalarParameters(NamedTuple):
    """Scalar settings.

    Attributes
    ----------
    braking : deceleration of the fail-safe [m/s^2]. dt : frame [s]. period : number of frames in a decision.
    decay : share of a speed error that remains after a decision.
    width, length : of a lane and of the road [m]. longitudinal, lateral : buffer [m].
    leader_braking, follower_braking, follower_acceleration : of the RSS rule [m/s^2].
    response, reaction : response times of the ego and of a follower [s]. ttc : least time to collision [s].
    slower, idle, faster : index of each action, or `NO_INDEX`. off : whether nothing is filtered.
    none, one : 0 and 1; a kernel is compiled again for each constant that it is called with.
    """

    braking: float
    dt: float
    period: int
    decay: float
    width: float
    length: float
    longitudinal: float
    lateral: float
    leader_braking: float
    follower_braking: float
    follower_acceleration: float
    response: float
    reaction: float
    ttc: float
    slower: int
    idle: int
    faster: int
    off: bool
    none: int = 0
    one: int = 1


class BatchParameters(NamedTuple):
    """Settings that all environments share.

    Attributes
    ----------
    centers : of the lanes, (lanes,) [m].
    size, settings, motion, limits : numbers of `Footprint`, of `Settings`, of `Motion` (with the marking tolerance and
        the lateral deviation), and of the limits of `rule_violations`.
    table, stretch, growth : of the road; a straight one needs none.
    target_speeds, labels : of the meta-actions, see `dynamics.highway_simulator.arrays.Rules`.
    numbers : scalars.
    """

    centers: FloatArray
    size: FloatArray
    settings: FloatArray
    motion: FloatArray
    limits: FloatArray
    table: FloatArray
    stretch: FloatArray
    growth: FloatArray
    target_speeds: FloatArray
    labels: IntArray
    numbers: ScalarParameters


def batch_parameters_of(
    config: ShieldConfig, scenario: Scenario, road: StraightRoad, length: float, width: float
) -> BatchParameters:
    """The settings of a configuration, for meta-actions on a straight road.

    Parameters
    ----------
    config : the configuration. scenario, road : of the environment. length, width : of the ego [m].
    """
    rules, a = scenario.rules, config.assumptions
    labels = rules.labels.tolist()
    dt, period = 1 / scenario.config["simulation_frequency"], rules.numbers[0]
    numbers = ScalarParameters(
        braking=config.braking,
        dt=dt,
        period=period,
        decay=(1 - KP_SPEED * dt) ** period,
        width=float(road.width),
        length=float(road.length),
        longitudinal=config.buffer.longitudinal,
        lateral=config.buffer.lateral,
        leader_braking=a.braking,
        follower_braking=a.follower_braking,
        follower_acceleration=a.acceleration,
        response=config.response_time,
        reaction=a.reaction_time,
        ttc=config.time_to_collision,
        slower=labels.index(4 if 4 in labels else 1),
        idle=labels.index(1) if 1 in labels else NO_INDEX,
        faster=labels.index(3) if 3 in labels else NO_INDEX,
        off=config.mode == "none",
    )
    return BatchParameters(
        centers=road.centers,
        size=footprint_of(length, width, config.buffer, None)[1],
        settings=settings_of(a, float(road.width), float(config.perception_range), 0.0, dt),
        motion=motion_settings(a, dt)[1],
        limits=limits_of(a, (dt, 1), 0.0, 0.0),
        table=table_of(road),
        stretch=np.zeros((2, 0)),
        growth=np.zeros((0, 2)),
        target_speeds=rules.target_speeds,
        labels=rules.labels,
        numbers=numbers,
    )
