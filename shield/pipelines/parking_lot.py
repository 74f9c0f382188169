"""The pipeline in a parking lot: only the ego moves, and distances are small.

An input (a, delta) is verified for the frames for which it is held, together with the fail-safe after it: braking to a
stop with the wheel held. The path must keep `ShieldConfig.clearance` from every obstacle at every frame. It must never
cause what highway-env counts as a collision in the coming frame. A proposal that does not verify is replaced by the
nearest input that does (`shield.alternatives.nearest_input`).

The assumption is that everything else stands still, which is checked in every frame. Once an obstacle moves there is no
certificate, the ego brakes, and the record has `Reason.BAD_SCENE`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dynamics.scenes.parking_lot import ParkingScene
from dynamics.scenes.rectangles import gaps
from dynamics.state import FloatArray, State
from dynamics.vehicle.actuators import Actuators
from dynamics.vehicle.bicycle import MAX_SPEED
from dynamics.vehicle.fixed_wheel_stops import stops
from shield.alternatives.nearest_input import JudgedInputs, NearestInputSearch
from shield.certificate.road.memory import Memory
from shield.certificate.road.monitor import ParkingMonitor
from shield.config import ShieldConfig
from shield.decision import Reason, Tier
from shield.errors import ConfigError
from shield.pipelines.decide import JudgedPlan, Plan, Unreadable

__all__ = ["ParkingLotPipeline"]

_ROUNDING = 1e-5
"""Bound on the rounding error up to a stop, single precision of actions included [m]."""
_FAR = 0.3
"""Distance from the proposal, in shares of the ranges, beyond which a grid is searched for a nearer input."""
_GRID = np.stack(np.meshgrid(np.linspace(0, 1, 11), np.linspace(0, 1, 13)), axis=-1).reshape(-1, 2)
"""Shares of the ranges of throttle and steering in that grid; 0 of the throttle stands for the brake."""
_NO_LANE = [0]
"""The search requires a stop lane; there is none in a parking lot."""


@dataclass(frozen=True, slots=True)
class _Now:
    """A parking lot together with the memory."""

    lot: ParkingScene
    memory: Memory[float]


class ParkingLotPipeline:
    """Decides about throttle and steering among obstacles that stand still; `Memory.stored` is the wheel angle [rad].

    Parameters
    ----------
    config : settings; `braking`, `clearance` and `mode` apply here.
    actuators : the policy's actuators.
    period : simulation frames for which each action is held, if the shield acts through the actions only. Without it,
        the shield acts at every frame, with the brake (`config.braking`) and the wheel, whatever the actuators are.

    Raises
    ------
    ConfigError
        If the mode is a rule for meta-actions, or the actions cannot brake both ways.
    """

    def __init__(self, config: ShieldConfig, actuators: Actuators | None = None, period: int | None = None) -> None:
        self.config = config
        if self.config.mode not in ("none", "full"):
            raise ConfigError(f"mode {self.config.mode!r} judges meta-actions; in a parking lot use none or full")
        self.actuators = actuators if actuators is not None else Actuators()
        self._agent, self._frames = period is not None, period if period is not None else 1
        self._braking = self.config.braking
        if self._agent:
            low, high = self.actuators.acceleration
            brake = min(-low, high) if self.actuators.longitudinal else 0.0
            if brake <= 0 and self.config.mode == "full":
                raise ConfigError(
                    "Shield brakes through the actions, and in a parking lot these cannot brake both ways: "
                    f"longitudinal is {self.actuators.longitudinal}, accelerations {low:g} to {high:g} m/s^2. "
                    "Use ShieldedEnv, or a throttle with a range such as (-5, 5)"
                )
            self._braking = min(self._braking, brake)

    def refuses(self, scene: ParkingScene, proposal: FloatArray | None) -> Reason | None:
        """Reason if the proposal is invalid or the parking lot cannot be judged; else None."""
        if proposal is None:
            return Reason.BAD_ACTION
        # Above MAX_SPEED highway-env limits the throttle, so its frames differ from the verified ones.
        good = scene.finite and abs(scene.ego[State.SPEED]) <= MAX_SPEED
        return None if good else Reason.BAD_SCENE

    def observe(self, memory: Memory[float], scene: ParkingScene) -> tuple[_Now, Memory[float]]:
        """Observe a parking lot: check that the obstacles stand still."""
        watch = memory.watch if isinstance(memory.watch, ParkingMonitor) else ParkingMonitor()
        memory = replace(memory, watch=watch.next(scene.moving))
        return _Now(scene, memory), memory

    def plans(self, view: _Now, proposal: FloatArray) -> Iterator[JudgedPlan[float]]:
        """The proposal, and the input nearest to it; no plans once an obstacle moves."""
        if view.memory.watch.violated:
            return
        yield JudgedPlan(Tier.PASSED, Reason.NONE, self._plan(view.lot, self.judge(view.lot, proposal[None]), proposal))
        nearest = self._nearest(view, proposal)
        yield JudgedPlan(Tier.GOVERNED, Reason.UNVERIFIED, self._plan(view.lot, nearest))

    def fall_back(self, view: _Now, proposal: FloatArray, tried: list[JudgedPlan[float]]) -> JudgedPlan[float]:
        """The stored stop as long as it keeps clear, else the least bad input. Once an obstacle moves, the last
        resort."""
        if view.memory.watch.violated:
            tier, plan = self.last_resort(view.memory, view.lot, proposal)
            return JudgedPlan(tier, Reason.BAD_SCENE, replace(plan, stored=None))
        if view.memory.stored is not None:
            # The rest of the plan verified a frame ago, up to the rounding error.
            fail_safe_inputs = self._fail_safe_inputs(view, proposal)
            kept = self.judge(view.lot, fail_safe_inputs[None])
            if kept.margin[0] >= -_ROUNDING:
                return JudgedPlan(Tier.STORED_PLAN, Reason.NO_SAFE_PLAN, self._plan(view.lot, kept, fail_safe_inputs))
        return JudgedPlan(Tier.LARGEST_MARGIN, Reason.NO_SAFE_PLAN, tried[-1].plan)

    def last_resort(
        self, memory: Memory[float], scene: ParkingScene | Unreadable, proposal: FloatArray | None
    ) -> tuple[Tier, Plan[float]]:
        """Inputs of the fail-safe: the stored wheel angle, or 0 without one."""
        floor = 0.0
        if isinstance(scene, Unreadable):
            floor = float(np.nan_to_num(scene.stopping))
        elif np.isfinite(scene.ego).all():
            floor = -float(scene.ego[State.SPEED]) / (self._frames * scene.dt)
        wheel = memory.stored if memory.stored is not None else 0.0
        inputs = np.array([np.clip(floor, -self._braking, self._braking), wheel])
        return Tier.EMERGENCY, Plan(inputs, stored=memory.stored)

    # -- repair ------------------------------------------------------------------------------------------

    def _fail_safe_inputs(self, view: _Now, proposal: FloatArray) -> FloatArray:
        """Inputs of the fail-safe, (2,); without a stored wheel angle, with the proposal's."""
        _, plan = self.last_resort(view.memory, view.lot, proposal)
        fail_safe_inputs: FloatArray = plan.action.copy()
        if view.memory.stored is None:
            fail_safe_inputs[1] = proposal[1]
        return fail_safe_inputs

    def _nearest(self, view: _Now, proposal: FloatArray) -> JudgedInputs:
        """The nearest input found; the least bad if none verifies."""
        lot, fail_safe_inputs = view.lot, self._fail_safe_inputs(view, proposal)
        limits = np.array([self.actuators.acceleration, self.actuators.steering]).T
        if self._agent and not self.actuators.lateral:
            limits[:, 1] = 0.0
        spans = np.ptp([self.actuators.acceleration, self.actuators.steering], axis=1)
        # Beyond the actuators' range the brake is available, up to a stop of the ego.
        low, high = (
            np.minimum(np.minimum(limits[0], fail_safe_inputs), proposal),
            np.maximum(np.maximum(limits[1], fail_safe_inputs), proposal),
        )
        search = NearestInputSearch(lambda inputs, lanes, parts: self.judge(lot, inputs), proposal, spans, low, high)
        judged = search.run(_NO_LANE, fail_safe_inputs)
        far = float(np.hypot(*((judged.inputs[0] - proposal) / spans))) if judged.margin[0] >= 0 else np.inf
        if far > _FAR:
            # Inputs that verify may lie neither near the proposal nor between it and the brake: search the whole range.
            tried = low + _GRID * (high - low)
            tried[_GRID[:, 0] == 0, 0] = fail_safe_inputs[0]
            grid = self.judge(lot, tried)
            distance = np.where(grid.margin >= 0, np.hypot(*((grid.inputs - proposal) / spans).T), np.inf)
            nearest = int(distance.argmin())
            judged = grid.row(nearest) if distance[nearest] < far else judged
        return judged

    @staticmethod
    def _plan(lot: ParkingScene, judged: JudgedInputs, action: FloatArray | None = None) -> Plan[float]:
        """The plan of the first judged input."""
        path = np.vstack([lot.ego[:4], judged.paths[0]])
        inputs = judged.inputs[0]
        margin, clear = float(judged.margin[0]), int(judged.clear[0])
        return Plan(inputs if action is None else action, margin, float(inputs[1]), path, clear=clear)

    def judge(self, lot: ParkingScene, inputs: FloatArray) -> JudgedInputs:
        """Margins of inputs (n, 2), each held and followed by the fail-safe; the parts are the margins from each
        obstacle."""
        if self._agent:
            # Verify the inputs that result from the normalised actions, rounding included.
            inputs = self.actuators.physical(self.actuators.normalised(inputs))
        length, width = lot.ego[4:]
        period = self._frames
        paths = stops(lot.ego[:4], inputs, period, self._braking, lot.dt, period, length)
        now, coming = gaps(paths, (length, width), lot.boxes, lot.dt)
        clearances = np.minimum(now - self.config.clearance, coming - _ROUNDING)
        parts = clearances.min(axis=1)
        margin = parts.min(axis=1, initial=np.inf)
        margin[np.abs(paths[..., State.SPEED]).max(axis=1) > MAX_SPEED] = -np.inf
        bad: Any = np.any(clearances < 0, axis=2)
        clear = np.where(bad.any(axis=1), bad.argmax(axis=1), paths.shape[1])
        return JudgedInputs(inputs, margin, clear, np.zeros(len(inputs), dtype=int), paths, parts)
