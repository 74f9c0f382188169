"""The procedure in a parking lot: nothing moves there but the ego, and distances are small.

An input (a, delta) is verified for the frames for which it is held: after it, the fail-safe (brake against the velocity
to a stop, the wheel held) must keep the ego at `ShieldConfig.clearance` from every obstacle at every frame, and must
never bring about what highway-env counts as a collision in the coming frame. A proposal that does not verify is
replaced by the nearest input that does (`shield.alternatives.nearest_input`).

The assumption is that everything else stands still. It is looked at in every frame: once something moves, no
certificate is claimed, the ego brakes, and the record says `Reason.BAD_SCENE`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dynamics.scenes.parking_lot import Lot
from dynamics.scenes.rectangles import gaps
from dynamics.state import FloatArray, State
from dynamics.vehicle.actuators import Actuators
from dynamics.vehicle.bicycle import MAX_SPEED
from dynamics.vehicle.wheel_held_stops import stops
from shield.alternatives.nearest_input import Judged, Search
from shield.certificate.road.memory import Memory
from shield.certificate.road.monitor import Stillness
from shield.config import ShieldConfig
from shield.decision import Reason, Tier
from shield.errors import ConfigError
from shield.pipelines.decide import Plan, Tried, Unreadable

__all__ = ["ParkingLot"]

_ROUNDING = 1e-5
"""What rounding may amount to until a stop, single precision of actions included [m]."""
_FAR = 0.3
"""Distance from the proposal, in shares of the ranges, beyond which something nearer is looked for on a grid."""
_GRID = np.stack(np.meshgrid(np.linspace(0, 1, 11), np.linspace(0, 1, 13)), axis=-1).reshape(-1, 2)
"""Shares of the ranges of throttle and steering that are tried where the search has found nothing near; 0 of the
throttle stands for the brake."""
_NO_LANE = [0]
"""The search names the lane that is stopped in; here there is none."""


@dataclass(frozen=True, slots=True)
class _Now:
    """A lot as it is seen with a memory."""

    lot: Lot
    memory: Memory[float]


class ParkingLot:
    """Decides about throttle and steering among obstacles that stand still; `Memory.stored` is the wheel angle [rad].

    Parameters
    ----------
    config : settings; `braking`, `clearance` and `mode` count here.
    actuators : what the policy controls.
    period : where the shield acts through the actions only, the simulation frames for which each is held. Without it,
        the shield acts at every frame, and may use the brake (`config.braking`) and the wheel in any case.

    Raises
    ------
    ConfigError
        If the mode is one of the rules for meta-actions, or the actions cannot brake both ways.
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

    def refuses(self, scene: Lot, proposal: FloatArray | None) -> Reason | None:
        """A proposal that is no input, or a lot that cannot be judged."""
        if proposal is None:
            return Reason.BAD_ACTION
        # Faster than MAX_SPEED, highway-env limits the throttle: its frames are others than those that are verified.
        good = scene.finite and abs(scene.ego[State.SPEED]) <= MAX_SPEED
        return None if good else Reason.BAD_SCENE

    def observe(self, memory: Memory[float], scene: Lot) -> tuple[_Now, Memory[float]]:
        """Take in a lot."""
        watch = memory.watch if isinstance(memory.watch, Stillness) else Stillness()
        memory = replace(memory, watch=watch.next(scene.moving))
        return _Now(scene, memory), memory

    def plans(self, view: _Now, proposal: FloatArray) -> Iterator[Tried[float]]:
        """The proposal, and the input nearest to it; nothing where anything moves."""
        if view.memory.watch.violated:
            return
        yield Tried(Tier.PASSED, Reason.NONE, self._plan(view.lot, self.judge(view.lot, proposal[None]), proposal))
        nearest = self._nearest(view, proposal)
        yield Tried(Tier.GOVERNED, Reason.UNVERIFIED, self._plan(view.lot, nearest))

    def fall_back(self, view: _Now, proposal: FloatArray, tried: list[Tried[float]]) -> Tried[float]:
        """The stored stop as long as it keeps clear; else the least bad. Where anything moves, the stored stop."""
        if view.memory.watch.violated:
            tier, plan = self.last_resort(view.memory, view.lot, proposal)
            return Tried(tier, Reason.BAD_SCENE, replace(plan, stored=None))
        if view.memory.stored is not None:
            # The end of what was verified a frame ago, of which rounding can have taken a trifle.
            law = self._law(view, proposal)
            kept = self.judge(view.lot, law[None])
            if kept.margin[0] >= -_ROUNDING:
                return Tried(Tier.STORED_PLAN, Reason.NO_SAFE_PLAN, self._plan(view.lot, kept, law))
        return Tried(Tier.LARGEST_MARGIN, Reason.NO_SAFE_PLAN, tried[-1].plan)

    def last_resort(
        self, memory: Memory[float], scene: Lot | Unreadable, proposal: FloatArray | None
    ) -> tuple[Tier, Plan[float]]:
        """The fail-safe's inputs: the wheel as it was stored, else straight."""
        floor = 0.0
        if isinstance(scene, Unreadable):
            floor = float(np.nan_to_num(scene.stopping))
        elif np.isfinite(scene.ego).all():
            floor = -float(scene.ego[State.SPEED]) / (self._frames * scene.dt)
        wheel = memory.stored if memory.stored is not None else 0.0
        inputs = np.array([np.clip(floor, -self._braking, self._braking), wheel])
        return Tier.EMERGENCY, Plan(inputs, stored=memory.stored)

    # -- repair ------------------------------------------------------------------------------------------

    def _law(self, view: _Now, proposal: FloatArray) -> FloatArray:
        _, plan = self.last_resort(view.memory, view.lot, proposal)
        law: FloatArray = plan.action.copy()
        if view.memory.stored is None:
            law[1] = proposal[1]
        return law

    def _nearest(self, view: _Now, proposal: FloatArray) -> Judged:
        """The nearest input that was found; the least bad where none verifies."""
        lot, law = view.lot, self._law(view, proposal)
        limits = np.array([self.actuators.acceleration, self.actuators.steering]).T
        if self._agent and not self.actuators.lateral:
            limits[:, 1] = 0.0
        spans = np.ptp([self.actuators.acceleration, self.actuators.steering], axis=1)
        # Beyond the actuators' range there is the brake, and that only as far as it stops the ego.
        low, high = np.minimum(np.minimum(limits[0], law), proposal), np.maximum(np.maximum(limits[1], law), proposal)
        search = Search(lambda inputs, lanes, parts: self.judge(lot, inputs), proposal, spans, low, high)
        judged = search.run(_NO_LANE, law)
        far = float(np.hypot(*((judged.inputs[0] - proposal) / spans))) if judged.margin[0] >= 0 else np.inf
        if far > _FAR:
            # What verifies may lie neither near the proposal nor on the way to the brake: anywhere at all.
            tried = low + _GRID * (high - low)
            tried[_GRID[:, 0] == 0, 0] = law[0]
            grid = self.judge(lot, tried)
            distance = np.where(grid.margin >= 0, np.hypot(*((grid.inputs - proposal) / spans).T), np.inf)
            nearest = int(distance.argmin())
            judged = grid.row(nearest) if distance[nearest] < far else judged
        return judged

    @staticmethod
    def _plan(lot: Lot, judged: Judged, action: FloatArray | None = None) -> Plan[float]:
        path = np.vstack([lot.ego[:4], judged.paths[0]])
        inputs = judged.inputs[0]
        margin, clear = float(judged.margin[0]), int(judged.clear[0])
        return Plan(inputs if action is None else action, margin, float(inputs[1]), path, clear=clear)

    def judge(self, lot: Lot, inputs: FloatArray) -> Judged:
        """Each input, held, and then the fail-safe; the parts of the margin are what each obstacle leaves of it."""
        if self._agent:
            # What is verified is what the environment will make of the action, rounding included.
            inputs = self.actuators.physical(self.actuators.normalised(inputs))
        length, width = lot.ego[4:]
        period = self._frames
        paths = stops(lot.ego[:4], inputs, period, self._braking, lot.dt, period, length)
        now, coming = gaps(paths, (length, width), lot.boxes, lot.dt)
        room = np.minimum(now - self.config.clearance, coming - _ROUNDING)
        parts = room.min(axis=1)
        margin = parts.min(axis=1, initial=np.inf)
        margin[np.abs(paths[..., State.SPEED]).max(axis=1) > MAX_SPEED] = -np.inf
        bad: Any = np.any(room < 0, axis=2)
        clear = np.where(bad.any(axis=1), bad.argmax(axis=1), paths.shape[1])
        return Judged(inputs, margin, clear, np.zeros(len(inputs), dtype=int), paths, parts)
