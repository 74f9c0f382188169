"""The procedure in a parking lot: nothing moves there but the ego, and distances are small.

An input (a, delta) is verified for the frames for which it is held: after it, the fail-safe (brake against the velocity
to a stop, the wheel held) must keep the ego at `ShieldConfig.clearance` from every obstacle at every frame, and must
never bring about what highway-env counts as a collision in the coming frame. A proposal that does not verify is
replaced by the nearest input that does (`shield.repair.nearest_input`).

The assumption is that everything else stands still. It is looked at in every frame: once something moves, no
certificate is claimed, the ego brakes, and the record says `Reason.BAD_SCENE`.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from dynamics.scenes.parking_lot import Lot
from dynamics.scenes.rectangles import gaps
from dynamics.state import BoolArray, FloatArray, State
from dynamics.vehicle.actuators import Actuators
from dynamics.vehicle.bicycle import MAX_SPEED
from dynamics.vehicle.wheel_held_stops import stops
from shield.config import ShieldConfig
from shield.decision import Decision, Reason, Tier
from shield.errors import ConfigError
from shield.repair.nearest_input import Judged, Search

__all__ = ["LotCore", "StillnessMonitor"]

_ROUNDING = 1e-5
"""What rounding may amount to until a stop, single precision of actions included [m]."""
_FAR = 0.3
"""Distance from the proposal, in shares of the ranges, beyond which something nearer is looked for on a grid."""
_GRID = np.stack(np.meshgrid(np.linspace(0, 1, 11), np.linspace(0, 1, 13)), axis=-1).reshape(-1, 2)
"""Shares of the ranges of throttle and steering that are tried where the search has found nothing near; 0 of the
throttle stands for the brake."""
_NO_LANE = [0]
"""The search names the lane that is stopped in; here there is none."""


@dataclass(slots=True)
class StillnessMonitor:
    """Counts what moves in a lot where everything is assumed to stand.

    Attributes
    ----------
    count : how often something has begun to move. violated : whether something moves now.
    """

    count: int = 0
    violated: bool = False
    _last: BoolArray | None = None

    def update(self, moving: BoolArray) -> None:
        """Take in which obstacles move now, (m,); they are matched by their order."""
        known = self._last is not None and self._last.shape == moving.shape
        self.count += int((moving & ~self._last if known else moving).sum())  # type: ignore[operator]
        self.violated, self._last = bool(moving.any()), moving


class LotCore:
    """Filters throttle and steering in a parking lot.

    Parameters
    ----------
    config : settings; `ShieldConfig()` by default. Of them, `mode`, `clearance` and `braking` count here.
    actuators : what the policy controls.
    period : where the shield acts through the actions only, the simulation frames for which each is held. Without it,
        the shield acts at every frame, and may use the brake (`config.braking`) and the wheel in any case.

    Attributes
    ----------
    stored_wheel : front wheel angle with which the fail-safe that was verified last brakes [rad]; None without one.
    monitor : counts how often something in the lot has begun to move.

    Raises
    ------
    ConfigError
        If the mode is one of the rules for meta-actions, or the actions cannot brake both ways.
    """

    def __init__(
        self, config: ShieldConfig | None = None, actuators: Actuators | None = None, period: int | None = None
    ) -> None:
        self.config = config if config is not None else ShieldConfig()
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
        self.reset()

    def reset(self) -> None:
        """Forget everything about the episode."""
        self.stored_wheel: float | None = None
        self.monitor = StillnessMonitor()

    def filter(self, lot: Lot, proposal: FloatArray) -> tuple[FloatArray, Decision]:
        """What the actuators get for the next frame, or decision.

        Parameters
        ----------
        lot : the scene now.
        proposal : (acceleration [m/s^2], front wheel angle [rad]), shape (2,).

        Returns
        -------
        The inputs (2,), `proposal` itself where it verifies; and the record, whose plan is in the world frame.
        """
        start = perf_counter()
        # Faster than MAX_SPEED, highway-env limits the throttle: its frames are others than those that are verified.
        if not lot.finite or abs(lot.ego[State.SPEED]) > MAX_SPEED:
            return self.brake_inputs(lot, proposal, Reason.BAD_SCENE, start)
        self.monitor.update(lot.moving)
        if self.monitor.violated:
            answer = self.brake_inputs(lot, proposal, Reason.BAD_SCENE, start)
            self.stored_wheel = None
            return answer
        judged = self._judge(lot, proposal[None])
        if judged.margin[0] >= 0:
            return proposal, self._record(lot, proposal, judged, Reason.NONE, Tier.PASSED, start)
        return self._repair(lot, proposal, start)

    def brake_inputs(
        self,
        lot: Lot | None,
        proposal: Any,
        reason: Reason,
        start: float,
        floor: float = 0.0,
    ) -> tuple[FloatArray, Decision]:
        """The fail-safe manoeuvre's inputs for one frame, or decision: the wheel as it was stored, else straight.

        Without a readable scene, or with an ego that is not finite in it, the brake is `floor`, the acceleration that
        just stops the ego [m/s^2], as far as the brake goes.
        """
        if lot is not None and np.isfinite(lot.ego).all():
            floor = -float(lot.ego[State.SPEED]) / (self._frames * lot.dt)
        wheel = self.stored_wheel if self.stored_wheel is not None else 0.0
        inputs = np.array([np.clip(floor, -self._braking, self._braking), wheel])
        return inputs, Decision(proposal, inputs, reason, Tier.EMERGENCY, np.nan, perf_counter() - start)

    # -- repair ------------------------------------------------------------------------------------------

    def _repair(self, lot: Lot, proposal: FloatArray, start: float) -> tuple[FloatArray, Decision]:
        law, _ = self.brake_inputs(lot, proposal, Reason.UNVERIFIED, start)
        stored = self.stored_wheel is not None
        if not stored:
            law[1] = proposal[1]
        limits = np.array([self.actuators.acceleration, self.actuators.steering]).T
        if self._agent and not self.actuators.lateral:
            limits[:, 1] = 0.0
        spans = np.ptp([self.actuators.acceleration, self.actuators.steering], axis=1)
        # Beyond the actuators' range there is the brake, and that only as far as it stops the ego.
        low, high = np.minimum(np.minimum(limits[0], law), proposal), np.maximum(np.maximum(limits[1], law), proposal)
        search = Search(lambda inputs, lanes, parts: self._judge(lot, inputs), proposal, spans, low, high)
        judged = search.run(_NO_LANE, law)
        far = float(np.hypot(*((judged.inputs[0] - proposal) / spans))) if judged.margin[0] >= 0 else np.inf
        if far > _FAR:
            # What verifies may lie neither near the proposal nor on the way to the brake: anywhere at all.
            tried = low + _GRID * (high - low)
            tried[_GRID[:, 0] == 0, 0] = law[0]
            grid = self._judge(lot, tried)
            distance = np.where(grid.margin >= 0, np.hypot(*((grid.inputs - proposal) / spans).T), np.inf)
            nearest = int(distance.argmin())
            judged = grid.row(nearest) if distance[nearest] < far else judged
        if judged.margin[0] >= 0:
            return judged.inputs[0], self._record(lot, proposal, judged, Reason.UNVERIFIED, Tier.GOVERNED, start)
        if stored:
            # The end of what was verified a frame ago, of which rounding can have taken a trifle.
            kept = self._judge(lot, law[None])
            if kept.margin[0] >= -_ROUNDING:
                return law, self._record(lot, proposal, kept, Reason.NO_SAFE_PLAN, Tier.STORED_PLAN, start)
        decision = self._record(lot, proposal, judged, Reason.NO_SAFE_PLAN, Tier.LARGEST_MARGIN, start)
        self.stored_wheel = None
        return judged.inputs[0], decision

    def _judge(self, lot: Lot, inputs: FloatArray) -> Judged:
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

    def _record(
        self, lot: Lot, proposal: FloatArray, judged: Judged, reason: Reason, tier: Tier, start: float
    ) -> Decision:
        self.stored_wheel = float(judged.inputs[0, 1])
        plan = np.vstack([lot.ego[:4], judged.paths[0]])
        return Decision(proposal, judged.inputs[0], reason, tier, float(judged.margin[0]), perf_counter() - start, plan)
