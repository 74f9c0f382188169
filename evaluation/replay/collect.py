"""Recording of one shielded episode in highway-env itself, for its replay."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from highway_env.envs.common.action import ContinuousAction

from dynamics.road_networks.geometry.road_geometry import RoadGeometry
from dynamics.roads.straight import StraightRoad
from dynamics.vehicle.actuators import Actuators
from evaluation.measuring.recorder import read_road
from evaluation.replay.areas import areas_at
from evaluation.replay.frames import frames_of
from evaluation.replay.record import LaneDrawn, Replay, ReplayBody, ReplayOverride, ReplayStep, WhatIf, rounded
from evaluation.replay.what_if import copy_without_recorder, what_if
from evaluation.report.draw import WorldFrame
from evaluation.report.proposal import action_labels
from evaluation.running.driver import Driver, DriverSpec
from evaluation.running.identity import versions
from evaluation.running.records import EpisodeRecord, ShieldVariant
from evaluation.settings import Setting
from evaluation.threads import one_thread
from shield import Shield, ShieldedEnv
from shield.certificate.network.workspace import NetworkPrediction
from shield.decision import Decision
from shield.explaining.words import action_name, inputs_name
from shield.explanation import Explanation
from shield.filters.network import NetworkFilter

__all__ = ["RecordedStep", "ReplayRequest", "collect"]

_SAMPLE = 2.0
"""Distance of two points of the edge of a curved lane [m]."""
_APART = 1.0
"""Least time between two simulations of refused proposals, for throttle and steering [s]."""


@dataclass(frozen=True, slots=True)
class ReplayRequest:
    """Specification of the episode, as in `evaluation.running.episodes.run_episode`."""

    setting: Setting
    policy: str
    variant: ShieldVariant
    seed: int
    algorithm: str | None = None
    model: str | None = None
    sensor: str = "exact"


@dataclass(slots=True)
class RecordedStep:
    """One step.

    Attributes
    ----------
    first : index of its first frame.
    record : the shield's record.
    frames : decisions about the frames.
    inputs : acceleration [m/s^2] and steering [rad] of each frame.
    foreseen : on a road network, the reachable lane intervals in each frame.
    explanation : explanation of the record.
    what_if : simulation of the refused proposal, if there is one.
    """

    first: int
    record: Decision
    frames: list[Decision]
    inputs: list[tuple[float, float]]
    foreseen: list[NetworkPrediction]
    explanation: Explanation
    what_if: WhatIf | None = None


class _ReplayRecorder:
    """Records an episode as it is driven; `Driver.run` calls `before` and `after`."""

    def __init__(self, driver: Driver, request: ReplayRequest, follows: bool) -> None:
        self.driver, self.request, self.follows = driver, request, follows
        shielded = driver.env if driver.shield is None else driver.shield
        assert isinstance(shielded, Shield | ShieldedEnv)
        self.shielded = shielded
        shielded.record()
        self.base: Any = driver.env.unwrapped
        self.steps: list[RecordedStep] = []
        self._frames = self._first = self._next = 0
        self._inputs: list[tuple[float, float]] = []
        self._foreseen: list[NetworkPrediction] = []
        self._copied: Any = None
        self._column: dict[Any, int] = {}

    @property
    def filter(self) -> Any:
        """The filter of the actions."""
        return self.shielded.filter if isinstance(self.shielded, ShieldedEnv) else self.shielded.filters[0]

    def before(self, number: int) -> None:
        """Prepare for the execution of a decision: start its frames, and copy the environment if it may be needed."""
        if number == 1:
            self._watch_frames()
        self._first, self._inputs, self._foreseen = self._frames, [], []
        self._copied = None
        if self.follows and not (self._inputs_only and self._frames < self._next):
            inner = self.driver.env.env if isinstance(self.driver.env, ShieldedEnv) else self.driver.env
            self._copied = copy_without_recorder(inner)
            columns, copied = self.driver.recorder.columns, self._copied.unwrapped.road
            there = self.base.road
            pairs = [
                *zip(there.vehicles, copied.vehicles, strict=True),
                *zip(there.objects, copied.objects, strict=True),
            ]
            self._column = {copy: columns[body] for body, copy in pairs if body in columns}

    def after(self, record: Decision) -> None:
        """Record the executed decision, and simulate its proposal if that was refused."""
        shielded = self.shielded
        frames = shielded.frame_decisions if isinstance(shielded, ShieldedEnv) else shielded.frame_decisions[0]
        seen = RecordedStep(self._first, record, list(frames), self._inputs, self._foreseen, record.explain())
        if self._copied is not None and record.overridden:
            request, buffer = self.request, self.shielded.config.buffer
            buffer_size = buffer.longitudinal, buffer.lateral
            seen.what_if = what_if(
                self._copied, record.proposed, request.policy, request.seed, buffer_size, self._column
            )
            self._next = self._first + round(_APART * self.base.config["simulation_frequency"])
        self._copied = None
        self.steps.append(seen)

    @property
    def _inputs_only(self) -> bool:
        return isinstance(self.base.action_type, ContinuousAction)

    def _watch_frames(self) -> None:
        inner = self.base.road.step

        def step(dt: float) -> None:
            action = self.base.vehicle.action
            self._inputs.append((float(action["acceleration"]), float(action["steering"])))
            if isinstance(self.filter, NetworkFilter) and not self.filter.cause:
                self._foreseen.append(self.filter.foreseen)
            self._frames += 1
            inner(dt)

        self.base.road.step = step


def collect(
    request: ReplayRequest, follows: bool = True, on_step: Callable[[float, Decision], None] | None = None
) -> tuple[Replay, EpisodeRecord]:
    """Drive an episode and record it.

    Parameters
    ----------
    request : specification of the episode.
    follows : whether refused proposals are simulated too (at most one a second for throttle and steering).
    on_step : called after each step, as in `evaluation.running.driver.Driver.run`.

    Returns
    -------
    The replay, and the record of the episode.
    """
    driver = Driver(
        DriverSpec(
            request.setting,
            request.policy,
            request.variant,
            request.algorithm,
            request.model,
            "highway-env",
            request.sensor,
        )
    )
    try:
        with one_thread():
            watch = _ReplayRecorder(driver, request, follows)

            def after(time: float, step: Decision) -> None:
                watch.after(step)
                if on_step is not None:
                    on_step(time, step)

            record = driver.run(request.seed, after, watch.before)
            return _replay(watch, record), record
    finally:
        driver.env.close()


def _replay(watch: _ReplayRecorder, record: EpisodeRecord) -> Replay:
    base, config = watch.base, watch.shielded.config
    world, columns = watch.driver.recorder.world(), watch.driver.recorder.columns
    dt, straight = 1.0 / base.config["simulation_frequency"], read_road(base.road.network)
    in_world = config.simulates or isinstance(watch.filter, NetworkFilter)
    road = WorldFrame() if in_world or straight is None else straight
    name, meta = _namer(base)
    geometry = RoadGeometry.of(base) if isinstance(watch.filter, NetworkFilter) else None
    return Replay(
        about={**_about(watch, record), "actions": "meta-actions" if meta else "inputs"},
        buffer=(config.buffer.longitudinal, config.buffer.lateral),
        dt=dt,
        straight=isinstance(straight, StraightRoad),
        lanes=_lanes(base.road.network),
        bodies=_bodies(world, columns),
        frames=frames_of(watch.steps, world, columns, road, meta, dt),
        steps=[_step(seen, name) for seen in watch.steps],
        overrides=[
            _override(number, seen, columns, dt, geometry)
            for number, seen in enumerate(watch.steps)
            if seen.record.overridden or seen.record.tier.fallback
        ],
    )


def _about(watch: _ReplayRecorder, record: EpisodeRecord) -> dict[str, Any]:
    request = watch.request
    return {
        "setting": record.setting,
        "environment": request.setting.env_id,
        "policy": record.policy,
        "seed": record.seed,
        "shield": request.variant.place,
        "mode": record.mode,
        "sensor": request.sensor,
        "verification": record.verification,
        "crashed": record.crashed,
        "off_road": record.off_road,
        "attribution": record.attribution,
        "return": record.return_,
        "steps": record.steps,
        "overridden": record.overridden,
        "held_back": record.held_back,
        "frames_overridden": record.frames_overridden,
        "violations": record.violations,
        "min_margin": record.min_margin,
        "min_gap": record.min_gap,
        "mean_speed": record.mean_speed,
        "duration": record.duration,
        "versions": versions(),
    }


def _namer(base: Any) -> tuple[Callable[[Any], str], bool]:
    """A function that names an action of the environment, and whether the actions are meta-actions."""
    labels = action_labels(base.action_type)
    if not isinstance(base.action_type, ContinuousAction):
        return (lambda action: action_name(labels, action)), True
    actuators = Actuators.of(base.action_type)

    def name(action: Any) -> str:
        read = actuators.read(action)
        return str(action) if read is None else inputs_name(actuators.physical(read))

    return name, False


def _lanes(network: Any) -> list[LaneDrawn]:
    return [_lane(lane) for lane in network.lanes_list()]


def _lane(lane: Any) -> LaneDrawn:
    bends = type(lane).__name__ != "StraightLane"
    ways = np.linspace(0.0, lane.length, max(2, int(lane.length / _SAMPLE) + 2) if bends else 2)
    left, right = (rounded([lane.position(s, side * lane.width_at(s) / 2) for s in ways]) for side in (-1, 1))
    lines = tuple(int(line) for line in lane.line_types)
    return LaneDrawn(left, right, (lines[0], lines[1]))


def _bodies(world: Any, columns: dict[Any, int]) -> list[ReplayBody]:
    sizes = world[:, :, 4:6].max(axis=0)
    return [ReplayBody(type(body).__name__, *map(float, sizes[k])) for body, k in columns.items()]


def _step(seen: RecordedStep, name: Callable[[Any], str]) -> ReplayStep:
    record = seen.record
    return ReplayStep(
        first=seen.first,
        proposed=name(record.proposed),
        executed=name(record.executed),
        tier=record.tier.value,
        reason=record.reason.value,
        intervention=record.intervention.value,
        guarantee=record.guarantee.value,
        overridden=record.overridden,
        fallback=record.tier.fallback,
        frames_overridden=record.frames_overridden,
        margin=float(record.margin),
        latency=record.latency,
        text=seen.explanation.text,
    )


def _override(
    number: int, seen: RecordedStep, columns: dict[Any, int], dt: float, geometry: RoadGeometry | None
) -> ReplayOverride:
    why = seen.explanation
    cause = -1 if why.cause is None else columns.get(why.cause.vehicle, -1)
    refused = seen.record if seen.record.refusal is None else seen.record.refusal[0]
    foreseen = None
    if geometry is not None and why.frame < len(seen.foreseen):
        foreseen = geometry, seen.foreseen[why.frame]
    return ReplayOverride(
        step=number,
        frame=seen.first + why.frame,
        refused=why.refused,
        clause=why.clause,
        why=why.why,
        done=why.done,
        proof=why.proof,
        text=why.text,
        short=why.short,
        binding=why.after,
        cause=cause,
        areas=areas_at(refused, why.after, dt, columns, foreseen),
        what_if=seen.what_if,
    )
